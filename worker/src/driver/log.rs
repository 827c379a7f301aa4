//! Ships a task's log lines to the service, in numbered chunks.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use jiff::Timestamp;
use lightshaft_api::client::Client;
use lightshaft_api::lease::LogChunk;

const SHIP_PERIOD: Duration = Duration::from_secs(1);
const MAX_CHUNK_LINES: usize = 1000;

/// Longest line, in characters: a scene's warning may quote a name of any length.
const MAX_LINE_CHARS: usize = 2000;

/// Lines that are not shipped yet.
#[derive(Debug, Default)]
pub(super) struct LogBuffer {
    pending: Mutex<Pending>,
}

#[derive(Debug, Default)]
struct Pending {
    /// Sequence number of the first line.
    first: u64,
    lines: Vec<String>,
}

impl LogBuffer {
    pub(super) fn push(&self, line: String) {
        let time = Timestamp::now().strftime("%Y-%m-%dT%H:%M:%S%.3fZ");
        let line: String = line.replace(['\n', '\r'], " ").chars().take(MAX_LINE_CHARS).collect();
        self.pending().lines.push(format!("{time} {line}"));
    }

    /// Ships what comes until dropped.
    pub(super) async fn ship(&self, client: &Client, token: &str) {
        loop {
            tokio::time::sleep(SHIP_PERIOD).await;
            self.flush(client, token).await;
        }
    }

    /// Ships all lines that there are; gives up at the first chunk that does not arrive, to be tried again.
    pub(super) async fn flush(&self, client: &Client, token: &str) {
        while let Some(chunk) = self.next_chunk() {
            match client.append_log(token, &chunk).await {
                Ok(accepted) => self.accepted(accepted.next_sequence),
                Err(error) if error.is_transient() => return,
                // The service does not want them: a stale lease, say. The heartbeat will tell what that means.
                Err(_) => return self.accepted(u64::MAX),
            }
        }
    }

    fn next_chunk(&self) -> Option<LogChunk> {
        let pending = self.pending();
        if pending.lines.is_empty() {
            return None;
        }
        let count = pending.lines.len().min(MAX_CHUNK_LINES);
        Some(LogChunk { first_sequence: pending.first, lines: pending.lines[..count].to_vec() })
    }

    fn accepted(&self, next_sequence: u64) {
        let mut pending = self.pending();
        let count = next_sequence.saturating_sub(pending.first).min(pending.lines.len() as u64);
        pending.lines.drain(..count as usize);
        pending.first += count;
    }

    fn pending(&self) -> MutexGuard<'_, Pending> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_numbered_on_and_dropped_only_when_accepted() {
        let log = LogBuffer::default();
        assert_eq!(log.next_chunk(), None);
        log.push("a".into());
        log.push("b\nc".into());
        let chunk = log.next_chunk().unwrap();
        assert_eq!((chunk.first_sequence, chunk.lines.len()), (0, 2));
        assert!(chunk.lines[1].ends_with("Z b c"), "{:?}", chunk.lines);
        assert_eq!(log.next_chunk().unwrap(), chunk, "not accepted yet");
        log.accepted(1);
        log.push("d".into());
        let chunk = log.next_chunk().unwrap();
        assert_eq!((chunk.first_sequence, chunk.lines.len()), (1, 2));
        log.accepted(3);
        assert_eq!(log.next_chunk(), None);
    }

    #[test]
    fn long_logs_go_in_pieces_and_long_lines_are_cut() {
        let log = LogBuffer::default();
        log.push("x".repeat(100_000));
        assert!(log.next_chunk().unwrap().lines[0].len() < MAX_LINE_CHARS + 40);
        (0..MAX_CHUNK_LINES).for_each(|i| log.push(i.to_string()));
        assert_eq!(log.next_chunk().unwrap().lines.len(), MAX_CHUNK_LINES);
    }
}
