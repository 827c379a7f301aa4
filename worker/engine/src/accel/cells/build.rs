//! Builds a tree of cells from the root down, one level after the other.
//!
//! For each node of a level: which of its cells does each of its primitives meet? Pairs of cell and primitive are sorted,
//! so equal cells come together; a cell with few primitives, or of the last level, becomes a leaf, any other a node of
//! the next level. Every array is known in size before it grows, and counted against the budget first.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use super::{CellTree, LAST, LEAF, Layout, Limits};
use crate::accel::BuildError;
use crate::accel::build::{check, primitive_bounds};
use crate::accel::wide::{LANES, NO_PRIMITIVE, Packet, set_lanes};
use crate::scene::{Aabb, Mesh};

/// Primitives that one thread sorts into the root's cells at a time.
const CHUNK: usize = 4096;

/// A node that is to be filled.
struct Pending {
    first_cell: [u32; 3],
    primitives: Vec<u32>,
}

/// A node that was.
struct Filled {
    /// Index of each cell that is not empty, ascending, with what is in it.
    cells: Vec<(u32, Child)>,
    /// Entries of all leaf lists, one after the other.
    lists: Vec<u32>,
}

enum Child {
    /// Start in [`Filled::lists`].
    Leaf(u32),
    Node(Pending),
}

struct Builder<'a> {
    mesh: &'a Mesh,
    layout: Layout,
    limits: &'a Limits,
    cancel: &'a AtomicBool,
    spent_bytes: AtomicU64,
    /// The packet of each primitive; [`NO_PRIMITIVE`] where it has none.
    packet_of: Vec<u32>,
}

pub(super) fn build(mesh: &Mesh, layout: Layout, limits: &Limits, cancel: &AtomicBool) -> Result<CellTree, BuildError> {
    let mut builder = Builder { mesh, layout, limits, cancel, spent_bytes: AtomicU64::new(0), packet_of: Vec::new() };
    builder.spend_nodes(0, 1)?;
    let packets = builder.make_packets()?;
    let mut tree = CellTree::empty(mesh, layout, packets);
    let traceable = (0..mesh.primitive_count() as u32).filter(|&p| builder.packet_of[p as usize] != NO_PRIMITIVE);
    let mut level = 0;
    let mut nodes = vec![Pending { first_cell: [0; 3], primitives: traceable.collect() }];
    while !nodes.is_empty() {
        check(cancel)?;
        let first = tree.level_starts[level as usize];
        let next_first = first + nodes.len() as u32;
        tree.level_starts.push(next_first);
        let filled: Vec<Filled> =
            nodes.into_par_iter().map(|node| builder.fill(level, node)).collect::<Result<_, BuildError>>()?;
        nodes = builder.append(&mut tree, level, next_first, filled)?;
        level += 1;
        if !nodes.is_empty() {
            builder.spend_nodes(level, nodes.len())?;
        }
    }
    Ok(tree)
}

impl Builder<'_> {
    /// Counts memory before it is taken.
    fn spend(&self, bytes: u64) -> Result<(), BuildError> {
        let spent = self.spent_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if spent <= self.limits.budget_bytes {
            return Ok(());
        }
        Err(BuildError::Unsupported(format!(
            "the {} needs more than {spent} bytes, the budget is {}: raise budget_bytes, or ask for fewer cells",
            self.limits.name, self.limits.budget_bytes
        )))
    }

    fn spend_nodes(&self, level: u32, count: usize) -> Result<(), BuildError> {
        let bytes = (self.layout.node_words(level) * size_of::<[u32; 2]>()) as u64 * count as u64;
        self.spend(bytes).map_err(|error| {
            let [x, y, z] = self.layout.node_dims(level);
            BuildError::Unsupported(format!("level {level} has {count} nodes of {x} x {y} x {z} cells: {error}"))
        })
    }

    /// Four primitives of a kind that lie close to each other in each packet: in the order of a Morton curve.
    fn make_packets(&mut self) -> Result<Vec<Packet>, BuildError> {
        let count = self.mesh.primitive_count();
        self.spend(count.div_ceil(LANES) as u64 * size_of::<Packet>() as u64)?;
        let root = self.layout.lattice(0);
        let size = (root.cell * glam::DVec3::from_array(root.dims.map(f64::from))).as_vec3();
        let mut keys: Vec<(u64, u32)> = (0..count)
            .into_par_iter()
            .with_min_len(CHUNK)
            .filter_map(|primitive| {
                let bounds = primitive_bounds(self.mesh, primitive);
                let is_finite = bounds.min.is_finite() && bounds.max.is_finite();
                let is_sphere = primitive >= self.mesh.triangles.len();
                is_finite
                    .then(|| (u64::from(is_sphere) << 63 | morton(&bounds, self.layout.origin, size), primitive as u32))
            })
            .collect();
        check(self.cancel)?;
        keys.par_sort_unstable();
        let first_sphere = keys.partition_point(|&(key, _)| key >> 63 == 0);
        let (triangles, spheres) = keys.split_at(first_sphere);
        self.packet_of = vec![NO_PRIMITIVE; count];
        let mut packets: Vec<Packet> = Vec::with_capacity(count.div_ceil(LANES) + 1);
        for group in triangles.chunks(LANES).chain(spheres.chunks(LANES)) {
            let mut packet: Packet = bytemuck::Zeroable::zeroed();
            for (lane, &(_, primitive)) in group.iter().enumerate() {
                set_lanes(&mut packet, lane, primitive, self.mesh);
                self.packet_of[primitive as usize] = packets.len() as u32;
            }
            packets.push(packet);
        }
        Ok(packets)
    }

    /// Sorts a node's primitives into its cells.
    fn fill(&self, level: u32, node: Pending) -> Result<Filled, BuildError> {
        check(self.cancel)?;
        let lattice = self.layout.lattice(level);
        let range = self.layout.node_cells(level, node.first_cell);
        let [nx, ny, _] = self.layout.node_dims(level);
        let pairs_of = |primitives: &[u32]| {
            let mut pairs: Vec<u64> = Vec::new();
            for &primitive in primitives {
                let before = pairs.len();
                lattice.primitive_cells(self.mesh, primitive as usize, range, |cell| {
                    let [x, y, z] = std::array::from_fn(|k| cell[k] - node.first_cell[k]);
                    let index = (z * ny + y) * nx + x;
                    pairs.push(u64::from(index) << 32 | u64::from(primitive));
                });
                // The lists that come of them take half of it.
                if pairs.len() - before >= CHUNK {
                    check(self.cancel)?;
                }
            }
            self.spend(pairs.len() as u64 * 4)?;
            Ok(pairs)
        };
        let mut pairs = if node.primitives.len() > CHUNK {
            let parts: Vec<Vec<u64>> =
                node.primitives.par_chunks(CHUNK).map(pairs_of).collect::<Result<_, BuildError>>()?;
            let mut pairs = parts.concat();
            pairs.par_sort_unstable();
            pairs
        } else {
            pairs_of(&node.primitives)?
        };
        pairs.sort_unstable();
        let is_last = level + 1 >= self.layout.levels;
        let mut filled = Filled { cells: Vec::new(), lists: Vec::new() };
        for group in pairs.chunk_by(|a, b| a >> 32 == b >> 32) {
            let index = (group[0] >> 32) as u32;
            let primitives = group.iter().map(|&pair| pair as u32);
            let child = if is_last || group.len() <= self.limits.max_leaf as usize {
                let start = filled.lists.len();
                filled.lists.extend(primitives.map(|primitive| self.packet_of[primitive as usize]));
                filled.lists[start..].sort_unstable();
                let unique = dedup(&mut filled.lists[start..]);
                filled.lists.truncate(start + unique);
                *filled.lists.last_mut().expect("a group has pairs") |= LAST;
                Child::Leaf(start as u32)
            } else {
                let local = [index % nx, index / nx % ny, index / (nx * ny)];
                let first_cell = std::array::from_fn(|k| (node.first_cell[k] + local[k]) * self.layout.n);
                Child::Node(Pending { first_cell, primitives: primitives.collect() })
            };
            filled.cells.push((index, child));
        }
        Ok(filled)
    }

    /// Puts a level's nodes at the end of the tree; gives the nodes below, which are numbered from `next` on.
    fn append(
        &self,
        tree: &mut CellTree,
        level: u32,
        next: u32,
        filled: Vec<Filled>,
    ) -> Result<Vec<Pending>, BuildError> {
        let words_each = self.layout.node_words(level);
        let cells: usize = filled.iter().map(|node| node.cells.len()).sum();
        let entries: usize = filled.iter().map(|node| node.lists.len()).sum();
        let too_many = tree.children.len() + cells >= LEAF as usize || tree.lists.len() + entries >= LEAF as usize;
        if too_many {
            return Err(BuildError::Unsupported(format!(
                "the {} has more than 2^31 cells or entries",
                self.limits.name
            )));
        }
        self.spend(4 * cells as u64)?;
        tree.words.reserve_exact(words_each * filled.len());
        tree.children.reserve_exact(cells);
        tree.lists.reserve_exact(entries);
        let mut below = Vec::new();
        for node in filled {
            let (word_base, list_base) = (tree.words.len(), tree.lists.len() as u32);
            let mut place = tree.children.len() as u32;
            tree.words.resize(word_base + words_each, [0; 2]);
            for (index, child) in node.cells {
                tree.words[word_base + index as usize / 32][0] |= 1 << (index & 31);
                tree.children.push(match child {
                    Child::Leaf(start) => LEAF | (list_base + start),
                    Child::Node(pending) => {
                        below.push(pending);
                        next + below.len() as u32 - 1
                    }
                });
            }
            for word in &mut tree.words[word_base..] {
                word[1] = place;
                place += word[0].count_ones();
            }
            tree.lists.extend_from_slice(&node.lists);
        }
        Ok(below)
    }
}

/// Moves the distinct values of a sorted slice to its front; gives their number.
fn dedup(sorted: &mut [u32]) -> usize {
    let mut kept = 0;
    for at in 0..sorted.len() {
        if kept == 0 || sorted[kept - 1] != sorted[at] {
            sorted[kept] = sorted[at];
            kept += 1;
        }
    }
    kept
}

/// The place of a box's centre on a Morton curve of 20 bits on each axis.
fn morton(bounds: &Aabb, origin: Vec3, size: Vec3) -> u64 {
    let center = 0.5 * bounds.min + 0.5 * bounds.max;
    let at = ((center - origin) / size * (1 << 20) as f32).to_array();
    let spread = |v: f32| {
        // Three more bits between any two of the low 20.
        let mut v = (v as u64).min((1 << 20) - 1);
        v = (v | v << 32) & 0x001f_0000_0000_ffff;
        v = (v | v << 16) & 0x001f_0000_ff00_00ff;
        v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
        v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
        (v | v << 2) & 0x1249_2492_4924_9249
    };
    spread(at[0]) | spread(at[1]) << 1 | spread(at[2]) << 2
}
