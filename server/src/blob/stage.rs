//! Bytes on their way in.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use bytes::Bytes;
use futures::{Stream, StreamExt};
use tempfile::TempPath;
use tokio::io::{AsyncWriteExt, BufWriter};

const WRITE_BUFFER: usize = 1 << 20;

#[derive(Debug, thiserror::Error)]
pub enum StageError {
    #[error("more than the limit of {limit} bytes")]
    TooLarge { limit: u64 },
    #[error("no bytes came for too long")]
    Stalled,
    #[error("the upload was cut off: {0}")]
    Incomplete(String),
    #[error("writing an upload: {0}")]
    Io(#[from] io::Error),
}

/// A whole upload in a temporary file, which goes when this is dropped.
#[derive(Debug)]
pub struct Staged {
    path: TempPath,
    hash: String,
    bytes: u64,
    /// The first bytes, to see what it is.
    start: Vec<u8>,
}

impl Staged {
    pub(super) async fn write<S, E>(dir: &Path, mut stream: S, limit: u64, stall: Duration) -> Result<Self, StageError>
    where
        S: Stream<Item = Result<Bytes, E>> + Unpin,
        E: std::fmt::Display,
    {
        let (file, path) = tempfile::NamedTempFile::new_in(dir)?.into_parts();
        let mut file = BufWriter::with_capacity(WRITE_BUFFER, tokio::fs::File::from_std(file));
        let mut hasher = blake3::Hasher::new();
        let mut start = Vec::new();
        let mut bytes = 0;
        loop {
            let chunk = match tokio::time::timeout(stall, stream.next()).await {
                Err(_) => return Err(StageError::Stalled),
                Ok(None) => break,
                Ok(Some(Err(error))) => return Err(StageError::Incomplete(error.to_string())),
                Ok(Some(Ok(chunk))) => chunk,
            };
            bytes += chunk.len() as u64;
            if bytes > limit {
                return Err(StageError::TooLarge { limit });
            }
            hasher.update(&chunk);
            start.extend(chunk.iter().take(16 - start.len().min(16)));
            file.write_all(&chunk).await?;
        }
        file.flush().await?;
        file.get_ref().sync_data().await?;
        Ok(Self { path, hash: hasher.finalize().to_hex().to_string(), bytes, start })
    }

    pub fn hash(&self) -> &str {
        &self.hash
    }

    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// At most 16 bytes.
    pub fn start(&self) -> &[u8] {
        &self.start
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Renames to `target` below `root`, whose folders are made on the way. Once this returns, neither the bytes nor
    /// the name are lost when the power is.
    pub(super) async fn persist(self, target: PathBuf, root: PathBuf) -> io::Result<()> {
        let path = self.path;
        let persist = move || {
            let folder = target.parent().unwrap_or(&root).to_owned();
            let is_new_folder = !folder.exists();
            std::fs::create_dir_all(&folder)?;
            path.persist(target).map_err(|error| error.error)?;
            let changed = if is_new_folder { usize::MAX } else { 1 };
            for folder in folder.ancestors().take_while(|folder| folder.starts_with(&root)).take(changed) {
                sync_folder(folder)?;
            }
            Ok(())
        };
        tokio::task::spawn_blocking(persist).await.map_err(io::Error::other)?
    }
}

/// Writes a folder's entries down (fsync(2): syncing a file does not sync the entry that names it).
#[cfg(unix)]
fn sync_folder(folder: &Path) -> io::Result<()> {
    std::fs::File::open(folder)?.sync_all()
}

/// Elsewhere folders cannot be opened; the file system keeps the order by itself.
#[cfg(not(unix))]
fn sync_folder(_folder: &Path) -> io::Result<()> {
    Ok(())
}
