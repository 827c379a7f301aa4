use super::*;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicUsize;

use lightshaft_engine::accel::line_space::LineSpaceParams;
use lightshaft_engine::accel::{BuildParams, NTreeParams, Quality, StructureParams};
use lightshaft_engine::scene::{Limits, Params, Source, generate, import};
use std::sync::Arc;

use crate::cache::LineSpaceRecipe;

const PARAMS: StructureParams = StructureParams::Bvh(BuildParams { quality: Quality::Medium, spatial_splits: false });
static GO: AtomicBool = AtomicBool::new(false);

fn mesh() -> Arc<Mesh> {
    let glb = generate("furnace-sphere", &Params { triangles: Some(2_000), ..Params::default() }).unwrap();
    let source = Source::from_bytes("sphere.glb", glb, &Limits::default()).unwrap();
    let scene = import(&source, &Limits::default(), &|| false).unwrap();
    Arc::clone(&scene.meshes[0])
}

fn on_disk(folder: &Path, memory_bytes: u64) -> StructureCache {
    StructureCache::new(memory_bytes, Some(DiskStore::open(folder, 1 << 30).unwrap()))
}

fn get(cache: &StructureCache, mesh: &Mesh) -> Obtained {
    cache.get(mesh, &PARAMS, None, &GO).unwrap()
}

/// The files of the cache's entries and temporaries.
fn files(folder: &Path) -> Vec<PathBuf> {
    let folders = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    folders.flat_map(|folder| fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path())).collect()
}

/// A store in memory that counts what is published.
#[derive(Default)]
struct Shelf {
    held: Mutex<HashMap<StructureKey, Vec<u8>>>,
    published: AtomicUsize,
}

impl StructureStore for Shelf {
    fn fetch(&self, key: &StructureKey) -> Result<Option<Vec<u8>>, String> {
        Ok(self.held.lock().unwrap().get(key).cloned())
    }

    fn publish(&self, key: &StructureKey, encoded: Vec<u8>, build_s: f64) {
        assert!(build_s >= 0.0);
        self.published.fetch_add(1, Ordering::Relaxed);
        self.held.lock().unwrap().insert(key.clone(), encoded);
    }
}

#[test]
fn a_structure_is_built_once_and_then_found_in_memory_and_by_the_next_process_on_disk() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = mesh();
    let cache = on_disk(folder.path(), 1 << 30);
    let built = get(&cache, &mesh);
    assert_eq!(built.report.source, CacheSource::Built);
    assert_eq!(built.report.bytes, built.structure.bytes() as u64);
    assert_eq!(built.report.structure, "bvh quality=medium,spatial_splits=false");
    assert_eq!(get(&cache, &mesh).report.source, CacheSource::Memory);

    let next_process = on_disk(folder.path(), 1 << 30);
    let loaded = get(&next_process, &mesh);
    assert_eq!(loaded.report.source, CacheSource::Disk);
    assert_eq!(loaded.structure.bvh2(), built.structure.bvh2());
    assert_eq!(get(&next_process, &mesh).report.source, CacheSource::Memory);
    let (warm, status) = next_process.holdings(10);
    assert_eq!((warm, status.entries), (vec![mesh.hash.to_string()], 1), "in memory and on disk, and counted once");
    assert_eq!(next_process.holdings(0).0, [""; 0]);
}

#[test]
fn other_parameters_are_another_structure() {
    let cache = StructureCache::new(1 << 30, None);
    let mesh = mesh();
    get(&cache, &mesh);
    let other = StructureParams::Bvh(BuildParams { quality: Quality::Fast, spatial_splits: false });
    assert_eq!(cache.get(&mesh, &other, None, &GO).unwrap().report.source, CacheSource::Built);
}

#[test]
fn trees_of_cells_are_kept_like_any_other_structure() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = mesh();
    let params = StructureParams::NTree(NTreeParams { n: 4, depth: 3, max_leaf: 4, budget_bytes: 1 << 28 });
    let source = |cache: &StructureCache| {
        let obtained = cache.get(&mesh, &params, None, &GO).unwrap();
        assert!(obtained.structure.cells().is_some() && obtained.report.structure == "ntree n=4,depth=3,max_leaf=4");
        obtained.report.source
    };
    let cache = on_disk(folder.path(), 1 << 30);
    assert_eq!([source(&cache), source(&cache)], [CacheSource::Built, CacheSource::Memory]);
    assert_eq!(source(&on_disk(folder.path(), 0)), CacheSource::Disk);
    // The budget does not decide what is built.
    let larger = StructureParams::NTree(NTreeParams { n: 4, depth: 3, max_leaf: 4, budget_bytes: 1 << 30 });
    assert_eq!(cache.get(&mesh, &larger, None, &GO).unwrap().report.source, CacheSource::Memory);
}

#[test]
fn line_spaces_are_kept_like_any_structure() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = mesh();
    let cache = on_disk(folder.path(), 1 << 30);
    let Structure::Bvh(structure) = get(&cache, &mesh).structure else { panic!("not a BVH") };
    let recipe = |n| LineSpaceRecipe {
        params: LineSpaceParams { n, ..LineSpaceParams::DEFAULT_CLASSES },
        structure: &structure,
        budget_bytes: 1 << 20,
        on_gpu: None,
    };
    let shelf = Shelf::default();
    let obtain = |cache: &StructureCache, n| cache.get(&mesh, &recipe(n), Some(&shelf), &GO).unwrap();
    let built = obtain(&cache, 8);
    assert_eq!(built.report.source, CacheSource::Built);
    assert_eq!(built.report.bytes, built.structure.bytes() as u64);
    assert!(built.report.structure.starts_with("line_space n=8,payload=classes"), "{}", built.report.structure);
    assert_eq!(obtain(&cache, 8).report.source, CacheSource::Memory);
    assert_eq!(obtain(&cache, 4).report.source, CacheSource::Built);
    let from_disk = obtain(&on_disk(folder.path(), 0), 8);
    assert_eq!((from_disk.report.source, &from_disk.structure), (CacheSource::Disk, &built.structure));
    let fetched = obtain(&StructureCache::new(1 << 30, None), 8);
    assert_eq!((fetched.report.source, &fetched.structure), (CacheSource::Fetched, &built.structure));

    let small = LineSpaceRecipe { budget_bytes: 100, ..recipe(16) };
    let refused = cache.get(&mesh, &small, None, &GO).unwrap_err().to_string();
    assert!(refused.contains("the budget is 100"), "{refused}");
    let cancelled = cache.get(&mesh, &recipe(16), None, &AtomicBool::new(true));
    assert!(matches!(cancelled, Err(BuildError::Cancelled)));
    assert_eq!(files(folder.path()).len(), 3, "a structure and two line spaces");
}

#[test]
fn a_corrupt_file_is_reported_and_rebuilt_wherever_it_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = mesh();
    get(&on_disk(folder.path(), 0), &mesh);
    let path = files(folder.path()).remove(0);
    let good = fs::read(&path).unwrap();
    let mut flipped = good.clone();
    flipped[good.len() / 2] ^= 1;
    for damaged in [&flipped[..], &good[..good.len() / 2], b"", b"garbage"] {
        fs::write(&path, damaged).unwrap();
        let rebuilt = get(&on_disk(folder.path(), 0), &mesh);
        assert_eq!(rebuilt.report.source, CacheSource::Built);
        assert!(rebuilt.warnings[0].contains("corrupt"), "{:?}", rebuilt.warnings);
        assert_eq!(fs::read(&path).unwrap(), good, "the entry is whole again");
    }
}

#[test]
fn a_mesh_without_memory_budget_is_still_shared_while_somebody_holds_it() {
    let cache = StructureCache::new(0, None);
    let mesh = mesh();
    let first = get(&cache, &mesh);
    assert_eq!(get(&cache, &mesh).report.source, CacheSource::Memory);
    drop(first);
    assert_eq!(get(&cache, &mesh).report.source, CacheSource::Built);
}

#[test]
fn what_one_worker_built_another_fetches() {
    let shelf = Shelf::default();
    let mesh = mesh();
    let first = StructureCache::new(1 << 30, None);
    assert_eq!(first.get(&mesh, &PARAMS, Some(&shelf), &GO).unwrap().report.source, CacheSource::Built);
    let folder = tempfile::tempdir().unwrap();
    let second = on_disk(folder.path(), 1 << 30);
    let fetched = second.get(&mesh, &PARAMS, Some(&shelf), &GO).unwrap();
    assert_eq!(fetched.report.source, CacheSource::Fetched);
    assert_eq!(shelf.published.load(Ordering::Relaxed), 1);
    assert_eq!(get(&on_disk(folder.path(), 0), &mesh).report.source, CacheSource::Disk, "it is kept from now on");
}

#[test]
fn a_corrupt_structure_of_the_service_is_reported_and_built() {
    let shelf = Shelf::default();
    let mesh = mesh();
    shelf.held.lock().unwrap().insert(PARAMS.key(mesh.hash), b"garbage".to_vec());
    let cache = StructureCache::new(1 << 30, None);
    let built = cache.get(&mesh, &PARAMS, Some(&shelf), &GO).unwrap();
    assert_eq!(built.report.source, CacheSource::Built);
    assert!(built.warnings[0].contains("corrupt"), "{:?}", built.warnings);
}

#[test]
fn requests_at_the_same_time_build_once() {
    let shelf = Shelf::default();
    let mesh = mesh();
    let cache = StructureCache::new(1 << 30, None);
    std::thread::scope(|scope| {
        let get = || cache.get(&mesh, &PARAMS, Some(&shelf), &GO).unwrap().report.source;
        let threads: Vec<_> = (0..8).map(|_| scope.spawn(get)).collect();
        let sources: Vec<CacheSource> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
        assert_eq!(sources.iter().filter(|&&source| source == CacheSource::Built).count(), 1, "{sources:?}");
    });
    assert_eq!(shelf.published.load(Ordering::Relaxed), 1);
}

#[test]
fn a_cancelled_build_leaves_nothing_and_does_not_stand_in_the_way() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = mesh();
    let cache = on_disk(folder.path(), 1 << 30);
    let cancelled = cache.get(&mesh, &PARAMS, None, &AtomicBool::new(true));
    assert!(matches!(cancelled, Err(BuildError::Cancelled)));
    assert!(files(folder.path()).is_empty());
    assert_eq!(get(&cache, &mesh).report.source, CacheSource::Built);
}
