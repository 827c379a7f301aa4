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
use lightshaft_engine::accel::StructureKey;
use lightshaft_engine::scene::{Content, Limits, Source};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::cache::{BlobCache, Pin, StructureStore};
use crate::executor::{Inputs, TaskError};

/// Hashes that one look-up may name.
const LOOKUP_LIMIT: usize = 4096;
/// Structures that are uploaded at the same time.
const CONCURRENT_UPLOADS: usize = 4;

/// A structure's key without its mesh: kind, parameters, builder version.
type StructureKind = (&'static str, String, u32);

pub(super) struct LeasedInputs {
    lease: Arc<Lease>,
    client: Client,
    blobs: Arc<BlobCache>,
    runtime: Handle,
    /// The scene's files stay on disk until the task has ended.
    pins: Mutex<Vec<Pin>>,
    /// What the service has for the scene's meshes, by key; asked for once.
    known: Mutex<HashMap<StructureKind, BTreeMap<String, String>>>,
    uploads: Arc<Mutex<JoinSet<()>>>,
    upload_slots: Arc<Semaphore>,
}

impl LeasedInputs {
    pub(super) fn new(lease: Arc<Lease>, client: Client, blobs: Arc<BlobCache>, runtime: Handle) -> Self {
        Self {
            lease,
            client,
            blobs,
            runtime,
            pins: Mutex::default(),
            known: Mutex::default(),
            uploads: Arc::default(),
            upload_slots: Arc::new(Semaphore::new(CONCURRENT_UPLOADS)),
        }
    }

    /// Structures that are still being uploaded: to be awaited before the task is reported, so that whoever sees it done
    /// finds them.
    pub(super) fn take_uploads(&self) -> JoinSet<()> {
        std::mem::take(&mut *self.uploads.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn blob(&self, hash: &str) -> Result<PathBuf, TaskError> {
        let download = &mut |path: &Path| {
            let downloaded = self.runtime.block_on(self.client.download_blob(hash, path));
            downloaded.map(|_| ()).map_err(io::Error::other)
        };
        let (path, pin) = self.blobs.ensure(hash, download).map_err(|error| download_error(hash, &error))?;
        self.pins.lock().unwrap_or_else(PoisonError::into_inner).push(pin);
        Ok(path)
    }

    /// The blob of a structure, if the service has it. The first question is asked for all meshes of the scene at once;
    /// meshes that are not of the scene, such as a ground plane, are not shared.
    fn known_structure(&self, key: &StructureKey) -> Result<Option<String>, String> {
        let kind = (key.kind, key.parameters.clone(), key.builder_version);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let blobs = match known.entry(kind) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(self.find_structures(key).map_err(|error| error.to_string())?),
        };
        Ok(blobs.get(&key.mesh.to_string()).cloned())
    }

    fn find_structures(&self, key: &StructureKey) -> Result<BTreeMap<String, String>, ClientError> {
        let mut found = BTreeMap::new();
        for meshes in self.lease.scene.meshes.chunks(LOOKUP_LIMIT) {
            let wanted = FindStructures {
                meshes: meshes.to_vec(),
                kind: key.kind.to_owned(),
                parameters: key.parameters.clone(),
                builder_version: key.builder_version,
            };
            found.extend(self.runtime.block_on(self.client.find_structures(&wanted))?.blobs);
        }
        Ok(found)
    }

    fn read_blob(&self, hash: &str) -> Result<Vec<u8>, TaskError> {
        std::fs::read(self.blob(hash)?).map_err(|error| TaskError::worker(format!("blob {hash}: {error}")))
    }
}

/// What could not be downloaded may be there later, unless the service says that it does not exist; what could not be
/// written is this worker's trouble.
fn download_error(hash: &str, error: &io::Error) -> TaskError {
    let client_error = error.get_ref().and_then(|inner| inner.downcast_ref::<ClientError>());
    match client_error {
        Some(ClientError::File { source, .. }) => {
            TaskError::worker(format!("blob {hash} could not be written: {source}"))
        }
        Some(error) if error.status() == Some(404) => TaskError::bad_input(format!("blob {hash} is gone")),
        Some(_) => TaskError::transient(format!("blob {hash} could not be downloaded")),
        None if error.kind() == io::ErrorKind::InvalidData => TaskError::transient(error.to_string()),
        None => TaskError::worker(format!("blob {hash}: {error}")),
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
        let files = &self.lease.scene.files;
        let opened = match &files[..] {
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
        opened.map_err(|error| TaskError::bad_input(error.to_string()))
    }

    fn environment_map(&self, name: &str) -> Result<Vec<u8>, TaskError> {
        self.read_blob(name)
    }

    fn parts(&self) -> Result<Vec<(TaskWork, Vec<u8>)>, TaskError> {
        self.lease.parts.iter().map(|part| Ok((part.work.clone(), self.read_blob(&part.blob)?))).collect()
    }

    fn structures(&self) -> Option<&dyn StructureStore> {
        Some(self)
    }
}

impl StructureStore for LeasedInputs {
    fn fetch(&self, key: &StructureKey) -> Result<Option<Vec<u8>>, String> {
        let Some(blob) = self.known_structure(key)? else { return Ok(None) };
        let fetched = self.runtime.block_on(self.client.blob(&blob));
        fetched.map(|bytes| Some(bytes.to_vec())).map_err(|error| error.to_string())
    }

    fn publish(&self, key: &StructureKey, encoded: Vec<u8>, build_s: f64) {
        let client = self.client.clone();
        let slots = Arc::clone(&self.upload_slots);
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
        self.uploads.lock().unwrap_or_else(PoisonError::into_inner).spawn_on(upload, &self.runtime);
    }
}
