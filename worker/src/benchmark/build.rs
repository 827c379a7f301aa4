//! Builds the structures of one configuration from nothing, so that the time is that of building and no cache's.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use lightshaft_api::benchmark::Built;
use lightshaft_api::job::{Metrics, TaskWork};
use lightshaft_api::settings::{Acceleration, RenderSettings};
use lightshaft_engine::accel::SceneAccel;
use lightshaft_engine::scene::{Limits, Scene, Source};

use crate::cache::{StructureCache, StructureStore};
use crate::executor::{Executor, Inputs, Observer, Task, TaskError, count_structures};
use crate::settings::Wanted;

/// What rays are traced against in one configuration.
#[derive(Debug)]
pub(super) struct Structures {
    pub accel: Arc<SceneAccel>,
    pub built: Built,
    pub warnings: Vec<String>,
}

/// Builds over `scene`, which has its ground in it. The inner error says why this build cannot have it.
pub(super) fn build(
    executor: &Executor,
    acceleration: &Acceleration,
    scene: &Scene,
    view: &RenderSettings,
    observer: &dyn Observer,
    stop: &AtomicBool,
) -> Result<Result<Structures, String>, TaskError> {
    let settings = RenderSettings { acceleration: acceleration.clone(), ..view.clone() };
    // Holds nothing by itself: what is built lives as long as the configuration.
    let cache = StructureCache::new(0, None);
    let task = Task {
        work: &TaskWork::Frame,
        settings: &settings,
        inputs: &Nothing,
        structures: &cache,
        observer: &Quiet(observer),
        stop,
        started: Instant::now(),
    };
    let mut metrics = Metrics::default();
    let started = Instant::now();
    let accel = match executor.accelerate(&task, scene, &Wanted::of(acceleration), &mut metrics) {
        Err(TaskError::Failed { fatal: true, message, .. }) => {
            return Ok(Err(message.replace("/settings/acceleration/", "").replace("/settings/acceleration: ", "")));
        }
        other => other?,
    };
    let init_s = started.elapsed().as_secs_f64();
    count_structures(&mut metrics, &accel);
    let built = Built {
        init_s,
        structure_bytes: metrics.structure_bytes,
        structure_nodes: metrics.structure_nodes,
        line_space_bytes: metrics.line_space_bytes,
        line_spaces: metrics.line_space.map_or(0, |line_space| line_space.meshes),
        cache: metrics.cache,
    };
    Ok(Ok(Structures { accel: Arc::new(accel), built, warnings: metrics.warnings }))
}

/// Nothing comes from elsewhere.
struct Nothing;

impl Inputs for Nothing {
    fn waited_s(&self) -> Option<f64> {
        None
    }

    fn scene_key(&self) -> Option<String> {
        None
    }

    fn open_scene(&self, _: &Limits) -> Result<Source, TaskError> {
        Err(TaskError::worker("a benchmark opens its scenes itself"))
    }

    fn environment_map(&self, name: &str) -> Result<Vec<u8>, TaskError> {
        Err(TaskError::bad_input(format!("a benchmark has no environment map {name}")))
    }

    fn parts(&self) -> Vec<TaskWork> {
        Vec::new()
    }

    fn part(&self, index: usize) -> Result<Vec<u8>, TaskError> {
        Err(TaskError::worker(format!("a benchmark has no part {index}")))
    }

    fn structures(&self) -> Option<&dyn StructureStore> {
        None
    }
}

/// Passes on what is said, but no progress: that is the benchmark's own.
struct Quiet<'a>(&'a dyn Observer);

impl Observer for Quiet<'_> {
    fn progress(&self, _: crate::executor::Progress) {}

    fn log(&self, line: String) {
        self.0.log(line);
    }

    fn wants_preview(&self) -> bool {
        false
    }

    fn preview(&self, _: Vec<u8>) {}
}
