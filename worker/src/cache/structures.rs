//! Built structures and Line Spaces, by `(mesh hash, kind, parameters, builder version)`: in memory, on disk, in the service's store.
//!
//! A structure is looked for from the nearest place to the farthest, and built when nobody has it; whatever was found or
//! built is put into the nearer places. Requests for one key at one time do the work once. Trouble with a cache is
//! never an error of the render: it becomes a warning in its metrics, and the structure is built.

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use lightshaft_api::job::{BuiltOn, CacheReport, CacheSource};
use lightshaft_api::worker::CacheStatus;
use lightshaft_engine::accel::{BuildError, Structure, StructureKey};
use lightshaft_engine::scene::Mesh;

use super::disk::DiskStore;
use super::lru::Lru;
use super::recipe::{Built, Cached, Kept, Recipe, WeakKept};

#[cfg(test)]
mod tests;

/// Structures that other workers built: the service's blob store.
pub trait StructureStore: Sync {
    /// The encoded structure, if the store has it.
    fn fetch(&self, key: &StructureKey) -> Result<Option<Vec<u8>>, String>;

    /// Offers a structure to the others. May return before it is stored.
    fn publish(&self, key: &StructureKey, encoded: Vec<u8>, build_s: f64);
}

#[derive(Debug)]
pub struct StructureCache {
    memory: Mutex<Memory>,
    disk: Option<DiskStore>,
    in_work: Mutex<HashSet<StructureKey>>,
    done: Condvar,
}

#[derive(Debug)]
struct Memory {
    kept: Lru<StructureKey, Kept>,
    /// Everything that somebody still traces with, evicted or not.
    alive: HashMap<StructureKey, WeakKept>,
}

/// A structure or a Line Space, and where it came from.
#[derive(Debug)]
pub struct Obtained<T = Structure> {
    pub structure: T,
    pub report: CacheReport,
    pub warnings: Vec<String>,
}

impl StructureCache {
    pub fn new(memory_budget_bytes: u64, disk: Option<DiskStore>) -> Self {
        Self {
            memory: Mutex::new(Memory { kept: Lru::new(memory_budget_bytes), alive: HashMap::new() }),
            disk,
            in_work: Mutex::default(),
            done: Condvar::new(),
        }
    }

    /// Gets the structure of `mesh`, building it when nobody has it.
    ///
    /// # Errors
    /// [`BuildError::Cancelled`] once `cancel` is set, also while waiting for somebody else's build; nothing is left
    /// behind then. Other errors are those of the builder.
    pub fn get<R: Recipe>(
        &self,
        mesh: &Mesh,
        recipe: &R,
        store: Option<&dyn StructureStore>,
        cancel: &AtomicBool,
    ) -> Result<Obtained<R::Product>, BuildError> {
        let started = Instant::now();
        let key = recipe.key(mesh);
        let _turn = self.take_turn(&key, cancel)?;
        let mut warnings = Vec::new();
        let (structure, source, built_on) = match self.find(&key, mesh, recipe, store, &mut warnings) {
            Some((found, source)) => (found, source, None),
            None => {
                let (built, on) = self.build(&key, mesh, recipe, store, cancel, &mut warnings)?;
                (built, CacheSource::Built, Some(on))
            }
        };
        let report = CacheReport {
            mesh: mesh.hash.to_string(),
            structure: format!("{} {}", key.kind, key.parameters),
            source,
            built_on,
            seconds: started.elapsed().as_secs_f64(),
            bytes: structure.bytes(),
        };
        Ok(Obtained { structure, report, warnings })
    }

    /// Counts again what the structures in memory take: a GPU adds its layout to those that it is given.
    pub fn weigh(&self) {
        self.memory().kept.weigh(Kept::bytes);
    }

    /// What is at hand: hashes of at most `limit` meshes with structures, and how much that is. Lists the folder once.
    pub fn holdings(&self, limit: usize) -> (Vec<String>, CacheStatus) {
        let listed = self.disk.as_ref().and_then(|disk| disk.names().ok()).unwrap_or_default();
        let memory = self.memory();
        let names: HashSet<String> = listed.into_iter().chain(memory.kept.keys().map(file_name)).collect();
        let status = CacheStatus {
            memory_bytes: memory.kept.used_bytes(),
            memory_budget_bytes: memory.kept.budget_bytes(),
            disk_bytes: self.disk.as_ref().map_or(0, DiskStore::used_bytes),
            entries: names.len() as u64,
        };
        let meshes: HashSet<&str> = names.iter().filter_map(|name| name.split_once('-')).map(|name| name.0).collect();
        (meshes.into_iter().take(limit).map(str::to_owned).collect(), status)
    }

    fn find<R: Recipe>(
        &self,
        key: &StructureKey,
        mesh: &Mesh,
        recipe: &R,
        store: Option<&dyn StructureStore>,
        warnings: &mut Vec<String>,
    ) -> Option<(R::Product, CacheSource)> {
        if let Some(structure) = self.recall(key) {
            return Some((structure, CacheSource::Memory));
        }
        if let Some(structure) = self.load(key, mesh, recipe, warnings) {
            return Some((self.remember(key, structure), CacheSource::Disk));
        }
        let (structure, encoded) = self.fetch(key, mesh, recipe, store?, warnings)?;
        self.save(key, &encoded, warnings);
        Some((self.remember(key, structure), CacheSource::Fetched))
    }

    fn load<R: Recipe>(
        &self,
        key: &StructureKey,
        mesh: &Mesh,
        recipe: &R,
        warnings: &mut Vec<String>,
    ) -> Option<R::Product> {
        let disk = self.disk.as_ref()?;
        let name = file_name(key);
        let bytes = match disk.read(&name) {
            Ok(bytes) => bytes?,
            Err(error) => {
                warnings.push(format!("the cached structure of mesh {} could not be read: {error}", key.mesh));
                return None;
            }
        };
        match recipe.decode(&bytes, mesh) {
            Ok(structure) => Some(structure),
            Err(why) => {
                warnings.push(format!("the cached structure of mesh {} was corrupt ({why}): rebuilt", key.mesh));
                if let Err(error) = disk.remove(&name) {
                    warnings.push(format!("the corrupt file could not be deleted: {error}"));
                }
                None
            }
        }
    }

    fn fetch<R: Recipe>(
        &self,
        key: &StructureKey,
        mesh: &Mesh,
        recipe: &R,
        store: &dyn StructureStore,
        warnings: &mut Vec<String>,
    ) -> Option<(R::Product, Vec<u8>)> {
        match store.fetch(key) {
            Ok(None) => None,
            Ok(Some(encoded)) => match recipe.decode(&encoded, mesh) {
                Ok(structure) => Some((structure, encoded)),
                Err(why) => {
                    warnings.push(format!("the service's structure of mesh {} was corrupt ({why}): rebuilt", key.mesh));
                    None
                }
            },
            Err(error) => {
                warnings.push(format!("the structure of mesh {} could not be fetched: {error}", key.mesh));
                None
            }
        }
    }

    fn build<R: Recipe>(
        &self,
        key: &StructureKey,
        mesh: &Mesh,
        recipe: &R,
        store: Option<&dyn StructureStore>,
        cancel: &AtomicBool,
        warnings: &mut Vec<String>,
    ) -> Result<(R::Product, BuiltOn), BuildError> {
        let started = Instant::now();
        let Built { product: structure, on, warning } = recipe.build(mesh, cancel)?;
        warnings.extend(warning);
        let build_s = started.elapsed().as_secs_f64();
        let encoded = (self.disk.is_some() || store.is_some()).then(|| structure.encode());
        let structure = self.remember(key, structure);
        if let Some(encoded) = encoded {
            self.save(key, &encoded, warnings);
            if let Some(store) = store {
                store.publish(key, encoded, build_s);
            }
        }
        Ok((structure, on))
    }

    fn save(&self, key: &StructureKey, encoded: &[u8], warnings: &mut Vec<String>) {
        if let Some(disk) = &self.disk
            && let Err(error) = disk.write(&file_name(key), encoded)
        {
            warnings.push(format!("the structure of mesh {} could not be cached on disk: {error}", key.mesh));
        }
    }

    fn recall<T: Cached>(&self, key: &StructureKey) -> Option<T> {
        let mut memory = self.memory();
        let kept = memory.kept.get(key).or_else(|| memory.alive.get(key).and_then(WeakKept::upgrade))?;
        T::from_kept(kept)
    }

    fn remember<T: Cached>(&self, key: &StructureKey, structure: T) -> T {
        let mut memory = self.memory();
        let kept: Kept = structure.clone().into();
        memory.alive.retain(|_, weak| weak.is_alive());
        memory.alive.insert(key.clone(), kept.downgrade());
        memory.kept.insert(key.clone(), kept, structure.bytes());
        structure
    }

    fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until nobody else works on the key.
    fn take_turn(&self, key: &StructureKey, cancel: &AtomicBool) -> Result<Turn<'_>, BuildError> {
        let mut in_work = self.in_work.lock().unwrap_or_else(PoisonError::into_inner);
        while !in_work.insert(key.clone()) {
            // Wakes now and then, since nobody notifies when `cancel` is set.
            let waited = self.done.wait_timeout(in_work, Duration::from_millis(50));
            in_work = waited.unwrap_or_else(PoisonError::into_inner).0;
            if cancel.load(Ordering::Relaxed) {
                return Err(BuildError::Cancelled);
            }
        }
        Ok(Turn { cache: self, key: key.clone() })
    }
}

/// The right to work on a key; handed on when dropped, whatever the end.
struct Turn<'a> {
    cache: &'a StructureCache,
    key: StructureKey,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.cache.in_work.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.key);
        self.cache.done.notify_all();
    }
}

/// `<mesh hash>-<hash of the rest of the key>`: the part before the hyphen tells which meshes are warm.
fn file_name(key: &StructureKey) -> String {
    let rest = format!("{}\n{}\n{}", key.kind, key.parameters, key.builder_version);
    format!("{}-{}", key.mesh, &blake3::hash(rest.as_bytes()).to_hex()[..32])
}
