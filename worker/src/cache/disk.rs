//! Files under a byte budget.
//!
//! Several worker processes may share one folder, so nothing here relies on knowing all of its content: an entry
//! appears by an atomic rename of a complete temporary file, and disappears by being deleted, which a reader takes for
//! a miss. A temporary file is locked by its writer for as long as it lives; one that nobody locks was left by a process
//! that died, and is deleted when the folder is opened next.
//!
//! Files are not synced: after a power failure an entry may be empty or torn, so readers check what they read.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

const TEMPORARY_FOLDER: &str = "tmp";

/// Eviction goes down to this share of the budget, so that it does not run at every write.
const EVICT_TO: f64 = 0.9;

#[derive(Debug)]
pub struct DiskStore {
    folder: PathBuf,
    budget_bytes: u64,
    /// As of the last scan, plus what was written since.
    used_bytes: AtomicU64,
    pins: Arc<Mutex<HashMap<String, usize>>>,
    next_temporary: AtomicU64,
}

impl DiskStore {
    /// Makes the folder where needed, and deletes what writers left that are dead by now.
    ///
    /// # Errors
    /// When the folder can be neither made nor listed.
    pub fn open(folder: &Path, budget_bytes: u64) -> io::Result<Self> {
        fs::create_dir_all(folder.join(TEMPORARY_FOLDER))?;
        let store = Self {
            folder: folder.to_owned(),
            budget_bytes,
            used_bytes: AtomicU64::new(0),
            pins: Arc::default(),
            next_temporary: AtomicU64::new(0),
        };
        store.delete_orphans()?;
        store.evict()?;
        Ok(store)
    }

    /// The entry's bytes, and a note that it was used now.
    pub fn read(&self, name: &str) -> io::Result<Option<Vec<u8>>> {
        let path = self.path(name);
        match fs::read(&path) {
            Ok(bytes) => {
                touch(&path);
                Ok(Some(bytes))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    pub fn write(&self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let mut pending = self.begin()?;
        pending.file.write_all(bytes)?;
        self.commit(pending, name)
    }

    /// A temporary file, deleted unless it is committed.
    pub fn begin(&self) -> io::Result<PendingFile> {
        let n = self.next_temporary.fetch_add(1, Ordering::Relaxed);
        let path = self.folder.join(TEMPORARY_FOLDER).join(format!("{}-{n}-{:p}", std::process::id(), self));
        let file = File::options().write(true).create_new(true).open(&path)?;
        file.lock()?;
        Ok(PendingFile { file, path, committed: false })
    }

    /// Makes the file an entry, and evicts older ones when the budget is exceeded. The new entry always stays.
    pub fn commit(&self, mut pending: PendingFile, name: &str) -> io::Result<()> {
        pending.file.flush()?;
        let bytes = pending.file.metadata()?.len();
        let path = self.path(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        let _pin = self.pin(name);
        fs::rename(&pending.path, &path)?;
        pending.committed = true;
        let used = self.used_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if used > self.budget_bytes { self.evict() } else { Ok(()) }
    }

    pub fn remove(&self, name: &str) -> io::Result<()> {
        let path = self.path(name);
        let bytes = fs::metadata(&path).map_or(0, |meta| meta.len());
        match fs::remove_file(&path) {
            Ok(()) => {
                let saturating = |used: u64| Some(used.saturating_sub(bytes));
                let _ = self.used_bytes.fetch_update(Ordering::Relaxed, Ordering::Relaxed, saturating);
                Ok(())
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Where the entry is, if it is there.
    pub fn path(&self, name: &str) -> PathBuf {
        let shard = name.get(..2).unwrap_or("00");
        self.folder.join(shard).join(name)
    }

    /// While the pin lives, this process does not evict the entry.
    pub fn pin(&self, name: &str) -> Pin {
        let mut pins = self.pins.lock().unwrap_or_else(PoisonError::into_inner);
        *pins.entry(name.to_owned()).or_default() += 1;
        Pin { name: name.to_owned(), pins: Arc::clone(&self.pins) }
    }

    pub fn used_bytes(&self) -> u64 {
        self.used_bytes.load(Ordering::Relaxed)
    }

    /// Names of all entries.
    pub fn names(&self) -> io::Result<Vec<String>> {
        Ok(self.scan()?.into_iter().map(|entry| entry.name).collect())
    }

    fn delete_orphans(&self) -> io::Result<()> {
        for entry in fs::read_dir(self.folder.join(TEMPORARY_FOLDER))? {
            let path = entry?.path();
            let orphaned = File::open(&path).is_ok_and(|file| file.try_lock().is_ok());
            if orphaned && fs::remove_file(&path).is_ok() {
                tracing::info!("deleted a temporary file of a process that has died");
            }
        }
        Ok(())
    }

    fn evict(&self) -> io::Result<()> {
        let mut entries = self.scan()?;
        let mut used: u64 = entries.iter().map(|entry| entry.bytes).sum();
        if used > self.budget_bytes {
            entries.sort_by_key(|entry| entry.used_at);
            let target = (self.budget_bytes as f64 * EVICT_TO) as u64;
            for entry in entries {
                if used <= target {
                    break;
                }
                let pinned = self.pins.lock().unwrap_or_else(PoisonError::into_inner).contains_key(&entry.name);
                if !pinned && fs::remove_file(self.path(&entry.name)).is_ok() {
                    used -= entry.bytes;
                }
            }
        }
        self.used_bytes.store(used, Ordering::Relaxed);
        Ok(())
    }

    fn scan(&self) -> io::Result<Vec<Entry>> {
        let mut entries = Vec::new();
        for shard in fs::read_dir(&self.folder)? {
            let shard = shard?;
            if shard.file_name() == TEMPORARY_FOLDER || !shard.file_type()?.is_dir() {
                continue;
            }
            for file in fs::read_dir(shard.path())? {
                let file = file?;
                // Another process may have evicted it meanwhile.
                let Ok(meta) = file.metadata() else { continue };
                if let (true, Ok(name)) = (meta.is_file(), file.file_name().into_string()) {
                    let used_at = meta.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                    entries.push(Entry { name, bytes: meta.len(), used_at });
                }
            }
        }
        Ok(entries)
    }
}

struct Entry {
    name: String,
    bytes: u64,
    used_at: SystemTime,
}

/// The modification time serves as the time of last use: access times are often switched off. Best effort.
fn touch(path: &Path) {
    if let Ok(file) = File::options().append(true).open(path) {
        let _ = file.set_modified(SystemTime::now());
    }
}

/// A file that becomes an entry by [`DiskStore::commit`] and is deleted otherwise.
#[derive(Debug)]
pub struct PendingFile {
    file: File,
    path: PathBuf,
    committed: bool,
}

impl PendingFile {
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Write for PendingFile {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        self.file.write(buffer)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for PendingFile {
    fn drop(&mut self) {
        if !self.committed {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// See [`DiskStore::pin`].
#[derive(Debug)]
pub struct Pin {
    name: String,
    pins: Arc<Mutex<HashMap<String, usize>>>,
}

impl Drop for Pin {
    fn drop(&mut self) {
        let mut pins = self.pins.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = pins.get_mut(&self.name) {
            *count -= 1;
            if *count == 0 {
                pins.remove(&self.name);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn store(budget: u64) -> (tempfile::TempDir, DiskStore) {
        let folder = tempfile::tempdir().unwrap();
        let store = DiskStore::open(folder.path(), budget).unwrap();
        (folder, store)
    }

    /// Makes the entry look as if it was last used that long ago.
    fn age(store: &DiskStore, name: &str, seconds: u64) {
        let file = File::options().append(true).open(store.path(name)).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(seconds)).unwrap();
    }

    #[test]
    fn what_was_written_is_read_back_also_after_reopening() {
        let (folder, store) = store(100);
        store.write("abc", b"hello").unwrap();
        assert_eq!(store.read("abc").unwrap().as_deref(), Some(&b"hello"[..]));
        assert_eq!(store.read("nothing").unwrap(), None);
        let again = DiskStore::open(folder.path(), 100).unwrap();
        assert_eq!(again.used_bytes(), 5);
        again.remove("abc").unwrap();
        again.remove("abc").unwrap();
        assert_eq!((again.read("abc").unwrap(), again.used_bytes()), (None, 0));
    }

    #[test]
    fn the_oldest_entries_go_when_the_budget_is_exceeded() {
        let (_folder, store) = store(100);
        for (name, seconds) in [("aa", 30), ("bb", 20), ("cc", 10)] {
            store.write(name, &[0; 30]).unwrap();
            age(&store, name, seconds);
        }
        store.read("aa").unwrap();
        store.write("dd", &[0; 30]).unwrap();
        let mut names = store.names().unwrap();
        names.sort();
        assert_eq!(names, ["aa", "cc", "dd"]);
        assert_eq!(store.used_bytes(), 90);
    }

    #[test]
    fn pinned_entries_and_the_newest_stay_even_over_the_budget() {
        let (_folder, store) = store(10);
        store.write("aa", &[0; 8]).unwrap();
        age(&store, "aa", 100);
        let pin = store.pin("aa");
        store.write("bb", &[0; 20]).unwrap();
        assert!(store.read("aa").unwrap().is_some() && store.read("bb").unwrap().is_some());
        age(&store, "aa", 100);
        drop(pin);
        store.write("cc", &[0; 1]).unwrap();
        assert!(store.read("aa").unwrap().is_none());
    }

    #[test]
    fn a_file_that_is_given_up_leaves_nothing() {
        let (folder, store) = store(100);
        let mut pending = store.begin().unwrap();
        pending.write_all(b"half").unwrap();
        drop(pending);
        assert_eq!(fs::read_dir(folder.path().join(TEMPORARY_FOLDER)).unwrap().count(), 0);
        assert!(store.names().unwrap().is_empty());
    }

    #[test]
    fn temporary_files_of_the_dead_are_deleted_and_those_of_the_living_kept() {
        let (folder, store) = store(100);
        let left_behind = folder.path().join(TEMPORARY_FOLDER).join("4000000000-0");
        fs::write(&left_behind, b"torn").unwrap();
        let mut alive = store.begin().unwrap();
        let again = DiskStore::open(folder.path(), 100).unwrap();
        assert!(!left_behind.exists());
        alive.write_all(b"whole").unwrap();
        store.commit(alive, "aa").unwrap();
        assert_eq!(again.read("aa").unwrap().as_deref(), Some(&b"whole"[..]));
    }
}
