//! Spatial structures: built once per unique mesh, shared by every instance, job and worker.
//!
//! [`Structure`] is any of them over one mesh: a BVH ([`MeshStructure`]: a binary tree, the wide tree that the CPU walks,
//! and the compressed one that GPUs do), or a tree of cells ([`CellTree`]: [grid], [octree] or [N-tree](ntree)).
//! [`SceneAccel`] is what rays are traced against: structures placed in the world under a top level, or one structure over
//! all instances in world space ([flat]). Whatever the structure, the same ray has the same hits.

mod approximate;
mod build;
pub(crate) mod bvh2;
pub(crate) mod cells;
pub(crate) mod compressed;
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

use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

pub use approximate::{AdaptiveRules, Approximation, BouncePolicy, Purpose};
pub use bvh2::{Bvh2, Bvh2Node, MAX_DEPTH};
pub use cells::{CellNode, CellShaftParams, CellShafts, CellTree, MAX_DIM};
pub use flat::{Names, flat_hash, flatten};
pub use grid::{GridParams, GridResolution};
pub use ntree::NTreeParams;
pub use octree::OctreeParams;
pub use scene_accel::{HitFilter, Placement, SceneAccel, SurfaceStart};
pub use structure::{Structure, StructureParams, WeakStructure};

use crate::scene::{Aabb, Mesh, MeshHash};
use compressed::CompressedBvh;
use wide::{ChildRef, Role, WideBvh};

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
pub const BUILDER_VERSION: u32 = 3;

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

/// What the nodes of a tree over a mesh are in the wide trees that are made from it.
#[derive(Debug)]
struct Roles {
    /// In [`WideBvh`].
    pub cpu: Vec<Role>,
    /// In [`CompressedBvh`].
    pub gpu: Vec<Role>,
}

impl Roles {
    fn choose(bvh2: &Bvh2, mesh: &Mesh, cancel: &AtomicBool) -> Result<Self, BuildError> {
        let (cpu, gpu) = rayon::join(|| WideBvh::choose(bvh2, mesh, cancel), || CompressedBvh::choose(bvh2, cancel));
        Ok(Self { cpu: cpu?, gpu: gpu? })
    }

    fn bytes(&self) -> usize {
        self.cpu.len() + self.gpu.len()
    }
}

/// The structure of one mesh. Immutable; share it in an [`std::sync::Arc`].
#[derive(Debug)]
pub struct MeshStructure {
    mesh: MeshHash,
    bvh2: Bvh2,
    roles: Roles,
    wide: WideBvh,
    /// Made when a GPU first asks.
    compressed: OnceLock<CompressedBvh>,
}

impl MeshStructure {
    /// Builds with rayon's current pool; looks at `cancel` often enough to stop within 100 ms.
    ///
    /// The mesh's indices must be in range. Primitives with a NaN or an infinity are left out.
    pub fn build(mesh: &Mesh, params: &BuildParams, cancel: &AtomicBool) -> Result<Self, BuildError> {
        let bvh2 = build::build(mesh, params, cancel)?;
        let roles = Roles::choose(&bvh2, mesh, cancel)?;
        let wide = WideBvh::over_mesh(&bvh2, &roles.cpu, mesh, cancel)?;
        Ok(Self { mesh: mesh.hash, bvh2, roles, wide, compressed: OnceLock::new() })
    }

    /// The mesh that the structure was built over.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    /// The binary tree that every device's layout is made from.
    pub fn bvh2(&self) -> &Bvh2 {
        &self.bvh2
    }

    /// The tree that GPUs walk, made at the first call. `bounds` gives the box of a primitive of the mesh.
    pub(crate) fn compressed(&self, bounds: &(dyn Fn(u32) -> Aabb + Sync)) -> &CompressedBvh {
        if let Some(known) = self.compressed.get() {
            return known;
        }
        // Not within the lock: a thread that waits there for others may be given work that comes here again.
        let made = CompressedBvh::new(&self.bvh2, &self.roles.gpu, bounds);
        self.compressed.get_or_init(|| made)
    }

    /// Memory that the structure takes, in bytes; more once a GPU has walked it.
    pub fn bytes(&self) -> usize {
        let compressed = self.compressed.get().map_or(0, CompressedBvh::bytes);
        self.bvh2.bytes() + self.roles.bytes() + self.wide.bytes() + compressed
    }

    /// The stored form: header, checksum, little-endian arrays of the binary tree.
    pub fn encode(&self) -> Vec<u8> {
        store::encode(self.mesh, &self.bvh2, &self.roles)
    }

    /// Reads what [`Self::encode`] wrote for `mesh`. Checks header, version, checksum, mesh, every index and every box
    /// before anything is made of it.
    pub fn decode(bytes: &[u8], mesh: &Mesh) -> Result<Self, CorruptStructure> {
        let (bvh2, roles) = store::decode(bytes, mesh).map_err(CorruptStructure)?;
        let (wide, checked) = rayon::join(
            || WideBvh::over_mesh(&bvh2, &roles.cpu, mesh, &AtomicBool::new(false)),
            || wide::check_roles(&bvh2, &roles.gpu),
        );
        let wide = checked.and(wide).map_err(|error| CorruptStructure(error.to_string()))?;
        Ok(Self { mesh: mesh.hash, bvh2, roles, wide, compressed: OnceLock::new() })
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

    /// The primitives as leaves have them, with the number below which they are triangles.
    pub(crate) fn packets(&self) -> (&[wide::Packet], u32) {
        (&self.wide.packets, self.wide.triangle_count)
    }

    fn wide(&self) -> &WideBvh {
        &self.wide
    }

    /// Where walks of the wide tree begin that look at what is below some nodes of the binary one: all of it, and what else
    /// stands in the same leaves. For each node a range of the list.
    fn subtree_roots(&self, mesh: &Mesh, nodes: &[u32]) -> Result<(Vec<ChildRef>, Vec<Range<u32>>), BuildError> {
        let slots = wide::slots(&self.bvh2, &self.roles.cpu, mesh)?;
        // The leaf of the wide tree that each node stands in or below; nodes come in depth-first order.
        let mut above = vec![ChildRef::UNUSED; slots.len()];
        for (index, node) in self.bvh2.nodes.iter().enumerate() {
            if slots[index] != ChildRef::UNUSED && slots[index].is_leaf() {
                above[index] = slots[index];
            }
            if !node.is_leaf() {
                (above[index + 1], above[node.right_or_first as usize]) = (above[index], above[index]);
            }
        }
        let (mut roots, mut ranges) = (Vec::new(), Vec::with_capacity(nodes.len()));
        for &node in nodes {
            let first = roots.len() as u32;
            let mut pending = vec![node];
            while let Some(node) = pending.pop() {
                let at = node as usize;
                match (slots[at], above[at]) {
                    // The root stands in no slot, unless it is a leaf.
                    (ChildRef::UNUSED, ChildRef::UNUSED) if at == 0 => roots.push(ChildRef::ROOT),
                    (ChildRef::UNUSED, ChildRef::UNUSED) => {
                        pending.extend([self.bvh2.nodes[at].right_or_first, node + 1]);
                    }
                    (ChildRef::UNUSED, leaf) => roots.push(leaf),
                    (slot, _) => roots.push(slot),
                }
            }
            ranges.push(first..roots.len() as u32);
        }
        Ok((roots, ranges))
    }
}
