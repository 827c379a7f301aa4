//! Answers with a blob: strong ETag (its hash), If-None-Match, and one Range (RFC 9110, sections 13 and 14).

use axum::body::Body;
use axum::response::{IntoResponse, Response};
use http::header::{self, HeaderName};
use http::{HeaderMap, HeaderValue, StatusCode};
use utoipa::openapi::{KnownFormat, ObjectBuilder, RefOr, Schema, SchemaFormat, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::app::App;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;

/// A file's content, as the API's description names it.
#[derive(Clone, Copy, Debug)]
pub struct Binary;

impl PartialSchema for Binary {
    fn schema() -> RefOr<Schema> {
        let format = SchemaFormat::KnownFormat(KnownFormat::Binary);
        ObjectBuilder::new().schema_type(Type::String).format(Some(format)).into()
    }
}

impl ToSchema for Binary {}

/// Blobs never change under their hash.
pub const IMMUTABLE: &str = "public, max-age=31536000, immutable";
/// What an address shows may change: ask again, and be told "not modified".
pub const REVALIDATE: &str = "no-cache";

/// Answers with the blob of this hash, or 404 as `what`.
pub async fn serve(
    app: &App,
    hash: &str,
    media_type: &str,
    cache: &'static str,
    headers: &HeaderMap,
    what: &str,
) -> ApiResult<Response> {
    let Some(length) = app.blobs.size(hash).await.map_err(ApiError::internal)? else {
        return Err(ApiError::not_found(what, hash));
    };
    let etag = format!("\"{hash}\"");
    let mut response = if matches(headers, &header::IF_NONE_MATCH, &etag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let wanted = match headers.get(header::IF_RANGE) {
            Some(condition) if condition.as_bytes() != etag.as_bytes() => Range::Whole,
            _ => parse_range(headers.get(header::RANGE), length),
        };
        match wanted {
            Range::Whole => body(app, hash, 0..length, StatusCode::OK).await?,
            Range::Part(range) => {
                let content_range = format!("bytes {}-{}/{length}", range.start, range.end - 1);
                let mut response = body(app, hash, range, StatusCode::PARTIAL_CONTENT).await?;
                insert(&mut response, header::CONTENT_RANGE, &content_range);
                response
            }
            Range::Outside => {
                let detail = format!("the content has {length} bytes");
                let mut response = ApiError::new(Code::RangeNotSatisfiable, detail).into_response();
                insert(&mut response, header::CONTENT_RANGE, &format!("bytes */{length}"));
                return Ok(response);
            }
        }
    };
    describe(&mut response, media_type, &etag, cache);
    insert(&mut response, header::ACCEPT_RANGES, "bytes");
    Ok(response)
}

/// Answers with something that is made when it is asked for. `etag`, in its quotes, must follow from what it is made of.
pub async fn made<B: IntoResponse>(
    etag: &str,
    media_type: &str,
    cache: &'static str,
    headers: &HeaderMap,
    make: impl AsyncFnOnce() -> ApiResult<B>,
) -> ApiResult<Response> {
    let mut response = if matches(headers, &header::IF_NONE_MATCH, etag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        make().await?.into_response()
    };
    describe(&mut response, media_type, etag, cache);
    Ok(response)
}

/// What every file says of itself. The content is a stranger's: no browser may take it for a page of ours.
fn describe(response: &mut Response, media_type: &str, etag: &str, cache: &'static str) {
    insert(response, header::CONTENT_TYPE, media_type);
    insert(response, header::ETAG, etag);
    insert(response, header::CACHE_CONTROL, cache);
    insert(response, header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    insert(response, header::CONTENT_SECURITY_POLICY, "default-src 'none'; sandbox");
}

async fn body(app: &App, hash: &str, range: std::ops::Range<u64>, status: StatusCode) -> ApiResult<Response> {
    let length = range.end - range.start;
    let stream = app.blobs.read(hash, range).await.map_err(ApiError::internal)?;
    let mut response = (status, Body::from_stream(stream)).into_response();
    response.headers_mut().insert(header::CONTENT_LENGTH, HeaderValue::from(length));
    Ok(response)
}

fn insert(response: &mut Response, name: HeaderName, value: &str) {
    if let Ok(value) = HeaderValue::from_str(value) {
        response.headers_mut().insert(name, value);
    }
}

fn matches(headers: &HeaderMap, name: &HeaderName, etag: &str) -> bool {
    headers.get_all(name).iter().filter_map(|value| value.to_str().ok()).any(|value| {
        value.split(',').map(str::trim).any(|tag| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == etag)
    })
}

#[derive(Debug, PartialEq, Eq)]
enum Range {
    Whole,
    Part(std::ops::Range<u64>),
    Outside,
}

/// One byte range; several ranges, other units and nonsense are answered with the whole, as the RFC allows.
fn parse_range(value: Option<&HeaderValue>, length: u64) -> Range {
    let spec = value.and_then(|value| value.to_str().ok()).and_then(|value| value.strip_prefix("bytes="));
    let Some((first, last)) = spec.and_then(|spec| spec.trim().split_once('-')) else { return Range::Whole };
    let number = |text: &str| text.parse::<u64>().ok();
    match (first.is_empty(), last.is_empty()) {
        (true, false) => match number(last) {
            Some(0) => Range::Outside,
            Some(_) if length == 0 => Range::Outside,
            Some(suffix) => Range::Part(length.saturating_sub(suffix)..length),
            None => Range::Whole,
        },
        (false, open) => match (number(first), if open { Some(u64::MAX) } else { number(last) }) {
            (Some(first), Some(last)) if first > last => Range::Whole,
            (Some(first), Some(_)) if first >= length => Range::Outside,
            (Some(first), Some(last)) => Range::Part(first..last.saturating_add(1).min(length)),
            _ => Range::Whole,
        },
        (true, true) => Range::Whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_follow_the_rfc() {
        let parse = |text: &'static str| parse_range(Some(&HeaderValue::from_static(text)), 100);
        assert_eq!(parse("bytes=0-9"), Range::Part(0..10));
        assert_eq!(parse("bytes=90-"), Range::Part(90..100));
        assert_eq!(parse("bytes=90-1000"), Range::Part(90..100));
        assert_eq!(parse("bytes=-10"), Range::Part(90..100));
        assert_eq!(parse("bytes=-1000"), Range::Part(0..100));
        assert_eq!(parse("bytes=100-"), Range::Outside);
        assert_eq!(parse("bytes=-0"), Range::Outside);
        for ignored in ["bytes=5-4", "bytes=0-1,5-6", "lines=0-1", "bytes=x-y", "bytes=-", "bytes"] {
            assert_eq!(parse(ignored), Range::Whole, "{ignored}");
        }
        assert_eq!(parse_range(None, 100), Range::Whole);
        assert_eq!(parse_range(Some(&HeaderValue::from_static("bytes=0-")), 0), Range::Outside);
    }
}
