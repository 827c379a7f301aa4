//! `lightshaft render FILE -o out.png`: the worker's executor without a service.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use lightshaft_api::job::{Metrics, Phase, TaskWork};
use lightshaft_api::settings::RenderSettings;
use lightshaft_engine::scene::{Limits, Source};
use lightshaft_worker::cache::{DiskStore, StructureCache, StructureStore};
use lightshaft_worker::driver::CacheBudgets;
use lightshaft_worker::executor::{self, Artifact, Budgets, Devices, Executor, Inputs, Observer, TaskError};
use serde_json::json;

use super::error::{CliError, Result};
use super::progress::Progress;
use super::settings::SettingsArgs;
use super::{Global, output};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A .glb, a .gltf with its files beside it, or a .zip of both.
    file: PathBuf,
    /// Picture to write, .png or .exr; may be given twice.
    #[arg(short, long, required = true, value_name = "OUT.png|OUT.exr")]
    output: Vec<PathBuf>,
    /// Write what was measured.
    #[arg(long, value_name = "FILE.json")]
    metrics: Option<PathBuf>,
    /// Folder that keeps built structures for the next time.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArgs,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<()> {
    let inputs = LocalInputs { scene: args.file.clone(), maps: HashMap::new() };
    let (settings, inputs) = args.resolve(inputs)?;
    let executor = args.executor(&settings)?;
    let watcher = Watcher { progress: Progress::new(), last: Mutex::new(String::new()) };
    let stop = AtomicBool::new(false);
    let outputs = executor
        .run(&TaskWork::Frame, &settings, &inputs, &watcher, &stop)
        .map_err(|error| render_error(&args.file, &error))?;
    drop(watcher);
    for path in &args.output {
        write(path, &outputs.artifacts)?;
    }
    if let Some(path) = &args.metrics {
        let text = serde_json::to_vec_pretty(&outputs.metrics)
            .map_err(|error| CliError::system(format!("the metrics could not be written as JSON: {error}")))?;
        write_file(path, &text)?;
    }
    if global.json { output::print_json(&outputs.metrics) } else { report(&args.output, &outputs.metrics) }
}

impl Args {
    /// The settings, with the environment map's file under its hash and the outputs that the file names ask for.
    fn resolve(&self, mut inputs: LocalInputs) -> Result<(RenderSettings, LocalInputs)> {
        let mut chosen = self.settings.read()?;
        let mut formats = Vec::new();
        for path in &self.output {
            let format = format_of(path)?;
            if !formats.contains(&format) {
                formats.push(format);
            }
        }
        // Layers travel in the EXR; without one they are not rendered at all.
        if chosen.has("aovs") && !formats.contains(&"exr") {
            return Err(CliError::usage("layers are written to an .exr: add one with -o"));
        }
        chosen.set("outputs", json!(formats));
        if let Some(path) = chosen.environment_file.clone() {
            let bytes =
                std::fs::read(&path).map_err(|error| CliError::usage(format!("{}: {error}", path.display())))?;
            let hash = blake3::hash(&bytes).to_hex().to_string();
            chosen.set_environment_map(&hash);
            inputs.maps.insert(hash, bytes);
        }
        Ok((chosen.finish()?, inputs))
    }

    fn executor(&self, settings: &RenderSettings) -> Result<Executor> {
        let budgets = CacheBudgets::default();
        let open = |folder: &PathBuf| {
            DiskStore::open(folder, budgets.structures_disk)
                .map_err(|error| CliError::usage(format!("--cache {}: {error}", folder.display())))
        };
        let disk = self.cache.as_ref().map(open).transpose()?;
        let structures = StructureCache::new(budgets.structures_memory, disk);
        let limits = Limits { input_bytes: u64::MAX, ..Limits::default() };
        Ok(Executor::new(structures, Devices::new(settings.device), Budgets { scenes_bytes: 0 }, limits))
    }
}

/// The scene from its file, environment maps from memory.
struct LocalInputs {
    scene: PathBuf,
    /// By hash.
    maps: HashMap<String, Vec<u8>>,
}

impl Inputs for LocalInputs {
    fn waited_s(&self) -> Option<f64> {
        None
    }

    fn scene_key(&self) -> Option<String> {
        None
    }

    fn open_scene(&self, limits: &Limits) -> std::result::Result<Source, TaskError> {
        Source::open(&self.scene, limits).map_err(|error| TaskError::bad_input(error.to_string()))
    }

    fn environment_map(&self, name: &str) -> std::result::Result<Vec<u8>, TaskError> {
        self.maps.get(name).cloned().ok_or_else(|| {
            TaskError::bad_input(format!(
                "the environment map {name} is not known here: give its file by --environment"
            ))
        })
    }

    fn parts(&self) -> Vec<TaskWork> {
        Vec::new()
    }

    fn part(&self, index: usize) -> std::result::Result<Vec<u8>, TaskError> {
        Err(TaskError::bad_input(format!("a picture that is rendered here has no part {index}")))
    }

    fn structures(&self) -> Option<&dyn StructureStore> {
        None
    }
}

/// Shows progress, and warnings as they come.
struct Watcher {
    progress: Progress,
    last: Mutex<String>,
}

impl Observer for Watcher {
    fn progress(&self, progress: executor::Progress) {
        let message = match progress.phase {
            Phase::Render => format!("{} spp", progress.spp),
            phase => phase.as_str().to_owned(),
        };
        self.progress.set(progress.fraction, message);
    }

    fn log(&self, line: String) {
        let mut last = self.last.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if line.starts_with("warning: ") && *last != line {
            self.progress.say(&output::printable(&line));
        }
        *last = line;
    }

    fn wants_preview(&self) -> bool {
        false
    }

    fn preview(&self, _png: Vec<u8>) {}
}

/// Wrong inputs are the user's, everything else is the system's.
fn render_error(file: &Path, error: &TaskError) -> CliError {
    let why = output::printable(&error.to_string());
    let named = file.file_name().is_some_and(|name| why.starts_with(&*name.to_string_lossy()));
    let message = if named { why } else { format!("{}: {why}", file.display()) };
    match error {
        TaskError::Failed { fatal: true, .. } => CliError::usage(message),
        TaskError::Failed { .. } | TaskError::Stopped => CliError::system(message),
    }
}

fn format_of(path: &Path) -> Result<&'static str> {
    let ending = path.extension().and_then(|ending| ending.to_str()).map(str::to_ascii_lowercase);
    match ending.as_deref() {
        Some("png") => Ok("png"),
        Some("exr") => Ok("exr"),
        _ => Err(CliError::usage(format!("--output {}: must end in .png or .exr", path.display()))),
    }
}

fn write(path: &Path, artifacts: &[Artifact]) -> Result<()> {
    let name = format!("image.{}", format_of(path)?);
    match artifacts.iter().find(|artifact| artifact.name == name) {
        Some(artifact) => write_file(path, &artifact.bytes),
        None => Err(CliError::system(format!("{name} was not rendered"))),
    }
}

fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).map_err(|error| CliError::usage(format!("{}: {error}", path.display())))
}

fn report(files: &[PathBuf], metrics: &Metrics) -> Result<()> {
    let names: Vec<String> = files.iter().map(|path| path.display().to_string()).collect();
    let line_spaces = match metrics.line_space_bytes {
        0 => String::new(),
        bytes => format!(", {} of line spaces", output::bytes(bytes)),
    };
    output::print(&format!(
        "{}: {} spp on {} in {:.2} s (scene {:.2}, structures {:.2}, render {:.2}), {:.2} MRays/s, {} of structures{line_spaces}\n",
        names.join(", "),
        metrics.spp,
        metrics.device,
        metrics.total_s,
        metrics.scene_s,
        metrics.build_s,
        metrics.render_s,
        metrics.mrays_per_s,
        output::bytes(metrics.structure_bytes),
    ))
}
