//! Settings of jobs. Every field has a default; unknown fields are refused.

mod benchmark;
mod choice;
mod layers;
mod line_space;
mod of_job;
mod policy;
mod validate;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use benchmark::{BenchmarkPreset, BenchmarkSettings, Configuration, Effect, file_name, validate_acceleration};
pub use layers::AovName;
pub use line_space::{Ask, LineSpace, LineSpaceBuilder, LineSpacePayload, OnOverBudget};
pub use of_job::{BuildSettings, JobSettings};
pub use policy::{Adaptive, BouncePolicy, OriginNode, OriginObject, Policy, Representative, RepresentativeOrigin};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RenderSettings {
    pub integrator: Integrator,
    /// Pixels, 1 to 16384.
    pub width: u32,
    /// Pixels, 1 to 16384; width times height at most 67108864.
    pub height: u32,
    /// Samples per pixel, 1 to 1048576.
    pub spp: u32,
    pub seed: u32,
    /// Longest path after the first hit (path), or longest chain of mirrors (whitted); 0 to 64.
    pub max_bounces: u32,
    /// Rays of ambient occlusion per pixel sample, 1 to 1024.
    pub ao_samples: u32,
    /// Reach of ambient occlusion in world units; a tenth of the scene's diagonal when null.
    pub ao_distance: Option<f32>,
    pub device: DeviceChoice,
    /// Part of the GPU adapter's name, case-insensitive; any adapter when null.
    pub adapter: Option<String>,
    /// A camera of the scene by name or number, or one given here; null takes the scene's first, or frames the scene.
    pub camera: Option<CameraChoice>,
    /// Constant radiance or a map; null is black, or a grey sky of 1 where the scene has no light: textures of emission are none.
    pub environment: Option<Environment>,
    /// Lights beside the scene's own.
    pub lights: Vec<Light>,
    pub ground: Option<Ground>,
    pub outputs: Vec<Output>,
    /// Layers for the EXR.
    pub aovs: Vec<AovName>,
    pub tone_map: ToneMap,
    /// Stops: the picture is multiplied by `2^exposure` before tone mapping; -32 to 32.
    pub exposure: f32,
    pub acceleration: Acceleration,
    /// Stop after the pass in which this much time has passed, with the samples there are; null for no limit.
    pub time_limit_s: Option<f64>,
    /// Cut the job into tasks that several workers can share; null renders it as one.
    pub split: Option<Split>,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            integrator: Integrator::Path,
            width: 640,
            height: 480,
            spp: 16,
            seed: 1,
            max_bounces: 4,
            ao_samples: 16,
            ao_distance: None,
            device: DeviceChoice::Auto,
            adapter: None,
            camera: None,
            environment: None,
            lights: Vec::new(),
            ground: None,
            outputs: vec![Output::Png, Output::Exr],
            aovs: Vec::new(),
            tone_map: ToneMap::PbrNeutral,
            exposure: 0.0,
            acceleration: Acceleration::default(),
            time_limit_s: None,
            split: None,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    Aov,
    Ao,
    Direct,
    Whitted,
    Path,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeviceChoice {
    /// A GPU where there is a real one, the CPU otherwise (software adapters such as lavapipe are only used by `gpu`).
    Auto,
    Cpu,
    Gpu,
}

#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum CameraChoice {
    Index(u32),
    Name(String),
    Custom(CustomCamera),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CustomCamera {
    pub position: [f32; 3],
    pub target: [f32; 3],
    #[serde(default = "up_y")]
    pub up: [f32; 3],
    /// Vertical field of view; 40 when neither this nor `half_height` is given.
    #[serde(default)]
    pub fov_y_deg: Option<f32>,
    /// Orthographic instead: half the height of the view in world units.
    #[serde(default)]
    pub half_height: Option<f32>,
}

fn up_y() -> [f32; 3] {
    [0.0, 1.0, 0.0]
}

/// A number (grey radiance), `[r, g, b]`, or a map uploaded to `/v1/blobs`.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum Environment {
    Grey(f32),
    Color([f32; 3]),
    Map(EnvironmentMap),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentMap {
    /// Hash of an equirectangular .hdr or .exr in the blob store.
    pub map: String,
    #[serde(default = "one")]
    pub intensity: f32,
    /// About +Y.
    #[serde(default)]
    pub rotation_deg: f32,
}

fn one() -> f32 {
    1.0
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Light {
    pub kind: LightKind,
    /// Linear colour.
    #[serde(default = "white")]
    pub color: [f32; 3],
    /// Candela (point, spot) or lux (directional).
    #[serde(default = "one")]
    pub intensity: f32,
    /// World space; required for point and spot.
    #[serde(default)]
    pub position: Option<[f32; 3]>,
    /// Where it shines to; required for directional and spot.
    #[serde(default)]
    pub direction: Option<[f32; 3]>,
    #[serde(default)]
    pub range: Option<f32>,
    /// Spot cone half angles, 0 <= inner < outer <= 90.
    #[serde(default)]
    pub inner_cone_deg: Option<f32>,
    #[serde(default)]
    pub outer_cone_deg: Option<f32>,
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LightKind {
    Point,
    Spot,
    Directional,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Ground {
    /// World height; the scene's lowest point when null.
    pub height: Option<f32>,
    /// Half side length; 20 scene radii when null.
    pub half_size: Option<f32>,
    pub albedo: [f32; 3],
    pub roughness: f32,
}

impl Default for Ground {
    fn default() -> Self {
        Self { height: None, half_size: None, albedo: [0.5; 3], roughness: 1.0 }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Output {
    Png,
    Exr,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ToneMap {
    /// Khronos PBR Neutral.
    PbrNeutral,
    Agx,
    /// Clamp to 0..1.
    None,
}

/// Which spatial structure rays are traced over. All give the same picture; what differs is time and memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Acceleration {
    pub structure: StructureKind,
    /// Of BVHs.
    pub quality: BuildQuality,
    /// Of BVHs: a triangle may stand in several leaves where that pays.
    pub spatial_splits: bool,
    /// Of `ntree`: cells of a node on each axis, 2 to 16; 6 when null.
    pub n: Option<u32>,
    /// Levels of subdivision. Of `ntree`: 1 to 6, 3 when null. Of `octree`: 1 to 16, 12 when null.
    pub depth: Option<u32>,
    /// Of `ntree` and `octree`: cells with at most so many primitives are not subdivided, 0 to 1024; 8 when null.
    pub max_leaf: Option<u32>,
    /// Of `grid`: cells for each primitive, 1 to 64; 4 when neither this nor `resolution` is given.
    pub cells_per_primitive: Option<u32>,
    /// Of `grid`: cells on the longest axis instead, 1 to 4096.
    pub resolution: Option<u32>,
    /// Of `grid`, `octree` and `ntree`: a structure that would need more is refused; 1048576 (1 MiB) and more, 4 GiB when
    /// null.
    pub budget_bytes: Option<u64>,
    /// Of `two_level` and `ntree`, on the CPU: what is known of the lines through each mesh, or each node; null for nothing.
    pub line_space: Option<LineSpace>,
    /// What `line_space` is used for.
    pub policy: Policy,
    /// Of policy `approximate_occlusion`, with boxes below the mesh's own: what is done in the box in which a ray starts.
    pub origin_node: OriginNode,
    /// Of the same: boxes nearer to a ray's start or end than so many of their longest edges count as the one in which it starts, 0 to
    /// 16. Without (0), a surface darkens itself along the borders of boxes, and lamps stand in their own light.
    pub origin_reach: f32,
    /// Of policy `adaptive`.
    pub adaptive: Adaptive,
    /// Of policy `representative`.
    pub representative: Representative,
}

impl Default for Acceleration {
    fn default() -> Self {
        Self {
            structure: StructureKind::TwoLevel,
            quality: BuildQuality::Medium,
            spatial_splits: false,
            n: None,
            depth: None,
            max_leaf: None,
            cells_per_primitive: None,
            resolution: None,
            budget_bytes: None,
            line_space: None,
            policy: Policy::Exact,
            origin_node: OriginNode::default(),
            origin_reach: 1.0,
            adaptive: Adaptive::default(),
            representative: Representative::default(),
        }
    }
}

impl Acceleration {
    /// In words, such as `two_level with tri_state line spaces`.
    pub fn describe(&self) -> String {
        let name = |value: serde_json::Value| value.as_str().unwrap_or_default().to_owned();
        let structure = name(serde_json::json!(self.structure));
        match &self.line_space {
            None => structure,
            Some(space) => format!("{structure} with {} line spaces", name(serde_json::json!(space.payload))),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StructureKind {
    /// One BVH per mesh under a BVH of instances.
    TwoLevel,
    /// One BVH over all instances in world space.
    Bvh,
    /// A uniform grid over all instances in world space.
    Grid,
    /// An octree over all instances in world space.
    Octree,
    /// A recursive grid with `n` x `n` x `n` cells in each node, over all instances in world space.
    #[serde(rename = "ntree")]
    NTree,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BuildQuality {
    Fast,
    Medium,
    High,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Split {
    /// Columns and rows of tiles, 1 to 64 each.
    Tiles([u32; 2]),
    /// Equal shares of the samples, 2 to 256; passes times pixels at most 268435456.
    Passes(u32),
}
