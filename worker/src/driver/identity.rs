//! The worker's id, kept on disk so that the service knows the worker again.
//!
//! Several workers may share one cache folder: each locks a file of its own for as long as it lives, the first that is
//! free. The id belongs to one service, so the file maps addresses to ids.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// More workers than this on one folder is a mistake.
const MAX_WORKERS: u32 = 4096;

#[derive(Clone, Debug)]
pub(super) struct Identity {
    file: Arc<Mutex<File>>,
    server: String,
}

impl Identity {
    /// Takes the first identity of the folder that no living worker holds.
    pub(super) fn claim(cache_dir: &Path, server: &str) -> io::Result<Self> {
        let folder = cache_dir.join("workers");
        fs::create_dir_all(&folder)?;
        for number in 0..MAX_WORKERS {
            let path = folder.join(format!("{number}.json"));
            let file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
            match file.try_lock() {
                Ok(()) => return Ok(Self { file: Arc::new(Mutex::new(file)), server: server.to_owned() }),
                Err(fs::TryLockError::WouldBlock) => {}
                Err(fs::TryLockError::Error(error)) => return Err(error),
            }
        }
        Err(io::Error::other(format!("{MAX_WORKERS} workers use this folder already")))
    }

    /// The id that the service gave at an earlier registration.
    pub(super) fn id(&self) -> Option<String> {
        read(&mut self.file.lock().unwrap_or_else(PoisonError::into_inner)).remove(&self.server)
    }

    pub(super) fn remember(&self, id: &str) -> io::Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let mut ids = read(&mut file);
        if ids.insert(self.server.clone(), id.to_owned()).as_deref() == Some(id) {
            return Ok(());
        }
        let text = serde_json::to_vec_pretty(&ids)?;
        file.seek(SeekFrom::Start(0))?;
        file.set_len(0)?;
        file.write_all(&text)
    }
}

/// An empty or torn file is one without ids: the worker gets a new one.
fn read(file: &mut File) -> BTreeMap<String, String> {
    let mut text = String::new();
    let read = file.seek(SeekFrom::Start(0)).and_then(|_| file.read_to_string(&mut text));
    read.ok().and_then(|_| serde_json::from_str(&text).ok()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_found_again_by_the_next_process_but_not_shared_with_a_living_one() {
        let folder = tempfile::tempdir().unwrap();
        let first = Identity::claim(folder.path(), "http://a/").unwrap();
        assert_eq!(first.id(), None);
        first.remember("w1").unwrap();
        let second = Identity::claim(folder.path(), "http://a/").unwrap();
        assert_eq!(second.id(), None);
        drop(first);
        let again = Identity::claim(folder.path(), "http://a/").unwrap();
        assert_eq!(again.id().as_deref(), Some("w1"));
        again.remember("a-much-longer-id").unwrap();
        again.remember("w2").unwrap();
        assert_eq!(again.id().as_deref(), Some("w2"));
    }

    #[test]
    fn ids_belong_to_one_service_and_a_torn_file_to_none() {
        let folder = tempfile::tempdir().unwrap();
        Identity::claim(folder.path(), "http://a/").unwrap().remember("w1").unwrap();
        assert_eq!(Identity::claim(folder.path(), "http://b/").unwrap().id(), None);
        fs::write(folder.path().join("workers/0.json"), "{\"http").unwrap();
        let identity = Identity::claim(folder.path(), "http://a/").unwrap();
        assert_eq!(identity.id(), None);
        identity.remember("w3").unwrap();
        assert_eq!(identity.id().as_deref(), Some("w3"));
    }
}
