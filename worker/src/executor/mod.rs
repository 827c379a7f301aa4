//! Renders one task: the same road for a leased task and for `lightshaft render`.
//!
//! ```text
//! fetch ─► import ─► structures ─► prepare ─► render (progressive passes) ─► output
//! ```
//!
//! The executor knows neither HTTP nor leases: what it needs comes through [`Inputs`], what it has to say goes to an
//! [`Observer`], and it looks at one flag to learn that it should stop. What it learnt stays for the next task: devices,
//! scenes, the packed scene, structures.

mod build;
mod cell_spaces;
mod compare;
mod devices;
mod line_spaces;
mod metrics;
mod node_spaces;
mod output;
mod part;
mod passes;
mod prepare;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use lightshaft_api::job::{Metrics, Phase, TaskWork};
use lightshaft_api::lease::RetryClass;
use lightshaft_api::settings::RenderSettings;
use lightshaft_engine::device::{DeviceError, Region};
use lightshaft_engine::film::{AovBuffers, PassFilm};
use lightshaft_engine::scene::{ImportError, ImportErrorKind, Limits, Source};

use crate::cache::{StructureCache, StructureStore};

pub(crate) use cell_spaces::DEFAULT_CELL_DEPTH;
pub use compare::{COMPARISON_JSON, HEAT_MAP_PNG, compare};
pub(crate) use devices::Choice;
pub use devices::Devices;
pub(crate) use line_spaces::MIN_PRIMITIVES as MIN_LINE_SPACE_PRIMITIVES;
pub(crate) use metrics::{peak_bytes, versions};
pub use output::Artifact;
pub(crate) use output::metrics_json;
use part::Part;
pub use part::name as name_of;
pub(crate) use prepare::count_structures;

/// Where a task's inputs come from.
pub trait Inputs: Sync {
    /// How long the task waited for its lease, in seconds; `None` when it did not come from a queue.
    fn waited_s(&self) -> Option<f64>;

    /// Names the scene's content: equal keys, equal scenes. `None` when it is not worth keeping.
    fn scene_key(&self) -> Option<String>;

    /// Downloads what the scene consists of, where needed, and opens it.
    fn open_scene(&self, limits: &Limits) -> Result<Source, TaskError>;

    /// The bytes of an environment map, by the name that the settings give it.
    fn environment_map(&self, name: &str) -> Result<Vec<u8>, TaskError>;

    /// The other tasks of the job, whose parts a merge puts together.
    fn parts(&self) -> Vec<TaskWork>;

    /// What one of them left, by its place among [`parts`](Self::parts). They are asked for one after the other.
    fn part(&self, index: usize) -> Result<Vec<u8>, TaskError>;

    /// Structures that others built.
    fn structures(&self) -> Option<&dyn StructureStore>;
}

/// Follows a task.
pub trait Observer: Sync {
    fn progress(&self, progress: Progress);

    /// A line for the task's log.
    fn log(&self, line: String);

    /// Whether a preview would be looked at; making one takes time.
    fn wants_preview(&self) -> bool;

    /// A PNG of the picture so far.
    fn preview(&self, png: Vec<u8>);
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    pub phase: Phase,
    /// Of the whole task, 0 to 1. Threads report it; the reports may come out of order.
    pub fraction: f64,
    /// Samples per pixel so far.
    pub spp: u32,
}

/// Why a task gave nothing.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TaskError {
    #[error("the task was stopped")]
    Stopped,
    #[error("{message}")]
    Failed {
        class: RetryClass,
        /// The same inputs will fail in the same way for everybody.
        fatal: bool,
        message: String,
    },
}

impl TaskError {
    /// The inputs are wrong: no attempt of anybody's can succeed.
    pub fn bad_input(message: impl Into<String>) -> Self {
        Self::Failed { class: RetryClass::Task, fatal: true, message: message.into() }
    }

    /// This worker cannot do it; another may.
    pub fn worker(message: impl Into<String>) -> Self {
        Self::Failed { class: RetryClass::Worker, fatal: false, message: message.into() }
    }

    /// It may work a little later.
    pub fn transient(message: impl Into<String>) -> Self {
        Self::Failed { class: RetryClass::Transient, fatal: false, message: message.into() }
    }
}

impl From<ImportError> for TaskError {
    /// A file that cannot be read says nothing of what it holds.
    fn from(error: ImportError) -> Self {
        match error.kind {
            ImportErrorKind::Cancelled => Self::Stopped,
            ImportErrorKind::Io => Self::worker(error.to_string()),
            ImportErrorKind::Malformed
            | ImportErrorKind::Unsupported
            | ImportErrorKind::MissingFile
            | ImportErrorKind::Limit => Self::bad_input(error.to_string()),
        }
    }
}

impl From<DeviceError> for TaskError {
    fn from(error: DeviceError) -> Self {
        match error {
            DeviceError::Cancelled => Self::Stopped,
            DeviceError::NoAdapter(_) | DeviceError::TooLarge(_) | DeviceError::Lost(_) | DeviceError::Other(_) => {
                Self::worker(error.to_string())
            }
        }
    }
}

/// What a task left: artifacts in memory, and what it cost.
#[derive(Clone, Debug)]
pub struct Outputs {
    pub artifacts: Vec<Artifact>,
    pub metrics: Metrics,
}

/// Memory that may be kept between tasks, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budgets {
    pub scenes_bytes: u64,
}

#[derive(Debug)]
pub struct Executor {
    prepared: prepare::Prepared,
    structures: StructureCache,
    devices: Devices,
    limits: Limits,
}

/// One task, as its phases see it.
pub(crate) struct Task<'a> {
    pub(crate) work: &'a TaskWork,
    pub(crate) settings: &'a RenderSettings,
    pub(crate) inputs: &'a dyn Inputs,
    /// Where what is built is kept.
    pub(crate) structures: &'a StructureCache,
    pub(crate) observer: &'a dyn Observer,
    pub(crate) stop: &'a AtomicBool,
    pub(crate) started: Instant,
}

impl Executor {
    pub fn new(structures: StructureCache, devices: Devices, budgets: Budgets, limits: Limits) -> Self {
        Self { prepared: prepare::Prepared::new(budgets.scenes_bytes), structures, devices, limits }
    }

    pub fn devices(&self) -> &Devices {
        &self.devices
    }

    pub fn structures(&self) -> &StructureCache {
        &self.structures
    }

    pub(crate) fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Renders, and encodes the outputs. Blocks; uses rayon's global pool. `settings` must have been validated.
    ///
    /// # Errors
    /// [`TaskError::Stopped`] within a tile's time after `stop` was set; otherwise why it failed and who may retry.
    pub fn run(
        &self,
        work: &TaskWork,
        settings: &RenderSettings,
        inputs: &dyn Inputs,
        observer: &dyn Observer,
        stop: &AtomicBool,
    ) -> Result<Outputs, TaskError> {
        let structures = &self.structures;
        let task = Task { work, settings, inputs, structures, observer, stop, started: Instant::now() };
        let mut metrics = Metrics { queue_s: inputs.waited_s(), versions: metrics::versions(), ..Metrics::default() };
        let (part, earlier) = match work {
            TaskWork::Merge => self.merge(&task, &mut metrics)?,
            TaskWork::Frame | TaskWork::Tile { .. } | TaskWork::Pass { .. } => {
                (self.render(&task, &mut metrics)?, Metrics::default())
            }
            TaskWork::Benchmark | TaskWork::Build | TaskWork::Compare => {
                return Err(TaskError::bad_input(format!("a render has no task for {}", part::name(work))));
            }
        };
        task.check_stop()?;
        task.report(Phase::Output, OUTPUT_STARTS, part.film.samples);
        let output_started = Instant::now();
        let mut artifacts = output::encode(&task, &part)?;
        metrics.spp = part.film.samples;
        metrics.peak_bytes = metrics::peak_bytes();
        metrics.output_s = output_started.elapsed().as_secs_f64();
        metrics.total_s = task.started.elapsed().as_secs_f64();
        if matches!(work, TaskWork::Frame | TaskWork::Merge) {
            let mut whole = earlier;
            whole.add(&metrics);
            artifacts.push(output::metrics_json(&whole)?);
        } else {
            artifacts.push(part.encode(&metrics)?);
        }
        Ok(Outputs { artifacts, metrics })
    }

    fn render(&self, task: &Task<'_>, metrics: &mut Metrics) -> Result<Part, TaskError> {
        let mut ready = self.prepare(task, metrics)?;
        let full = Region::full(&ready.settings);
        let (region, first_sample, samples) = match *task.work {
            TaskWork::Tile { x, y, width, height } => {
                (tile_within(full, Region { x, y, width, height })?, 0, ready.settings.spp)
            }
            TaskWork::Pass { first_sample, samples } => (full, first_sample, samples),
            TaskWork::Frame | TaskWork::Merge | TaskWork::Benchmark | TaskWork::Build | TaskWork::Compare => {
                (full, 0, ready.settings.spp)
            }
        };
        let mut part = Part {
            film: PassFilm::new(region),
            aovs: (!ready.settings.aovs.is_empty()).then(|| AovBuffers::new(region, &ready.settings.aovs)),
        };
        let rendered = passes::render(task, &mut ready, first_sample, samples, &mut part, metrics);
        if rendered.as_ref().is_err_and(|error| !matches!(error, DeviceError::Cancelled)) {
            // The next task opens it anew.
            self.devices.close(&ready.choice);
        }
        rendered?;
        Ok(part)
    }

    /// Puts the parts together, one at a time; also answers what making them cost.
    fn merge(&self, task: &Task<'_>, metrics: &mut Metrics) -> Result<(Part, Metrics), TaskError> {
        task.report(Phase::Fetch, 0.0, 0);
        let full = Region { x: 0, y: 0, width: task.settings.width, height: task.settings.height };
        let mut merge = part::Merge::new(full);
        let works = task.inputs.parts();
        for (done, index) in part::order(&works).into_iter().enumerate() {
            task.check_stop()?;
            let bytes = task.inputs.part(index)?;
            let name = || name_of(&works[index]);
            merge
                .add(&bytes)
                .map_err(|why| TaskError::worker(format!("the part of {} is of no use: {why}", name())))?;
            task.report(Phase::Fetch, OUTPUT_STARTS * (done + 1) as f64 / works.len() as f64, 0);
        }
        metrics.scene_s = task.started.elapsed().as_secs_f64();
        merge.finish()
    }
}

/// Progress at the beginning of the phases after the first.
const IMPORT_STARTS: f64 = 0.02;
const STRUCTURES_START: f64 = 0.04;
const PREPARE_STARTS: f64 = 0.08;
const RENDER_STARTS: f64 = 0.1;
const OUTPUT_STARTS: f64 = 0.97;

impl Task<'_> {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn check_stop(&self) -> Result<(), TaskError> {
        if self.stopped() { Err(TaskError::Stopped) } else { Ok(()) }
    }

    fn report(&self, phase: Phase, fraction: f64, spp: u32) {
        self.observer.progress(Progress { phase, fraction, spp });
    }

    fn warn(&self, metrics: &mut Metrics, warning: String) {
        self.observer.log(format!("warning: {warning}"));
        if !metrics.warnings.contains(&warning) {
            metrics.warnings.push(warning);
        }
    }
}

fn tile_within(full: Region, tile: Region) -> Result<Region, TaskError> {
    let inside =
        |start: u32, size: u32, limit: u32| size > 0 && start.checked_add(size).is_some_and(|end| end <= limit);
    if inside(tile.x, tile.width, full.width) && inside(tile.y, tile.height, full.height) {
        Ok(tile)
    } else {
        let Region { x, y, width, height } = tile;
        Err(TaskError::bad_input(format!(
            "the tile {width}x{height} at ({x}, {y}) is not within the picture of {}x{}",
            full.width, full.height
        )))
    }
}

/// Everything that passes need.
struct Ready {
    settings: lightshaft_engine::settings::RenderSettings,
    choice: devices::Choice,
    renderer: Box<dyn lightshaft_engine::device::Renderer>,
}
