//! The JSON API, asked in process on behalf of whoever asked for the page.

use axum::Router;
use axum::body::Body;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, Request, StatusCode, header};
use axum::response::Response;
use lightshaft_api::problem::Problem;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use serde::de::DeserializeOwned;
use tower::ServiceExt;

use super::page::PageError;

/// The router of the API, shared by all pages.
#[derive(Clone)]
pub(super) struct ApiRouter(pub(super) Router);

/// The API with the credentials of one request. An extractor.
pub(super) struct Api {
    router: Router,
    forwarded: HeaderMap,
}

impl FromRequestParts<ApiRouter> for Api {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut Parts, state: &ApiRouter) -> Result<Self, Self::Rejection> {
        let mut forwarded = HeaderMap::new();
        for name in [header::AUTHORIZATION, header::COOKIE, header::HOST] {
            if let Some(value) = parts.headers.get(&name) {
                forwarded.insert(name, value.clone());
            }
        }
        Ok(Self { router: state.0.clone(), forwarded })
    }
}

/// Largest answer that a page reads: a scene with many thousand meshes stays below.
const MAX_ANSWER_BYTES: usize = 64 << 20;

impl Api {
    /// The value at `path`, or the problem that the API answered with.
    pub(super) async fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, PageError> {
        let response = self.send(path).await;
        let status = response.status();
        let unreadable = |reason: String| PageError::Unreadable { path: path.to_owned(), reason };
        let body = axum::body::to_bytes(response.into_body(), MAX_ANSWER_BYTES)
            .await
            .map_err(|error| unreadable(error.to_string()))?;
        if status.is_success() {
            serde_json::from_slice(&body).map_err(|error| unreadable(error.to_string()))
        } else {
            Err(match serde_json::from_slice::<Problem>(&body) {
                Ok(problem) => PageError::Problem(Box::new(problem)),
                Err(error) => unreadable(format!("status {status}: {error}")),
            })
        }
    }

    /// As [`Api::get`], but `None` where the API answers 404.
    pub(super) async fn find<T: DeserializeOwned>(&self, path: &str) -> Result<Option<T>, PageError> {
        match self.get(path).await {
            Ok(value) => Ok(Some(value)),
            Err(error) if error.status() == StatusCode::NOT_FOUND => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// The text at `path`.
    pub(super) async fn text(&self, path: &str) -> Result<String, PageError> {
        let unreadable = |reason: String| PageError::Unreadable { path: path.to_owned(), reason };
        let response = self.send(path).await;
        let status = response.status();
        if !status.is_success() {
            return Err(unreadable(format!("status {status}")));
        }
        let body = axum::body::to_bytes(response.into_body(), MAX_ANSWER_BYTES).await;
        let bytes = body.map_err(|error| unreadable(error.to_string()))?;
        String::from_utf8(bytes.to_vec()).map_err(|error| unreadable(error.to_string()))
    }

    async fn send(&self, path: &str) -> Response {
        let mut request = Request::new(Body::empty());
        match path.parse() {
            Ok(uri) => *request.uri_mut() = uri,
            Err(_) => return Response::builder().status(StatusCode::NOT_FOUND).body(Body::empty()).unwrap_or_default(),
        }
        *request.headers_mut() = self.forwarded.clone();
        match self.router.clone().oneshot(request).await {
            Ok(response) => response,
            Err(never) => match never {},
        }
    }
}

/// Characters that stay as they are in a path segment or query value (RFC 3986, unreserved).
const ESCAPED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');

/// `text` as one path segment or query value.
pub(super) fn escape(text: &str) -> String {
    utf8_percent_encode(text, ESCAPED).to_string()
}

/// `path?name=value&…` of the pairs whose value is not empty.
pub(super) fn with_query(path: &str, pairs: &[(&str, &str)]) -> String {
    let mut url = path.to_owned();
    for (name, value) in pairs.iter().filter(|(_, value)| !value.is_empty()) {
        url.push(if url.contains('?') { '&' } else { '?' });
        url.push_str(name);
        url.push('=');
        url.push_str(&escape(value));
    }
    url
}
