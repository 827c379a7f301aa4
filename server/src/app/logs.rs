//! Logs of attempts: one file each, one line per sequence number, so that a repeated chunk changes nothing.

use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use futures::stream::{self, BoxStream, StreamExt, TryStreamExt};
use lightshaft_api::lease::LogChunk;
use tokio::io::AsyncWriteExt;
use tokio::sync::Mutex;
use tokio_util::io::ReaderStream;

/// Longest line kept.
const LINE_BYTES: usize = 16 << 10;
/// Longest log kept of one attempt.
const LOG_BYTES: u64 = 16 << 20;
/// Logs whose ends are known without a look at the file.
const MOST_OPEN: usize = 1024;

/// A log as it is read.
pub type LogStream = BoxStream<'static, io::Result<Bytes>>;

#[derive(Debug)]
pub(super) struct Logs {
    dir: PathBuf,
    /// Next sequence number and size of the logs being written.
    open: Mutex<HashMap<String, Position>>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Position {
    next: u64,
    bytes: u64,
}

impl Logs {
    pub(super) async fn open(dir: &Path) -> io::Result<Self> {
        tokio::fs::create_dir_all(dir).await?;
        Ok(Self { dir: dir.to_owned(), open: Mutex::default() })
    }

    /// Appends the lines that are new; returns the number of the next line wanted. Lines after a gap are not taken:
    /// the worker sends them again from there.
    pub(super) async fn append(&self, attempt: &str, chunk: &LogChunk) -> io::Result<u64> {
        let mut open = self.open.lock().await;
        let position = match open.get_mut(attempt) {
            Some(position) => position,
            None => {
                let found = self.find_end(attempt).await?;
                // Ends can be found again: a late line of an ended attempt must not stay here for ever.
                if open.len() >= MOST_OPEN {
                    open.clear();
                }
                open.entry(attempt.to_owned()).or_insert(found)
            }
        };
        let Some(skip) = position.next.checked_sub(chunk.first_sequence) else { return Ok(position.next) };
        let skip = usize::try_from(skip).unwrap_or(usize::MAX);
        let new_lines = chunk.lines.get(skip..).unwrap_or_default();
        let mut text = String::new();
        for line in new_lines {
            // A full log goes on counting, so that the worker does not send the same lines for ever.
            if position.bytes + (text.len() as u64) < LOG_BYTES {
                push_line(&mut text, line);
            } else {
                text.push('\n');
            }
        }
        let mut file = tokio::fs::OpenOptions::new().append(true).create(true).open(self.path(attempt)).await?;
        file.write_all(text.as_bytes()).await?;
        file.flush().await?;
        position.next += new_lines.len() as u64;
        position.bytes += text.len() as u64;
        Ok(position.next)
    }

    pub(super) async fn close(&self, attempt: &str) {
        self.open.lock().await.remove(attempt);
    }

    /// The log so far; empty when there is none.
    pub(super) fn read(&self, attempt: &str) -> LogStream {
        let path = self.path(attempt);
        let open = async move {
            match tokio::fs::File::open(path).await {
                Ok(file) => Ok(Some(ReaderStream::new(file))),
                Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
                Err(error) => Err(error),
            }
        };
        let opened = stream::once(open).try_filter_map(|file| std::future::ready(Ok(file)));
        opened.try_flatten().boxed()
    }

    /// Harmless when there is none.
    pub(super) async fn delete(&self, attempt: &str) -> io::Result<()> {
        self.close(attempt).await;
        match tokio::fs::remove_file(self.path(attempt)).await {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    async fn find_end(&self, attempt: &str) -> io::Result<Position> {
        let mut position = Position::default();
        let mut log = self.read(attempt);
        while let Some(chunk) = log.try_next().await? {
            position.next += chunk.iter().filter(|&&b| b == b'\n').count() as u64;
            position.bytes += chunk.len() as u64;
        }
        Ok(position)
    }

    fn path(&self, attempt: &str) -> PathBuf {
        self.dir.join(format!("{attempt}.log"))
    }
}

/// One line of text is one line of the file, whatever it holds.
fn push_line(text: &mut String, line: &str) {
    let mut end = line.len().min(LINE_BYTES);
    while !line.is_char_boundary(end) {
        end -= 1;
    }
    text.extend(line[..end].chars().map(|c| if c.is_control() && c != '\t' { ' ' } else { c }));
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(first_sequence: u64, lines: &[&str]) -> LogChunk {
        LogChunk { first_sequence, lines: lines.iter().map(|&line| line.to_owned()).collect() }
    }

    async fn read(logs: &Logs, attempt: &str) -> String {
        let chunks: Vec<Bytes> = logs.read(attempt).try_collect().await.unwrap();
        String::from_utf8(chunks.concat()).unwrap()
    }

    #[tokio::test]
    async fn ends_that_were_forgotten_are_found_again() {
        let dir = tempfile::tempdir().unwrap();
        let logs = Logs::open(dir.path()).await.unwrap();
        for i in 0..2 * MOST_OPEN {
            logs.append(&i.to_string(), &chunk(0, &["one"])).await.unwrap();
        }
        assert!(logs.open.lock().await.len() <= MOST_OPEN);
        assert_eq!(logs.append("0", &chunk(0, &["one", "two"])).await.unwrap(), 2);
        assert_eq!(read(&logs, "0").await, "one\ntwo\n");
        logs.delete("0").await.unwrap();
        logs.delete("0").await.unwrap();
        assert_eq!(read(&logs, "0").await, "");
    }

    #[tokio::test]
    async fn repeated_and_overlapping_chunks_change_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let logs = Logs::open(dir.path()).await.unwrap();
        assert_eq!(logs.append("a", &chunk(0, &["one", "two"])).await.unwrap(), 2);
        assert_eq!(logs.append("a", &chunk(0, &["one", "two"])).await.unwrap(), 2);
        assert_eq!(logs.append("a", &chunk(1, &["two", "three"])).await.unwrap(), 3);
        assert_eq!(logs.append("a", &chunk(7, &["eight"])).await.unwrap(), 3, "a gap is asked for again");
        assert_eq!(read(&logs, "a").await, "one\ntwo\nthree\n");
    }

    #[tokio::test]
    async fn numbering_goes_on_after_a_restart() {
        let dir = tempfile::tempdir().unwrap();
        Logs::open(dir.path()).await.unwrap().append("a", &chunk(0, &["one\nstill one"])).await.unwrap();
        let logs = Logs::open(dir.path()).await.unwrap();
        assert_eq!(logs.append("a", &chunk(0, &["one", "two"])).await.unwrap(), 2);
        assert_eq!(read(&logs, "a").await, "one still one\ntwo\n");
        assert_eq!(read(&logs, "b").await, "");
    }

    #[tokio::test]
    async fn endless_logs_are_cut_but_go_on_counting() {
        let dir = tempfile::tempdir().unwrap();
        let logs = Logs::open(dir.path()).await.unwrap();
        let line = "é".repeat(LINE_BYTES);
        let lines: Vec<&str> = (0..600).map(|_| line.as_str()).collect();
        logs.append("a", &chunk(0, &lines)).await.unwrap();
        logs.append("a", &chunk(600, &lines)).await.unwrap();
        assert_eq!(logs.append("a", &chunk(1200, &["last"])).await.unwrap(), 1201);
        let length = read(&logs, "a").await.len() as u64;
        assert!((LOG_BYTES..LOG_BYTES + 2 * LINE_BYTES as u64).contains(&length), "{length}");
    }
}
