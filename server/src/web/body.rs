//! Extractors that answer with problem documents: JSON bodies whose errors name the field, queries, path ids.

use std::time::Duration;

use axum::body::Body;
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use bytes::Bytes;
use http::HeaderMap;
use http::header::{CONTENT_LENGTH, CONTENT_TYPE};
use http::request::Parts;
use http_body_util::{BodyExt, LengthLimitError, Limited};
use serde::de::DeserializeOwned;
use uuid::Uuid;

use crate::app::Shared;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;

/// A JSON body.
#[derive(Clone, Copy, Debug)]
pub struct Json<T>(pub T);

impl<T: DeserializeOwned> FromRequest<Shared> for Json<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, app: &Shared) -> ApiResult<Self> {
        read_json(request, app.config.limits.json_bytes, app.config.limits.upload_stall).await.map(Self)
    }
}

/// A worker's report of success: JSON with a budget of its own.
#[derive(Clone, Copy, Debug)]
pub struct Report<T>(pub T);

impl<T: DeserializeOwned> FromRequest<Shared> for Report<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, app: &Shared) -> ApiResult<Self> {
        read_json(request, app.config.limits.report_bytes, app.config.limits.upload_stall).await.map(Self)
    }
}

async fn read_json<T: DeserializeOwned>(request: Request, limit: u64, within: Duration) -> ApiResult<T> {
    if !is_json(request.headers()) {
        return Err(ApiError::new(Code::UnsupportedMediaType, "expected Content-Type: application/json"));
    }
    parse(&read_whole(request, limit, within).await?)
}

pub fn is_json(headers: &HeaderMap) -> bool {
    media_type(headers).is_some_and(|media| media == "application/json" || media.ends_with("+json"))
}

/// A whole body that is kept in memory.
pub async fn read_whole(request: Request, limit: u64, within: Duration) -> ApiResult<Bytes> {
    let too_large = || ApiError::new(Code::TooLarge, format!("this body must be at most {limit} bytes"));
    if announced_length(request.headers()).is_some_and(|length| length > limit) {
        return Err(too_large());
    }
    let limited = Limited::new(request.into_body(), usize::try_from(limit).unwrap_or(usize::MAX));
    match tokio::time::timeout(within, limited.collect()).await {
        Ok(Ok(body)) => Ok(body.to_bytes()),
        Ok(Err(error)) if error.is::<LengthLimitError>() => Err(too_large()),
        Ok(Err(_)) => Err(ApiError::new(Code::IncompleteBody, "the body ended before its announced length")),
        Err(_) => Err(ApiError::new(Code::UploadStalled, "the body did not arrive in time")),
    }
}

fn announced_length(headers: &HeaderMap) -> Option<u64> {
    headers.get(CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// Reads JSON; syntax errors name line and column, all others every field that is wrong.
pub fn parse<T: DeserializeOwned>(bytes: &[u8]) -> ApiResult<T> {
    // Read twice, since a `Value` would hide fields that are given twice.
    match serde_json::from_slice(bytes) {
        Ok(read) if bytes.trim_ascii_start().starts_with(b"{") => Ok(read),
        first => {
            let value =
                serde_json::from_slice(bytes).map_err(|error| ApiError::new(Code::BadJson, error.to_string()))?;
            let first = first.err().map(|error| error.to_string()).unwrap_or_default();
            match lightshaft_api::read::from_value::<T>(value) {
                // What depends on the order of the fields, which is sorted now.
                Ok(read) if !first.contains("duplicate field") => Ok(read),
                Ok(_) => Err(ApiError::new(Code::BadJson, first)),
                Err(errors) => Err(ApiError::fields(errors)),
            }
        }
    }
}

/// A query string; unknown parameters are errors where the type denies them.
#[derive(Clone, Copy, Debug)]
pub struct Params<T>(pub T);

impl<T: DeserializeOwned> FromRequestParts<Shared> for Params<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &Shared) -> ApiResult<Self> {
        match Query::<T>::try_from_uri(&parts.uri) {
            Ok(Query(params)) => Ok(Self(params)),
            Err(rejection) => {
                let message = rejection.body_text();
                let detail = message.trim_start_matches("Failed to deserialize query string: ");
                let (name, detail) = match detail.split_once(": ") {
                    Some((name, detail)) if !name.contains(' ') => (name, detail),
                    _ => (detail.split('`').nth(1).unwrap_or_default(), detail),
                };
                Err(ApiError::bad_request(&format!("query/{name}"), detail))
            }
        }
    }
}

/// The one parameter of a path, as text.
#[derive(Clone, Debug)]
pub struct Id(pub String);

impl FromRequestParts<Shared> for Id {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &Shared) -> ApiResult<Self> {
        path(parts, app).await.map(Self)
    }
}

/// The two parameters of a path, as text.
#[derive(Clone, Debug)]
pub struct Ids(pub String, pub String);

impl FromRequestParts<Shared> for Ids {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &Shared) -> ApiResult<Self> {
        path(parts, app).await.map(|(first, second)| Self(first, second))
    }
}

/// The three parameters of a path, as text.
#[derive(Clone, Debug)]
pub struct ThreeIds(pub String, pub String, pub String);

impl FromRequestParts<Shared> for ThreeIds {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &Shared) -> ApiResult<Self> {
        path(parts, app).await.map(|(first, second, third)| Self(first, second, third))
    }
}

async fn path<T: DeserializeOwned + Send>(parts: &mut Parts, app: &Shared) -> ApiResult<T> {
    let read = axum::extract::Path::<T>::from_request_parts(parts, app).await;
    let unreadable = |_| ApiError::new(Code::NotFound, "the address holds no readable id");
    read.map(|axum::extract::Path(found)| found).map_err(unreadable)
}

/// The body as a stream of an upload, checked against a budget by its announced length first.
pub fn upload(request: Request, limit: u64) -> ApiResult<Body> {
    if announced_length(request.headers()).is_some_and(|length| length > limit) {
        return Err(ApiError::new(Code::TooLarge, format!("the body must be at most {limit} bytes")));
    }
    Ok(request.into_body())
}

/// The media type of a request in lower case, without parameters.
pub fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

/// The header `Idempotency-Key`, where there is one.
#[derive(Clone, Debug)]
pub struct IdempotencyKey(pub Option<String>);

impl<S: Sync> FromRequestParts<S> for IdempotencyKey {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> ApiResult<Self> {
        let Some(key) = parts.headers.get("idempotency-key") else { return Ok(Self(None)) };
        match key.to_str() {
            Ok(key) if (1..=255).contains(&key.len()) && key.bytes().all(|byte| byte.is_ascii_graphic()) => {
                Ok(Self(Some(key.to_owned())))
            }
            _ => Err(ApiError::bad_request("header/idempotency-key", "must be 1 to 255 visible ASCII characters")),
        }
    }
}

/// The rows a page may have, and where it starts.
#[derive(Clone, Debug, Default, serde::Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageParams {
    /// Rows, 1 to 200; 50 by default.
    pub limit: Option<u32>,
    /// `next_cursor` of the page before.
    pub cursor: Option<String>,
}

impl PageParams {
    pub fn limit(&self) -> ApiResult<u32> {
        match self.limit.unwrap_or(50) {
            limit @ 1..=200 => Ok(limit),
            _ => Err(ApiError::bad_request("query/limit", "must be 1 to 200")),
        }
    }

    /// Cursors are opaque to clients; inside, they are the last row's id.
    pub fn after_id(&self) -> ApiResult<Option<String>> {
        self.check_cursor(|cursor| Uuid::parse_str(cursor).is_ok_and(|id| id.to_string() == cursor))
    }

    pub fn after_hash(&self) -> ApiResult<Option<String>> {
        self.check_cursor(lightshaft_api::blob::is_hash)
    }

    fn check_cursor(&self, is_valid: impl Fn(&str) -> bool) -> ApiResult<Option<String>> {
        match &self.cursor {
            Some(cursor) if !is_valid(cursor) => {
                Err(ApiError::bad_request("query/cursor", "is not a cursor that this list gave"))
            }
            cursor => Ok(cursor.clone()),
        }
    }
}

#[cfg(test)]
mod tests {
    use lightshaft_api::job::NewJob;

    use super::*;

    #[test]
    fn wrong_fields_are_all_named() {
        let body = br#"{ "scene": "x", "settings": { "widht": 5, "spp": "many" } }"#;
        let error = parse::<NewJob>(body).unwrap_err();
        assert_eq!(error.code(), Code::InvalidFields);
        let text = error.to_string();
        assert!(text.contains("/settings/spp") && text.ends_with("(and 1 more)"), "{text}");
    }

    #[test]
    fn a_field_given_twice_is_refused() {
        let error = parse::<NewJob>(br#"{ "scene": "x", "scene": "y" }"#).unwrap_err();
        assert_eq!(error.code(), Code::BadJson);
        assert!(error.to_string().contains("duplicate field `scene`"), "{error}");
    }

    #[test]
    fn the_kind_of_a_job_may_stand_behind_its_settings() {
        let body = br#"{ "scene": "x", "settings": { "preset": "keul-4.1" }, "kind": "benchmark" }"#;
        assert_eq!(parse::<NewJob>(body).unwrap().kind.as_str(), "benchmark");
    }

    #[test]
    fn broken_json_is_named_by_line_and_column() {
        for body in ["{", "{\n \"scene\": }", "", "{} x", "\u{0}"] {
            let error = parse::<serde_json::Value>(body.as_bytes()).unwrap_err();
            assert_eq!(error.code(), Code::BadJson, "{body}");
            assert!(error.to_string().contains("line"), "{error}");
        }
    }
}
