//! From a task's inputs to a scene on a device: the phases fetch, import, structures and prepare.
//!
//! The last scenes are kept under a byte budget, and the last packed scene with everything that went into it: tasks of
//! one job, and jobs that differ in samples or seed alone, find it ready.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use lightshaft_api::job::{CacheReport, LineSpaceUse, Metrics, Phase};
use lightshaft_api::settings::{self as api, DeviceChoice};
use lightshaft_engine::accel::{BuildError, SceneAccel, Structure, StructureParams, flatten};
use lightshaft_engine::device::DeviceError;
use lightshaft_engine::film::read_environment;
use lightshaft_engine::pack::{self, PackedScene};
use lightshaft_engine::scene::{self, Mesh, Scene};
use lightshaft_engine::settings::{HdrImage, RenderSettings};
use rayon::prelude::*;

use super::cell_spaces::with_cells;
use super::devices::{Choice, OnDevice};
use super::{Executor, IMPORT_STARTS, PREPARE_STARTS, Ready, STRUCTURES_START, Task, TaskError};
use crate::cache::{Lru, Obtained, Recipe};
use crate::settings::{self, LineSpaces, Structures, Wanted};

/// Pixels of the largest environment map: 16384 x 8192.
const MAX_MAP_PIXELS: u64 = 1 << 27;

#[derive(Debug)]
pub(super) struct Prepared {
    scenes: Mutex<Lru<String, Arc<Scene>>>,
    last: Mutex<Option<LastPacked>>,
}

#[derive(Debug)]
struct LastPacked {
    key: String,
    packed: Arc<PackedScene>,
    structures: Vec<CacheReport>,
}

impl Prepared {
    pub(super) fn new(scenes_bytes: u64) -> Self {
        Self { scenes: Mutex::new(Lru::new(scenes_bytes)), last: Mutex::new(None) }
    }
}

impl Executor {
    pub(super) fn prepare(&self, task: &Task<'_>, metrics: &mut Metrics) -> Result<Ready, TaskError> {
        // Before anything is built for a device that is not there.
        let choice = self.devices.choose(task.settings.device, task.settings.adapter.as_deref())?;
        let wanted = Wanted::of(&task.settings.acceleration);
        // A job that leaves the device to us gets one that can.
        let needs_cpu = wanted.needs_cpu() && task.settings.device == DeviceChoice::Auto && choice != Choice::Cpu;
        let choice = if needs_cpu { self.devices.choose(DeviceChoice::Cpu, None)? } else { choice };
        let scene = self.scene(task, metrics)?;
        let map = environment_map(task, metrics)?;
        let resolved = settings::resolve(task.settings, &scene, map)
            .map_err(|error| TaskError::bad_input(format!("{}: {}", error.pointer, error.detail)))?;
        let packed = self.packed(task, &scene, &resolved, metrics)?;
        task.check_stop()?;

        let started = Instant::now();
        let (choice, on_device) = self.on_device(task, choice, &packed, &resolved, metrics)?;
        metrics.prepare_s += started.elapsed().as_secs_f64();
        self.structures.weigh();
        metrics.device = on_device.info.name.clone();
        metrics.device_kind = on_device.info.kind.to_owned();
        count_structures(metrics, &packed.accel);
        if !on_device.info.driver.is_empty() {
            metrics.versions.insert("driver".into(), on_device.info.driver.clone());
        }
        Ok(Ready { settings: resolved, choice, renderer: on_device.renderer })
    }

    /// The imported scene, from memory where possible.
    pub(super) fn scene(&self, task: &Task<'_>, metrics: &mut Metrics) -> Result<Arc<Scene>, TaskError> {
        let started = Instant::now();
        task.report(Phase::Fetch, 0.0, 0);
        let key = task.inputs.scene_key();
        let known = key.as_ref().and_then(|key| self.scenes().get(key));
        let scene = match known {
            Some(scene) => scene,
            None => {
                let source = task.inputs.open_scene(&self.limits)?;
                task.check_stop()?;
                task.report(Phase::Import, IMPORT_STARTS, 0);
                let imported = scene::import(&source, &self.limits, &|| task.stopped())?;
                let scene = Arc::new(imported);
                if let Some(key) = key {
                    self.scenes().insert(key, Arc::clone(&scene), memory_bytes(&scene));
                }
                scene
            }
        };
        for warning in &scene.warnings {
            task.warn(metrics, warning.clone());
        }
        metrics.scene_s += started.elapsed().as_secs_f64();
        task.observer.log(format!(
            "scene: {} meshes, {} instances, {} triangles, ready after {:.3} s",
            scene.meshes.len(),
            scene.instances.len(),
            scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum::<usize>(),
            metrics.scene_s,
        ));
        Ok(scene)
    }

    fn packed(
        &self,
        task: &Task<'_>,
        scene: &Arc<Scene>,
        resolved: &RenderSettings,
        metrics: &mut Metrics,
    ) -> Result<Arc<PackedScene>, TaskError> {
        let wanted = Wanted::of(&task.settings.acceleration);
        let key = packed_key(task, &wanted);
        let known = key.as_ref().and_then(|key| {
            let last = self.prepared.last.lock().unwrap_or_else(PoisonError::into_inner);
            last.as_ref()
                .filter(|last| last.key == *key)
                .map(|last| (Arc::clone(&last.packed), last.structures.clone()))
        });
        if let Some((packed, structures)) = known {
            metrics.cache.extend(structures);
            return Ok(packed);
        }
        // The old one goes before the new one is made, so that memory holds one at a time.
        *self.prepared.last.lock().unwrap_or_else(PoisonError::into_inner) = None;

        task.report(Phase::Structures, STRUCTURES_START, 0);
        let started = Instant::now();
        let with_overlays = pack::with_overlays(scene, resolved);
        let accel = Arc::new(self.accelerate(task, &with_overlays, &wanted, metrics)?);
        metrics.build_s += started.elapsed().as_secs_f64();
        task.check_stop()?;

        task.report(Phase::Prepare, PREPARE_STARTS, 0);
        let started = Instant::now();
        let packed = pack::pack(&with_overlays, resolved, accel).map_err(|e| TaskError::bad_input(e.to_string()))?;
        let packed = Arc::new(packed);
        metrics.prepare_s += started.elapsed().as_secs_f64();
        if let Some(key) = key {
            // Whoever finds it ready has every structure in memory.
            let in_memory = |report: &CacheReport| CacheReport {
                source: lightshaft_api::job::CacheSource::Memory,
                built_on: None,
                seconds: 0.0,
                ..report.clone()
            };
            let structures = metrics.cache.iter().map(in_memory).collect();
            *self.prepared.last.lock().unwrap_or_else(PoisonError::into_inner) =
                Some(LastPacked { key, packed: Arc::clone(&packed), structures });
        }
        Ok(packed)
    }

    /// What rays are traced against: structures, and what is known of the lines through them.
    pub(crate) fn accelerate(
        &self,
        task: &Task<'_>,
        scene: &Scene,
        wanted: &Wanted,
        metrics: &mut Metrics,
    ) -> Result<SceneAccel, TaskError> {
        Ok(match &wanted.structures {
            Structures::PerMesh(params) => {
                let structures = self.obtain_structures(task, scene, params, metrics)?;
                let placements = pack::placements(scene);
                match &wanted.line_spaces {
                    None => SceneAccel::build(structures, &placements),
                    Some(LineSpaces { rules: Some(_), .. }) => {
                        let meshes: Vec<&Mesh> = scene.meshes.iter().map(|mesh| &**mesh).collect();
                        let accel = SceneAccel::build(structures, &placements);
                        self.with_node_spaces(task, accel, &meshes, wanted, metrics)?
                    }
                    Some(line_spaces) => {
                        let mut obtained = self.obtain_line_spaces(task, scene, &structures, line_spaces)?;
                        let accel = SceneAccel::build(structures, &placements);
                        metrics.cache.append(&mut obtained.reports);
                        std::mem::take(&mut obtained.warnings).into_iter().for_each(|w| task.warn(metrics, w));
                        obtained.given_to(accel).map_err(TaskError::worker)?
                    }
                }
            }
            Structures::Flat(params) => {
                let (flat, accel) = self.obtain_flat(task, scene, params, metrics)?;
                match (&wanted.line_spaces, params) {
                    (None, _) => accel,
                    (Some(_), StructureParams::Bvh(_)) => {
                        self.with_node_spaces(task, accel, &[&flat], wanted, metrics)?
                    }
                    (Some(wanted), _) => with_cells(accel, &flat, wanted, task.stop, &mut |w| task.warn(metrics, w))?,
                }
            }
        })
    }

    /// One structure for each mesh, in the meshes' order.
    fn obtain_structures(
        &self,
        task: &Task<'_>,
        scene: &Scene,
        params: &StructureParams,
        metrics: &mut Metrics,
    ) -> Result<Vec<Structure>, TaskError> {
        let asked: Vec<_> = scene.meshes.iter().map(|mesh| Some((&**mesh, *params))).collect();
        let obtained = self.obtain_all(task, &asked)?;
        Ok(obtained.into_iter().flatten().map(|obtained| take(obtained, task, metrics)).collect())
    }

    /// What each recipe makes of its mesh, in the same order. Meshes are worked on at once, the largest first.
    pub(super) fn obtain_all<R: Recipe<Product: Send> + Sync>(
        &self,
        task: &Task<'_>,
        asked: &[Option<(&Mesh, R)>],
    ) -> Result<Vec<Option<Obtained<R::Product>>>, TaskError> {
        let size = |i: usize| asked[i].as_ref().map_or(0, |(mesh, _)| mesh.primitive_count());
        let mut order: Vec<usize> = (0..asked.len()).collect();
        order.sort_by_key(|&i| std::cmp::Reverse(size(i)));
        let store = task.inputs.structures();
        let done = AtomicUsize::new(0);
        let mut obtained = order
            .par_iter()
            .with_max_len(1)
            .map(|&i| {
                let Some((mesh, recipe)) = &asked[i] else { return Ok((i, None)) };
                let obtained = task.structures.get(mesh, recipe, store, task.stop)?;
                let share = (done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / asked.len() as f64;
                task.report(Phase::Structures, STRUCTURES_START + (PREPARE_STARTS - STRUCTURES_START) * share, 0);
                Ok((i, Some(obtained)))
            })
            .collect::<Result<Vec<_>, BuildError>>()
            .map_err(build_error)?;
        obtained.sort_by_key(|(i, _)| *i);
        Ok(obtained.into_iter().map(|(_, obtained)| obtained).collect())
    }

    /// One structure over all instances. It belongs to this arrangement of meshes and to no single one, so it is kept by
    /// this worker, and not offered to the service, which knows structures by mesh.
    fn obtain_flat(
        &self,
        task: &Task<'_>,
        scene: &Scene,
        params: &StructureParams,
        metrics: &mut Metrics,
    ) -> Result<(Mesh, SceneAccel), TaskError> {
        let (flat, names) = flatten(&scene.meshes, &pack::placements(scene)).map_err(build_error)?;
        task.check_stop()?;
        let obtained = task.structures.get(&flat, params, None, task.stop).map_err(build_error)?;
        let accel = SceneAccel::flat(take(obtained, task, metrics), names);
        Ok((flat, accel))
    }

    fn on_device(
        &self,
        task: &Task<'_>,
        choice: Choice,
        packed: &Arc<PackedScene>,
        resolved: &RenderSettings,
        metrics: &mut Metrics,
    ) -> Result<(Choice, OnDevice), TaskError> {
        match self.devices.prepare(&choice, packed, resolved) {
            Err(error @ (DeviceError::NoAdapter(_) | DeviceError::TooLarge(_) | DeviceError::Lost(_)))
                if task.settings.device == DeviceChoice::Auto && choice != Choice::Cpu =>
            {
                task.warn(metrics, format!("rendered on the CPU instead: {error}"));
                Ok((Choice::Cpu, self.devices.prepare(&Choice::Cpu, packed, resolved)?))
            }
            other => Ok((choice, other?)),
        }
    }

    fn scenes(&self) -> std::sync::MutexGuard<'_, Lru<String, Arc<Scene>>> {
        self.prepared.scenes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn environment_map(task: &Task<'_>, metrics: &mut Metrics) -> Result<Option<Arc<HdrImage>>, TaskError> {
    let Some(api::Environment::Map(choice)) = &task.settings.environment else { return Ok(None) };
    let started = Instant::now();
    let bytes = task.inputs.environment_map(&choice.map)?;
    let image = read_environment(&bytes, MAX_MAP_PIXELS)
        .map_err(|error| TaskError::bad_input(format!("/settings/environment/map: {error}")))?;
    metrics.scene_s += started.elapsed().as_secs_f64();
    Ok(Some(Arc::new(image)))
}

/// The structure; what there is to tell about it goes to the metrics.
fn take(obtained: Obtained, task: &Task<'_>, metrics: &mut Metrics) -> Structure {
    for warning in obtained.warnings {
        task.warn(metrics, warning);
    }
    metrics.cache.push(obtained.report);
    obtained.structure
}

pub(super) fn build_error(error: BuildError) -> TaskError {
    match error {
        BuildError::Cancelled => TaskError::Stopped,
        BuildError::Unsupported(why) => TaskError::bad_input(format!("/settings/acceleration: {why}")),
    }
}

/// Names everything that goes into a packed scene. Samples, seed and outputs do not.
fn packed_key(task: &Task<'_>, wanted: &Wanted) -> Option<String> {
    let scene = task.inputs.scene_key()?;
    let s = task.settings;
    let parts = (&s.camera, s.width, s.height, &s.environment, &s.lights, &s.ground);
    Some(format!("{scene} {wanted:?} {parts:?}"))
}

/// What the structures of a scene take.
pub(crate) fn count_structures(metrics: &mut Metrics, accel: &SceneAccel) {
    let structures = accel.structures();
    let bytes: usize = structures.iter().map(Structure::bytes).sum();
    metrics.structure_bytes = (bytes + accel.top_bytes()) as u64;
    let nodes: usize = structures.iter().map(Structure::node_count).sum();
    metrics.structure_nodes = (nodes + accel.top().nodes.len()) as u64;
    let spaces = accel.line_spaces();
    let meshes = spaces.iter().flatten().count() as u64;
    let on_gpu = metrics.device_kind == "gpu";
    let asked = if on_gpu { accel.line_spaces_asked_on_gpu() } else { accel.asked_line_spaces() } as u64;
    metrics.line_space = (!spaces.is_empty()).then(|| LineSpaceUse { meshes, asked, ..LineSpaceUse::default() });
    metrics.line_space_bytes = spaces.iter().flatten().map(|space| space.bytes() as u64).sum();
    let nodes = accel.node_spaces();
    if !nodes.is_empty() {
        let meshes = nodes.iter().flatten().count() as u64;
        metrics.line_space = Some(LineSpaceUse { meshes, asked: meshes, ..LineSpaceUse::default() });
        metrics.line_space_bytes = nodes.iter().flatten().map(|nodes| nodes.bytes() as u64).sum();
    }
    if let Some(shafts) = accel.cell_shafts() {
        let asked = u64::from(accel.asks_cell_shafts());
        metrics.line_space = Some(LineSpaceUse { meshes: 1, asked, ..LineSpaceUse::default() });
        metrics.line_space_bytes = shafts.bytes() as u64;
    }
    if let Some(spaces) = accel.cell_spaces() {
        let has_any = u64::from(spaces.count() > 0);
        metrics.line_space = Some(LineSpaceUse { meshes: has_any, asked: has_any, ..LineSpaceUse::default() });
        metrics.line_space_bytes = spaces.bytes() as u64;
    }
}

/// Bytes that an imported scene takes, roughly: geometry and images outweigh the rest.
fn memory_bytes(scene: &Scene) -> u64 {
    let meshes: usize = scene
        .meshes
        .iter()
        .map(|m| {
            size_of_val(&m.positions[..])
                + size_of_val(&m.triangles[..])
                + size_of_val(&m.triangle_slots[..])
                + size_of_val(&m.normals[..])
                + size_of_val(&m.tangents[..])
                + size_of_val(&m.uv0[..])
                + size_of_val(&m.uv1[..])
                + size_of_val(&m.colors[..])
                + size_of_val(&m.spheres[..])
        })
        .sum();
    let images: usize = scene.images.iter().map(|image| image.rgba8.len()).sum();
    (meshes + images + size_of_val(&scene.instances[..]) + size_of_val(&scene.materials[..])) as u64
}
