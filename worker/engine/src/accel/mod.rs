//! Spatial structures: built once per unique mesh, shared by every instance, job and worker.
//!
//! [`Structure`] is any of them over one mesh: a BVH ([`MeshStructure`]: a binary tree, from which every device makes its
//! own layout, and the wide tree that the CPU walks), or a tree of cells ([`CellTree`]: [grid], [octree] or [N-tree](ntree)).
//! [`SceneAccel`] is what rays are traced against: structures placed in the world under a top level, or one structure over
//! all instances in world space ([flat]). Whatever the structure, the same ray has the same hits.

mod build;
pub(crate) mod bvh2;
pub(crate) mod cells;
mod flat;
mod grid;
pub mod line_space;
mod memory;
mod ntree;
mod octree;
pub mod overlap;
mod scene_accel;
mod store;
mod stored;
mod structure;
mod two_level;
pub(crate) mod wide;

use std::sync::atomic::AtomicBool;

pub use bvh2::{Bvh2, Bvh2Node, MAX_DEPTH};
pub use cells::{CellNode, CellTree, MAX_DIM};
pub use flat::{Names, flat_hash, flatten};
pub use grid::{GridParams, GridResolution};
pub use ntree::NTreeParams;
pub use octree::OctreeParams;
pub use scene_accel::{HitFilter, Placement, SceneAccel, SurfaceStart};
pub use structure::{Structure, StructureParams, WeakStructure};

use crate::scene::{Aabb, Mesh, MeshHash};
use wide::{Role, WideBvh};

/// How a BVH is to be built. [`Self::canonical`] is its part of the cache key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct BuildParams {
    pub quality: Quality,
    /// Lets a primitive stand in several leaves where that pays (Stich, Friedrich, Dietrich 2009): slower to build,
    /// and faster to trace where large triangles overlap.
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
pub const BUILDER_VERSION: u32 = 2;

/// The key of a structure in every cache.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct StructureKey {
    pub mesh: MeshHash,
    /// `"bvh"`, `"grid"`, `"octree"` or `"ntree"`; `"line_space"` or `"surface_shafts"`.
    pub kind: &'static str,
    /// Canonical text of the parameters, e.g. `quality=medium,spatial_splits=false`.
    pub parameters: String,
    pub builder_version: u32,
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
        StructureParams::from(*self).key(mesh)
    }

    pub fn canonical(&self) -> String {
        let quality = match self.quality {
            Quality::Fast => "fast",
            Quality::Medium => "medium",
            Quality::High => "high",
        };
        format!("quality={quality},spatial_splits={}", self.spatial_splits)
    }
}

/// The structure of one mesh. Immutable; share it in an [`std::sync::Arc`].
#[derive(Debug)]
pub struct MeshStructure {
    mesh: MeshHash,
    bvh2: Bvh2,
    /// What the nodes of `bvh2` are in `wide`.
    roles: Vec<Role>,
    wide: WideBvh,
}

impl MeshStructure {
    /// Builds with rayon's current pool; looks at `cancel` often enough to stop within 100 ms.
    ///
    /// The mesh's indices must be in range. Primitives with a NaN or an infinity are left out.
    pub fn build(mesh: &Mesh, params: &BuildParams, cancel: &AtomicBool) -> Result<Self, BuildError> {
        let bvh2 = build::build(mesh, params, cancel)?;
        let roles = WideBvh::choose(&bvh2, mesh, cancel)?;
        let wide = WideBvh::over_mesh(&bvh2, &roles, mesh, cancel)?;
        Ok(Self { mesh: mesh.hash, bvh2, roles, wide })
    }

    /// The mesh that the structure was built over.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    /// The binary tree that every device's layout is made from.
    pub fn bvh2(&self) -> &Bvh2 {
        &self.bvh2
    }

    /// Memory that the structure takes, in bytes.
    pub fn bytes(&self) -> usize {
        self.bvh2.bytes() + self.roles.len() + self.wide.bytes()
    }

    /// The stored form: header, checksum, little-endian arrays of the binary tree.
    pub fn encode(&self) -> Vec<u8> {
        store::encode(self.mesh, &self.bvh2, &self.roles)
    }

    /// Reads what [`Self::encode`] wrote for `mesh`. Checks header, version, checksum, mesh, every index and every box
    /// before anything is made of it.
    pub fn decode(bytes: &[u8], mesh: &Mesh) -> Result<Self, CorruptStructure> {
        let (bvh2, roles) = store::decode(bytes, mesh).map_err(CorruptStructure)?;
        let wide = WideBvh::over_mesh(&bvh2, &roles, mesh, &AtomicBool::new(false))
            .map_err(|error| CorruptStructure(error.to_string()))?;
        Ok(Self { mesh: mesh.hash, bvh2, roles, wide })
    }

    /// Checks that every primitive is referenced and lies in its leaves' boxes, that boxes are finite and nested, and
    /// that indices are in range.
    pub fn validate(&self, mesh: &Mesh) -> Result<(), String> {
        if self.mesh != mesh.hash {
            return Err(format!("the structure is for mesh {}, not {}", self.mesh, mesh.hash));
        }
        self.bvh2.check_topology(mesh.primitive_count())?;
        self.bvh2.check_boxes()?;
        // With spatial splits a leaf may hold a part of its primitive: the leaves together must hold all of it.
        let mut covered = vec![Aabb::EMPTY; mesh.primitive_count()];
        for leaf in self.bvh2.nodes.iter().filter(|node| node.is_leaf()) {
            let range = leaf.right_or_first as usize..(leaf.right_or_first + leaf.count) as usize;
            for &primitive in &self.bvh2.primitives[range] {
                let covered = &mut covered[primitive as usize];
                *covered = covered.union(leaf.bounds());
            }
        }
        for (primitive, covered) in covered.iter().enumerate() {
            let bounds = build::primitive_bounds(mesh, primitive);
            let traceable = bounds.min.is_finite() && bounds.max.is_finite();
            if traceable && !(covered.min.cmple(bounds.min).all() && bounds.max.cmple(covered.max).all()) {
                return Err(format!("primitive {primitive} is not inside the leaves that refer to it"));
            }
        }
        Ok(())
    }

    fn wide(&self) -> &WideBvh {
        &self.wide
    }
}
