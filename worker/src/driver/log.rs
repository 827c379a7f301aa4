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
        self.pending().lines.push(stamped(&line));
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
                // Should it take nothing of what it asked for itself, asking at once again would be in vain.
                Ok(accepted) if !self.accepted(accepted.next_sequence) => return,
                Ok(_) => {}
                Err(error) if error.is_transient() => return,
                // The service does not want them: a stale lease, say. The heartbeat will tell what that means.
                Err(_) => return self.drop_all(),
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

    /// Goes on from the line that the service wants next; whether that is another one than before.
    ///
    /// Lines that it took once are gone here. When it wants them again, having lost its log, the others go on under their
    /// numbers, after a line that says so.
    fn accepted(&self, next_sequence: u64) -> bool {
        let mut pending = self.pending();
        if next_sequence < pending.first {
            let lost = pending.first - next_sequence;
            pending.first = next_sequence;
            pending.lines.insert(0, stamped(&format!("{lost} lines of this log were lost")));
            return true;
        }
        let count = (next_sequence - pending.first).min(pending.lines.len() as u64);
        pending.lines.drain(..count as usize);
        pending.first += count;
        count > 0
    }

    fn drop_all(&self) {
        let mut pending = self.pending();
        pending.first += pending.lines.len() as u64;
        pending.lines.clear();
    }

    fn pending(&self) -> MutexGuard<'_, Pending> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One line, with the time before it.
fn stamped(line: &str) -> String {
    let time = Timestamp::now().strftime("%Y-%m-%dT%H:%M:%S%.3fZ");
    let line: String = line.replace(['\n', '\r'], " ").chars().take(MAX_LINE_CHARS).collect();
    format!("{time} {line}")
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
        assert!(log.accepted(1));
        log.push("d".into());
        let chunk = log.next_chunk().unwrap();
        assert_eq!((chunk.first_sequence, chunk.lines.len()), (1, 2));
        assert!(log.accepted(3));
        assert_eq!(log.next_chunk(), None);
    }

    #[test]
    fn a_service_that_takes_nothing_is_not_asked_again_at_once() {
        let log = LogBuffer::default();
        log.push("a".into());
        assert!(!log.accepted(0), "nothing got on");
        assert_eq!(log.next_chunk().unwrap().first_sequence, 0);
    }

    #[test]
    fn after_a_gap_that_cannot_be_filled_the_log_goes_on_and_says_so() {
        let log = LogBuffer::default();
        ["a", "b", "c"].into_iter().for_each(|line| log.push(line.into()));
        log.accepted(3);
        log.push("d".into());
        assert!(log.accepted(1), "the service was restored from an old copy, say");
        let chunk = log.next_chunk().unwrap();
        assert_eq!(chunk.first_sequence, 1);
        assert!(chunk.lines[0].ends_with(" 2 lines of this log were lost") && chunk.lines[1].ends_with(" d"));
        assert!(log.accepted(3));
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
