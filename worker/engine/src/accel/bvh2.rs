//! The binary tree: what every builder makes and every device's layout is made from.
//!
//! Nodes lie in depth-first order and primitives in leaf order, so the primitives under any subtree are one
//! contiguous range of [`Bvh2::primitives`]: a device may turn any subtree into a leaf.

use glam::Vec3;
use rayon::prelude::*;

use crate::scene::Aabb;

/// No leaf lies deeper than this below the root (the root has depth 0), so a fixed stack of this many entries is
/// enough to walk any [`Bvh2`].
pub const MAX_DEPTH: u32 = 64;

/// A binary BVH, nodes in depth-first order: the left child of inner node `i` is `i + 1`. Builders make leaves of at most
/// four primitives, and of one instance in a top level.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bvh2 {
    /// Node 0 is the root; empty for a mesh without primitives.
    pub nodes: Vec<Bvh2Node>,
    /// Primitive numbers, in leaf order (with spatial splits one may stand in several leaves).
    pub primitives: Vec<u32>,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Bvh2Node {
    pub min: [f32; 3],
    /// Inner: the right child's number. Leaf: the first of its `count` entries in [`Bvh2::primitives`].
    pub right_or_first: u32,
    pub max: [f32; 3],
    /// 0 for inner nodes.
    pub count: u32,
}
const _: () = assert!(size_of::<Bvh2Node>() == 32);

impl Bvh2Node {
    pub fn is_leaf(&self) -> bool {
        self.count != 0
    }

    pub fn bounds(&self) -> Aabb {
        Aabb { min: Vec3::from_array(self.min), max: Vec3::from_array(self.max) }
    }

    fn contains(&self, other: &Self) -> bool {
        (0..3).all(|k| self.min[k] <= other.min[k] && other.max[k] <= self.max[k])
    }
}

impl Bvh2 {
    /// The root's box; empty for a tree without nodes.
    pub fn bounds(&self) -> Aabb {
        self.nodes.first().map_or(Aabb::EMPTY, Bvh2Node::bounds)
    }

    pub fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.primitives.as_slice())
    }

    /// Checks all that a walk relies on: depth-first order, leaves that cover [`Self::primitives`] from front to
    /// back, depth at most [`MAX_DEPTH`], primitive numbers below `primitive_count`. Boxes are not looked at.
    pub fn check_topology(&self, primitive_count: usize) -> Result<(), String> {
        if self.nodes.is_empty() {
            return if self.primitives.is_empty() { Ok(()) } else { Err("primitives without a node".into()) };
        }
        let mut next_primitive = 0_u64;
        // Right children that are still to come, each with its depth, the next one last.
        let mut pending: Vec<(usize, u32)> = Vec::new();
        let mut depth = 0;
        for (index, node) in self.nodes.iter().enumerate() {
            if depth > MAX_DEPTH {
                return Err(format!("node {index} lies deeper than {MAX_DEPTH}"));
            }
            if !node.is_leaf() {
                pending.push((node.right_or_first as usize, depth + 1));
                depth += 1;
                continue;
            }
            if u64::from(node.right_or_first) != next_primitive {
                return Err(format!("leaf {index} starts at {}, not {next_primitive}", node.right_or_first));
            }
            next_primitive += u64::from(node.count);
            if next_primitive > self.primitives.len() as u64 {
                return Err(format!("leaf {index} ends behind the last of {} primitives", self.primitives.len()));
            }
            let is_last = index + 1 == self.nodes.len();
            match pending.pop() {
                Some((right, right_depth)) if right == index + 1 && !is_last => depth = right_depth,
                None if is_last => {}
                _ => return Err(format!("nodes are not in depth-first order behind leaf {index}")),
            }
        }
        if !pending.is_empty() || next_primitive != self.primitives.len() as u64 {
            return Err("the tree ends early".into());
        }
        match self.primitives.iter().find(|&&primitive| primitive as usize >= primitive_count) {
            Some(primitive) => Err(format!("primitive {primitive} of {primitive_count}")),
            None => Ok(()),
        }
    }

    /// Every box finite, not inverted and inside its parent's. On a tree that fails [`Self::check_topology`] the answer
    /// means nothing.
    pub(super) fn check_boxes(&self) -> Result<(), String> {
        self.nodes.par_iter().enumerate().with_min_len(4096).try_for_each(|(index, node)| {
            let ordered = (0..3).all(|k| node.min[k] <= node.max[k]);
            if !ordered || !node.min.iter().chain(&node.max).all(|value| value.is_finite()) {
                return Err(format!("node {index} has the box {:?} to {:?}", node.min, node.max));
            }
            let children = [index + 1, node.right_or_first as usize];
            let children = if node.is_leaf() { &[][..] } else { &children };
            match children.iter().find(|&&child| self.nodes.get(child).is_none_or(|child| !node.contains(child))) {
                Some(child) => Err(format!("node {child} sticks out of its parent {index}")),
                None => Ok(()),
            }
        })
    }

    /// Depth of the deepest leaf; the root alone has depth 0.
    pub fn depth(&self) -> u32 {
        let mut pending = Vec::new();
        let (mut depth, mut deepest) = (0, 0);
        for node in &self.nodes {
            if node.is_leaf() {
                deepest = deepest.max(depth);
                depth = pending.pop().unwrap_or(0);
            } else {
                depth += 1;
                pending.push(depth);
            }
        }
        deepest
    }

    /// Expected cost of a random line against the root box: the surface area heuristic with unit costs.
    pub fn sah_cost(&self) -> f64 {
        let area = |node: &Bvh2Node| {
            let e: [f64; 3] = std::array::from_fn(|k| f64::from(node.max[k]) - f64::from(node.min[k]));
            e[0] * e[1] + e[1] * e[2] + e[2] * e[0]
        };
        let Some(root) = self.nodes.first().map(area).filter(|&a| a > 0.0) else { return 0.0 };
        self.nodes.iter().map(|node| area(node) / root * f64::from(node.count.max(1))).sum()
    }
}
