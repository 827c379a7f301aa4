//! Files under a byte budget.
//!
//! Several worker processes may share one folder, so nothing here relies on knowing all of its content: an entry
//! appears by an atomic rename of a complete temporary file, and disappears by being deleted, which a reader takes for
//! a miss. Locks of files tell processes of each other, and end with the process that holds them, however it ends:
//!
//! - a temporary file is locked by its writer; one that nobody locks was left by a process that died, and is deleted
//!   when the folder is opened next;
//! - an entry is locked (shared) by whoever needs it to stay; eviction spares what it cannot lock for itself.
//!
//! The budget is that of one process: each counts what it has written since it last looked at the whole folder, so
//! together they may exceed it for a while.
//!
//! Files are not synced: after a power failure an entry may be empty or torn, so readers check what they read.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
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
            next_temporary: AtomicU64::new(0),
        };
        store.delete_orphans()?;
        store.evict_if_over(budget_bytes)?;
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
        self.commit(pending, name).map(drop)
    }

    /// A temporary file, deleted unless it is committed.
    pub fn begin(&self) -> io::Result<PendingFile> {
        let n = self.next_temporary.fetch_add(1, Ordering::Relaxed);
        let path = self.folder.join(TEMPORARY_FOLDER).join(format!("{}-{n}-{:p}", std::process::id(), self));
        let file = File::options().write(true).create_new(true).open(&path)?;
        file.lock()?;
        Ok(PendingFile { file, path, committed: false })
    }

    /// Makes the file an entry, and evicts others when the budget is exceeded. The new entry stays while its pin lives.
    pub fn commit(&self, mut pending: PendingFile, name: &str) -> io::Result<Pin> {
        pending.file.flush()?;
        let bytes = pending.file.metadata()?.len();
        let path = self.path(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        // Locked all the time: first as a file that is being written, then as an entry in use.
        let file = pending.file.try_clone()?;
        fs::rename(&pending.path, &path)?;
        pending.committed = true;
        file.lock_shared()?;
        let pin = Pin { _file: file };
        let used = self.used_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if used > self.budget_bytes {
            self.evict_if_over(self.budget_bytes)?;
        }
        Ok(pin)
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

    /// Keeps the entry from eviction, by whatever process, while the pin lives, and notes that it was used now; `None`
    /// when there is no such entry.
    pub fn pin(&self, name: &str) -> io::Result<Option<Pin>> {
        let path = self.path(name);
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error),
        };
        // Whoever evicts holds its lock for a moment; then the file is gone, though it is still open here.
        file.lock_shared()?;
        if !is_at(&file, &path)? {
            return Ok(None);
        }
        touch(&path);
        Ok(Some(Pin { _file: file }))
    }

    pub fn used_bytes(&self) -> u64 {
        self.used_bytes.load(Ordering::Relaxed)
    }

    /// Names of all entries.
    pub fn names(&self) -> io::Result<Vec<String>> {
        let mut names = Vec::new();
        self.each_file(|file| names.extend(file.file_name().into_string()))?;
        Ok(names)
    }

    /// Evicts what was not used for the longest time until half of what is there is gone; whether anything went.
    pub fn make_room(&self) -> io::Result<bool> {
        let used = self.scan()?.iter().map(|entry| entry.bytes).sum::<u64>();
        tracing::warn!(used_bytes = used, "the cache's disk is full: making room");
        self.evict(self.scan()?, used / 2);
        Ok(self.used_bytes() < used)
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

    fn evict_if_over(&self, budget_bytes: u64) -> io::Result<()> {
        let entries = self.scan()?;
        let used: u64 = entries.iter().map(|entry| entry.bytes).sum();
        let target = if used > budget_bytes { (budget_bytes as f64 * EVICT_TO) as u64 } else { used };
        self.evict(entries, target);
        Ok(())
    }

    /// Deletes entries, the least recently used first, until no more than `target` bytes are left or all are in use.
    fn evict(&self, mut entries: Vec<Entry>, target: u64) {
        let mut used: u64 = entries.iter().map(|entry| entry.bytes).sum();
        entries.sort_by_key(|entry| entry.used_at);
        for entry in entries {
            if used <= target {
                break;
            }
            let path = self.path(&entry.name);
            // Locked until it is deleted.
            let unused = File::open(&path).ok().filter(|file| file.try_lock().is_ok());
            if unused.is_some() && fs::remove_file(&path).is_ok() {
                used -= entry.bytes;
            }
        }
        self.used_bytes.store(used, Ordering::Relaxed);
    }

    fn scan(&self) -> io::Result<Vec<Entry>> {
        let mut entries = Vec::new();
        self.each_file(|file| {
            // Another process may have evicted it meanwhile.
            if let (Ok(meta), Ok(name)) = (file.metadata(), file.file_name().into_string()) {
                let used_at = meta.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                entries.push(Entry { name, bytes: meta.len(), used_at });
            }
        })?;
        Ok(entries)
    }

    fn each_file(&self, mut visit: impl FnMut(&fs::DirEntry)) -> io::Result<()> {
        for shard in fs::read_dir(&self.folder)? {
            let shard = shard?;
            if shard.file_name() == TEMPORARY_FOLDER || !shard.file_type()?.is_dir() {
                continue;
            }
            for file in fs::read_dir(shard.path())? {
                let file = file?;
                if file.file_type()?.is_file() {
                    visit(&file);
                }
            }
        }
        Ok(())
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

/// Whether the open file is still the one at `path`.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt;
    let open = file.metadata()?;
    Ok(fs::metadata(path).is_ok_and(|there| (there.dev(), there.ino()) == (open.dev(), open.ino())))
}

#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> io::Result<bool> {
    path.try_exists()
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
    /// Holds the lock.
    _file: File,
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
        let pin = store.pin("aa").unwrap();
        age(&store, "aa", 100);
        store.write("bb", &[0; 20]).unwrap();
        assert!(store.read("aa").unwrap().is_some() && store.read("bb").unwrap().is_some());
        age(&store, "aa", 100);
        drop(pin);
        store.write("cc", &[0; 1]).unwrap();
        assert!(store.read("aa").unwrap().is_none());
    }

    #[test]
    fn what_one_process_uses_another_one_spares() {
        let (folder, ours) = store(10);
        // Locks belong to open files: a second store on the folder is as good as a second process.
        let theirs = DiskStore::open(folder.path(), 10).unwrap();
        ours.write("aa", &[0; 8]).unwrap();
        let pin = theirs.pin("aa").unwrap().expect("it is there");
        age(&ours, "aa", 100);
        ours.write("bb", &[0; 8]).unwrap();
        assert!(ours.read("aa").unwrap().is_some());
        drop(pin);
        age(&ours, "aa", 100);
        ours.write("cc", &[0; 8]).unwrap();
        assert!(theirs.pin("aa").unwrap().is_none());
    }

    #[test]
    fn room_is_made_at_the_cost_of_what_was_used_longest_ago() {
        let (_folder, store) = store(1000);
        for (name, seconds) in [("aa", 30), ("bb", 20), ("cc", 10), ("dd", 5)] {
            store.write(name, &[0; 30]).unwrap();
            age(&store, name, seconds);
        }
        assert!(store.make_room().unwrap());
        let mut names = store.names().unwrap();
        names.sort();
        assert_eq!((names, store.used_bytes()), (vec!["cc".to_owned(), "dd".to_owned()], 60));
        let _pins = [store.pin("cc").unwrap(), store.pin("dd").unwrap()];
        assert!(!store.make_room().unwrap(), "all is in use");
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
        drop(store.commit(alive, "aa").unwrap());
        assert_eq!(again.read("aa").unwrap().as_deref(), Some(&b"whole"[..]));
    }
}
