//! The content store: immutable bytes named by their BLAKE3 hash.
//!
//! An upload is first *staged*: streamed into a temporary file and hashed on the way. Only then is it *committed*:
//! renamed to its name. So no blob is ever half written, and a staged file that is dropped is gone. What a killed
//! process left in the staging folder is removed at the next start.

mod stage;

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures::stream::BoxStream;
use futures::{Stream, StreamExt, TryStreamExt};
use lightshaft_api::blob::is_hash;
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use object_store::{GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreExt};
pub use stage::{StageError, Staged};

#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    #[error("blob store: {0}")]
    Store(#[from] object_store::Error),
    #[error("blob store: {0}")]
    Io(#[from] std::io::Error),
}

pub type Result<T, E = BlobError> = std::result::Result<T, E>;

#[derive(Clone, Debug)]
pub struct BlobStore {
    objects: Arc<LocalFileSystem>,
    root: PathBuf,
    staging: PathBuf,
    /// Bytes of all blobs.
    total: Arc<AtomicU64>,
}

impl BlobStore {
    /// Opens or makes the store below `dir`.
    pub async fn open(dir: &Path) -> Result<Self> {
        let root = dir.join("blobs");
        let staging = dir.join("staging");
        if tokio::fs::try_exists(&staging).await? {
            tokio::fs::remove_dir_all(&staging).await?;
        }
        tokio::fs::create_dir_all(&staging).await?;
        tokio::fs::create_dir_all(&root).await?;
        let objects = Arc::new(LocalFileSystem::new_with_prefix(&root)?);
        let total: u64 =
            objects.list(None).map_ok(|meta| meta.size).try_fold(0, |a, b| async move { Ok(a + b) }).await?;
        Ok(Self { objects, root, staging, total: Arc::new(AtomicU64::new(total)) })
    }

    /// Streams an upload into a temporary file, hashing it. `limit` is in bytes; `stall` the longest pause.
    pub async fn stage<S, E>(&self, stream: S, limit: u64, stall: Duration) -> Result<Staged, StageError>
    where
        S: Stream<Item = Result<Bytes, E>> + Unpin,
        E: std::fmt::Display,
    {
        Staged::write(&self.staging, stream, limit, stall).await
    }

    /// Gives staged bytes their name. What is there under it is replaced: it counts as put now, and should the disk have
    /// spoilt it, it is whole again.
    pub async fn commit(&self, staged: Staged) -> Result<()> {
        let (hash, bytes) = (staged.hash().to_owned(), staged.bytes());
        let before = self.size(&hash).await?.unwrap_or(0);
        let target = self.objects.path_to_filesystem(&object_path(&hash))?;
        staged.persist(target, self.root.clone()).await?;
        self.total.fetch_add(bytes, Ordering::Relaxed);
        self.total.fetch_sub(before, Ordering::Relaxed);
        Ok(())
    }

    /// Makes a blob count as put now; whether it is here.
    pub async fn touch(&self, hash: &str) -> Result<bool> {
        if !is_hash(hash) {
            return Ok(false);
        }
        let path = self.objects.path_to_filesystem(&object_path(hash))?;
        let touch = move || match std::fs::File::options().append(true).open(path) {
            Ok(file) => file.set_modified(SystemTime::now()).map(|()| true),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error),
        };
        Ok(tokio::task::spawn_blocking(touch).await.map_err(std::io::Error::other)??)
    }

    /// When a blob was last put, if it is here.
    pub async fn put_at(&self, hash: &str) -> Result<Option<jiff::Timestamp>> {
        let Some(meta) = self.head(hash).await? else { return Ok(None) };
        let ms = meta.last_modified.timestamp_millis();
        Ok(Some(jiff::Timestamp::from_millisecond(ms).map_err(std::io::Error::other)?))
    }

    /// The blob's length in bytes, if it is here. A text that is no hash names nothing.
    pub async fn size(&self, hash: &str) -> Result<Option<u64>> {
        Ok(self.head(hash).await?.map(|meta| meta.size))
    }

    async fn head(&self, hash: &str) -> Result<Option<ObjectMeta>> {
        if !is_hash(hash) {
            return Ok(None);
        }
        match self.objects.head(&object_path(hash)).await {
            Ok(meta) => Ok(Some(meta)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Streams part of a blob.
    pub async fn read(&self, hash: &str, range: Range<u64>) -> Result<BoxStream<'static, object_store::Result<Bytes>>> {
        if range.is_empty() {
            return Ok(futures::stream::empty().boxed());
        }
        let options = GetOptions { range: Some(GetRange::Bounded(range)), ..GetOptions::default() };
        Ok(self.objects.get_opts(&object_path(hash), options).await?.into_stream())
    }

    /// The first bytes of a blob, to see what it is.
    pub async fn start(&self, hash: &str, bytes: u64) -> Result<Option<Bytes>> {
        let Some(size) = self.size(hash).await? else { return Ok(None) };
        let stream = self.read(hash, 0..bytes.min(size)).await?;
        let chunks: Vec<Bytes> = stream.try_collect().await?;
        Ok(Some(chunks.concat().into()))
    }

    /// Removes a blob; harmless when it is not there.
    pub async fn delete(&self, hash: &str) -> Result<()> {
        let Some(size) = self.size(hash).await? else { return Ok(()) };
        match self.objects.delete(&object_path(hash)).await {
            Ok(()) => {
                self.total.fetch_sub(size, Ordering::Relaxed);
                Ok(())
            }
            Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Hashes of blobs that were last put before a time.
    pub fn older_than(&self, before: jiff::Timestamp) -> BoxStream<'static, Result<String>> {
        let before_ms = before.as_millisecond();
        self.objects
            .list(None)
            .map_err(BlobError::from)
            .try_filter(move |meta| std::future::ready(meta.last_modified.timestamp_millis() < before_ms))
            .map_ok(|meta| meta.location.filename().unwrap_or_default().to_owned())
            .boxed()
    }

    /// Bytes of all blobs.
    pub fn total_bytes(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }

    /// Fails when nothing can be written.
    pub async fn check_writable(&self) -> Result<()> {
        let file = tempfile::NamedTempFile::new_in(&self.staging)?;
        tokio::fs::write(file.path(), b"ready").await?;
        Ok(())
    }
}

/// `ab/cd/abcd…`: folders of a few hundred entries even with millions of blobs.
fn object_path(hash: &str) -> ObjectPath {
    ObjectPath::from_iter([&hash[..2], &hash[2..4], hash])
}

#[cfg(test)]
mod tests {
    use super::*;

    const STALL: Duration = Duration::from_secs(5);

    fn chunks(parts: &[&'static str]) -> impl Stream<Item = Result<Bytes, String>> + Unpin + use<> {
        futures::stream::iter(parts.iter().map(|part| Ok(Bytes::from_static(part.as_bytes()))).collect::<Vec<_>>())
    }

    fn staged_files(dir: &Path) -> usize {
        std::fs::read_dir(dir.join("staging")).unwrap().count()
    }

    #[tokio::test]
    async fn what_is_committed_can_be_read_whole_and_in_part() {
        let dir = tempfile::tempdir().unwrap();
        let store = BlobStore::open(dir.path()).await.unwrap();
        let staged = store.stage(chunks(&["hello ", "world"]), 100, STALL).await.unwrap();
        let hash = staged.hash().to_owned();
        assert_eq!(hash, blake3::hash(b"hello world").to_hex().to_string());
        assert_eq!(store.size(&hash).await.unwrap(), None, "staged is not stored");
        store.commit(staged).await.unwrap();
        assert_eq!(store.size(&hash).await.unwrap(), Some(11));
        assert_eq!(store.start(&hash, 5).await.unwrap().unwrap(), "hello");
        assert_eq!(store.start(&hash, 50).await.unwrap().unwrap(), "hello world");
        assert_eq!(store.total_bytes(), 11);
        assert_eq!(staged_files(dir.path()), 0);
        let again = store.stage(chunks(&["hello world"]), 100, STALL).await.unwrap();
        store.commit(again).await.unwrap();
        assert_eq!(store.total_bytes(), 11, "the same bytes are stored once");
        let reopened = BlobStore::open(dir.path()).await.unwrap();
        assert_eq!(reopened.total_bytes(), 11);
        reopened.delete(&hash).await.unwrap();
        reopened.delete(&hash).await.unwrap();
        assert_eq!((reopened.size(&hash).await.unwrap(), reopened.total_bytes()), (None, 0));
    }

    #[tokio::test]
    async fn what_is_put_again_is_as_new() {
        let dir = tempfile::tempdir().unwrap();
        let store = BlobStore::open(dir.path()).await.unwrap();
        let put = async || store.commit(store.stage(chunks(&["x"]), 100, STALL).await.unwrap()).await.unwrap();
        put().await;
        let hash = blake3::hash(b"x").to_hex().to_string();
        let path = store.objects.path_to_filesystem(&object_path(&hash)).unwrap();
        let age = || {
            let file = std::fs::File::options().append(true).open(&path).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(3600)).unwrap();
        };
        let half_an_hour_ago = jiff::Timestamp::now() - jiff::SignedDuration::from_mins(30);
        age();
        assert!(store.put_at(&hash).await.unwrap().unwrap() < half_an_hour_ago);
        std::fs::write(&path, "spoilt").unwrap();
        age();
        put().await;
        assert!(store.put_at(&hash).await.unwrap().unwrap() > half_an_hour_ago);
        assert_eq!(store.start(&hash, 10).await.unwrap().unwrap(), "x");
        age();
        assert!(store.touch(&hash).await.unwrap());
        assert!(store.put_at(&hash).await.unwrap().unwrap() > half_an_hour_ago);
        assert!(!store.touch(&"0".repeat(64)).await.unwrap());
    }

    #[tokio::test]
    async fn nothing_is_left_of_an_upload_that_fails() {
        let dir = tempfile::tempdir().unwrap();
        let store = BlobStore::open(dir.path()).await.unwrap();
        let too_large = store.stage(chunks(&["12345", "67890"]), 9, STALL).await;
        assert!(matches!(too_large, Err(StageError::TooLarge { limit: 9 })));
        let cut = futures::stream::iter([Ok(Bytes::from_static(b"abc")), Err("cut".to_owned())]);
        assert!(matches!(store.stage(cut, 100, STALL).await, Err(StageError::Incomplete(_))));
        let stalled = futures::stream::pending::<Result<Bytes, String>>();
        let result = store.stage(stalled, 100, Duration::from_millis(20)).await;
        assert!(matches!(result, Err(StageError::Stalled)));
        assert_eq!(staged_files(dir.path()), 0);
    }

    #[tokio::test]
    async fn what_a_killed_process_left_is_removed_at_the_start() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("staging")).unwrap();
        std::fs::write(dir.path().join("staging/orphan"), b"half").unwrap();
        BlobStore::open(dir.path()).await.unwrap();
        assert_eq!(staged_files(dir.path()), 0);
    }

    #[tokio::test]
    async fn a_text_that_is_no_hash_names_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let store = BlobStore::open(dir.path()).await.unwrap();
        for name in ["", "..", "../../etc/passwd", &"A".repeat(64), &"0".repeat(63)] {
            assert_eq!(store.size(name).await.unwrap(), None);
        }
    }
}
