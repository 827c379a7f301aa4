//! Reads on what a handler left of a request's body.
//!
//! A request that is refused by its head is answered before its body has come. Were the connection closed then, a client
//! that is still sending would get a reset and never see the answer. So the rest is read and dropped, beside the answer
//! and within bounds; past those the connection is closed after all. A client that waits for `100 Continue` is not
//! made to send anything.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, BodyDataStream, Bytes, HttpBody};
use axum::extract::Request;
use futures::{Stream, StreamExt};
use http::header::EXPECT;
use tokio::runtime::Handle;

const MOST_BYTES: usize = 64 << 20;
const LONGEST: Duration = Duration::from_secs(30);
/// Longest pause between two pieces.
const LONGEST_STALL: Duration = Duration::from_secs(5);

/// The same request, whose body is read to its end even when its handler does not.
pub fn read_on(request: Request) -> Request {
    if request.body().is_end_stream() {
        return request;
    }
    let waits_for_continue = request.headers().contains_key(EXPECT);
    request.map(|body| {
        let body = Some(body.into_data_stream());
        Body::from_stream(ReadOn { body, waits_for_continue })
    })
}

struct ReadOn {
    /// `None` once it has ended or failed.
    body: Option<BodyDataStream>,
    waits_for_continue: bool,
}

impl Stream for ReadOn {
    type Item = Result<Bytes, axum::Error>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.waits_for_continue = false;
        let Some(body) = &mut self.body else { return Poll::Ready(None) };
        let polled = body.poll_next_unpin(cx);
        if matches!(polled, Poll::Ready(None | Some(Err(_)))) {
            self.body = None;
        }
        polled
    }
}

impl Drop for ReadOn {
    fn drop(&mut self) {
        let Some(body) = self.body.take().filter(|_| !self.waits_for_continue) else { return };
        if let Ok(runtime) = Handle::try_current() {
            runtime.spawn(tokio::time::timeout(LONGEST, drop_all(body)));
        }
    }
}

async fn drop_all(mut body: BodyDataStream) {
    let mut left = MOST_BYTES;
    while let Ok(Some(Ok(piece))) = tokio::time::timeout(LONGEST_STALL, body.next()).await {
        match left.checked_sub(piece.len()) {
            Some(rest) => left = rest,
            None => return,
        }
    }
}
