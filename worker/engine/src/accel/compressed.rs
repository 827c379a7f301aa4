//! The tree that GPUs walk: a compressed 8-wide BVH.
//!
//! Nodes are those of Ylitie, Karras and Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide
//! BVHs" (HPG 2017), section 3: 80 bytes, child boxes quantised to 8 bits in the node's own frame, children placed in
//! slots so that `slot ^ octant` visits them roughly front to back. One stack entry stands for all the hit children of
//! a node, so a traversal never needs more entries than the tree is deep; [`CompressedBvh::depth`] sizes the kernel's
//! stack.
//!
//! Which nodes of the binary tree become children is chosen at build time as for the CPU's tree, with leaves of three
//! primitives at most, and stored with the structure ([`Roles`](super::Roles)); free slots go to smaller boxes.
//!
//! Meshes and the top level share the node format; in the top level a leaf entry is an instance.

use std::ops::Range;
use std::sync::atomic::AtomicBool;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::BuildError;
use super::bvh2::{Bvh2, Bvh2Node};
use super::wide::{self, Role};
use crate::scene::Aabb;

/// Primitives that one leaf slot may hold: the three unary bits of its meta byte.
const MAX_LEAF: u32 = 3;
const WIDTH: usize = 8;
/// Subtrees that are compressed at once, and the fewest primitives for which that pays.
const PARTS: usize = 64;
const MIN_PART: u32 = 4096;

/// The layout that `shaders/shared/traverse.wgsl` reads as five `vec4<u32>`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct CompressedNode {
    /// Corner of the frame in which child boxes are quantised.
    pub origin: [f32; 3],
    /// Biased exponents of the frame's scale in bytes 0 to 2; byte 3: bit `s` is set when slot `s` is an inner child.
    pub exponents_and_inner: u32,
    /// Number of the first inner child; the others follow in slot order.
    pub child_base: u32,
    /// First leaf entry; the slots' entries follow one after the other.
    pub leaf_base: u32,
    /// Per slot: 0 if empty; inner: `0b001` above `24 + slot`; leaf: one to three bits above the offset of its entries.
    pub meta: [u8; 8],
    pub low: [[u8; 8]; 3],
    pub high: [[u8; 8]; 3],
}
const _: () = assert!(size_of::<CompressedNode>() == 80);

impl CompressedNode {
    /// The node, where its tree's nodes and leaf entries stand that much farther back.
    pub(crate) fn moved(mut self, nodes: u32, leaves: u32) -> Self {
        self.child_base += nodes;
        self.leaf_base += leaves;
        self
    }
}

/// A wide tree. Node and leaf numbers are relative to the tree.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct CompressedBvh {
    /// Node 0 is the root; empty for a tree without primitives.
    pub nodes: Vec<CompressedNode>,
    /// Primitive numbers in leaf order.
    pub leaves: Vec<u32>,
    /// Levels of nodes: the most stack entries that a walk can need.
    pub depth: u32,
}

impl CompressedBvh {
    /// What the nodes of a tree over a mesh are to become.
    pub(super) fn choose(bvh2: &Bvh2, cancel: &AtomicBool) -> Result<Vec<Role>, BuildError> {
        wide::choose(bvh2, MAX_LEAF, &|primitives: &[u32]| primitives.len() as u32, cancel)
    }

    /// `bounds` gives a primitive's box, to split leaves of more than three.
    pub(super) fn new(tree: &Bvh2, roles: &[Role], bounds: &(dyn Fn(u32) -> Aabb + Sync)) -> Self {
        if tree.nodes.is_empty() {
            return Self::default();
        }
        let source = Source { tree, roles, ranges: primitive_ranges(tree), bounds };
        let mut whole = Self { nodes: vec![CompressedNode::default()], ..Self::default() };
        // Level by level, until there are subtrees enough for all threads.
        let mut parts = vec![Place { node: 0, subtree: source.node(0), level: 1 }];
        while parts.len() < PARTS && parts.iter().any(Place::is_big) {
            parts = parts
                .into_iter()
                .flat_map(|place| if place.is_big() { whole.fill(&place, &source) } else { vec![place] })
                .collect();
        }
        let trees: Vec<Self> = parts.par_iter().with_max_len(1).map(|part| source.compress(part)).collect();
        for (part, tree) in parts.iter().zip(trees) {
            whole.graft(part, tree);
        }
        whole
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.leaves.as_slice())
    }

    /// Puts a subtree's tree in its place.
    fn graft(&mut self, part: &Place, tree: Self) {
        // Its root stands elsewhere, so the others move up by one.
        let (nodes, leaves) = ((self.nodes.len() as u32).wrapping_sub(1), self.leaves.len() as u32);
        let mut moved = tree.nodes.into_iter().map(|mut node| {
            node.child_base = node.child_base.wrapping_add(nodes);
            node.leaf_base += leaves;
            node
        });
        if let Some(root) = moved.next() {
            self.nodes[part.node as usize] = root;
        }
        self.nodes.extend(moved);
        self.leaves.extend(tree.leaves);
        self.depth = self.depth.max(tree.depth);
    }

    /// Writes the node over a subtree and answers its inner children, whose nodes it has reserved.
    fn fill(&mut self, place: &Place, source: &Source<'_>) -> Vec<Place> {
        self.depth = self.depth.max(place.level);
        let children = source.open(&place.subtree);
        let slots = assign_slots(place.subtree.bounds, &children);
        let frame = Frame::new(place.subtree.bounds);
        let mut node = CompressedNode {
            origin: frame.origin,
            exponents_and_inner: frame.exponents,
            child_base: self.nodes.len() as u32,
            leaf_base: self.leaves.len() as u32,
            ..CompressedNode::default()
        };
        let mut inner = Vec::new();
        for (slot, child) in slots.into_iter().enumerate() {
            let Some(child) = child.map(|i| &children[i]) else { continue };
            for axis in 0..3 {
                (node.low[axis][slot], node.high[axis][slot]) = frame.quantise(axis, child.bounds);
            }
            if !child.is_leaf {
                node.exponents_and_inner |= 1 << (24 + slot);
                node.meta[slot] = 0b0010_0000 | (24 + slot as u8);
                inner.push(Place { node: self.nodes.len() as u32, subtree: child.clone(), level: place.level + 1 });
                self.nodes.push(CompressedNode::default());
            } else {
                let offset = self.leaves.len() as u32 - node.leaf_base;
                let unary = (1u8 << child.count()) - 1;
                node.meta[slot] = (unary << 5) | offset as u8;
                self.leaves.extend_from_slice(source.primitives(child));
            }
        }
        self.nodes[place.node as usize] = node;
        inner
    }
}

/// A node that is still to be written.
#[derive(Clone, Debug)]
struct Place {
    node: u32,
    subtree: Subtree,
    /// The root is on the first.
    level: u32,
}

impl Place {
    fn is_big(&self) -> bool {
        self.subtree.count() >= MIN_PART
    }
}

/// A part of the binary tree that becomes one slot.
#[derive(Clone, Debug)]
struct Subtree {
    /// The binary node; none for a part of a leaf too big for a slot.
    node: Option<u32>,
    bounds: Aabb,
    /// In [`Bvh2::primitives`].
    primitives: Range<u32>,
    /// At most [`MAX_LEAF`] primitives, to be tested without further boxes.
    is_leaf: bool,
}

impl Subtree {
    fn count(&self) -> u32 {
        self.primitives.end - self.primitives.start
    }
}

struct Source<'a> {
    tree: &'a Bvh2,
    roles: &'a [Role],
    /// Which primitives lie below each node.
    ranges: Vec<Range<u32>>,
    bounds: &'a (dyn Fn(u32) -> Aabb + Sync),
}

impl Source<'_> {
    /// The tree over a part of this one: its root is node 0.
    fn compress(&self, part: &Place) -> CompressedBvh {
        let mut tree = CompressedBvh { nodes: vec![CompressedNode::default()], ..CompressedBvh::default() };
        let mut pending = vec![Place { node: 0, ..part.clone() }];
        while let Some(place) = pending.pop() {
            pending.extend(tree.fill(&place, self));
        }
        tree
    }

    fn node(&self, index: u32) -> Subtree {
        let primitives = self.ranges[index as usize].clone();
        let bounds = self.tree.nodes[index as usize].bounds();
        let mut subtree = Subtree { node: Some(index), bounds, primitives, is_leaf: false };
        subtree.is_leaf = subtree.count() <= MAX_LEAF && !self.is_wide(&subtree);
        subtree
    }

    fn run(&self, primitives: Range<u32>) -> Subtree {
        let entries = &self.tree.primitives[primitives.start as usize..primitives.end as usize];
        let bounds = entries.iter().fold(Aabb::EMPTY, |b, &p| b.union((self.bounds)(p)));
        let is_leaf = primitives.len() as u32 <= MAX_LEAF;
        Subtree { node: None, bounds, primitives, is_leaf }
    }

    /// Up to eight parts of a subtree: those that were chosen. While slots are left over, the largest leaf of more than
    /// three primitives is opened, and then any leaf: smaller boxes for their primitives are tested at no cost.
    fn open(&self, subtree: &Subtree) -> Vec<Subtree> {
        let mut parts = Vec::with_capacity(WIDTH);
        match subtree.node {
            Some(index) if self.is_wide(subtree) => {
                wide::for_each_slot(self.tree, self.roles, index, &mut |child| parts.push(self.node(child)));
            }
            // A tree of one primitive has an empty half.
            _ => parts.extend(self.split(subtree).into_iter().filter(|part| part.count() > 0)),
        }
        while parts.len() < WIDTH {
            let largest = |leaves: bool| {
                (0..parts.len())
                    .filter(|&i: &usize| parts[i].is_leaf == leaves && parts[i].count() > 1 && !self.is_wide(&parts[i]))
                    .max_by(|&a, &b| half_area(parts[a].bounds).total_cmp(&half_area(parts[b].bounds)))
            };
            let Some(best) = largest(false).or_else(|| largest(true)) else { break };
            let opened = parts.swap_remove(best);
            for mut part in self.split(&opened) {
                part.is_leaf |= opened.is_leaf;
                parts.push(part);
            }
        }
        parts
    }

    /// Whether it was chosen to be a wide node.
    fn is_wide(&self, subtree: &Subtree) -> bool {
        subtree.node.is_some_and(|index| self.roles[index as usize] == Role::Node)
    }

    fn split(&self, subtree: &Subtree) -> [Subtree; 2] {
        match subtree.node.map(|index| (index, &self.tree.nodes[index as usize])) {
            Some((index, node)) if !node.is_leaf() => [self.node(index + 1), self.node(node.right_or_first)],
            _ => {
                let Range { start, end } = subtree.primitives;
                let middle = start + (end - start) / 2;
                [self.run(start..middle), self.run(middle..end)]
            }
        }
    }

    fn primitives(&self, subtree: &Subtree) -> &[u32] {
        &self.tree.primitives[subtree.primitives.start as usize..subtree.primitives.end as usize]
    }
}

/// Primitives under each node. Children come after their parent, so one pass from the back does it.
fn primitive_ranges(tree: &Bvh2) -> Vec<Range<u32>> {
    let mut ranges = vec![0..0; tree.nodes.len()];
    for (i, node) in tree.nodes.iter().enumerate().rev() {
        ranges[i] = match *node {
            Bvh2Node { count: 0, right_or_first, .. } => ranges[i + 1].start..ranges[right_or_first as usize].end,
            Bvh2Node { count, right_or_first, .. } => right_or_first..right_or_first + count,
        };
    }
    ranges
}

fn half_area(bounds: Aabb) -> f32 {
    let e = bounds.extent();
    e.x * e.y + e.y * e.z + e.z * e.x
}

/// Which child stands in which slot: greedily, the child farthest along a slot's diagonal gets it (section 3.2 of the
/// paper; bit 0 of a slot is +x, bit 1 +y, bit 2 +z).
fn assign_slots(bounds: Aabb, children: &[Subtree]) -> [Option<usize>; WIDTH] {
    let center = bounds.center();
    let mut pairs = [(0.0, 0, 0); WIDTH * WIDTH];
    for (i, child) in children.iter().enumerate() {
        let d = child.bounds.center() - center;
        for slot in 0..WIDTH {
            let sign = |bit: usize, x: f32| if slot & bit != 0 { x } else { -x };
            pairs[WIDTH * i + slot] = (sign(1, d.x) + sign(2, d.y) + sign(4, d.z), i, slot);
        }
    }
    let pairs = &mut pairs[..WIDTH * children.len()];
    pairs.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut slots = [None; WIDTH];
    let mut placed = [false; WIDTH];
    for &(_, child, slot) in &*pairs {
        if slots[slot].is_none() && !placed[child] {
            slots[slot] = Some(child);
            placed[child] = true;
        }
    }
    slots
}

/// A node's quantisation frame: plane `q` of an axis lies at `origin + q * 2^exponent`.
struct Frame {
    origin: [f32; 3],
    scale: [f64; 3],
    exponents: u32,
}

impl Frame {
    /// Part of a plane step that is kept free around every child, see [`Self::quantise`].
    const SLACK: f64 = 1.0 / 64.0;

    fn new(bounds: Aabb) -> Self {
        let mut frame = Self { origin: bounds.min.to_array(), scale: [0.0; 3], exponents: 0 };
        for axis in 0..3 {
            let extent = f64::from(bounds.max[axis]) - f64::from(bounds.min[axis]);
            let mut exponent = (extent / 254.0).log2().ceil().clamp(-126.0, 127.0);
            if extent / exponent.exp2() > 254.9 {
                exponent += 1.0;
            }
            frame.scale[axis] = exponent.exp2();
            frame.exponents |= ((exponent as i32 + 127) as u32) << (8 * axis);
        }
        frame
    }

    /// Planes around the box: the node's own lower plane exactly, all others at least [`Self::SLACK`] steps away. The
    /// kernel finds a plane's distance with an error of a few units in the last place of the node's extent, and the
    /// slack is hundreds of those; the rest of the error is relative to the distance, and the kernel widens by that.
    fn quantise(&self, axis: usize, bounds: Aabb) -> (u8, u8) {
        let steps = |x: f32| (f64::from(x) - f64::from(self.origin[axis])) / self.scale[axis];
        let low = (steps(bounds.min[axis]) - Self::SLACK).floor().clamp(0.0, 255.0);
        let high = (steps(bounds.max[axis]) + Self::SLACK).ceil().clamp(0.0, 255.0);
        (low as u8, high as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::{BuildParams, MeshStructure};
    use crate::scene::Mesh;

    /// Primitive numbers under a node, each tested against the node's quantised boxes on the way down.
    fn check(tree: &CompressedBvh, node: usize, level: u32, bounds: &dyn Fn(u32) -> Aabb, found: &mut Vec<u32>) -> u32 {
        let CompressedNode { origin, exponents_and_inner, child_base, leaf_base, meta, low, high } = tree.nodes[node];
        let mut deepest = level;
        let mut inner = child_base as usize;
        for slot in 0..WIDTH {
            if meta[slot] == 0 {
                continue;
            }
            let first = found.len();
            if exponents_and_inner >> (24 + slot) & 1 == 1 {
                assert_eq!(meta[slot], 0b0010_0000 | (24 + slot as u8));
                deepest = deepest.max(check(tree, inner, level + 1, bounds, found));
                inner += 1;
            } else {
                let start = leaf_base as usize + usize::from(meta[slot] & 31);
                let count = (meta[slot] >> 5).count_ones() as usize;
                assert_eq!(meta[slot] >> 5, (1 << count) - 1);
                found.extend(&tree.leaves[start..start + count]);
            }
            assert!(found.len() > first, "an empty child");
            for axis in 0..3 {
                let scale = f64::from((exponents_and_inner >> (8 * axis) & 255) as i32 - 127).exp2();
                let plane = |q: u8| f64::from(origin[axis]) + f64::from(q) * scale;
                for bounds in found[first..].iter().map(|&primitive| bounds(primitive)) {
                    assert!(plane(low[axis][slot]) <= bounds.min[axis].into());
                    assert!(plane(high[axis][slot]) >= bounds.max[axis].into());
                }
            }
        }
        deepest
    }

    fn mesh(triangles: u32) -> Mesh {
        let mut state = 7_u32;
        let mut unit = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let mut positions = Vec::new();
        for _ in 0..triangles {
            let corner = 10.0 * glam::Vec3::new(unit(), unit(), unit());
            positions.extend([corner, corner + glam::Vec3::new(unit(), 0.0, unit()), corner + glam::Vec3::Y * unit()]);
        }
        let triangles = (0..triangles).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Mesh::of_shapes("", positions, triangles, vec![])
    }

    /// Small meshes in one go, large ones in parts that are put together.
    #[test]
    fn every_primitive_stands_once_inside_all_boxes_above() {
        for triangles in [0, 1, 2, 3, 4, 5, 9, 100, 60_000] {
            let mesh = mesh(triangles);
            let structure = MeshStructure::build(&mesh, &BuildParams::default(), &AtomicBool::new(false)).unwrap();
            let bounds = |primitive: u32| crate::accel::build::primitive_bounds(&mesh, primitive as usize);
            let tree = structure.compressed(&bounds);
            let mut found = Vec::new();
            if triangles > 0 {
                assert_eq!(check(tree, 0, 1, &bounds, &mut found), tree.depth);
            }
            assert_eq!(found.len(), tree.leaves.len());
            found.sort_unstable();
            assert_eq!(found, (0..triangles).collect::<Vec<u32>>());
            assert!(tree.nodes.len() <= 1 + triangles as usize / 2, "{} nodes", tree.nodes.len());
        }
    }
}
