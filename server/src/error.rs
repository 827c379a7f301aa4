//! [`ApiError`]: the one error of handlers. What a client sees is its code, detail and field errors; what went wrong
//! inside is kept apart, logged once, and never part of an answer.

use std::error::Error;
use std::fmt;

use axum::response::{IntoResponse, Response};
use http::{HeaderValue, header};
use lightshaft_api::problem::{FieldError, Problem};

use crate::problems::Code;
use crate::store::StoreError;
use crate::web::context;

#[derive(Debug)]
pub struct ApiError {
    code: Code,
    detail: String,
    errors: Vec<FieldError>,
    source: Option<Box<dyn Error + Send + Sync>>,
}

pub type ApiResult<T> = Result<T, ApiError>;

impl ApiError {
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        Self { code, detail: detail.into(), errors: Vec::new(), source: None }
    }

    pub fn not_found(what: &str, id: &str) -> Self {
        let id: String = id.chars().take(128).collect();
        Self::new(Code::NotFound, format!("there is no {what} `{id}`"))
    }

    /// Fields of a JSON body that are wrong.
    pub fn fields(errors: Vec<FieldError>) -> Self {
        Self::with_errors(Code::InvalidFields, errors)
    }

    /// A query parameter or header that is wrong: `query/limit`, `header/idempotency-key`.
    pub fn bad_request(pointer: &str, detail: &str) -> Self {
        Self::with_errors(Code::BadRequest, vec![FieldError::new(pointer, detail)])
    }

    pub fn with_errors(code: Code, errors: Vec<FieldError>) -> Self {
        let first = errors.first().map(|error| format!("{}: {}", error.pointer, error.detail)).unwrap_or_default();
        let detail = match errors.len() {
            0 | 1 => first,
            n => format!("{first} (and {} more)", n - 1),
        };
        Self { code, detail, errors, source: None }
    }

    /// Something of our own failed; the client learns nothing of it.
    pub fn internal(source: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        let detail = "the service failed to answer; its log has the reason".to_owned();
        Self { code: Code::Internal, detail, errors: Vec::new(), source: Some(source.into()) }
    }

    pub fn code(&self) -> Code {
        self.code
    }
}

impl fmt::Display for ApiError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.source {
            Some(source) => write!(f, "{}: {source}", self.detail),
            None => f.write_str(&self.detail),
        }
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        Self::internal(error)
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        if let Some(source) = &self.source {
            tracing::error!(error = %source, "request failed");
        }
        let request_id = context::request_id();
        let problem = Problem {
            kind: format!("/problems/{}", self.code.as_str()),
            code: self.code.as_str().to_owned(),
            title: self.code.title().to_owned(),
            status: self.code.status().as_u16(),
            detail: self.detail,
            errors: self.errors,
            instance: request_id.as_ref().map(|id| format!("/requests/{id}")),
            request_id,
        };
        let mut response = (self.code.status(), axum::Json(problem)).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        if matches!(self.code, Code::ShuttingDown | Code::NotReady) {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static("5"));
        }
        response
    }
}
