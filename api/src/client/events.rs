//! Server-sent events (WHATWG HTML, section 9.2): enough of the format to read what the service writes.

use bytes::Bytes;
use futures::stream::{self, BoxStream};
use futures::{Stream, StreamExt};
use reqwest::Method;
use reqwest::header::ACCEPT;

use super::{Client, ClientError, Result, segment, transport};
use crate::event::Event;

impl Client {
    /// Events of one job from its creation, or after `last_event_id`. Ends after the job's final event, and when the
    /// service shuts down: a caller that wants more connects again with the id of the last event it saw.
    pub async fn job_events(
        &self,
        job: &str,
        last_event_id: Option<i64>,
    ) -> Result<impl Stream<Item = Result<Event>> + Unpin + use<>> {
        self.event_stream(&format!("v1/jobs/{}/events", segment(job)), last_event_id).await
    }

    /// Events of all jobs from now on, or after `last_event_id`.
    pub async fn events(
        &self,
        last_event_id: Option<i64>,
    ) -> Result<impl Stream<Item = Result<Event>> + Unpin + use<>> {
        self.event_stream("v1/events", last_event_id).await
    }

    async fn event_stream(
        &self,
        path: &str,
        last_event_id: Option<i64>,
    ) -> Result<impl Stream<Item = Result<Event>> + Unpin + use<>> {
        let mut request = self.request(Method::GET, path).header(ACCEPT, "text/event-stream");
        if let Some(id) = last_event_id {
            request = request.header("last-event-id", id);
        }
        let response = self.send(request).await?;
        let url = response.url().to_string();
        let reader = Reader { url, body: response.bytes_stream().boxed(), parser: Parser::default() };
        Ok(Box::pin(stream::try_unfold(reader, |mut reader| async move {
            Ok(reader.next().await?.map(|event| (event, reader)))
        })))
    }
}

struct Reader {
    url: String,
    body: BoxStream<'static, reqwest::Result<Bytes>>,
    parser: Parser,
}

impl Reader {
    async fn next(&mut self) -> Result<Option<Event>> {
        loop {
            if let Some(data) = self.parser.take_data() {
                return serde_json::from_str(&data).map(Some).map_err(|error| ClientError::Unexpected {
                    url: self.url.clone(),
                    status: 200,
                    detail: error.to_string(),
                    retry_after: None,
                });
            }
            match self.body.next().await {
                Some(chunk) => self.parser.push(&chunk.map_err(transport)?),
                None => return Ok(None),
            }
        }
    }
}

/// Bytes in, `data` of whole events out.
#[derive(Debug, Default)]
struct Parser {
    buffer: Vec<u8>,
    data: String,
}

impl Parser {
    fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    fn take_data(&mut self) -> Option<String> {
        while let Some(end) = self.buffer.iter().position(|&b| b == b'\n') {
            let line: Vec<u8> = self.buffer.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line);
            let line = line.trim_end_matches(['\n', '\r']);
            if let Some(data) = line.strip_prefix("data:") {
                if !self.data.is_empty() {
                    self.data.push('\n');
                }
                self.data.push_str(data.strip_prefix(' ').unwrap_or(data));
            } else if line.is_empty() && !self.data.is_empty() {
                return Some(std::mem::take(&mut self.data));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_may_be_cut_anywhere() {
        let text = ": keep-alive\n\nid: 7\nevent: job.created\ndata: {\"a\":1}\n\ndata: x\r\ndata: y\r\n\r\n";
        for step in 1..text.len() {
            let mut parser = Parser::default();
            let mut events = Vec::new();
            for chunk in text.as_bytes().chunks(step) {
                parser.push(chunk);
                while let Some(data) = parser.take_data() {
                    events.push(data);
                }
            }
            assert_eq!(events, ["{\"a\":1}", "x\ny"], "chunks of {step}");
        }
    }
}
