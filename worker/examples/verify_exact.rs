//! Shows on real models that policy `exact` changes no picture: renders every `.glb` and `.gltf` of a folder with Line Spaces and
//! without, and prints the differing pixels of each as a Markdown table. Ends with an error when there is one.
//!
//! ```text
//! cargo run --release -p lightshaft-worker --example verify_exact -- DIR [--device cpu|gpu] [--width 160] [--height 120] [--spp 4]
//! ```
//!
//! Each scene is rendered by path tracing, where it has no light of its own under an even sky, and by ambient occlusion. With
//! `two_level` the Line Spaces are tri-state trees of the meshes, asked always; on the CPU, the nodes of an N-tree with masks too.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use lightshaft_api::job::{Metrics, TaskWork};
use lightshaft_api::settings::{
    Acceleration, Ask, DeviceChoice, Integrator, LineSpace, LineSpacePayload, Output, RenderSettings, StructureKind,
};
use lightshaft_engine::film::read_environment;
use lightshaft_engine::scene::{Limits, Source};
use lightshaft_worker::cache::{StructureCache, StructureStore};
use lightshaft_worker::executor::{Budgets, Devices, Executor, Inputs, Observer, Progress, TaskError};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("which folder?")?;
    let (mut device, mut width, mut height, mut spp) = (DeviceChoice::Cpu, 160, 120, 4);
    while let (Some(option), Some(value)) = (arguments.next(), arguments.next()) {
        match option.as_str() {
            "--device" => device = if value == "gpu" { DeviceChoice::Gpu } else { DeviceChoice::Cpu },
            "--width" => width = value.parse()?,
            "--height" => height = value.parse()?,
            "--spp" => spp = value.parse()?,
            _ => return Err(format!("{option}: is no option").into()),
        }
    }
    let mut files = Vec::new();
    find(Path::new(&folder), &mut files)?;
    files.sort();
    let limits = Limits { input_bytes: u64::MAX, ..Limits::default() };
    println!(
        "| scene | structure | rays that asked | EMPTY or OPAQUE | nodes skipped | differing pixels |\n|---|---|---|---|---|---|"
    );
    let mut differing = 0;
    for file in &files {
        let name = file.strip_prefix(&folder)?.display().to_string();
        let executor = Executor::new(
            StructureCache::new(1 << 30, None),
            Devices::new(DeviceChoice::Auto),
            Budgets { scenes_bytes: 0 },
            limits.clone(),
        );
        for asked in asked(device) {
            let mut row = Row::default();
            for integrator in [Integrator::Path, Integrator::Ao] {
                let settings = RenderSettings {
                    width,
                    height,
                    spp,
                    integrator,
                    device,
                    outputs: vec![Output::Exr],
                    acceleration: Acceleration { line_space: None, ..asked.clone() },
                    ..RenderSettings::default()
                };
                let result = render(&executor, &settings, file).and_then(|(plain, _)| {
                    let settings = RenderSettings { acceleration: asked.clone(), ..settings };
                    Ok((plain, render(&executor, &settings, file)?))
                });
                match result {
                    Ok((plain, (pixels, metrics))) => row.add(&plain, &pixels, &metrics),
                    Err(why) => row.refused = Some(why.to_string()),
                }
            }
            differing += row.differing;
            println!("| {name} | {} | {row}", serde_json::json!(asked.structure).as_str().unwrap_or_default());
        }
    }
    println!("\n{differing} pixels differ");
    if differing == 0 { Ok(()) } else { Err("policy exact changed a picture".into()) }
}

/// What is compared with the same structure alone.
fn asked(device: DeviceChoice) -> Vec<Acceleration> {
    let always = |payload| LineSpace { payload, ask: Ask::Always, ..LineSpace::default() };
    let of_meshes = Acceleration { line_space: Some(always(LineSpacePayload::TriState)), ..Acceleration::default() };
    let of_nodes = Acceleration {
        structure: StructureKind::NTree,
        n: Some(8),
        line_space: Some(always(LineSpacePayload::Binary)),
        ..Acceleration::default()
    };
    if device == DeviceChoice::Gpu { vec![of_meshes] } else { vec![of_meshes, of_nodes] }
}

fn find(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            find(&path, files)?;
        } else if path.extension().is_some_and(|ending| ending == "glb" || ending == "gltf") {
            files.push(path);
        }
    }
    Ok(())
}

fn render(executor: &Executor, settings: &RenderSettings, file: &Path) -> Result<(Vec<[f32; 3]>, Metrics), TaskError> {
    let outputs = executor.run(&TaskWork::Frame, settings, &File(file), &Silent, &AtomicBool::new(false))?;
    let image = outputs.artifacts.iter().find(|artifact| artifact.name == "image.exr");
    let bytes = image.map_or(&[][..], |image| &image.bytes);
    let picture = read_environment(bytes, 1 << 26).map_err(|error| TaskError::bad_input(error.to_string()))?;
    Ok((picture.rgb, outputs.metrics))
}

/// The pictures of one scene with one structure.
#[derive(Default)]
struct Row {
    rays: u64,
    decided: u64,
    skipped: u64,
    differing: usize,
    refused: Option<String>,
}

impl Row {
    fn add(&mut self, plain: &[[f32; 3]], pixels: &[[f32; 3]], metrics: &Metrics) {
        let bits = |pixel: &[f32; 3]| pixel.map(f32::to_bits);
        self.differing += plain.iter().zip(pixels).filter(|(a, b)| bits(a) != bits(b)).count();
        if let Some(used) = metrics.line_space {
            self.rays += used.rays + used.node_look_ups;
            self.decided += used.empty + used.opaque;
            self.skipped += used.skipped_nodes;
        }
    }
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.refused {
            Some(why) => write!(f, "refused: {why} | | | |"),
            None => write!(f, "{} | {} | {} | {} |", self.rays, self.decided, self.skipped, self.differing),
        }
    }
}

struct File<'a>(&'a Path);

impl Inputs for File<'_> {
    fn waited_s(&self) -> Option<f64> {
        None
    }

    fn scene_key(&self) -> Option<String> {
        None
    }

    fn open_scene(&self, limits: &Limits) -> Result<Source, TaskError> {
        Ok(Source::open(self.0, limits)?)
    }

    fn environment_map(&self, name: &str) -> Result<Vec<u8>, TaskError> {
        Err(TaskError::bad_input(format!("there is no map {name}")))
    }

    fn parts(&self) -> Vec<TaskWork> {
        Vec::new()
    }

    fn part(&self, _: usize) -> Result<Vec<u8>, TaskError> {
        Err(TaskError::bad_input("a frame has no parts"))
    }

    fn structures(&self) -> Option<&dyn StructureStore> {
        None
    }
}

struct Silent;

impl Observer for Silent {
    fn progress(&self, _: Progress) {}

    fn log(&self, _: String) {}

    fn wants_preview(&self) -> bool {
        false
    }

    fn preview(&self, _: Vec<u8>) {}
}
