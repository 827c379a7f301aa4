//! The N-tree: a recursive grid of cubic cells, each node cut into N x N x N, primitives in leaves alone (Keul 2020,
//! chapter 2.3). Between the uniform grid, which knows no empty space, and the octree, which takes many steps down.

use std::sync::atomic::AtomicBool;

use super::cells::{CellTree, Layout, Limits};
use super::{BuildError, build};
use crate::scene::Mesh;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct NTreeParams {
    /// Cells of a node on each axis, 2 to 16.
    pub n: u32,
    /// Levels of nodes, 1 to 6: the finest cells are `n^depth` on each axis. Fewer where they would become smaller than
    /// rounding allows.
    pub depth: u32,
    /// A cell with at most so many primitives is not subdivided; 0 subdivides down to `depth` everywhere.
    pub max_leaf: u32,
    /// The build gives up when the tree needs more; no part of the cache's key.
    pub budget_bytes: u64,
}

impl NTreeParams {
    pub(super) fn canonical(&self) -> String {
        format!("n={},depth={},max_leaf={}", self.n, self.depth, self.max_leaf)
    }

    pub(super) fn build(&self, mesh: &Mesh, cancel: &AtomicBool) -> Result<CellTree, BuildError> {
        if !(2..=16).contains(&self.n) || !(1..=6).contains(&self.depth) {
            return Err(BuildError::Unsupported(format!(
                "an N-tree with n = {} and depth = {}: n is 2 to 16, depth 1 to 6",
                self.n, self.depth
            )));
        }
        let layout = Layout::new(&build::traceable_bounds(mesh), [self.n; 3], true, self.n, self.depth)?;
        let limits = Limits { max_leaf: self.max_leaf, budget_bytes: self.budget_bytes, name: "N-tree" };
        CellTree::build(mesh, layout, &limits, cancel)
    }
}
