//! Scenes as the API shows them.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Scene {
    pub id: String,
    /// BLAKE3 of the uploaded bytes (multipart: of the canonical file list), 64 hex digits.
    pub hash: String,
    pub name: String,
    pub created_at: jiff::Timestamp,
    /// Bytes of the upload.
    pub bytes: u64,
    #[serde(flatten)]
    pub summary: SceneSummary,
    /// Where the thumbnail is, once its job has succeeded.
    pub thumbnail: Option<String>,
}

/// What a scene holds: found on import.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneSummary {
    pub meshes: Vec<MeshSummary>,
    pub instances: u64,
    /// Over unique meshes.
    pub triangles_total: u64,
    /// Over all instances.
    pub triangles_instanced: u64,
    pub spheres_total: u64,
    pub materials: Vec<String>,
    pub textures: u64,
    pub texture_pixels: u64,
    pub cameras: Vec<CameraSummary>,
    pub lights: Vec<LightSummary>,
    /// Triangles and spheres that emit, over all instances.
    pub emitters: u64,
    /// World-space bounds of all instances; null for a scene with nothing in it.
    pub bounds: Option<Bounds>,
    /// Geometry, textures and structures in memory, roughly.
    pub estimated_bytes: u64,
    pub warnings: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MeshSummary {
    pub hash: String,
    pub name: String,
    pub triangles: u64,
    pub spheres: u64,
    pub instances: u64,
    /// In object space.
    pub bounds: Option<Bounds>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Bounds {
    pub min: [f32; 3],
    pub max: [f32; 3],
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CameraSummary {
    pub name: String,
    /// `perspective` or `orthographic`.
    pub kind: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LightSummary {
    pub name: String,
    /// `point`, `spot` or `directional`.
    pub kind: String,
}
