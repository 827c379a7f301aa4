//! Generated scenes as a task's inputs, and what tests look at.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use lightshaft_api::job::TaskWork;
use lightshaft_api::lease::RetryClass;
use lightshaft_api::settings::{Acceleration, DeviceChoice, LineSpace, RenderSettings};
use lightshaft_engine::film::read_environment;
use lightshaft_engine::scene::{KINDS, Limits, Params, Source, generate};
use lightshaft_worker::cache::{StructureCache, StructureStore};
use lightshaft_worker::executor::{
    Artifact, Budgets, Devices, Executor, Inputs, Observer, Outputs, Progress, TaskError,
};

pub(crate) struct Generated {
    pub kind: &'static str,
    pub opened: AtomicUsize,
    pub params: Params,
    pub map: Vec<u8>,
    pub parts: Vec<(TaskWork, Vec<u8>)>,
}

pub(crate) fn generated(kind: &'static str) -> Generated {
    Generated { kind, opened: AtomicUsize::new(0), params: Params::default(), map: Vec::new(), parts: Vec::new() }
}

/// Few triangles and few objects, where the kind lets us choose.
pub(crate) fn small_scene(kind: &'static str) -> Generated {
    let known = KINDS.iter().find(|known| known.name == kind).expect("a kind");
    let choose = |default: u32, value: u32| (default > 0).then_some(value);
    let (triangles, count) = (choose(known.default_triangles, 600), choose(known.default_count, 12));
    Generated { params: Params { triangles, count, ..Params::default() }, ..generated(kind) }
}

impl Inputs for Generated {
    fn waited_s(&self) -> Option<f64> {
        Some(1.5)
    }

    fn scene_key(&self) -> Option<String> {
        Some(self.kind.to_owned())
    }

    fn open_scene(&self, limits: &Limits) -> Result<Source, TaskError> {
        self.opened.fetch_add(1, Ordering::Relaxed);
        let glb = generate(self.kind, &self.params).unwrap();
        Source::from_bytes("scene.glb", glb, limits).map_err(|error| TaskError::bad_input(error.to_string()))
    }

    fn environment_map(&self, _name: &str) -> Result<Vec<u8>, TaskError> {
        Ok(self.map.clone())
    }

    fn parts(&self) -> Vec<TaskWork> {
        self.parts.iter().map(|(work, _)| work.clone()).collect()
    }

    fn part(&self, index: usize) -> Result<Vec<u8>, TaskError> {
        Ok(self.parts[index].1.clone())
    }

    fn structures(&self) -> Option<&dyn StructureStore> {
        None
    }
}

#[derive(Default)]
pub(crate) struct Recorder {
    pub progress: Mutex<Vec<Progress>>,
    pub log: Mutex<Vec<String>>,
    pub previews: Mutex<Vec<Vec<u8>>>,
}

impl Observer for Recorder {
    fn progress(&self, progress: Progress) {
        self.progress.lock().unwrap().push(progress);
    }

    fn log(&self, line: String) {
        self.log.lock().unwrap().push(line);
    }

    fn wants_preview(&self) -> bool {
        true
    }

    fn preview(&self, png: Vec<u8>) {
        self.previews.lock().unwrap().push(png);
    }
}

pub(crate) fn executor() -> Executor {
    executor_on(DeviceChoice::Cpu)
}

pub(crate) fn executor_on(device: DeviceChoice) -> Executor {
    let structures = StructureCache::new(1 << 30, None);
    Executor::new(structures, Devices::new(device), Budgets { scenes_bytes: 1 << 30 }, Limits::default())
}

pub(crate) fn small() -> RenderSettings {
    RenderSettings { width: 37, height: 23, spp: 6, ..RenderSettings::default() }
}

pub(crate) fn run(executor: &Executor, work: &TaskWork, settings: &RenderSettings, inputs: &Generated) -> Outputs {
    executor.run(work, settings, inputs, &Recorder::default(), &AtomicBool::new(false)).unwrap()
}

pub(crate) fn fails(settings: &RenderSettings) -> (RetryClass, bool, String) {
    let result = executor().run(
        &TaskWork::Frame,
        settings,
        &generated("cornell-box"),
        &Recorder::default(),
        &AtomicBool::new(false),
    );
    match result {
        Err(TaskError::Failed { class, fatal, message }) => (class, fatal, message),
        other => panic!("expected a failure, got {other:?}"),
    }
}

pub(crate) fn artifact<'a>(outputs: &'a Outputs, name: &str) -> &'a Artifact {
    outputs.artifacts.iter().find(|artifact| artifact.name == name).unwrap_or_else(|| panic!("no {name}"))
}

pub(crate) fn pixels(outputs: &Outputs) -> Vec<[f32; 3]> {
    read_environment(&artifact(outputs, "image.exr").bytes, 1 << 20).unwrap().rgb
}

pub(crate) fn with_line_space(line_space: LineSpace) -> RenderSettings {
    let acceleration = Acceleration { line_space: Some(line_space), ..Acceleration::default() };
    RenderSettings { width: 24, height: 18, spp: 2, acceleration, ..RenderSettings::default() }
}

/// Root of the mean squared difference, over pixels and channels.
pub(crate) fn rmse(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let squares = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| f64::from(a - b).powi(2));
    (squares.sum::<f64>() / (3 * a.len()) as f64).sqrt()
}
