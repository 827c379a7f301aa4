//! What a picture is to be: the engine's own terms, resolved from a job's settings by the caller.

use std::sync::Arc;

use glam::Vec3;

use crate::scene::{Camera, PunctualLight};

#[derive(Clone, Debug)]
pub struct RenderSettings {
    pub integrator: Integrator,
    pub width: u32,
    pub height: u32,
    pub spp: u32,
    pub seed: u32,
    pub camera: Camera,
    pub environment: Environment,
    /// Added to the scene's own lights.
    pub extra_lights: Vec<PunctualLight>,
    pub ground: Option<Ground>,
    /// AOVs wanted beside the picture (the `aov` integrator renders only these).
    pub aovs: Vec<Aov>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Integrator {
    /// Only AOVs; the picture is the shading normal mapped to 0..1.
    Aov,
    /// Share of unoccluded cosine-weighted directions within `distance` (world units), `samples` per pixel sample.
    Ao { samples: u32, distance: f32 },
    /// Emission and direct light of area, punctual and environment lights, soft shadows.
    Direct,
    /// Direct light, and mirror reflections down to `max_bounces` (Whitted 1980).
    Whitted { max_bounces: u32 },
    /// Path tracing with next-event estimation and multiple importance sampling.
    Path { max_bounces: u32 },
}

/// Light from infinitely far away.
#[derive(Clone, Debug)]
pub enum Environment {
    /// Linear radiance; black is none.
    Constant(Vec3),
    /// Equirectangular (latitude-longitude), `+Y` up, the image's centre at `-Z`.
    Map { image: Arc<HdrImage>, intensity: f32, rotation_y_rad: f32 },
}

/// Linear RGB, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct HdrImage {
    pub width: u32,
    pub height: u32,
    pub rgb: Vec<[f32; 3]>,
}

/// A horizontal square under the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// World height; the scene's lowest point when not given.
    pub height: Option<f32>,
    /// Half side length; 20 scene radii when not given.
    pub half_size: Option<f32>,
    pub albedo: Vec3,
    pub roughness: f32,
}

/// Quantities of a pixel: most of the first hit of the ray through its centre, some of what Line Spaces did for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Aov {
    /// Planar: world-space distance from the camera along its forward axis, infinite on a miss.
    Depth,
    Position,
    GeometricNormal,
    ShadingNormal,
    Albedo,
    InstanceId,
    PrimitiveId,
    MaterialId,
    BoxTests,
    TriangleTests,
    /// The largest gamma of the usage heuristic among the objects that the rays of the pixel's first sample come to.
    LineSpaceGamma,
    /// By what those rays were answered: see [`crate::integrate::usage`].
    LineSpaceAnswer,
    /// Shafts that they looked up.
    LineSpaceLookUps,
    /// Meshes and nodes that they passed by because their shaft was empty.
    LineSpaceSkipped,
}

impl Aov {
    pub const ALL: [Self; 14] = [
        Self::Depth,
        Self::Position,
        Self::GeometricNormal,
        Self::ShadingNormal,
        Self::Albedo,
        Self::InstanceId,
        Self::PrimitiveId,
        Self::MaterialId,
        Self::BoxTests,
        Self::TriangleTests,
        Self::LineSpaceGamma,
        Self::LineSpaceAnswer,
        Self::LineSpaceLookUps,
        Self::LineSpaceSkipped,
    ];

    /// Those that any device makes.
    pub const OF_FIRST_HIT: &[Self] = Self::ALL.split_at(10).0;

    /// The name in settings and in EXR layers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Position => "position",
            Self::GeometricNormal => "geometric_normal",
            Self::ShadingNormal => "shading_normal",
            Self::Albedo => "albedo",
            Self::InstanceId => "instance_id",
            Self::PrimitiveId => "primitive_id",
            Self::MaterialId => "material_id",
            Self::BoxTests => "box_tests",
            Self::TriangleTests => "triangle_tests",
            Self::LineSpaceGamma => "line_space_gamma",
            Self::LineSpaceAnswer => "line_space_answer",
            Self::LineSpaceLookUps => "line_space_look_ups",
            Self::LineSpaceSkipped => "line_space_skipped",
        }
    }

    /// Whether it tells what Line Spaces did for all rays of the pixel's first sample. The CPU device makes these.
    pub fn is_of_line_space(self) -> bool {
        !Self::OF_FIRST_HIT.contains(&self)
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|aov| aov.name() == name)
    }
}
