//! Every kind of problem that the service answers with: one list for responses, the explanation pages and the docs.

use http::StatusCode;

/// A stable code. Its page is `/problems/<code>`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Code {
    BadJson,
    BadToml,
    BadRequest,
    IncompleteBody,
    CrossSite,
    NotFound,
    NoSuchRoute,
    MethodNotAllowed,
    UploadStalled,
    WrongState,
    InUse,
    StaleLease,
    LeaseEnded,
    TooLarge,
    UnsupportedMediaType,
    RangeNotSatisfiable,
    InvalidFields,
    InvalidScene,
    HashMismatch,
    IdempotencyKeyReused,
    ShuttingDown,
    NotReady,
    Internal,
}

impl Code {
    pub const ALL: [Self; 23] = [
        Self::BadJson,
        Self::BadToml,
        Self::BadRequest,
        Self::IncompleteBody,
        Self::CrossSite,
        Self::NotFound,
        Self::NoSuchRoute,
        Self::MethodNotAllowed,
        Self::UploadStalled,
        Self::WrongState,
        Self::InUse,
        Self::StaleLease,
        Self::LeaseEnded,
        Self::TooLarge,
        Self::UnsupportedMediaType,
        Self::RangeNotSatisfiable,
        Self::InvalidFields,
        Self::InvalidScene,
        Self::HashMismatch,
        Self::IdempotencyKeyReused,
        Self::ShuttingDown,
        Self::NotReady,
        Self::Internal,
    ];

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|code| code.as_str() == name)
    }

    pub fn as_str(self) -> &'static str {
        self.row().0
    }

    pub fn status(self) -> StatusCode {
        self.row().1
    }

    pub fn title(self) -> &'static str {
        self.row().2
    }

    /// What it means and what to do, for the page.
    pub fn explanation(self) -> &'static str {
        self.row().3
    }

    fn row(self) -> (&'static str, StatusCode, &'static str, &'static str) {
        use StatusCode as S;
        match self {
            Self::BadJson => (
                "bad-json",
                S::BAD_REQUEST,
                "The body is not JSON",
                "The body could not be read as JSON. The detail names the line and column.",
            ),
            Self::BadToml => (
                "bad-toml",
                S::BAD_REQUEST,
                "The body is not TOML",
                "The body could not be read as TOML. The detail names the line and column.",
            ),
            Self::BadRequest => (
                "bad-request",
                S::BAD_REQUEST,
                "The request is malformed",
                "A query parameter, a header or the form of the body is wrong; `errors` names which.",
            ),
            Self::IncompleteBody => (
                "incomplete-body",
                S::BAD_REQUEST,
                "The body ended too early",
                "The connection was cut, or the body was shorter than announced. Nothing was kept: send it again.",
            ),
            Self::CrossSite => (
                "cross-site",
                S::FORBIDDEN,
                "Requests from other sites are refused",
                "A page of another site tried to change something here. Use the API from a program, or the dashboard.",
            ),
            Self::NotFound => (
                "not-found",
                S::NOT_FOUND,
                "There is no such thing",
                "The id, hash or name in the address is not known (any more).",
            ),
            Self::NoSuchRoute => (
                "no-such-route",
                S::NOT_FOUND,
                "There is no such address",
                "The path is not part of the API. `/openapi.json` lists every path.",
            ),
            Self::MethodNotAllowed => (
                "method-not-allowed",
                S::METHOD_NOT_ALLOWED,
                "The method is not allowed here",
                "The path exists, but not with this method; the Allow header lists those it has.",
            ),
            Self::UploadStalled => (
                "upload-stalled",
                S::REQUEST_TIMEOUT,
                "The upload stood still",
                "No bytes came for too long. Nothing was kept: send it again.",
            ),
            Self::WrongState => (
                "wrong-state",
                S::CONFLICT,
                "Not in this state",
                "The job's state does not allow this: a finished job cannot be cancelled, a running one not retried.",
            ),
            Self::InUse => {
                ("in-use", S::CONFLICT, "Still in use", "Unfinished work needs it. Cancel that or wait for it first.")
            }
            Self::StaleLease => (
                "stale-lease",
                S::CONFLICT,
                "The lease has ended",
                "The task was given to another worker, finished or cancelled. The report was not taken: drop the work.",
            ),
            Self::LeaseEnded => (
                "lease-ended",
                S::GONE,
                "The lease has ended",
                "The task is no longer this worker's. Stop and drop the work.",
            ),
            Self::TooLarge => (
                "too-large",
                S::PAYLOAD_TOO_LARGE,
                "The body is too large",
                "The body is over its limit, which the detail names.",
            ),
            Self::UnsupportedMediaType => (
                "unsupported-media-type",
                S::UNSUPPORTED_MEDIA_TYPE,
                "The content type is not accepted",
                "The Content-Type header is missing, not accepted here, or does not fit the content.",
            ),
            Self::RangeNotSatisfiable => (
                "range-not-satisfiable",
                S::RANGE_NOT_SATISFIABLE,
                "The range is outside the content",
                "The Range header asks for bytes that are not there; Content-Range names the length.",
            ),
            Self::InvalidFields => (
                "invalid-fields",
                S::UNPROCESSABLE_ENTITY,
                "Some fields are wrong",
                "The body is JSON, but fields are unknown, missing, of the wrong type or out of range; `errors` names each.",
            ),
            Self::InvalidScene => (
                "invalid-scene",
                S::UNPROCESSABLE_ENTITY,
                "The scene cannot be imported",
                "The file is damaged, over a limit, or needs something that is not supported; `errors` says where.",
            ),
            Self::HashMismatch => (
                "hash-mismatch",
                S::UNPROCESSABLE_ENTITY,
                "The content has another hash",
                "The BLAKE3 hash of the body is not the one in the address. Nothing was kept.",
            ),
            Self::IdempotencyKeyReused => (
                "idempotency-key-reused",
                S::UNPROCESSABLE_ENTITY,
                "The idempotency key was used for another request",
                "Within 24 hours a key stands for one request. Use a new key for a new request.",
            ),
            Self::ShuttingDown => {
                ("shutting-down", S::SERVICE_UNAVAILABLE, "The service is shutting down", "Ask again in a few seconds.")
            }
            Self::NotReady => (
                "not-ready",
                S::SERVICE_UNAVAILABLE,
                "The service is not ready",
                "The database or the blob store cannot be written at the moment.",
            ),
            Self::Internal => (
                "internal",
                S::INTERNAL_SERVER_ERROR,
                "Something went wrong here",
                "The service is at fault, not the request. The request id finds the reason in its log.",
            ),
        }
    }
}
