//! Uploads: bodies of any size over links of any speed.
//!
//! A limit on the whole of an upload would end those that are merely big or slow. What is watched instead is whether it
//! gets on: that the service takes the next piece of the body in time, and answers in time once it has all of it.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::{Stream, StreamExt, stream};
use http_body_util::BodyDataStream;
use reqwest::header::CONTENT_LENGTH;
use reqwest::{Body, RequestBuilder, Response};

use super::{Client, ClientError, Result, transport};

/// Bodies go in pieces of this size, so that it is seen how far they have got.
const PIECE_BYTES: usize = 256 << 10;

/// How long an upload may stand still.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patience {
    /// For the next piece of the body to be taken.
    pub(super) piece: Duration,
    /// For the answer, once all is taken: the service may have a scene to import, and others before it.
    pub(super) answer: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self { piece: Duration::from_secs(60), answer: Duration::from_secs(600) }
    }
}

impl Client {
    /// Sends a request with a body of any size. Answers outside 2xx are errors.
    pub(super) async fn send_upload(&self, request: RequestBuilder) -> Result<Response> {
        let (_, request) = request.build_split();
        let mut request = request.map_err(transport)?;
        let url = request.url().to_string();
        let progress = Progress::begun();
        if let Some(body) = request.body_mut().take() {
            // Of a body in memory, whose length would not be known any more.
            if let Some(bytes) = body.as_bytes() {
                request.headers_mut().entry(CONTENT_LENGTH).or_insert(bytes.len().into());
            }
            *request.body_mut() = Some(Body::wrap_stream(watched(body, progress.clone())));
        }
        tokio::select! {
            response = self.uploads.execute(request) => Self::checked(response.map_err(transport)?).await,
            waited = progress.stalled(self.patience) => Err(ClientError::Stalled { url, waited }),
        }
    }
}

/// The same body in pieces; each that is taken is noted.
fn watched(body: Body, progress: Progress) -> impl Stream<Item = reqwest::Result<Bytes>> + Send {
    let end = progress.clone();
    let pieces = BodyDataStream::new(body).flat_map(|chunk| match chunk {
        Ok(chunk) => stream::iter(pieces(chunk).map(Ok).collect::<Vec<_>>()),
        Err(error) => stream::iter(vec![Err(error)]),
    });
    let noted = pieces.inspect(move |_| progress.note(false));
    noted.chain(stream::poll_fn(move |_| {
        end.note(true);
        std::task::Poll::Ready(None)
    }))
}

fn pieces(mut chunk: Bytes) -> impl Iterator<Item = Bytes> {
    std::iter::from_fn(move || {
        let piece = chunk.split_to(chunk.len().min(PIECE_BYTES));
        (!piece.is_empty()).then_some(piece)
    })
}

/// When a body last got on, and whether all of it is taken.
#[derive(Clone, Debug)]
struct Progress(Arc<Mutex<(Instant, bool)>>);

impl Progress {
    fn begun() -> Self {
        Self(Arc::new(Mutex::new((Instant::now(), false))))
    }

    fn note(&self, is_whole: bool) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = (Instant::now(), is_whole);
    }

    /// Ends when nothing has happened for too long; says how long that was.
    async fn stalled(&self, patience: Patience) -> Duration {
        loop {
            let (last, is_whole) = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let limit = if is_whole { patience.answer } else { patience.piece };
            let Some(left) = limit.checked_sub(last.elapsed()).filter(|left| !left.is_zero()) else { return limit };
            // The limit changes when the body has ended.
            tokio::time::sleep(left.min(patience.piece)).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    use super::*;

    const BODY_BYTES: usize = 32 << 20;

    /// A service that takes a body a mebibyte at a time, with a pause after each, and answers after a further one.
    async fn slow_service(pause: Duration, stops_after: usize, patience: Duration) -> Client {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let client = Client::new(&format!("http://{}", listener.local_addr().unwrap())).unwrap();
        tokio::spawn(async move {
            let (mut connection, _) = listener.accept().await.unwrap();
            let mut buffer = vec![0; 1 << 20];
            let mut taken = 0;
            while taken < BODY_BYTES {
                if taken >= stops_after {
                    std::future::pending::<()>().await;
                }
                let piece = connection.read(&mut buffer).await.unwrap();
                assert!(piece > 0, "the client has closed the connection after {taken} bytes");
                if taken % (1 << 20) + piece >= 1 << 20 {
                    tokio::time::sleep(pause).await;
                }
                taken += piece;
            }
            let body = r#"{"hash":"h","bytes":1}"#;
            tokio::time::sleep(pause).await;
            let head = format!("HTTP/1.1 201 Created\r\ncontent-length: {}\r\n\r\n{body}", body.len());
            connection.write_all(head.as_bytes()).await.unwrap();
            std::future::pending::<()>().await;
        });
        let patience = Patience { piece: patience, answer: Duration::from_secs(15) };
        let http = reqwest::Client::builder().read_timeout(patience.piece).build().unwrap();
        Client { patience, http, ..client }
    }

    #[tokio::test]
    async fn a_slow_upload_goes_on_past_every_limit_while_it_gets_on() {
        // Twenty pauses: a machine that is busy with other tests may be late by nearly as much.
        let patience = Duration::from_secs(4);
        let client = slow_service(patience / 20, usize::MAX, patience).await;
        let started = Instant::now();
        client.put_blob("h", vec![7; BODY_BYTES]).await.unwrap();
        assert!(started.elapsed() > patience * 3 / 2, "{:?}", started.elapsed());
    }

    #[tokio::test]
    async fn an_upload_that_stands_still_ends_with_an_error_that_says_so() {
        let client = slow_service(Duration::ZERO, 4 << 20, Duration::from_millis(600)).await;
        let error = client.put_blob("h", vec![7; BODY_BYTES]).await.unwrap_err();
        assert!(matches!(error, ClientError::Stalled { .. }) && error.is_transient(), "{error}");
        assert!(error.to_string().contains("0.6 s"), "{error}");
    }
}
