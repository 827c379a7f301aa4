//! What all pages share: how they are answered, and how errors look to a person.

use askama::Template;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{Html, IntoResponse, Response};
use lightshaft_api::problem::{FieldError, Problem};

/// Everything from this service, nothing inline, no frames around us.
pub const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' \
    blob:; connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// Headers of every page and asset.
pub(super) const SECURITY_HEADERS: [(HeaderName, &str); 4] = [
    (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "same-origin"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
];

/// A rendered template as an answer. Pages show what is now, so caches must ask again.
pub(super) struct Page<T>(pub(super) T);

impl<T: Template> IntoResponse for Page<T> {
    fn into_response(self) -> Response {
        answer(StatusCode::OK, &self.0)
    }
}

fn answer(status: StatusCode, template: &impl Template) -> Response {
    match template.render() {
        Ok(html) => (status, SECURITY_HEADERS, [(header::CACHE_CONTROL, "no-cache")], Html(html)).into_response(),
        Err(error) => {
            tracing::error!(%error, "a page could not be rendered");
            (StatusCode::INTERNAL_SERVER_ERROR, SECURITY_HEADERS, "This page could not be rendered.").into_response()
        }
    }
}

/// Why there is no page.
#[derive(Debug)]
pub(super) enum PageError {
    /// The API refused.
    Problem(Box<Problem>),
    /// The API answered with something that is not what it documents.
    Unreadable { path: String, reason: String },
}

impl PageError {
    pub(super) fn status(&self) -> StatusCode {
        match self {
            Self::Problem(problem) => StatusCode::from_u16(problem.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR),
            Self::Unreadable { .. } => StatusCode::INTERNAL_SERVER_ERROR,
        }
    }
}

impl IntoResponse for PageError {
    fn into_response(self) -> Response {
        let status = self.status();
        let page = match self {
            Self::Problem(problem) => ErrorPage {
                here: "",
                status: status.as_u16(),
                title: problem.title,
                detail: problem.detail,
                errors: problem.errors,
                request_id: problem.request_id,
            },
            Self::Unreadable { path, reason } => {
                tracing::error!(%path, %reason, "the API's answer could not be read");
                ErrorPage {
                    here: "",
                    status: status.as_u16(),
                    title: "Something went wrong here".to_owned(),
                    detail: "The service could not read its own data for this page. Its log says more.".to_owned(),
                    errors: Vec::new(),
                    request_id: None,
                }
            }
        };
        answer(status, &page)
    }
}

#[derive(Template)]
#[template(path = "error.html")]
struct ErrorPage {
    here: &'static str,
    status: u16,
    title: String,
    detail: String,
    errors: Vec<FieldError>,
    request_id: Option<String>,
}

/// The page for an address that does not exist. Scripts get a problem document instead: see [`wants_html`].
pub async fn not_found(request: Request) -> Response {
    let page = ErrorPage {
        here: "",
        status: 404,
        title: "There is no page here".to_owned(),
        detail: format!("Nothing lives at {}.", request.uri().path()),
        errors: Vec::new(),
        request_id: None,
    };
    answer(StatusCode::NOT_FOUND, &page)
}

/// Whether the sender is a browser that navigates: it names `text/html` in `Accept`, which scripts do not.
pub fn wants_html(headers: &HeaderMap) -> bool {
    headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .any(|value| value.contains("text/html"))
}
