//! The typed HTTP client, for the command line, the worker and tests.
//!
//! Every method is one call of the API. Errors carry the service's [`Problem`], so that a caller can act on its
//! status and show its detail; nothing is retried here, because what may be repeated differs from caller to caller.

mod blobs;
mod events;
mod farm;
mod jobs;
mod scenes;
mod upload;
mod workers;

use std::time::Duration;

use reqwest::header::{ACCEPT, CONTENT_TYPE, HeaderMap, RETRY_AFTER};
use reqwest::{ClientBuilder, Method, RequestBuilder, Response, StatusCode, Url};
use serde::Serialize;
use serde::de::DeserializeOwned;

pub use farm::{DecisionFilter, HistoryQuery, RunFilter};
pub use jobs::JobFilter;
pub use scenes::{ScenePart, Upload};

use crate::problem::Problem;
use crate::status::Status;

/// Longest pause within an answer, and from the end of a short request to the beginning of its answer.
const READ_TIMEOUT: Duration = Duration::from_secs(60);

/// A service at one address. Cheap to clone; connections are shared.
#[derive(Clone, Debug)]
pub struct Client {
    http: reqwest::Client,
    /// For requests with bodies of any size: it waits without limit, see [`upload`].
    uploads: reqwest::Client,
    patience: upload::Patience,
    base: Url,
    traceparent: Option<String>,
}

#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The service answered, and said no.
    #[error("{problem}")]
    Problem { problem: Box<Problem>, retry_after: Option<Duration> },
    /// No answer: not reachable, cut off, or too late.
    #[error("no answer from {url}: {source}")]
    Transport { url: String, source: reqwest::Error },
    /// An answer that is not in the API's form: most likely not a Lightshaft service.
    #[error("{url} answered {status} in an unexpected form: {detail}")]
    Unexpected { url: String, status: u16, detail: String, retry_after: Option<Duration> },
    #[error("`{url}` is no address of a service: {detail} (expected something like http://127.0.0.1:8080)")]
    Address { url: String, detail: String },
    /// The service takes nothing of a body, or does not answer after it.
    #[error("{url} did not get on with an upload for {:.1} s", waited.as_secs_f64())]
    Stalled { url: String, waited: Duration },
    #[error("{path}: {source}")]
    File { path: String, source: std::io::Error },
}

impl ClientError {
    /// The HTTP status, where there was an answer.
    pub fn status(&self) -> Option<u16> {
        match self {
            Self::Problem { problem, .. } => Some(problem.status),
            Self::Unexpected { status, .. } => Some(*status),
            Self::Transport { .. } | Self::Stalled { .. } | Self::Address { .. } | Self::File { .. } => None,
        }
    }

    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Problem { problem, .. } => Some(problem),
            _ => None,
        }
    }

    /// How long the answer asked to wait before the same call is made again.
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Problem { retry_after, .. } | Self::Unexpected { retry_after, .. } => *retry_after,
            Self::Transport { .. } | Self::Stalled { .. } | Self::Address { .. } | Self::File { .. } => None,
        }
    }

    /// Whether the same call may well succeed a little later.
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Transport { .. } | Self::Stalled { .. } => true,
            Self::Address { .. } | Self::File { .. } => false,
            Self::Problem { .. } | Self::Unexpected { .. } => {
                self.status().is_some_and(|status| status == 408 || status == 429 || status >= 500)
            }
        }
    }
}

pub type Result<T, E = ClientError> = std::result::Result<T, E>;

impl Client {
    /// `base` such as `http://127.0.0.1:8080`; a path in it is kept as a prefix.
    pub fn new(base: &str) -> Result<Self> {
        let address_error = |detail: String| ClientError::Address { url: base.to_owned(), detail };
        let mut url = Url::parse(base).map_err(|error| address_error(error.to_string()))?;
        if !matches!(url.scheme(), "http" | "https") || url.host_str().is_none() {
            return Err(address_error("expected an http address with a host".to_owned()));
        }
        if !url.path().ends_with('/') {
            url.set_path(&format!("{}/", url.path()));
        }
        let build = |builder: ClientBuilder| builder.build().map_err(|error| address_error(error.to_string()));
        Ok(Self {
            http: build(builder().read_timeout(READ_TIMEOUT))?,
            uploads: build(builder())?,
            patience: upload::Patience::default(),
            base: url,
            traceparent: None,
        })
    }

    /// The same client, all of whose requests carry this W3C `traceparent`.
    pub fn with_traceparent(&self, traceparent: impl Into<String>) -> Self {
        Self { traceparent: Some(traceparent.into()), ..self.clone() }
    }

    /// The service's address, with a slash at its end.
    pub fn base(&self) -> &str {
        self.base.as_str()
    }

    /// The full address of a path or `href` of the API, such as `/v1/jobs/…/artifacts/image.png`.
    pub fn url(&self, path: &str) -> String {
        format!("{}{}", self.base, path.trim_start_matches('/'))
    }

    pub async fn status(&self) -> Result<Status> {
        self.get_json("v1/status", &()).await
    }

    /// Whether the service can take work: its database and blob store can be written.
    pub async fn is_ready(&self) -> bool {
        self.send(self.request(Method::GET, "readyz")).await.is_ok()
    }

    fn request(&self, method: Method, path: &str) -> RequestBuilder {
        let mut request = self.http.request(method, self.url(path)).header(ACCEPT, "*/*");
        if let Some(traceparent) = &self.traceparent {
            request = request.header("traceparent", traceparent);
        }
        request
    }

    /// Sends, and turns every answer outside 2xx and 304 into an error.
    async fn send(&self, request: RequestBuilder) -> Result<Response> {
        Self::checked(request.send().await.map_err(transport)?).await
    }

    async fn checked(response: Response) -> Result<Response> {
        if response.status().is_success() || response.status() == StatusCode::NOT_MODIFIED {
            return Ok(response);
        }
        let url = response.url().to_string();
        let status = response.status().as_u16();
        let retry_after = retry_after(response.headers());
        let is_problem = response
            .headers()
            .get(CONTENT_TYPE)
            .and_then(|value| value.to_str().ok())
            .is_some_and(|value| value.starts_with("application/problem+json"));
        let body = response.bytes().await.map_err(transport)?;
        if is_problem && let Ok(problem) = serde_json::from_slice::<Problem>(&body) {
            return Err(ClientError::Problem { problem: Box::new(problem), retry_after });
        }
        let start: String = String::from_utf8_lossy(&body).chars().take(200).collect();
        Err(ClientError::Unexpected { url, status, detail: start, retry_after })
    }

    async fn read_json<T: DeserializeOwned>(response: Response) -> Result<T> {
        let url = response.url().to_string();
        let status = response.status().as_u16();
        let body = response.bytes().await.map_err(transport)?;
        serde_json::from_slice(&body).map_err(|error| ClientError::Unexpected {
            url,
            status,
            detail: error.to_string(),
            retry_after: None,
        })
    }

    async fn send_json<T: DeserializeOwned>(&self, request: RequestBuilder) -> Result<T> {
        Self::read_json(self.send(request).await?).await
    }

    async fn get_json<T: DeserializeOwned>(&self, path: &str, query: &impl Serialize) -> Result<T> {
        self.send_json(self.request(Method::GET, path).query(query)).await
    }

    async fn post_json<T: DeserializeOwned>(&self, path: &str, body: &impl Serialize) -> Result<T> {
        self.send_json(self.request(Method::POST, path).json(body)).await
    }

    /// With a key, repeating the request makes nothing twice.
    async fn post_once<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
        idempotency_key: Option<&str>,
    ) -> Result<T> {
        let mut request = self.request(Method::POST, path).json(body);
        if let Some(key) = idempotency_key {
            request = request.header("idempotency-key", key);
        }
        self.send_json(request).await
    }
}

fn builder() -> ClientBuilder {
    // A peer that is gone without a word is noticed also where there is no limit to an answer's time.
    reqwest::Client::builder()
        .connect_timeout(Duration::from_secs(10))
        .tcp_keepalive(Duration::from_secs(20))
        .user_agent(concat!("lightshaft/", env!("CARGO_PKG_VERSION")))
}

fn transport(source: reqwest::Error) -> ClientError {
    let url = source.url().map_or_else(|| "the service".to_owned(), Url::to_string);
    ClientError::Transport { url, source: source.without_url() }
}

/// `Retry-After` in seconds (RFC 9110, section 10.2.3); its other form, a date, would need the clocks to agree.
fn retry_after(headers: &HeaderMap) -> Option<Duration> {
    headers.get(RETRY_AFTER)?.to_str().ok()?.trim().parse().ok().map(Duration::from_secs)
}

/// One segment of a path: ids and names come from users and files.
fn segment(text: &str) -> String {
    let mut encoded = String::with_capacity(text.len());
    for byte in text.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'~' => encoded.push(char::from(byte)),
            b'.' if text.bytes().any(|b| b != b'.') => encoded.push('.'),
            _ => encoded.push_str(&format!("%{byte:02X}")),
        }
    }
    encoded
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_checked_and_prefixes_kept() {
        let client = Client::new("http://localhost:8080").unwrap();
        assert_eq!(client.url("/v1/jobs"), "http://localhost:8080/v1/jobs");
        let client = Client::new("https://farm.example/render").unwrap();
        assert_eq!(client.url("v1/jobs"), "https://farm.example/render/v1/jobs");
        for wrong in ["localhost:8080", "", "ftp://farm", "http://"] {
            assert!(matches!(Client::new(wrong), Err(ClientError::Address { .. })), "{wrong}");
        }
    }

    #[test]
    fn a_wait_that_is_asked_for_is_read_in_seconds() {
        let read = |value: &'static str| {
            retry_after(&HeaderMap::from_iter([(RETRY_AFTER, reqwest::header::HeaderValue::from_static(value))]))
        };
        assert_eq!(read("5"), Some(Duration::from_secs(5)));
        assert_eq!(read("Fri, 31 Dec 1999 23:59:59 GMT"), None);
        assert_eq!(read("-1"), None);
        assert_eq!(retry_after(&HeaderMap::new()), None);
    }

    #[test]
    fn segments_cannot_leave_their_place() {
        assert_eq!(segment("image.png"), "image.png");
        assert_eq!(segment("../x?y"), "..%2Fx%3Fy");
        assert_eq!(segment(".."), "%2E%2E");
    }
}
