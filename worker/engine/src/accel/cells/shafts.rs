//! Line Spaces of an N-tree's nodes: which lines through a node meet no cell that holds anything (Keul 2020, chapter 4).
//!
//! The faces of a node with N^3 cells are cut into patches that are one or several cells wide, and each shaft between two of
//! them has a bit; the bits of a node are the union of an atlas' masks over its occupied cells (section 4.2.3). A ray that comes
//! to a node knows where its line enters and leaves it, so it finds its shaft with one look-up, and passes the node by when the
//! shaft is empty. That holds for any part of the line, so also for rays that end in the node; no answer changes.
//!
//! The thesis' patches are one cell wide. Wider ones know less and take a small part of the memory: what a look-up spares are
//! steps through empty cells, so it must not miss the CPU's cache.
//!
//! Shafts are grown by [`GROWTH`] of the node's edge before anything is claimed of them, which is more than a walk from cell to
//! cell may be off; levels whose nodes are too small for that have none.

use std::ops::Range;
use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::CellTree;
use crate::accel::BuildError;
use crate::accel::build::check;
use crate::accel::line_space::shaft::{symmetric_count, symmetric_index};
use crate::accel::line_space::{AtlasParams, MAX_MASK_N, MaskAtlas, Patch};
use crate::scene::MeshHash;

/// By how much shafts grow, as a part of the node's edge.
pub(in crate::accel) const GROWTH: f64 = 1.0 / 256.0;
/// What a walk may be off is at most [`CellTree::growth`]; shafts grow by so many times that.
const MARGIN: f64 = 2.0;
/// A node has no Line Space when more of its shafts than this are marked: most rays would ask in vain.
const MOST_MARKED: f64 = 0.9;
/// Cells of a node on an axis, at most.
const MAX_CELLS: usize = 16;

/// Of a node without a Line Space.
const NONE: u32 = u32::MAX;

/// Which nodes of an N-tree have Line Spaces, and how fine they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellShaftParams {
    /// Levels of nodes below the root, from the one right below it down. The root has none: nearly all of its shafts hold something.
    pub levels: u32,
    /// Most patches along the edge of a face, 1 to [`MAX_MASK_N`]; each is a whole number of cells wide. None: two cells wide right
    /// below the root, four cells below that.
    pub patches: Option<u32>,
}

impl CellShaftParams {
    /// Cells that a patch is wide, in nodes of a level with `n` cells on each axis.
    fn width(&self, level: u32, n: u32) -> u32 {
        match self.patches {
            Some(patches) => n.div_ceil(patches.clamp(1, n)),
            None if level <= 1 => 2,
            None => 4,
        }
    }

    /// Bytes of the Line Space of one node of a level, in a tree whose nodes have `n` cells on each axis.
    pub fn bytes_of_node(&self, level: u32, n: u32) -> u64 {
        let patches = n.div_ceil(self.width(level, n));
        4 + 4 * symmetric_count(patches).div_ceil(32)
    }
}

/// The Line Spaces of a tree's nodes. Immutable; share it in an [`std::sync::Arc`].
#[derive(Debug)]
pub struct CellShafts {
    mesh: MeshHash,
    /// Cells of a node on each axis.
    n: u32,
    /// From the one right below the root down.
    levels: Vec<LevelShafts>,
}

/// Those of the nodes of one level.
#[derive(Debug)]
struct LevelShafts {
    first_node: u32,
    /// Patches along the edge of a face.
    patches: u32,
    /// Of each cell along an edge.
    patch_of: [u8; MAX_CELLS],
    words_per_node: usize,
    /// For each node: the number of its own, or [`NONE`].
    places: Vec<u32>,
    bits: Vec<u32>,
}

/// What is known of the lines through one node.
#[derive(Clone, Copy)]
pub(crate) struct NodeMarks<'a> {
    level: &'a LevelShafts,
    words: &'a [u32],
}

impl CellShafts {
    /// Levels of nodes of `tree` that have Line Spaces, when `levels` are asked for.
    fn usable(tree: &CellTree, levels: u32) -> Range<u32> {
        let is_wide = |level: &u32| {
            let edge = tree.layout.cell_at(*level).as_dvec3().min_element() * f64::from(tree.layout.n);
            edge * GROWTH > MARGIN * f64::from(tree.layout.growth)
        };
        let below_root = 1..levels.saturating_add(1).min(tree.levels());
        1..1 + below_root.take_while(is_wide).count() as u32
    }

    /// Bytes that the Line Spaces of a tree's nodes take at most, known before anything is allocated.
    pub fn bytes_at_most(tree: &CellTree, params: &CellShaftParams) -> u64 {
        let of_level =
            |level: u32| u64::from(tree.nodes_at(level).len() as u32) * params.bytes_of_node(level, tree.layout.n);
        Self::usable(tree, params.levels).map(of_level).sum()
    }

    /// Builds with rayon's current pool; looks at `cancel` at every node.
    ///
    /// # Errors
    /// [`BuildError::Unsupported`] for a tree whose root is not divided as its other nodes are, for more than [`MAX_MASK_N`]
    /// patches along an edge, and, with the figure, when it may take more than `budget_bytes`.
    pub fn build(
        tree: &CellTree,
        params: &CellShaftParams,
        budget_bytes: u64,
        cancel: &AtomicBool,
    ) -> Result<Self, BuildError> {
        let n = tree.layout.n;
        if tree.layout.dims != [n; 3] || n as usize > MAX_CELLS {
            return Err(BuildError::Unsupported(format!(
                "line spaces of nodes need an N-tree with n = 2 to {MAX_CELLS}; this has {:?} cells in its root, {n} in others",
                tree.layout.dims
            )));
        }
        if params.patches.is_some_and(|patches| !(1..=MAX_MASK_N).contains(&patches)) {
            return Err(BuildError::Unsupported(format!(
                "line spaces of an N-tree's nodes with {:?} patches along an edge: 1 to {MAX_MASK_N}",
                params.patches
            )));
        }
        let needed = Self::bytes_at_most(tree, params);
        if needed > budget_bytes {
            return Err(BuildError::Unsupported(format!(
                "the line spaces of the nodes of {} levels of an N-tree (n={n}) may take {needed} bytes; the budget is \
                 {budget_bytes}",
                params.levels
            )));
        }
        let level = |level| LevelShafts::build(tree, level, params.width(level, n), cancel);
        let levels = Self::usable(tree, params.levels).map(level).collect::<Result<_, BuildError>>()?;
        Ok(Self { mesh: tree.mesh, n, levels })
    }

    /// The mesh whose tree it was built for.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    /// Whether these are of the nodes of `tree`.
    pub(crate) fn fit(&self, tree: &CellTree) -> bool {
        let is_of = |(level, shafts): (u32, &LevelShafts)| {
            let nodes = tree.nodes_at(level);
            nodes.start == shafts.first_node && nodes.len() == shafts.places.len()
        };
        (self.mesh, self.n) == (tree.mesh, tree.layout.n) && (1..).zip(&self.levels).all(is_of)
    }

    /// Nodes that have one.
    pub fn count(&self) -> usize {
        self.levels.iter().map(LevelShafts::count).sum()
    }

    /// The part of all shafts that may hold something.
    pub fn marked_share(&self) -> f64 {
        let marked = |level: &LevelShafts| level.bits.iter().map(|word| f64::from(word.count_ones())).sum::<f64>();
        let shafts = |level: &LevelShafts| level.count() as f64 * symmetric_count(level.patches) as f64;
        self.levels.iter().map(marked).sum::<f64>() / self.levels.iter().map(shafts).sum::<f64>().max(1.0)
    }

    /// Memory, in bytes.
    pub fn bytes(&self) -> usize {
        let level = |level: &LevelShafts| size_of_val(level.places.as_slice()) + size_of_val(level.bits.as_slice());
        self.levels.iter().map(level).sum()
    }

    /// What is known of a node; none for a node without a Line Space.
    #[inline(always)]
    pub(crate) fn of_node(&self, level: usize, node: u32) -> Option<NodeMarks<'_>> {
        let level = self.levels.get(level.wrapping_sub(1))?;
        let place = *level.places.get(node.wrapping_sub(level.first_node) as usize)?;
        let first = place as usize * level.words_per_node;
        level.bits.get(first..first + level.words_per_node).map(|words| NodeMarks { level, words })
    }
}

impl LevelShafts {
    fn build(tree: &CellTree, level: u32, width: u32, cancel: &AtomicBool) -> Result<Self, BuildError> {
        let atlas = AtlasParams { cells: tree.layout.n, width, growth: GROWTH };
        let patches = atlas.patches();
        let atlas = MaskAtlas::get(&atlas, cancel)?;
        let nodes = tree.nodes_at(level);
        let first_node = nodes.start;
        let most = (MOST_MARKED * symmetric_count(patches) as f64) as u64;
        let words_per_node = symmetric_count(patches).div_ceil(32) as usize;
        let spaces = nodes
            .into_par_iter()
            .map(|node| {
                check(cancel)?;
                let bits = marked(tree, &atlas, node, level, words_per_node);
                let marked: u64 = bits.iter().map(|word| u64::from(word.count_ones())).sum();
                Ok((marked <= most).then_some(bits))
            })
            .collect::<Result<Vec<_>, BuildError>>()?;
        let mut next = 0;
        let mut place = |space: &Option<Vec<u32>>| {
            next += u32::from(space.is_some());
            if space.is_some() { next - 1 } else { NONE }
        };
        let places = spaces.iter().map(&mut place).collect();
        let bits = spaces.into_iter().flatten().flatten().collect();
        let patch_of = std::array::from_fn(|cell| (cell as u32 / width) as u8);
        Ok(Self { first_node, patches, patch_of, words_per_node, places, bits })
    }

    fn count(&self) -> usize {
        self.bits.len() / self.words_per_node
    }
}

impl NodeMarks<'_> {
    /// Whether nothing is on the lines between two faces of cells; these are named as patches one cell wide.
    #[inline(always)]
    pub(crate) fn is_empty(&self, entry: Patch, exit: Patch) -> bool {
        let of_cells = |Patch { face, u, v }: Patch| {
            let at = |cell: u32| u32::from(self.level.patch_of[cell as usize % MAX_CELLS]);
            Patch { face, u: at(u), v: at(v) }
        };
        let index = symmetric_index(self.level.patches, of_cells(entry), of_cells(exit)) as usize;
        self.words[index / 32] >> (index % 32) & 1 == 0
    }
}

/// The marks of a node: the union over its occupied cells.
pub(in crate::accel) fn marked(tree: &CellTree, atlas: &MaskAtlas, node: u32, level: u32, words: usize) -> Vec<u32> {
    let mut bits = vec![0_u32; words];
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
