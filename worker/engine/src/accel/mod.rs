//! Spatial structures: built once per unique mesh, shared by every instance, job and worker.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::Affine3A;

use crate::scene::{Mesh, MeshHash};
use crate::trace::{Counters, Hit, Ray};

/// Which structure, and how it is to be built. `canonical()` is its part of the cache key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BuildParams {
    pub quality: Quality,
    pub spatial_splits: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Quality {
    Fast,
    #[default]
    Medium,
    High,
}

/// Changes whenever a builder or a stored layout changes: old cache entries are then simply not found.
pub const BUILDER_VERSION: u32 = 1;

/// The key of a structure in every cache.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct StructureKey {
    pub mesh: MeshHash,
    /// `"bvh"`.
    pub kind: &'static str,
    /// Canonical text of the parameters, e.g. `quality=medium,spatial_splits=false`.
    pub parameters: String,
    pub builder_version: u32,
}

/// A binary BVH, nodes in depth-first order: the left child of inner node `i` is `i + 1`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bvh2 {
    /// Node 0 is the root; empty for a mesh without primitives.
    pub nodes: Vec<Bvh2Node>,
    /// Primitive numbers, in leaf order (with spatial splits one may stand in several leaves).
    pub primitives: Vec<u32>,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Bvh2Node {
    pub min: [f32; 3],
    /// Inner: the right child's number. Leaf: the first of its `count` entries in [`Bvh2::primitives`].
    pub right_or_first: u32,
    pub max: [f32; 3],
    /// 0 for inner nodes.
    pub count: u32,
}
const _: () = assert!(size_of::<Bvh2Node>() == 32);

/// The structure of one mesh. Cheap to share; immutable.
#[derive(Debug)]
pub struct MeshStructure {
    _private: (),
}

#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    #[error("the build was cancelled")]
    Cancelled,
    #[error("{0}")]
    Unsupported(String),
}

#[derive(Debug, thiserror::Error)]
#[error("corrupt structure: {0}")]
pub struct CorruptStructure(pub String);

impl BuildParams {
    pub fn key(&self, mesh: MeshHash) -> StructureKey {
        let _ = mesh;
        unreachable!()
    }
}

impl MeshStructure {
    /// Builds with rayon's current pool; looks at `cancel` often enough to stop within 100 ms.
    pub fn build(_mesh: &Mesh, _params: &BuildParams, _cancel: &AtomicBool) -> Result<Self, BuildError> {
        unreachable!()
    }

    /// The binary tree that every device's layout is made from.
    pub fn bvh2(&self) -> &Bvh2 {
        unreachable!()
    }

    /// Memory that the structure takes, in bytes.
    pub fn bytes(&self) -> usize {
        unreachable!()
    }

    /// The stored form: header, checksum, little-endian arrays.
    pub fn encode(&self) -> Vec<u8> {
        unreachable!()
    }

    /// Checks header, version, checksum and every index before anything is traced with it.
    pub fn decode(_bytes: &[u8]) -> Result<Self, CorruptStructure> {
        unreachable!()
    }

    /// Every primitive referenced, boxes nested and finite, indices in range.
    pub fn validate(&self, _mesh: &Mesh) -> Result<(), String> {
        unreachable!()
    }
}

/// One placed mesh, as the top level sees it.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Index into the scene's structures.
    pub mesh: u32,
    pub transform: Affine3A,
    /// Candidate hits of this instance go through the [`HitFilter`].
    pub filtered: bool,
}

/// Decides whether a candidate hit counts (alpha mask and blend). Must depend on the hit alone, never on the order of
/// the calls: the same ray gives the same answers on every device.
pub trait HitFilter {
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool;
}

/// A top-level structure over instances of mesh structures: what rays are traced against.
#[derive(Debug)]
pub struct SceneAccel {
    _private: (),
}

impl SceneAccel {
    pub fn build(_structures: Vec<Arc<MeshStructure>>, _placements: &[Placement]) -> Self {
        unreachable!()
    }

    /// The nearest hit in `(t_min, t_max)`.
    pub fn closest(&self, _ray: &Ray, _filter: &dyn HitFilter, _counters: &mut Counters) -> Option<Hit> {
        unreachable!()
    }

    /// Whether anything is hit in `(t_min, t_max)`.
    pub fn occluded(&self, _ray: &Ray, _filter: &dyn HitFilter, _counters: &mut Counters) -> bool {
        unreachable!()
    }

    /// Bytes of the top level alone.
    pub fn top_bytes(&self) -> usize {
        unreachable!()
    }

    /// The top level over world-space instance bounds; its primitives are instance numbers.
    pub fn top(&self) -> &Bvh2 {
        unreachable!()
    }

    pub fn structures(&self) -> &[Arc<MeshStructure>] {
        unreachable!()
    }
}
