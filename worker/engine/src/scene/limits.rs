//! What one scene may cost. Every limit is checked before the memory that it bounds is allocated.

use std::fmt::Display;

use serde::{Deserialize, Serialize};

use super::error::{ImportError, ImportErrorKind};

/// Budget of one import. The defaults suit a service that takes files from strangers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Bytes read from the scene's files, counted after decompression.
    pub input_bytes: u64,
    /// Bytes of decoded geometry, over all meshes in each of their poses.
    pub geometry_bytes: u64,
    /// Triangles and spheres, over all meshes in each of their poses.
    pub triangles: u64,
    pub instances: u64,
    pub nodes: u64,
    pub materials: u64,
    /// Textures in the file, whether used or not.
    pub textures: u64,
    /// Nodes with a camera.
    pub cameras: u64,
    /// Nodes with a punctual light.
    pub lights: u64,
    /// Pixels over all images.
    pub texture_pixels: u64,
    /// Pixels along either side of an image.
    pub image_side: u32,
    /// Files in a .zip or in an upload of several parts.
    pub files: u64,
    /// Decompressed over compressed size of a .zip entry larger than 1 MiB.
    pub zip_ratio: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            input_bytes: 2 << 30,
            geometry_bytes: 8 << 30,
            triangles: 50_000_000,
            instances: 1_000_000,
            nodes: 2_000_000,
            materials: 100_000,
            textures: 100_000,
            cameras: 10_000,
            lights: 100_000,
            texture_pixels: 512 << 20,
            image_side: 32_768,
            files: 10_000,
            zip_ratio: 200,
        }
    }
}

impl Limits {
    /// None at all: for a scene that whoever sent it has imported before, within limits of their own.
    pub const NONE: Self = Self {
        input_bytes: u64::MAX,
        geometry_bytes: u64::MAX,
        triangles: u64::MAX,
        instances: u64::MAX,
        nodes: u64::MAX,
        materials: u64::MAX,
        textures: u64::MAX,
        cameras: u64::MAX,
        lights: u64::MAX,
        texture_pixels: u64::MAX,
        image_side: u32::MAX,
        files: u64::MAX,
        zip_ratio: u64::MAX,
    };

    /// An error at `position` unless `found <= limit`; `what` names the limited thing in the plural.
    pub(super) fn check(position: impl Display, what: &str, found: u64, limit: u64) -> Result<(), ImportError> {
        if found <= limit {
            return Ok(());
        }
        Err(ImportError::new(
            ImportErrorKind::Limit,
            position.to_string(),
            format!("{found} {what} are more than the limit of {limit}"),
        ))
    }
}
