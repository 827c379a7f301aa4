//! The service's blobs on the worker's disk, by hash.

use std::io;
use std::path::{Path, PathBuf};

use super::disk::{DiskStore, Pin};

#[derive(Debug)]
pub struct BlobCache {
    disk: DiskStore,
}

impl BlobCache {
    pub fn new(disk: DiskStore) -> Self {
        Self { disk }
    }

    /// The path of the blob; `download` writes it to the file that it is given when it is not there. The bytes are
    /// checked against the hash in both cases, so a torn file is downloaded again. The file stays while the pin lives.
    ///
    /// # Errors
    /// Those of `download`, and of the disk; `InvalidData` when what was downloaded has another hash.
    pub fn ensure(&self, hash: &str, download: &mut dyn FnMut(&Path) -> io::Result<()>) -> io::Result<(PathBuf, Pin)> {
        let pin = self.disk.pin(hash);
        let path = self.disk.path(hash);
        match file_hash(&path) {
            Ok(found) if found == hash => return Ok((path, pin)),
            Ok(_) => {
                tracing::warn!(blob = hash, "a cached blob was corrupt; downloading it again");
                self.disk.remove(hash)?;
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        let pending = self.disk.begin()?;
        download(pending.path())?;
        let found = file_hash(pending.path())?;
        if found != hash {
            let message = format!("the blob {hash} arrived with the hash {found}");
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
        self.disk.commit(pending, hash)?;
        Ok((path, pin))
    }

    pub fn used_bytes(&self) -> u64 {
        self.disk.used_bytes()
    }
}

fn file_hash(path: &Path) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(std::fs::File::open(path)?)?;
    Ok(hasher.finalize().to_hex().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cache() -> (tempfile::TempDir, BlobCache) {
        let folder = tempfile::tempdir().unwrap();
        let disk = DiskStore::open(folder.path(), 1000).unwrap();
        (folder, BlobCache::new(disk))
    }

    #[test]
    fn a_blob_is_downloaded_once_and_again_when_the_file_is_torn() {
        let (_folder, cache) = cache();
        let hash = blake3::hash(b"content").to_hex().to_string();
        let mut downloads = 0;
        let mut get = |cache: &BlobCache| {
            let mut download = |path: &Path| {
                downloads += 1;
                std::fs::write(path, b"content")
            };
            let (path, _pin) = cache.ensure(&hash, &mut download).unwrap();
            (std::fs::read(&path).unwrap(), path, downloads)
        };
        assert_eq!(get(&cache).0, b"content");
        let (_, path, downloads) = get(&cache);
        assert_eq!(downloads, 1);
        std::fs::write(&path, b"cont").unwrap();
        let (bytes, _, downloads) = get(&cache);
        assert_eq!((&bytes[..], downloads), (&b"content"[..], 2));
    }

    #[test]
    fn wrong_bytes_are_refused_and_leave_nothing() {
        let (_folder, cache) = cache();
        let hash = blake3::hash(b"content").to_hex().to_string();
        let error = cache.ensure(&hash, &mut |path| std::fs::write(path, b"other")).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
        let error = cache.ensure(&hash, &mut |_| Err(io::Error::other("gone"))).unwrap_err();
        assert_eq!(error.to_string(), "gone");
        assert_eq!(cache.used_bytes(), 0);
    }
}
