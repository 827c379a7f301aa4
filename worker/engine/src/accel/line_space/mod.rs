//! Line Spaces: what can be said of all lines of a shaft at once (Keul 2020, "Efficient ray tracing with line space").
//!
//! The faces of a mesh's box are cut into patches, two patches make a shaft ([`shaft`]), and a [`LineSpace`] stores
//! something for each shaft, its payload:
//!
//! - [`Payload::Binary`]: whether it may hold geometry. By masking or clipping it is conservative, by ray casting not.
//! - [`Payload::Candidates`]: a primitive that stands for all that is in the shaft, seen from its start.
//! - [`Payload::Classes`]: EMPTY, OPAQUE or MIXED, each proven ([`Class`]); dense or hierarchical. This is what makes
//!   [`SceneAccel`](super::SceneAccel) faster without changing an answer.
//! - [`Payload::Coverage`]: which part of its lines is blocked.
//!
//! [`NodeSpaces`] are the same on the nodes of a mesh's BVH, [`CellSpaces`] on those of an N-tree, and [`SurfaceShafts`] do the same for rays that
//! start on the mesh. What belongs to a mesh is cached as structures are.

mod bits;
mod blocks;
mod candidates;
mod cast;
mod cell_spaces;
mod classes;
mod gate;
mod hull;
mod layered;
mod mask;
mod nodes;
mod params;
pub mod shaft;
mod store;
mod surface;
mod surface_rows;
#[cfg(test)]
mod tests;
mod voxels;
mod worth;

use std::sync::atomic::AtomicBool;

pub use bits::{BinaryShafts, BitSet, Coverage, SparseCandidates};
pub use candidates::CandidateRules;
pub(crate) use candidates::CandidateTriangle;
pub use cell_spaces::{CellSpaceParams, CellSpaces};
pub use classes::{Class, ClassTable, ClassTree};
pub use gate::GateCounters;
pub(crate) use gate::{Gates, Verdict, chance};
pub use mask::MAX_MASK_N;
pub(crate) use mask::{AtlasParams, MaskAtlas};
pub(crate) use nodes::NodeSpace;
pub use nodes::{MAX_NODE_DEPTH, MIN_NODE_PRIMITIVES, NodeSpaceParams, NodeSpaces};
pub use params::{BinaryBuilder, CastPattern, ClassLayout, LineSpaceParams, Payload};
pub use shaft::{Chord, Location, Patch, ShaftGrid};
pub use surface::{Evidence, SurfaceShaftParams, SurfaceShafts};
pub(crate) use worth::{pays, pays_in_cells};

/// What builders on other devices share with those here.
pub(crate) mod parts {
    pub(crate) use super::bits::NO_CANDIDATE;
    pub(crate) use super::cast::Caster;
    pub(crate) use super::layered::{Classifier, middle};
    pub(crate) use super::nodes::Below;
    pub(crate) use super::shaft::{DILATION, directed_count, directed_patches, symmetric_count, symmetric_patches};
    pub(crate) use super::voxels::{Rasterizer, Voxels, lattice, rim_edges};
}

use super::{BuildError, CorruptStructure, MeshStructure, StructureKey};
use crate::scene::{Mesh, MeshHash};

/// Changes whenever a builder or the stored layout changes: old cache entries are then simply not found.
pub const LINE_SPACE_VERSION: u32 = 2;

/// What is stored for the shafts of a box.
#[derive(Clone, Debug, PartialEq)]
pub enum Shafts {
    Binary(BinaryShafts),
    Candidates(SparseCandidates),
    Table(ClassTable),
    Tree(ClassTree),
    Coverage(Coverage),
}

impl Shafts {
    /// A tree of classes in the layout that is asked for.
    pub(crate) fn of_classes(layout: ClassLayout, tree: ClassTree) -> Self {
        match layout {
            ClassLayout::Tree => Self::Tree(tree),
            ClassLayout::Table => Self::Table(ClassTable::from_fn(tree.n(), |index| {
                let (a, b) = shaft::symmetric_patches(tree.n(), index);
                tree.class(a, b)
            })),
        }
    }

    /// Memory, in bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Binary(binary) => size_of_val(binary.bits().words()),
            Self::Candidates(candidates) => candidates.bytes(),
            Self::Table(table) => table.bytes(),
            Self::Tree(tree) => tree.bytes(),
            Self::Coverage(coverage) => coverage.bytes(),
        }
    }
}

/// The Line Space of one mesh's root box. Immutable; share it in an [`std::sync::Arc`].
#[derive(Clone, Debug, PartialEq)]
pub struct LineSpace {
    mesh: MeshHash,
    params: LineSpaceParams,
    /// None for a mesh whose box single precision cannot divide (see [`ShaftGrid::new`]): nothing is known of its rays.
    content: Option<(ShaftGrid, Shafts)>,
}

impl LineSpace {
    /// Builds with rayon's current pool; looks at `cancel` often enough to stop within 100 ms (but for single primitives
    /// that fill the box).
    ///
    /// `structure` is any structure over `mesh`: it finds hits, but does not change what is built.
    ///
    /// # Errors
    /// [`BuildError::Unsupported`] for parameters out of range, and with the figure when it may take more than
    /// `budget_bytes`.
    pub fn build(
        mesh: &Mesh,
        structure: &MeshStructure,
        params: &LineSpaceParams,
        budget_bytes: u64,
        cancel: &AtomicBool,
    ) -> Result<Self, BuildError> {
        let Some(grid) = params.grid_within(structure, budget_bytes)? else {
            return Ok(Self::new(mesh, params, None));
        };
        let shafts = match params.payload {
            Payload::Classes { layout, resolution } => {
                let root_n = params.n >> params.class_levels();
                Shafts::of_classes(layout, layered::build(mesh, structure, &grid, root_n, resolution, cancel)?)
            }
            Payload::Binary { .. } | Payload::Candidates { .. } | Payload::Coverage { .. } => {
                nodes::shafts(mesh, &nodes::Below::root(structure), &grid, params, cancel)?
            }
        };
        Ok(Self::new(mesh, params, Some((grid, shafts))))
    }

    /// `content` is of `mesh` and `params`; none where [`LineSpaceParams::grid_within`] gives no grid.
    pub(crate) fn new(mesh: &Mesh, params: &LineSpaceParams, content: Option<(ShaftGrid, Shafts)>) -> Self {
        Self { mesh: mesh.hash, params: *params, content }
    }

    /// The mesh that it was built for.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    pub fn params(&self) -> &LineSpaceParams {
        &self.params
    }

    /// The grid of patches; None where nothing is known of any ray.
    pub fn grid(&self) -> Option<&ShaftGrid> {
        self.content.as_ref().map(|(grid, _)| grid)
    }

    /// What is stored; None where nothing is known of any ray.
    pub fn shafts(&self) -> Option<&Shafts> {
        self.content.as_ref().map(|(_, shafts)| shafts)
    }

    /// The class of a shaft between two patches on different faces; [`Class::Mixed`] with another payload.
    pub fn class(&self, a: Patch, b: Patch) -> Class {
        match self.shafts() {
            Some(Shafts::Table(table)) => table.class(a, b),
            Some(Shafts::Tree(tree)) => tree.class(a, b),
            _ => Class::Mixed,
        }
    }

    /// Memory that it takes, in bytes.
    pub fn bytes(&self) -> usize {
        self.shafts().map_or(0, Shafts::bytes)
    }

    /// The stored form: header, checksum, parameters, little-endian words.
    pub fn encode(&self) -> Vec<u8> {
        store::encode(self)
    }

    /// Reads what [`Self::encode`] wrote for `mesh` with `params`. Checks header, version, checksum, mesh, parameters, and
    /// every number of the payload before anything is made of it.
    pub fn decode(
        bytes: &[u8],
        mesh: &Mesh,
        structure: &MeshStructure,
        params: &LineSpaceParams,
    ) -> Result<Self, CorruptStructure> {
        store::decode(bytes, mesh, structure, params).map_err(CorruptStructure)
    }
}

impl LineSpaceParams {
    /// The grid of a mesh's root box; none for one that single precision cannot divide.
    ///
    /// # Errors
    /// [`BuildError::Unsupported`] for parameters out of range, and with the figure when the Line Space may take more than
    /// `budget_bytes`.
    pub(crate) fn grid_within(
        &self,
        structure: &MeshStructure,
        budget_bytes: u64,
    ) -> Result<Option<ShaftGrid>, BuildError> {
        self.check().map_err(BuildError::Unsupported)?;
        let needed = self.bytes_at_most();
        if needed > budget_bytes {
            return Err(BuildError::Unsupported(format!(
                "the line space of a mesh ({}) may take {needed} bytes; the budget is {budget_bytes}",
                self.canonical()
            )));
        }
        Ok(ShaftGrid::new(&structure.bvh2().bounds(), self.n))
    }

    /// The key of a mesh's Line Space in every cache.
    pub fn key(&self, mesh: MeshHash) -> StructureKey {
        StructureKey { mesh, kind: "line_space", parameters: self.canonical(), builder_version: LINE_SPACE_VERSION }
    }
}
