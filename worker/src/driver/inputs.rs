//! A leased task's inputs: blobs through the local cache, structures through the service.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use lightshaft_api::client::{Client, ClientError};
use lightshaft_api::job::TaskWork;
use lightshaft_api::lease::{Lease, SceneFile};
use lightshaft_api::mesh::{FindStructures, NewStructure};
use lightshaft_api::settings::JobSettings;
use lightshaft_engine::accel::StructureKey;
use lightshaft_engine::scene::{Content, Limits, Source};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use super::live::Live;
use super::stop::Stop;
use super::tries::Tries;
use crate::benchmark::{SceneInput, Scenes, load};
use crate::cache::{BlobCache, Pin, StructureStore};
use crate::executor::{Inputs, TaskError};

/// Hashes that one look-up may name.
const LOOKUP_LIMIT: usize = 4096;
/// Structures that are uploaded at the same time.
const CONCURRENT_UPLOADS: usize = 4;

/// A structure's key without its mesh: kind, parameters, builder version.
type StructureKind = (&'static str, String, u32);

/// Inputs of the task of one lease. Calls wait on the thread that renders, until they are answered or the task is to stop.
pub(super) struct LeasedInputs {
    pub(super) lease: Arc<Lease>,
    pub(super) client: Client,
    pub(super) blobs: Arc<BlobCache>,
    pub(super) live: Arc<Live>,
    pub(super) stop: Arc<Stop>,
    pub(super) runtime: Handle,
    pub(super) kept: Kept,
}

/// What a task gathers on its way.
pub(super) struct Kept {
    /// The scene's files stay on disk until the task has ended.
    pins: Mutex<Vec<Pin>>,
    /// What the service has for the scene's meshes, by key; asked for once.
    known: Mutex<HashMap<StructureKind, BTreeMap<String, String>>>,
    uploads: Mutex<JoinSet<()>>,
    upload_slots: Arc<Semaphore>,
}

impl Default for Kept {
    fn default() -> Self {
        Self {
            pins: Mutex::default(),
            known: Mutex::default(),
            uploads: Mutex::default(),
            upload_slots: Arc::new(Semaphore::new(CONCURRENT_UPLOADS)),
        }
    }
}

impl LeasedInputs {
    /// Structures that are still being uploaded.
    pub(super) fn take_uploads(&self) -> JoinSet<()> {
        std::mem::take(&mut *self.kept.uploads.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The answer of a call, unless the task is to stop first.
    fn wait<T>(&self, call: impl Future<Output = T>) -> Result<T, TaskError> {
        self.runtime.block_on(async {
            tokio::select! {
                answer = call => Ok(answer),
                () = self.stop.asked() => Err(TaskError::Stopped),
            }
        })
    }

    pub(super) fn blob(&self, hash: &str) -> Result<PathBuf, TaskError> {
        let mut tries = Tries::new(&self.live, &self.stop);
        loop {
            let download = &mut |path: &Path| match self.wait(self.client.download_blob(hash, path)) {
                Ok(downloaded) => downloaded.map(|_| ()).map_err(io::Error::other),
                Err(stopped) => Err(io::Error::other(stopped)),
            };
            let error = match self.blobs.ensure(hash, download) {
                Ok((path, pin)) => {
                    self.kept.pins.lock().unwrap_or_else(PoisonError::into_inner).push(pin);
                    return Ok(path);
                }
                Err(error) => error,
            };
            let again = match cause::<ClientError>(&error) {
                Some(error) => self.runtime.block_on(tries.again(error))?,
                None => false,
            };
            if !again {
                return Err(download_error(hash, &error));
            }
        }
    }

    fn open_files(&self, files: &[SceneFile], limits: &Limits) -> Result<Source, TaskError> {
        let opened = match files {
            [] => return Err(TaskError::bad_input("the scene has no files")),
            [one] => Source::open(&self.blob(&one.blob)?, limits),
            _ => {
                let mut parts = Vec::with_capacity(files.len());
                for file in files {
                    parts.push((file.path.clone(), Content::File(self.blob(&file.blob)?)));
                }
                Source::from_files(parts, limits)
            }
        };
        opened.map_err(TaskError::from)
    }

    /// The blob of a structure, if the service has it. The first question is asked for all meshes of the scene at once;
    /// meshes that are not of the scene, such as a ground plane, are not shared.
    fn known_structure(&self, key: &StructureKey) -> Result<Option<String>, String> {
        let kind = (key.kind, key.parameters.clone(), key.builder_version);
        let mut known = self.kept.known.lock().unwrap_or_else(PoisonError::into_inner);
        let blobs = match known.entry(kind) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => {
                let found = self.wait(self.find_structures(key)).map_err(|stopped| stopped.to_string())?;
                entry.insert(found.map_err(|error| error.to_string())?)
            }
        };
        Ok(blobs.get(&key.mesh.to_string()).cloned())
    }

    async fn find_structures(&self, key: &StructureKey) -> Result<BTreeMap<String, String>, ClientError> {
        let mut found = BTreeMap::new();
        for meshes in self.lease.scene.meshes.chunks(LOOKUP_LIMIT) {
            let wanted = FindStructures {
                meshes: meshes.to_vec(),
                kind: key.kind.to_owned(),
                parameters: key.parameters.clone(),
                builder_version: key.builder_version,
            };
            found.extend(self.client.find_structures(&wanted).await?.blobs);
        }
        Ok(found)
    }
}

/// The error of another kind that an error of a download carries.
fn cause<E: std::error::Error + 'static>(error: &io::Error) -> Option<&E> {
    error.get_ref()?.downcast_ref()
}

/// What could not be downloaded may be there later, unless the service says that it does not exist; what could not be
/// written or read is this worker's trouble, and none of the job's.
fn download_error(hash: &str, error: &io::Error) -> TaskError {
    if let Some(stopped) = cause::<TaskError>(error) {
        return stopped.clone();
    }
    match cause::<ClientError>(error) {
        Some(ClientError::File { source, .. }) => {
            TaskError::worker(format!("blob {hash} could not be written to the worker's cache: {source}"))
        }
        Some(error) if error.status() == Some(404) => TaskError::bad_input(format!("blob {hash} is gone")),
        Some(_) => TaskError::transient(format!("blob {hash} could not be downloaded")),
        None if error.kind() == io::ErrorKind::InvalidData => TaskError::transient(error.to_string()),
        None => TaskError::worker(format!("blob {hash} in the worker's cache: {error}")),
    }
}

impl Inputs for LeasedInputs {
    fn waited_s(&self) -> Option<f64> {
        Some(self.lease.waited_s)
    }

    fn scene_key(&self) -> Option<String> {
        let mut hasher = blake3::Hasher::new();
        for SceneFile { path, blob, .. } in &self.lease.scene.files {
            hasher.update(path.as_bytes()).update(&[0]).update(blob.as_bytes()).update(&[0]);
        }
        Some(hasher.finalize().to_hex().to_string())
    }

    fn open_scene(&self, limits: &Limits) -> Result<Source, TaskError> {
        self.open_files(&self.lease.scene.files, limits)
    }

    fn environment_map(&self, name: &str) -> Result<Vec<u8>, TaskError> {
        let path = self.blob(name)?;
        std::fs::read(path).map_err(|error| TaskError::worker(format!("blob {name} in the worker's cache: {error}")))
    }

    fn parts(&self) -> Vec<TaskWork> {
        self.lease.parts.iter().map(|part| part.work.clone()).collect()
    }

    /// Straight to memory: it is needed once, and nobody else will.
    fn part(&self, index: usize) -> Result<Vec<u8>, TaskError> {
        let Some(part) = self.lease.parts.get(index) else {
            return Err(TaskError::bad_input(format!("the job has no part {index}")));
        };
        let mut tries = Tries::new(&self.live, &self.stop);
        loop {
            match self.wait(self.client.blob(&part.blob))? {
                Ok(bytes) => return Ok(bytes.into()),
                Err(error) if self.runtime.block_on(tries.again(&error))? => {}
                Err(error) => return Err(download_error(&part.blob, &io::Error::other(error))),
            }
        }
    }

    fn structures(&self) -> Option<&dyn StructureStore> {
        Some(self)
    }
}

/// The scenes of a benchmark: the job's own, then the further ones in the order of its settings.
impl Scenes for LeasedInputs {
    fn list(&self) -> Vec<SceneInput> {
        let table = match &self.lease.settings {
            JobSettings::Benchmark(settings) => settings.preset.and_then(|preset| load(preset).ok()),
            JobSettings::Render(_) | JobSettings::Build(_) | JobSettings::Compare(_) => None,
        };
        let own = &self.lease.scene;
        let mut listed = vec![SceneInput::named(&own.name, format!("{} ({})", own.name, own.id), table.as_ref())];
        for id in self.lease.settings.further_scenes() {
            listed.push(match self.lease.more_scenes.iter().find(|scene| scene.id == *id) {
                Some(scene) => SceneInput::named(&scene.name, format!("{} ({id})", scene.name), table.as_ref()),
                None => SceneInput { name: id.clone(), measured: id.clone(), ..SceneInput::default() },
            });
        }
        listed
    }

    fn open(&self, index: usize, limits: &Limits) -> Result<Source, TaskError> {
        let Some(further) = index.checked_sub(1) else { return self.open_scene(limits) };
        let wanted = self.lease.settings.further_scenes().get(further);
        match wanted.and_then(|id| self.lease.more_scenes.iter().find(|scene| scene.id == *id)) {
            Some(scene) => self.open_files(&scene.files, limits),
            None => Err(TaskError::bad_input(format!("/settings/scenes/{further}: the scene was deleted"))),
        }
    }
}

impl StructureStore for LeasedInputs {
    fn fetch(&self, key: &StructureKey) -> Result<Option<Vec<u8>>, String> {
        let Some(blob) = self.known_structure(key)? else { return Ok(None) };
        let fetched = self.wait(self.client.blob(&blob)).map_err(|stopped| stopped.to_string())?;
        fetched.map(|bytes| Some(bytes.to_vec())).map_err(|error| error.to_string())
    }

    fn publish(&self, key: &StructureKey, encoded: Vec<u8>, build_s: f64) {
        let client = self.client.clone();
        let slots = Arc::clone(&self.kept.upload_slots);
        let mesh = key.mesh.to_string();
        let structure = NewStructure {
            kind: key.kind.to_owned(),
            parameters: key.parameters.clone(),
            builder_version: key.builder_version,
            bytes: encoded.len() as u64,
            build_s,
            blob: blake3::hash(&encoded).to_hex().to_string(),
            // Only what could not be had or read is built: should one be there, it is of no use.
            replaces: self.known_structure(key).ok().flatten(),
        };
        let upload = async move {
            let _slot = slots.acquire().await;
            let published = match client.put_blob(&structure.blob, encoded).await {
                Ok(_) => client.add_structure(&mesh, &structure).await.map(|_| ()),
                Err(error) => Err(error),
            };
            if let Err(error) = published {
                tracing::warn!(mesh, "the structure could not be published: {error}");
            }
        };
        self.kept.uploads.lock().unwrap_or_else(PoisonError::into_inner).spawn_on(upload, &self.runtime);
    }
}

#[cfg(test)]
mod tests {
    use lightshaft_api::lease::RetryClass;

    use super::*;

    fn class(error: io::Error) -> (RetryClass, bool) {
        match download_error("hash", &error) {
            TaskError::Failed { class, fatal, .. } => (class, fatal),
            TaskError::Stopped => panic!("nobody asked for that"),
        }
    }

    #[test]
    fn trouble_with_the_disk_or_the_way_is_no_verdict_on_the_job() {
        let full = || io::Error::from(io::ErrorKind::StorageFull);
        let unwritten = ClientError::File { path: "tmp".into(), source: full() };
        let odd = ClientError::Unexpected { url: "u".into(), status: 502, detail: "".into(), retry_after: None };
        assert_eq!(class(full()), (RetryClass::Worker, false));
        assert_eq!(class(io::Error::other(unwritten)), (RetryClass::Worker, false));
        assert_eq!(class(io::Error::other(odd)), (RetryClass::Transient, false));
        assert_eq!(class(io::Error::new(io::ErrorKind::InvalidData, "torn")), (RetryClass::Transient, false));
        assert_eq!(download_error("hash", &io::Error::other(TaskError::Stopped)), TaskError::Stopped);
    }
}
