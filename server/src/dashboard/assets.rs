//! Static files, embedded in the binary.
//!
//! All of them live below one version, the hash of their whole content: pages name the current version, modules
//! import each other relatively, and a browser may keep what it has for ever.

use std::sync::LazyLock;

use axum::extract::Path;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use rust_embed::Embed;

use super::page::SECURITY_HEADERS;

#[derive(Embed)]
#[folder = "src/dashboard/assets"]
pub(super) struct Assets;

/// Hash over the names and contents of all files.
static VERSION: LazyLock<String> = LazyLock::new(|| {
    let mut names: Vec<_> = Assets::iter().collect();
    names.sort();
    let mut hasher = blake3::Hasher::new();
    for name in names {
        if let Some(file) = Assets::get(&name) {
            hasher.update(name.as_bytes());
            hasher.update(&file.metadata.sha256_hash());
        }
    }
    hasher.finalize().to_hex()[..16].to_owned()
});

/// Address of the asset `file` in its current version.
pub(super) fn url(file: &str) -> String {
    format!("/assets/{}/{file}", *VERSION)
}

/// `GET /assets/{version}/{file}`. A page that was loaded from an older server names an older version: it gets the
/// current file, but may not keep it.
pub(super) async fn serve(Path((version, name)): Path<(String, String)>, headers: HeaderMap) -> Response {
    let Some(file) = Assets::get(&name) else {
        return (StatusCode::NOT_FOUND, SECURITY_HEADERS, "no such file").into_response();
    };
    let etag = format!("\"{}\"", &blake3::hash(&file.data).to_hex()[..32]);
    let cache = if version == *VERSION { "public, max-age=31536000, immutable" } else { "no-cache" };
    let known = headers
        .get(header::IF_NONE_MATCH)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|tags| tags.split(',').any(|tag| tag.trim().trim_start_matches("W/") == etag));
    let common = [(header::ETAG, etag), (header::CACHE_CONTROL, cache.to_owned())];
    if known {
        return (StatusCode::NOT_MODIFIED, SECURITY_HEADERS, common).into_response();
    }
    let media_type = [(header::CONTENT_TYPE, media_type(&name))];
    (SECURITY_HEADERS, common, media_type, file.data.into_owned()).into_response()
}

/// Browsers ask for `/favicon.ico` by themselves.
pub(super) async fn favicon() -> Redirect {
    Redirect::temporary(&url("favicon.svg"))
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("webmanifest") => "application/manifest+json",
        _ => "application/octet-stream",
    }
}
