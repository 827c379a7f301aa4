//! What belongs to the request being answered: its id, and the trace that it is part of.

use std::future::Future;

use uuid::Uuid;

tokio::task_local! {
    static CONTEXT: Context;
}

/// A request's id and W3C trace context.
#[derive(Clone, Debug)]
pub struct Context {
    pub request_id: String,
    /// 32 hex digits.
    pub trace_id: String,
}

impl Context {
    /// Takes over what the client sent where that is well formed.
    pub fn from_headers(headers: &http::HeaderMap) -> Self {
        let text = |name: &str| headers.get(name).and_then(|value| value.to_str().ok());
        let request_id = text("x-request-id").filter(|id| is_request_id(id)).map(str::to_owned);
        let trace_id = text("traceparent").and_then(trace_id_of).map(str::to_owned);
        Self {
            request_id: request_id.unwrap_or_else(|| Uuid::new_v4().simple().to_string()),
            trace_id: trace_id.unwrap_or_else(|| Uuid::new_v4().simple().to_string()),
        }
    }

    pub async fn scope<F: Future>(self, future: F) -> F::Output {
        CONTEXT.scope(self, future).await
    }
}

/// The id of the request being answered; `None` outside of one.
pub fn request_id() -> Option<String> {
    CONTEXT.try_with(|context| context.request_id.clone()).ok()
}

/// The trace of the request being answered, or a new one.
pub fn trace_id() -> String {
    CONTEXT.try_with(|context| context.trace_id.clone()).unwrap_or_else(|_| Uuid::new_v4().simple().to_string())
}

/// A W3C traceparent that goes on with a trace.
pub fn traceparent(trace_id: &str) -> String {
    let span = &Uuid::new_v4().simple().to_string()[..16];
    format!("00-{trace_id}-{span}-01")
}

fn is_request_id(id: &str) -> bool {
    (1..=128).contains(&id.len()) && id.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.:".contains(&b))
}

/// `version-trace_id-parent_id-flags` (W3C Trace Context, section 3.2).
fn trace_id_of(traceparent: &str) -> Option<&str> {
    let mut parts = traceparent.split('-');
    let (version, trace_id, parent_id) = (parts.next()?, parts.next()?, parts.next()?);
    let is_hex = |text: &str, len| text.len() == len && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
    let is_zero = trace_id.bytes().all(|b| b == b'0');
    (is_hex(version, 2) && version != "ff" && is_hex(trace_id, 32) && is_hex(parent_id, 16) && !is_zero)
        .then_some(trace_id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_well_formed_traces_are_taken_over() {
        let trace = "0af7651916cd43dd8448eb211c80319c";
        assert_eq!(trace_id_of(&format!("00-{trace}-b7ad6b7169203331-01")), Some(trace));
        assert_eq!(trace_id_of(&traceparent(trace)), Some(trace));
        for wrong in [
            "",
            "00",
            "00-0AF7651916CD43DD8448EB211C80319C-b7ad6b7169203331-01",
            "00-00000000000000000000000000000000-b7ad6b7169203331-01",
            "ff-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01",
        ] {
            assert_eq!(trace_id_of(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn request_ids_cannot_break_a_log_line() {
        assert!(is_request_id("build-42:job.7"));
        assert!(!is_request_id("a b"));
        assert!(!is_request_id(""));
        assert!(!is_request_id(&"x".repeat(129)));
    }
}
