//! Line Spaces of an N-tree's nodes: which lines through a node meet no cell that holds anything (Keul 2020, chapter 4).
//!
//! A node with N^3 cells has N x N patches on each face and a bit for each of its 15 N^4 shafts; the bits of a node are the
//! union of the atlas' masks over its occupied cells (section 4.2.3). A ray that comes to a node knows where its line
//! enters and leaves it, so it finds its shaft with one look-up, and passes the node by when the shaft is empty. That holds
//! for any part of the line, so also for rays that start or end in the node; no answer changes.
//!
//! Shafts are grown by [`GROWTH`] of the node's edge before anything is claimed of them, which is more than a walk from cell to
//! cell may be off; levels whose nodes are too small for that have none.

use std::ops::Range;
use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::CellTree;
use crate::accel::BuildError;
use crate::accel::build::check;
use crate::accel::line_space::shaft::symmetric_count;
use crate::accel::line_space::{MAX_MASK_N, MaskAtlas};
use crate::scene::MeshHash;

/// By how much shafts grow, as a part of the node's edge.
const GROWTH: f64 = 1.0 / 256.0;
/// What a walk may be off is at most [`CellTree::growth`]; shafts grow by so many times that.
const MARGIN: f64 = 2.0;
/// A node has no Line Space when more of its shafts than this are marked: most rays would ask in vain.
const MOST_MARKED: f64 = 0.9;

/// Of a node without a Line Space.
const NONE: u32 = u32::MAX;

/// The Line Spaces of a tree's nodes. Immutable; share it in an [`std::sync::Arc`].
#[derive(Debug)]
pub struct CellShafts {
    mesh: MeshHash,
    n: u32,
    levels: Range<u32>,
    first_node: u32,
    words_per_node: usize,
    /// For each node of the levels that have Line Spaces: the number of its own, or [`NONE`].
    places: Vec<u32>,
    bits: Vec<u32>,
    marked_share: f64,
}

impl CellShafts {
    /// Levels of nodes of `tree` that can have Line Spaces, of those that are asked for.
    fn usable(tree: &CellTree, levels: &Range<u32>) -> Range<u32> {
        let is_wide = |level: u32| {
            let edge = tree.layout.cell_at(level).as_dvec3().min_element() * f64::from(tree.layout.n);
            edge * GROWTH > MARGIN * f64::from(tree.layout.growth)
        };
        let last = levels.end.min(tree.levels());
        let end =
            (levels.start..last).take_while(|&level| is_wide(level)).last().map_or(levels.start, |level| level + 1);
        levels.start.min(end)..end
    }

    /// Bytes that the Line Spaces of the nodes at some levels take at most, known before anything is allocated.
    pub fn bytes_at_most(tree: &CellTree, levels: &Range<u32>) -> u64 {
        let levels = Self::usable(tree, levels);
        let nodes = u64::from(tree.level_starts[levels.end as usize] - tree.level_starts[levels.start as usize]);
        nodes * (4 + 4 * symmetric_count(tree.layout.n).div_ceil(32))
    }

    /// Builds those of all nodes at `levels` (0 is the root), with rayon's current pool; looks at `cancel` at every node.
    ///
    /// # Errors
    /// [`BuildError::Unsupported`] for a tree whose root is not divided as its other nodes are, for an N beyond
    /// [`MAX_MASK_N`], and, with the figure, when it may take more than `budget_bytes`.
    pub fn build(
        tree: &CellTree,
        levels: Range<u32>,
        budget_bytes: u64,
        cancel: &AtomicBool,
    ) -> Result<Self, BuildError> {
        let n = tree.layout.n;
        if tree.layout.dims != [n; 3] || n > MAX_MASK_N {
            return Err(BuildError::Unsupported(format!(
                "line spaces of nodes need an N-tree with n = 2 to {MAX_MASK_N}; this has {:?} cells in its root, {n} in others",
                tree.layout.dims
            )));
        }
        let needed = Self::bytes_at_most(tree, &levels);
        if needed > budget_bytes {
            return Err(BuildError::Unsupported(format!(
                "the line spaces of an N-tree's nodes (n={n}, levels {} to {}) may take {needed} bytes; the budget is {budget_bytes}",
                levels.start, levels.end
            )));
        }
        let levels = Self::usable(tree, &levels);
        let atlas = MaskAtlas::get(n, GROWTH, cancel)?;
        let words_per_node = symmetric_count(n).div_ceil(32) as usize;
        let first_node = tree.level_starts[levels.start as usize];
        let count = tree.level_starts[levels.end as usize] - first_node;
        let most = (MOST_MARKED * symmetric_count(n) as f64) as u64;
        let spaces = (first_node..first_node + count)
            .into_par_iter()
            .map(|node| {
                check(cancel)?;
                let bits = marked(tree, &atlas, node, words_per_node);
                let marked: u64 = bits.iter().map(|word| u64::from(word.count_ones())).sum();
                Ok((marked <= most).then_some((marked, bits)))
            })
            .collect::<Result<Vec<_>, BuildError>>()?;
        let kept: Vec<&(u64, Vec<u32>)> = spaces.iter().flatten().collect();
        let shafts = kept.len() as f64 * symmetric_count(n) as f64;
        let marked_share = kept.iter().map(|(marked, _)| *marked as f64).sum::<f64>() / shafts.max(1.0);
        let mut next = 0;
        let mut place = |is_kept: bool| {
            next += u32::from(is_kept);
            if is_kept { next - 1 } else { NONE }
        };
        let places = spaces.iter().map(|space| place(space.is_some())).collect();
        let bits = kept.par_iter().flat_map_iter(|(_, bits)| bits.iter().copied()).collect();
        Ok(Self { mesh: tree.mesh, n, levels, first_node, words_per_node, places, bits, marked_share })
    }

    /// The mesh whose tree it was built for.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    /// Whether these are of the nodes of `tree`.
    pub(crate) fn fit(&self, tree: &CellTree) -> bool {
        let has_levels = (self.levels.end as usize) < tree.level_starts.len();
        has_levels
            && (self.mesh, self.n) == (tree.mesh, tree.layout.n)
            && tree.level_starts[self.levels.start as usize] == self.first_node
            && (tree.level_starts[self.levels.end as usize] - self.first_node) as usize == self.places.len()
    }

    /// Cells of a node on each axis, and patches along the edge of its faces.
    pub fn n(&self) -> u32 {
        self.n
    }

    /// Levels whose nodes may have one.
    pub fn levels(&self) -> Range<u32> {
        self.levels.clone()
    }

    /// Nodes that have one.
    pub fn count(&self) -> usize {
        self.bits.len() / self.words_per_node
    }

    /// The part of all shafts that may hold something.
    pub fn marked_share(&self) -> f64 {
        self.marked_share
    }

    /// Memory, in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.places.as_slice()) + size_of_val(self.bits.as_slice())
    }

    /// The words of a node's bits; none for a node without a Line Space.
    #[inline(always)]
    pub(crate) fn of_node(&self, node: u32) -> Option<&[u32]> {
        let place = *self.places.get(node.wrapping_sub(self.first_node) as usize)?;
        let first = place as usize * self.words_per_node;
        self.bits.get(first..first + self.words_per_node)
    }
}

/// The marks of a node: the union over its occupied cells.
fn marked(tree: &CellTree, atlas: &MaskAtlas, node: u32, words: usize) -> Vec<u32> {
    let mut bits = vec![0_u32; words];
    let level = tree.level_starts.partition_point(|&start| start <= node) as u32 - 1;
    let first = tree.layout.first_word(node);
    let occupied = &tree.words[first..first + tree.layout.node_words(level)];
    for (word, &[cells, _]) in occupied.iter().enumerate() {
        let mut rest = cells;
        while rest != 0 {
            let cell = 32 * word + rest.trailing_zeros() as usize;
            rest &= rest - 1;
            bits.iter_mut().zip(atlas.mask(cell)).for_each(|(bits, mask)| *bits |= mask);
        }
    }
    bits
}
