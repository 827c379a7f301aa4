//! Trees of cells: the uniform grid, the octree and the N-tree are one structure with different numbers.
//!
//! A node is a box cut into equal cells; a cell is empty, a leaf (a list of primitives), or a node again. The root may
//! have any number of cells on each axis, every node below it has N on each (a *recursive grid*, Jevans and Wyvill 1989):
//! a [grid](super::grid) is a root alone, an [octree](super::octree) has N = 2, an [N-tree](super::ntree) cubic cells and
//! N up to 16. Only leaves hold primitives, and one that reaches into several cells is listed in each.
//!
//! - Cells are found empty by one bit. A node has a bit for each cell, in words of 32; beside each word stands the place
//!   of its first non-empty cell in [`CellTree::children`], so that a cell's child is found by counting bits.
//! - Nodes are numbered level by level, the children of a level in the order of their parents and cells.
//! - Leaves list *packets* of four primitives that lie close to each other, each stored once, since the kernel tests four
//!   at a time.
//! - Primitives are listed in a cell when they come closer to it than [`CellTree::growth`]: more than the rounding of a
//!   walk from cell to cell and of the primitive tests can be for rays that start within [`FAR`] extents of the scene
//!   (others are walked more carefully). So nothing is missed that a loop over all primitives would hit.

mod build;
mod check;
mod shafts;
mod store;

use std::sync::atomic::AtomicBool;

use glam::Vec3;

pub(crate) use shafts::NodeMarks;
pub use shafts::{CellShaftParams, CellShafts};
pub(in crate::accel) use shafts::{GROWTH, marked};

use super::overlap::{CellRange, Lattice};
use super::wide::Packet;
use super::{BuildError, CorruptStructure};
use crate::scene::{Aabb, Mesh, MeshHash};

/// Levels of nodes that any tree has at most.
pub(crate) const MAX_LEVELS: usize = 16;
/// Cells of a root on one axis.
pub const MAX_DIM: u32 = 4096;
/// Rays whose origin is farther from the tree's far side than this many extents are walked with a margin of their own.
pub(crate) const FAR: f32 = 4.0;
/// Rounding of a walk and of primitive tests, in half ulps of the distance from a ray's origin, with a factor of 2 to
/// spare: four for each of them.
pub(crate) const ROUNDING: f32 = 16.0 * (0.5 * f32::EPSILON);
/// No cell is smaller than this many times [`CellTree::growth`]: finer ones would list little but neighbours.
const MIN_CELL: f32 = 4.0;

/// In [`CellTree::children`]: the others bits are the start of a list, not the number of a node.
pub(crate) const LEAF: u32 = 1 << 31;
/// In [`CellTree::lists`]: the last of a list.
pub(crate) const LAST: u32 = 1 << 31;

/// What is cut into which cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Layout {
    /// Lowest corner of the root.
    pub origin: Vec3,
    /// Edges of the root's cells.
    pub cell: Vec3,
    pub dims: [u32; 3],
    /// Cells of all other nodes, on each axis.
    pub n: u32,
    /// Levels of nodes, 1 to [`MAX_LEVELS`].
    pub levels: u32,
    /// By how much cells are grown when primitives are sorted into them, world units.
    pub growth: f32,
}

/// When to subdivide, and when to give up.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Cells with at most so many primitives become leaves.
    pub max_leaf: u32,
    pub budget_bytes: u64,
    /// For messages: which structure it is, with its parameters.
    pub name: &'static str,
}

/// A grid, an octree or an N-tree over one mesh.
#[derive(Debug)]
pub struct CellTree {
    mesh: MeshHash,
    layout: Layout,
    /// For each 32 cells of a node: which are not empty, and the place of the first such cell's child.
    words: Vec<[u32; 2]>,
    /// A node's number, or [`LEAF`] and the start of a list.
    children: Vec<u32>,
    /// Numbers of packets; the last of each list has [`LAST`] set.
    lists: Vec<u32>,
    packets: Vec<Packet>,
    /// Primitives below this number are triangles, the others spheres.
    triangle_count: u32,
    /// First node of each level, then their number.
    level_starts: Vec<u32>,
    level_cells: [[f32; 3]; MAX_LEVELS],
    /// Reciprocals of `level_cells`.
    inverse_cells: [[f32; 3]; MAX_LEVELS],
}

/// See the fields of [`CellTree`].
#[derive(Clone, Copy)]
pub(crate) struct Arrays<'a> {
    pub words: &'a [[u32; 2]],
    pub children: &'a [u32],
    pub lists: &'a [u32],
    pub packets: &'a [Packet],
}

/// One node of a tree, as [`CellTree::for_each_node`] shows it.
#[derive(Clone, Copy, Debug)]
pub struct CellNode<'a> {
    tree: &'a CellTree,
    pub number: u32,
    /// 0 for the root.
    pub level: u32,
    /// Its lowest cell, counted in cells of this level from the root's lowest corner.
    pub first_cell: [u32; 3],
}

impl Layout {
    /// A root of `dims` cells over `bounds`, which are grown a little so that no primitive touches the border; `cubic`
    /// cells where asked for, which then may reach beyond. `levels` is cut where cells would become smaller than rounding
    /// allows.
    pub(super) fn new(bounds: &Aabb, dims: [u32; 3], cubic: bool, n: u32, levels: u32) -> Result<Self, BuildError> {
        let bounds = if bounds.is_empty() { Aabb { min: Vec3::ZERO, max: Vec3::ZERO } } else { *bounds };
        let magnitude = bounds.min.abs().max(bounds.max.abs()).max_element();
        if magnitude.is_nan() || magnitude > 1e30 {
            return Err(BuildError::Unsupported(format!(
                "the geometry reaches {magnitude:e} from the origin; cells of a grid or tree reach at most 1e30 \
                 (structure two_level has no such limit)"
            )));
        }
        // Far from the origin coordinates are coarser than the extent's rounding.
        let extent = bounds.extent().max_element().max(4.0 * f32::EPSILON * magnitude).max(1e-30);
        let growth = ROUNDING * (1.0 + FAR) * extent;
        let margin = (4.0 * growth).max(4.0 * f32::EPSILON * magnitude);
        let origin = bounds.min - margin;
        let size = bounds.max + margin - origin;
        let cells = Vec3::from_array(dims.map(|dim| dim as f32));
        let mut cell = size / cells;
        if cubic {
            cell = Vec3::splat(cell.max_element());
        }
        let cells: u64 = dims.iter().map(|&dim| u64::from(dim)).product();
        if cells >= 1 << 31 {
            return Err(BuildError::Unsupported(format!(
                "{dims:?} are {cells} cells; at most 2147483647 can be numbered"
            )));
        }
        let mut layout = Self { origin, cell, dims, n, levels: levels.clamp(1, MAX_LEVELS as u32), growth };
        while layout.levels > 1 && layout.cell_at(layout.levels - 1).min_element() < MIN_CELL * growth {
            layout.levels -= 1;
        }
        Ok(layout)
    }

    /// Edges of the cells of a level.
    pub(super) fn cell_at(&self, level: u32) -> Vec3 {
        (self.cell.as_dvec3() / f64::from(self.n).powi(level as i32)).as_vec3()
    }

    /// Cells of the node, on each axis.
    pub(super) fn node_dims(&self, level: u32) -> [u32; 3] {
        if level == 0 { self.dims } else { [self.n; 3] }
    }

    /// Words of [`CellTree::words`] that a node takes.
    pub(super) fn node_words(&self, level: u32) -> usize {
        let cells: u64 = self.node_dims(level).iter().map(|&dim| u64::from(dim)).product();
        cells.div_ceil(32) as usize
    }

    /// First word of a node.
    pub(super) fn first_word(&self, node: u32) -> usize {
        match node {
            0 => 0,
            node => self.node_words(0) + (node as usize - 1) * self.node_words(1),
        }
    }

    /// All cells of a level, of which the nodes of that level have some.
    pub(super) fn lattice(&self, level: u32) -> Lattice {
        let fine = f64::from(self.n).powi(level as i32);
        Lattice {
            origin: self.origin,
            cell: self.cell.as_dvec3() / fine,
            dims: self.dims.map(|dim| dim * self.n.pow(level)),
            growth: f64::from(self.growth),
        }
    }

    /// The cells of a node of `level` whose lowest is `first`.
    pub(super) fn node_cells(&self, level: u32, first: [u32; 3]) -> CellRange {
        let dims = self.node_dims(level);
        CellRange { first, last: std::array::from_fn(|k| first[k] + dims[k] - 1) }
    }
}

impl CellTree {
    pub(super) fn build(mesh: &Mesh, layout: Layout, limits: &Limits, cancel: &AtomicBool) -> Result<Self, BuildError> {
        build::build(mesh, layout, limits, cancel)
    }

    /// Without any nodes yet.
    fn empty(mesh: &Mesh, layout: Layout, packets: Vec<Packet>) -> Self {
        let level_cells: [[f32; 3]; MAX_LEVELS] =
            std::array::from_fn(|level| layout.cell_at((level as u32).min(layout.levels - 1)).to_array());
        Self {
            mesh: mesh.hash,
            layout,
            words: Vec::new(),
            children: Vec::new(),
            lists: Vec::new(),
            packets,
            triangle_count: mesh.triangles.len() as u32,
            level_starts: vec![0],
            level_cells,
            inverse_cells: level_cells.map(|cell| cell.map(|edge| 1.0 / edge)),
        }
    }

    /// The mesh that the tree was built over.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    /// The root's box.
    pub fn bounds(&self) -> Aabb {
        let size = self.layout.cell * Vec3::from_array(self.layout.dims.map(|dim| dim as f32));
        Aabb { min: self.layout.origin, max: self.layout.origin + size }
    }

    pub fn node_count(&self) -> usize {
        self.level_starts.last().map_or(0, |&nodes| nodes as usize)
    }

    /// Levels of nodes that there are; leaves may lie at all of them.
    pub fn levels(&self) -> u32 {
        self.level_starts.len() as u32 - 1
    }

    /// Numbers of the nodes of a level; none of one that there is not.
    pub(crate) fn nodes_at(&self, level: u32) -> std::ops::Range<u32> {
        match self.level_starts.get(level as usize..=level as usize + 1) {
            Some(&[first, end]) => first..end,
            _ => 0..0,
        }
    }

    /// Cells that are not empty, at all levels.
    pub fn occupied_cells(&self) -> usize {
        self.children.len()
    }

    /// Packets in all leaves together, each as often as it is listed.
    pub fn listed_packets(&self) -> usize {
        self.lists.len()
    }

    /// Memory that the tree takes, in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.words.as_slice())
            + size_of_val(self.children.as_slice())
            + size_of_val(self.lists.as_slice())
            + size_of_val(self.packets.as_slice())
    }

    /// Shows every node, level by level.
    pub fn for_each_node(&self, mut f: impl FnMut(CellNode<'_>)) {
        let mut level_nodes = vec![[0; 3]];
        for level in 0..self.levels() {
            let mut below = Vec::new();
            for (number, &first_cell) in (self.level_starts[level as usize]..).zip(&level_nodes) {
                let node = CellNode { tree: self, number, level, first_cell };
                node.for_each_child(|cell, child| {
                    if child & LEAF == 0 {
                        below.push(cell.map(|at| at * self.layout.n));
                    }
                });
                f(node);
            }
            level_nodes = below;
        }
    }

    /// The child of cell `index` (x fastest) of a node; none where the cell is empty.
    #[inline(always)]
    pub(crate) fn child(&self, first_word: usize, index: usize) -> Option<u32> {
        // SAFETY: nodes have a word for each 32 of their cells, and bits are set only for children that are there; both
        // hold for trees that were built, and are checked for those that were read.
        let [bits, first] = *unsafe { self.words.get_unchecked(first_word + (index >> 5)) };
        let bit = 1 << (index & 31);
        if bits & bit == 0 {
            return None;
        }
        let place = first + (bits & (bit - 1)).count_ones();
        // SAFETY: as above.
        Some(*unsafe { self.children.get_unchecked(place as usize) })
    }

    /// Numbers of the packets in the list that starts at `start`.
    #[inline(always)]
    pub(crate) fn list(&self, start: usize) -> impl Iterator<Item = u32> {
        let mut next = Some(start);
        std::iter::from_fn(move || {
            let at = next?;
            // SAFETY: every list begins inside the array and ends at an entry with `LAST`, as for `child`.
            let entry = *unsafe { self.lists.get_unchecked(at) };
            next = (entry & LAST == 0).then_some(at + 1);
            Some(entry & !LAST)
        })
    }

    /// A packet by a number from a list.
    #[inline(always)]
    pub(crate) fn packet(&self, number: u32) -> &Packet {
        // SAFETY: lists name packets that are there, as for `child`.
        unsafe { self.packets.get_unchecked(number as usize) }
    }

    pub(crate) fn origin(&self) -> Vec3 {
        self.layout.origin
    }

    pub(crate) fn growth(&self) -> f32 {
        self.layout.growth
    }

    pub(crate) fn dims(&self) -> [u32; 3] {
        self.layout.dims
    }

    /// Cells of every node but the root, on each axis.
    pub(crate) fn n(&self) -> u32 {
        self.layout.n
    }

    #[inline(always)]
    pub(crate) fn first_word(&self, node: u32) -> usize {
        self.layout.first_word(node)
    }

    /// Cell edges of each level.
    pub(crate) fn level_cells(&self) -> &[[f32; 3]; MAX_LEVELS] {
        &self.level_cells
    }

    #[inline(always)]
    pub(crate) fn inverse_cell(&self, level: usize, axis: usize) -> f32 {
        self.inverse_cells[level][axis]
    }

    /// The arrays themselves, for devices that walk them.
    pub(crate) fn arrays(&self) -> Arrays<'_> {
        let Self { words, children, lists, packets, .. } = self;
        Arrays { words, children, lists, packets }
    }

    pub(crate) fn is_triangles(&self, packet: &Packet) -> bool {
        packet.ids[0] < self.triangle_count
    }

    /// The stored form: header, checksum, little-endian arrays.
    pub fn encode(&self) -> Vec<u8> {
        store::encode(self)
    }

    /// Reads what [`Self::encode`] wrote for `mesh`. Checks header, version, checksum, mesh and every index before
    /// anything is made of it.
    pub fn decode(bytes: &[u8], mesh: &Mesh) -> Result<Self, CorruptStructure> {
        store::decode(bytes, mesh).map_err(CorruptStructure)
    }

    /// Checks that indices are in range, nodes in order, and that each primitive is listed in every cell that it meets.
    pub fn validate(&self, mesh: &Mesh) -> Result<(), String> {
        check::structure(self)?;
        check::coverage(self, mesh)
    }
}

impl CellNode<'_> {
    /// Cells on each axis.
    pub fn dims(&self) -> [u32; 3] {
        self.tree.layout.node_dims(self.level)
    }

    pub fn bounds(&self) -> Aabb {
        let lattice = self.tree.layout.lattice(self.level);
        let dims = self.dims();
        let corner = |cells: [u32; 3]| {
            let offset = glam::DVec3::from_array(cells.map(f64::from)) * lattice.cell;
            (lattice.origin.as_dvec3() + offset).as_vec3()
        };
        let last = std::array::from_fn(|k| self.first_cell[k] + dims[k]);
        Aabb { min: corner(self.first_cell), max: corner(last) }
    }

    /// Whether all of its cells are leaves or empty: the last level but one, seen from the leaves.
    pub fn has_only_leaves(&self) -> bool {
        let mut only = true;
        self.for_each_child(|_, child| only &= child & LEAF != 0);
        only
    }

    /// Which cells are not empty: bit `i & 31` of word `i / 32` for cell `i`, x running fastest.
    pub fn occupied(&self) -> impl Iterator<Item = u32> + '_ {
        let first = self.tree.layout.first_word(self.number);
        self.tree.words[first..first + self.tree.layout.node_words(self.level)].iter().map(|&[bits, _]| bits)
    }

    /// Non-empty cells, by their place among all cells of this level, with their children.
    fn for_each_child(&self, mut f: impl FnMut([u32; 3], u32)) {
        let first_word = self.tree.layout.first_word(self.number);
        let [nx, ny, _] = self.dims();
        for (word, bits) in self.occupied().enumerate() {
            let mut rest = bits;
            while rest != 0 {
                let index = 32 * word as u32 + rest.trailing_zeros();
                rest &= rest - 1;
                let local = [index % nx, index / nx % ny, index / (nx * ny)];
                let cell = std::array::from_fn(|k| self.first_cell[k] + local[k]);
                f(cell, self.tree.child(first_word, index as usize).expect("its bit is set"));
            }
        }
    }
}
