//! Around every request: its id and span, one access-log line, metrics, an answer even to a panic, and that answer even
//! to clients that are still sending.

use std::panic::AssertUnwindSafe;
use std::time::Instant;

use axum::extract::{MatchedPath, Request};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures::FutureExt;
use http::{HeaderMap, HeaderName, HeaderValue, Method};
use metrics::{counter, histogram};
use tracing::Instrument;

use super::context::Context;
use super::read_on::read_on;
use crate::error::ApiError;
use crate::problems::Code;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

pub async fn observe(request: Request, next: Next) -> Response {
    let started = Instant::now();
    let context = Context::from_headers(request.headers());
    let method = request.method().clone();
    let route = request.extensions().get::<MatchedPath>().map_or("unmatched", MatchedPath::as_str).to_owned();
    let span = tracing::info_span!(
        "request",
        request.id = %context.request_id,
        trace.id = %context.trace_id,
        http.method = %method,
        http.route = %route,
    );
    let request_id = HeaderValue::from_str(&context.request_id);
    let request = read_on(request);
    let answer = async {
        if is_cross_site_write(&method, request.headers()) {
            let detail = "the browser says that this request comes from another site";
            return ApiError::new(Code::CrossSite, detail).into_response();
        }
        match AssertUnwindSafe(next.run(request)).catch_unwind().await {
            Ok(response) => response,
            Err(panic) => ApiError::internal(format!("panic: {}", panic_text(panic.as_ref()))).into_response(),
        }
    };
    async {
        let mut response = context.scope(answer).await;
        if let Ok(request_id) = request_id {
            response.headers_mut().insert(REQUEST_ID, request_id);
        }
        let status = response.status().as_u16();
        let seconds = started.elapsed().as_secs_f64();
        tracing::info!(http.status = status, seconds, "{method} {route} {status}");
        let labels = [("method", method.to_string()), ("route", route), ("status", status.to_string())];
        counter!("lightshaft_http_requests_total", &labels).increment(1);
        histogram!("lightshaft_http_request_seconds", &labels[..2]).record(seconds);
        response
    }
    .instrument(span)
    .await
}

/// Without logins, a page of any site could make a visitor's browser write here. Browsers tell on themselves.
fn is_cross_site_write(method: &Method, headers: &HeaderMap) -> bool {
    let is_write = !matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS);
    let site = headers.get("sec-fetch-site").and_then(|value| value.to_str().ok());
    is_write && site.is_some_and(|site| !matches!(site, "same-origin" | "none"))
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("of no known kind")
}
