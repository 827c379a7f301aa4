//! What a benchmark found: `results.json`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::job::{CacheReport, RayCounts};
use crate::settings::{BenchmarkPreset, Effect};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BenchmarkResults {
    pub title: String,
    pub preset: Option<BenchmarkPreset>,
    /// Where the paper's figures are from.
    pub source: Option<String>,
    pub device: String,
    /// `cpu` or `gpu`.
    pub device_kind: String,
    pub driver: String,
    pub versions: BTreeMap<String, String>,
    /// Pixels.
    pub width: u32,
    pub height: u32,
    /// Samples per pixel of a timed frame, and of the pictures that are compared.
    pub spp: u32,
    pub picture_spp: u32,
    pub seed: u32,
    pub repetitions: u32,
    pub min_sample_s: f64,
    /// What a table for people shows of each row, in order.
    pub columns: Vec<Column>,
    pub scenes: Vec<SceneResults>,
    pub total_s: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneResults {
    /// As the paper or the user calls it.
    pub name: String,
    /// What was measured: a file, a generated kind, a scene's id.
    pub measured: String,
    /// Whether it stands in for a scene of the paper that is not at hand.
    pub stand_in: bool,
    /// Over unique meshes.
    pub triangles: u64,
    pub spheres: u64,
    pub instances: u64,
    pub meshes: u64,
    pub comparisons: Vec<Comparison>,
}

/// One reference, and what is compared with it in one effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Null where structures are only built.
    pub effect: Option<Effect>,
    /// Name and effect for people.
    pub title: String,
    /// How the scene was lit, and which rays are in the times.
    pub note: String,
    /// Null where structures are only built.
    pub reference: Option<String>,
    /// Names of the views that were rendered.
    pub views: Vec<String>,
    pub rows: Vec<Row>,
}

/// One configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub configuration: String,
    pub acceleration: serde_json::Value,
    /// Why it could not be measured by this build.
    pub unavailable: Option<String>,
    pub built: Option<Built>,
    pub timed: Option<Timed>,
    pub picture: Option<PictureDifference>,
    pub paper: Option<PaperFigures>,
    /// What there is to tell about building it.
    pub warnings: Vec<String>,
}

/// Structures, built from nothing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Built {
    /// Wall-clock time of building everything on all threads.
    pub init_s: f64,
    pub structure_bytes: u64,
    pub structure_nodes: u64,
    pub line_space_bytes: u64,
    /// How many there are.
    pub line_spaces: u64,
    pub cache: Vec<CacheReport>,
}

/// Each figure is the median over the views of that view's figure over the rounds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timed {
    /// Rays of all kinds over the time of rendering alone.
    pub mrays_per_s: Quartiles,
    pub frames_per_s: Quartiles,
    /// Speed over that of the reference just before and after; null for the reference itself.
    pub ratio: Option<Interval>,
    /// Traced in one frame, mean over the views.
    pub rays: RayCounts,
    pub per_ray: WorkPerRay,
    pub samples: Vec<Sample>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quartiles {
    pub lower: f64,
    pub median: f64,
    pub upper: f64,
}

/// With a confidence of 95 %.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    pub value: f64,
    pub low: f64,
    pub high: f64,
}

/// What one ray did on average. A GPU does not count tests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WorkPerRay {
    pub box_tests: f64,
    pub triangle_tests: f64,
    /// Shafts that were looked up, and by class; the rest of the rays that asked start inside or pass the box by.
    pub look_ups: f64,
    pub empty: f64,
    pub opaque: f64,
    pub mixed: f64,
    pub starts_inside: f64,
    pub approximated: f64,
}

/// One time of one configuration in one view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// From 0.
    pub round: u32,
    pub view: u32,
    /// Frames that were rendered in this time.
    pub frames: u32,
    pub seconds: f64,
    pub rays: u64,
    /// Speed over that of the reference just before and after; null for the reference itself.
    pub ratio: Option<f64>,
}

/// The picture against the reference's, worst of all views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureDifference {
    pub rmse: f64,
    pub flip: f64,
    /// Of all views together.
    pub differing_pixels: u64,
    /// Names of the artifacts of the first view.
    pub heat_map: String,
    pub picture: String,
}

/// What the paper gives for this configuration, where it does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaperFigures {
    pub fps: Option<f64>,
    pub mrays_per_s: Option<f64>,
    /// Speed over that of the reference.
    pub ratio: Option<f64>,
    pub size_mb: Option<f64>,
    pub line_space_mb: Option<f64>,
    pub line_spaces: Option<f64>,
    pub nodes: Option<f64>,
    pub init_s: Option<f64>,
    pub rmse: Option<f64>,
}

/// A figure that a table shows of each row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Column {
    InitS,
    Nodes,
    StructureMb,
    LineSpaces,
    LineSpaceMb,
    /// Structures and Line Spaces together.
    SizeMb,
    Fps,
    MraysPerS,
    Ratio,
    Rmse,
    Flip,
    BoxTests,
    TriangleTests,
    LookUps,
    PaperInitS,
    PaperNodes,
    PaperLineSpaces,
    PaperLineSpaceMb,
    PaperSizeMb,
    PaperFps,
    PaperMraysPerS,
    PaperRatio,
    PaperRmse,
}
