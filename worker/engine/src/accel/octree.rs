//! The octree: cubic cells, each cut into eight until it holds few primitives (Glassner 1984, "Space subdivision for
//! fast ray tracing").

use std::sync::atomic::AtomicBool;

use super::cells::{CellTree, Layout, Limits};
use super::{BuildError, build};
use crate::scene::Mesh;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct OctreeParams {
    /// Levels of subdivision, 1 to 16; fewer where cells would become smaller than rounding allows.
    pub depth: u32,
    /// A cell with at most so many primitives is not subdivided.
    pub max_leaf: u32,
    /// The build gives up when the tree needs more; no part of the cache's key.
    pub budget_bytes: u64,
}

impl OctreeParams {
    pub(super) fn canonical(&self) -> String {
        format!("depth={},max_leaf={}", self.depth, self.max_leaf)
    }

    pub(super) fn build(&self, mesh: &Mesh, cancel: &AtomicBool) -> Result<CellTree, BuildError> {
        if !(1..=16).contains(&self.depth) {
            return Err(BuildError::Unsupported(format!("an octree of depth {}: 1 to 16 are possible", self.depth)));
        }
        let layout = Layout::new(&build::traceable_bounds(mesh), [2; 3], true, 2, self.depth)?;
        let limits = Limits { max_leaf: self.max_leaf, budget_bytes: self.budget_bytes, name: "octree" };
        CellTree::build(mesh, layout, &limits, cancel)
    }
}
