//! The service's blobs on the worker's disk, by hash.

use std::collections::HashSet;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Condvar, Mutex, PoisonError};

use super::disk::{DiskStore, Pin};

#[derive(Debug)]
pub struct BlobCache {
    disk: DiskStore,
    in_work: Mutex<HashSet<String>>,
    done: Condvar,
}

impl BlobCache {
    pub fn new(disk: DiskStore) -> Self {
        Self { disk, in_work: Mutex::default(), done: Condvar::new() }
    }

    /// The path of the blob; `download` writes it to the file that it is given when it is not there. The bytes are
    /// checked against the hash in both cases, so a torn file is downloaded again. The file stays while the pin lives.
    ///
    /// Who asks for a blob that is being downloaded waits for it; other blobs go on beside it. On a full disk, what was
    /// not used for long makes room, once.
    ///
    /// # Errors
    /// Those of `download`, and of the disk; `InvalidData` when what was downloaded has another hash.
    pub fn ensure(&self, hash: &str, download: &mut dyn FnMut(&Path) -> io::Result<()>) -> io::Result<(PathBuf, Pin)> {
        let _turn = self.take_turn(hash);
        let path = self.disk.path(hash);
        if let Some(pin) = self.find(hash)? {
            return Ok((path, pin));
        }
        let pin = match self.fetch(hash, download) {
            Err(error) if is_disk_full(&error) && self.disk.make_room()? => self.fetch(hash, download),
            other => other,
        };
        Ok((path, pin?))
    }

    pub fn used_bytes(&self) -> u64 {
        self.disk.used_bytes()
    }

    fn find(&self, hash: &str) -> io::Result<Option<Pin>> {
        let Some(pin) = self.disk.pin(hash)? else { return Ok(None) };
        if file_hash(&self.disk.path(hash))? == hash {
            return Ok(Some(pin));
        }
        tracing::warn!(blob = hash, "a cached blob was corrupt; downloading it again");
        self.disk.remove(hash)?;
        Ok(None)
    }

    fn fetch(&self, hash: &str, download: &mut dyn FnMut(&Path) -> io::Result<()>) -> io::Result<Pin> {
        let pending = self.disk.begin()?;
        download(pending.path())?;
        let found = file_hash(pending.path())?;
        if found != hash {
            let message = format!("the blob {hash} arrived with the hash {found}");
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
        self.disk.commit(pending, hash)
    }

    fn take_turn(&self, hash: &str) -> Turn<'_> {
        let in_work = self.in_work.lock().unwrap_or_else(PoisonError::into_inner);
        let wait = self.done.wait_while(in_work, |in_work| in_work.contains(hash));
        wait.unwrap_or_else(PoisonError::into_inner).insert(hash.to_owned());
        Turn { cache: self, hash: hash.to_owned() }
    }
}

/// The right to look for a blob; handed on when dropped, whatever the end.
struct Turn<'a> {
    cache: &'a BlobCache,
    hash: String,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.cache.in_work.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.hash);
        self.cache.done.notify_all();
    }
}

/// Also when the disk's error is wrapped in that of a download.
fn is_disk_full(error: &io::Error) -> bool {
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = cause {
        if let Some(io) = error.downcast_ref::<io::Error>() {
            if matches!(io.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded) {
                return true;
            }
            // An error that carries another one shows that one's source as its own.
            if let Some(inner) = io.get_ref() {
                cause = Some(inner);
                continue;
            }
        }
        cause = error.source();
    }
    false
}

fn file_hash(path: &Path) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(std::fs::File::open(path)?)?;
    Ok(hasher.finalize().to_hex().to_string())
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use super::*;

    fn cache(budget: u64) -> (tempfile::TempDir, BlobCache) {
        let folder = tempfile::tempdir().unwrap();
        let disk = DiskStore::open(folder.path(), budget).unwrap();
        (folder, BlobCache::new(disk))
    }

    fn hash_of(content: &[u8]) -> String {
        blake3::hash(content).to_hex().to_string()
    }

    /// Gets a blob; says whether it had to be downloaded.
    fn get(cache: &BlobCache, content: &[u8]) -> bool {
        let mut downloaded = false;
        let mut download = |path: &Path| {
            downloaded = true;
            std::fs::write(path, content)
        };
        let (path, _pin) = cache.ensure(&hash_of(content), &mut download).unwrap();
        assert_eq!(std::fs::read(path).unwrap(), content);
        downloaded
    }

    #[test]
    fn a_blob_is_downloaded_once_and_again_when_the_file_is_torn() {
        let (_folder, cache) = cache(1000);
        assert!(get(&cache, b"content"));
        assert!(!get(&cache, b"content"));
        std::fs::write(cache.disk.path(&hash_of(b"content")), b"cont").unwrap();
        assert!(get(&cache, b"content"));
    }

    #[test]
    fn wrong_bytes_are_refused_and_leave_nothing() {
        let (_folder, cache) = cache(1000);
        let hash = hash_of(b"content");
        let error = cache.ensure(&hash, &mut |path| std::fs::write(path, b"other")).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
        let error = cache.ensure(&hash, &mut |_| Err(io::Error::other("gone"))).unwrap_err();
        assert_eq!(error.to_string(), "gone");
        assert_eq!(cache.used_bytes(), 0);
        assert!(get(&cache, b"content"), "the next one is not held up");
    }

    #[test]
    fn what_was_used_last_stays_longest_whenever_it_came() {
        let (_folder, cache) = cache(100);
        let blobs = [[1; 30], [2; 30], [3; 30], [4; 30]];
        for blob in &blobs[..3] {
            get(&cache, blob);
            // Times of last use differ by more than what a file system may round to.
            std::thread::sleep(Duration::from_millis(20));
        }
        assert!(!get(&cache, &blobs[0]));
        std::thread::sleep(Duration::from_millis(20));
        get(&cache, &blobs[3]);
        assert!(!get(&cache, &blobs[0]), "the oldest was used lately");
        assert!(get(&cache, &blobs[1]), "the least recently used one went");
    }

    #[test]
    fn one_blob_is_downloaded_by_one_while_others_go_on() {
        let (_folder, cache) = cache(1000);
        let (downloads, both_under_way) = (AtomicUsize::new(0), Barrier::new(2));
        std::thread::scope(|scope| {
            let (cache, downloads, both_under_way) = (&cache, &downloads, &both_under_way);
            for content in [&b"left"[..], b"right"] {
                for _ in 0..4 {
                    scope.spawn(move || {
                        let mut download = |path: &Path| {
                            downloads.fetch_add(1, Ordering::Relaxed);
                            // Returns only if the other blob is being downloaded at the same time.
                            both_under_way.wait();
                            std::fs::write(path, content)
                        };
                        let (path, _pin) = cache.ensure(&hash_of(content), &mut download).unwrap();
                        assert_eq!(std::fs::read(path).unwrap(), content);
                    });
                }
            }
        });
        assert_eq!(downloads.load(Ordering::Relaxed), 2);
    }

    #[test]
    fn on_a_full_disk_old_blobs_make_room_and_pinned_ones_stay() {
        let (_folder, cache) = cache(1000);
        let (_, pin) = cache.ensure(&hash_of(b"in use"), &mut |path| std::fs::write(path, b"in use")).unwrap();
        get(&cache, b"old");
        let full = || io::Error::other(io::Error::from(io::ErrorKind::StorageFull));
        let mut tries = 0;
        let mut when_there_is_room = |path: &Path| {
            tries += 1;
            if tries == 1 { Err(full()) } else { std::fs::write(path, b"new") }
        };
        cache.ensure(&hash_of(b"new"), &mut when_there_is_room).unwrap();
        assert_eq!(tries, 2);
        assert!(!get(&cache, b"in use") && get(&cache, b"old"));
        drop(pin);

        let error = cache.ensure(&hash_of(b"too big"), &mut |_| Err(full())).unwrap_err();
        assert!(is_disk_full(&error), "{error}");
        assert!(get(&cache, b"the next one"), "room that is there is used");
    }
}
