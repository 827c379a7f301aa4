//! The GPU's tree: a compressed 8-wide BVH made from a binary one on upload.
//!
//! Nodes are those of Ylitie, Karras and Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide
//! BVHs" (HPG 2017), section 3: 80 bytes, child boxes quantised to 8 bits in the node's own frame, children placed in
//! slots so that `slot ^ octant` visits them roughly front to back. One stack entry stands for all the hit children of
//! a node, so a traversal never needs more entries than the tree is deep; [`WideTree::depth`] is computed here and
//! sizes the kernel's stack.
//!
//! Meshes and the top level share the node format; in the top level a leaf entry is an instance.

use bytemuck::{Pod, Zeroable};

use crate::accel::{Bvh2, Bvh2Node};
use crate::scene::Aabb;

/// Primitives that one leaf slot may hold: the three unary bits of its meta byte.
const MAX_LEAF: u32 = 3;
const WIDTH: usize = 8;

/// The layout that `shaders/shared/traverse.wgsl` reads as five `vec4<u32>`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct WideNode {
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
const _: () = assert!(size_of::<WideNode>() == 80);

/// A wide tree. Node and leaf numbers are relative to the tree.
#[derive(Debug, Default)]
pub(super) struct WideTree {
    /// Node 0 is the root; empty for a tree without primitives.
    pub nodes: Vec<WideNode>,
    /// Primitive numbers in leaf order.
    pub leaves: Vec<u32>,
    /// Levels of nodes: the most stack entries that a walk can need.
    pub depth: u32,
}

impl WideTree {
    /// `bounds` gives a primitive's box, to split leaves of more than three.
    pub(super) fn from_bvh2(tree: &Bvh2, bounds: &dyn Fn(u32) -> Aabb) -> Self {
        let mut wide = Self::default();
        if tree.nodes.is_empty() {
            return wide;
        }
        let counts = subtree_counts(tree);
        let source = Source { tree, counts, bounds };
        wide.nodes.push(WideNode::default());
        let mut pending = vec![(0u32, source.root(), 1u32)];
        while let Some((node, subtree, level)) = pending.pop() {
            wide.depth = wide.depth.max(level);
            let inner = wide.fill(node as usize, &subtree, &source);
            pending.extend(inner.into_iter().map(|(child, subtree)| (child, subtree, level + 1)));
        }
        wide
    }

    /// Writes node `index` over `subtree` and answers its inner children, whose nodes it has reserved.
    fn fill(&mut self, index: usize, subtree: &Subtree, source: &Source<'_>) -> Vec<(u32, Subtree)> {
        let children = source.open(subtree);
        let slots = assign_slots(subtree.bounds, &children);
        let frame = Frame::new(subtree.bounds);
        let mut node = WideNode {
            origin: frame.origin,
            exponents_and_inner: frame.exponents,
            child_base: self.nodes.len() as u32,
            leaf_base: self.leaves.len() as u32,
            ..WideNode::default()
        };
        let mut inner = Vec::new();
        for (slot, child) in slots.into_iter().enumerate() {
            let Some(child) = child.map(|i| &children[i]) else { continue };
            for axis in 0..3 {
                (node.low[axis][slot], node.high[axis][slot]) = frame.quantise(axis, child.bounds);
            }
            if child.count > MAX_LEAF {
                node.exponents_and_inner |= 1 << (24 + slot);
                node.meta[slot] = 0b0010_0000 | (24 + slot as u8);
                inner.push((self.nodes.len() as u32, child.clone()));
                self.nodes.push(WideNode::default());
            } else {
                let offset = self.leaves.len() as u32 - node.leaf_base;
                let unary = (1u8 << child.count) - 1;
                node.meta[slot] = (unary << 5) | offset as u8;
                source.push_primitives(child, &mut self.leaves);
            }
        }
        self.nodes[index] = node;
        inner
    }
}

/// A part of the binary tree that becomes one slot.
#[derive(Clone, Debug)]
struct Subtree {
    root: Part,
    bounds: Aabb,
    /// Primitives below.
    count: u32,
}

#[derive(Clone, Copy, Debug)]
enum Part {
    Node(u32),
    /// Entries `first .. first + count` of a leaf too big for a slot.
    Run(u32),
}

struct Source<'a> {
    tree: &'a Bvh2,
    counts: Vec<u32>,
    bounds: &'a dyn Fn(u32) -> Aabb,
}

impl Source<'_> {
    fn root(&self) -> Subtree {
        self.node(0)
    }

    fn node(&self, index: u32) -> Subtree {
        let node = &self.tree.nodes[index as usize];
        Subtree {
            root: Part::Node(index),
            bounds: Aabb { min: node.min.into(), max: node.max.into() },
            count: self.counts[index as usize],
        }
    }

    fn run(&self, first: u32, count: u32) -> Subtree {
        let entries = &self.tree.primitives[first as usize..(first + count) as usize];
        let bounds = entries.iter().fold(Aabb::EMPTY, |b, &p| b.union((self.bounds)(p)));
        Subtree { root: Part::Run(first), bounds, count }
    }

    /// Up to eight parts of a subtree: the one with the largest surface is opened until they fill the node. Parts that
    /// fit a leaf slot come last: where slots are left over, smaller leaf boxes are tested at no cost.
    fn open(&self, subtree: &Subtree) -> Vec<Subtree> {
        let mut parts = Vec::with_capacity(WIDTH);
        // A tree of one primitive has an empty half.
        parts.extend(self.split(subtree).into_iter().filter(|part| part.count > 0));
        while parts.len() < WIDTH {
            let largest = |more_than: u32| {
                (0..parts.len())
                    .filter(|&i: &usize| parts[i].count > more_than)
                    .max_by(|&a, &b| half_area(parts[a].bounds).total_cmp(&half_area(parts[b].bounds)))
            };
            let Some(best) = largest(MAX_LEAF).or_else(|| largest(1)) else { break };
            let [a, b] = self.split(&parts.swap_remove(best));
            parts.push(a);
            parts.push(b);
        }
        parts
    }

    fn split(&self, subtree: &Subtree) -> [Subtree; 2] {
        let halves = |first: u32, count: u32| {
            let half = count / 2;
            [self.run(first, half), self.run(first + half, count - half)]
        };
        match subtree.root {
            Part::Run(first) => halves(first, subtree.count),
            Part::Node(index) => match self.tree.nodes[index as usize] {
                Bvh2Node { count: 0, right_or_first, .. } => [self.node(index + 1), self.node(right_or_first)],
                leaf => halves(leaf.right_or_first, leaf.count),
            },
        }
    }

    fn push_primitives(&self, subtree: &Subtree, out: &mut Vec<u32>) {
        let mut stack = vec![subtree.root];
        while let Some(part) = stack.pop() {
            match part {
                Part::Run(first) => {
                    out.extend_from_slice(&self.tree.primitives[first as usize..(first + subtree.count) as usize]);
                }
                Part::Node(index) => match self.tree.nodes[index as usize] {
                    Bvh2Node { count: 0, right_or_first, .. } => {
                        stack.push(Part::Node(right_or_first));
                        stack.push(Part::Node(index + 1));
                    }
                    Bvh2Node { count, right_or_first, .. } => {
                        let first = right_or_first as usize;
                        out.extend_from_slice(&self.tree.primitives[first..first + count as usize]);
                    }
                },
            }
        }
    }
}

/// Primitives under each node. Children come after their parent, so one pass from the back does it.
fn subtree_counts(tree: &Bvh2) -> Vec<u32> {
    let mut counts = vec![0; tree.nodes.len()];
    for (i, node) in tree.nodes.iter().enumerate().rev() {
        counts[i] = if node.count > 0 { node.count } else { counts[i + 1] + counts[node.right_or_first as usize] };
    }
    counts
}

fn half_area(bounds: Aabb) -> f32 {
    let e = bounds.extent();
    e.x * e.y + e.y * e.z + e.z * e.x
}

/// Which child stands in which slot: greedily, the child farthest along a slot's diagonal gets it (section 3.2 of the
/// paper; bit 0 of a slot is +x, bit 1 +y, bit 2 +z).
fn assign_slots(bounds: Aabb, children: &[Subtree]) -> [Option<usize>; WIDTH] {
    let center = bounds.center();
    let mut pairs = Vec::with_capacity(WIDTH * WIDTH);
    for (i, child) in children.iter().enumerate() {
        let d = child.bounds.center() - center;
        for slot in 0..WIDTH {
            let sign = |bit: usize, x: f32| if slot & bit != 0 { x } else { -x };
            pairs.push((sign(1, d.x) + sign(2, d.y) + sign(4, d.z), i, slot));
        }
    }
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut slots = [None; WIDTH];
    let mut placed = [false; WIDTH];
    for (_, child, slot) in pairs {
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
