//! Which nodes of the binary tree become nodes and leaves of the wide one, by dynamic programming over the surface area
//! cost (Ylitie, Karras, Laine 2017, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs", section 3).

use std::sync::atomic::AtomicBool;

use glam::Vec3A;

use super::WIDTH;
use crate::accel::BuildError;
use crate::accel::build::check;
use crate::accel::bvh2::{Bvh2, Bvh2Node};

/// Cost of a wide node's visit, in units of one packet test.
const NODE_COST: f32 = 1.0;
/// Whoever cancels is asked after so many nodes.
const CHECKED_NODES: usize = 16384;

/// What a binary node is in the wide tree.
#[repr(u8)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::accel) enum Role {
    /// Inside a wide node: only its descendants stand in slots.
    Inside = 0,
    /// In a slot that refers to a wide node of its own. So is the root, unless it is a leaf.
    Node = 1,
    /// In a slot that is a leaf with all primitives below.
    Leaf = 2,
    /// Below such a leaf.
    Below = 3,
}

impl Role {
    pub(in crate::accel) fn from_bits(bits: u8) -> Option<Self> {
        [Self::Inside, Self::Node, Self::Leaf, Self::Below].into_iter().find(|&role| role as u8 == bits)
    }
}

/// The nodes in the slots of the wide node over `node`, whose role that is, from left to right.
pub(in crate::accel) fn for_each_slot(bvh2: &Bvh2, roles: &[Role], node: u32, found: &mut impl FnMut(u32)) {
    for child in [node + 1, bvh2.nodes[node as usize].right_or_first] {
        if roles[child as usize] == Role::Inside {
            for_each_slot(bvh2, roles, child, found);
        } else {
            found(child);
        }
    }
}

/// What the dynamic programme knows of a binary node.
#[derive(Clone, Copy, Default)]
struct Choice {
    /// Cost of the cheapest forest of at most `i + 1` wide roots for this subtree.
    costs: [f32; WIDTH - 1],
    /// How many of `i + 1` roots go to the left child; 0: use one root fewer. Entry 0 is unused.
    left: [u8; WIDTH],
    is_leaf: bool,
    first: u32,
    count: u32,
}

/// The cheapest wide tree with leaves of at most `max_leaf` primitives. `entries` says how many leaf entries some
/// primitives need.
pub(in crate::accel) fn choose(
    bvh2: &Bvh2,
    max_leaf: u32,
    entries: &(impl Fn(&[u32]) -> u32 + Sync),
    cancel: &AtomicBool,
) -> Result<Vec<Role>, BuildError> {
    if bvh2.nodes.is_empty() {
        return Ok(Vec::new());
    }
    let choices = Chooser::new(bvh2, max_leaf, entries, cancel).choose()?;
    // Whatever no wide node distributes to a slot is inside of one, or below a leaf.
    let mut roles = vec![Role::Inside; bvh2.nodes.len()];
    let mut pending = vec![0_u32];
    while let Some(node) = pending.pop() {
        if choices[node as usize].is_leaf {
            roles[node as usize] = Role::Leaf;
        } else {
            roles[node as usize] = Role::Node;
            distribute(bvh2, &choices, node, WIDTH, &mut |child| pending.push(child));
        }
    }
    let mut below = Vec::new();
    for (index, node) in bvh2.nodes.iter().enumerate() {
        let is_below = below.pop().unwrap_or(false);
        if is_below {
            roles[index] = Role::Below;
        }
        if !node.is_leaf() {
            let children_are = is_below || roles[index] == Role::Leaf;
            below.extend([children_are; 2]);
        }
    }
    Ok(roles)
}

/// The dynamic programme, from the leaves up.
struct Chooser<'a, E> {
    bvh2: &'a Bvh2,
    max_leaf: u32,
    entries: &'a E,
    /// Areas are taken relative to the root, so that they do not overflow.
    scale: f32,
    cancel: &'a AtomicBool,
}

impl<'a, E: Fn(&[u32]) -> u32 + Sync> Chooser<'a, E> {
    fn new(bvh2: &'a Bvh2, max_leaf: u32, entries: &'a E, cancel: &'a AtomicBool) -> Self {
        let bounds = bvh2.bounds();
        let extent = bounds.max.as_dvec3() - bounds.min.as_dvec3();
        let scale = if extent.max_element() > 0.0 { (1.0 / extent.max_element()) as f32 } else { 1.0 };
        Self { bvh2, max_leaf, entries, scale, cancel }
    }

    fn choose(&self) -> Result<Vec<Choice>, BuildError> {
        let mut choices = vec![Choice::default(); self.bvh2.nodes.len()];
        self.choose_subtree(0, &mut choices)?;
        Ok(choices)
    }

    /// `choices` are those of the subtree's nodes, which are the nodes from `root` on.
    fn choose_subtree(&self, root: usize, choices: &mut [Choice]) -> Result<(), BuildError> {
        if choices.len() < CHECKED_NODES {
            for at in (0..choices.len()).rev() {
                choices[at] = self.choice(root + at, root, choices);
            }
            return check(self.cancel);
        }
        let right = self.bvh2.nodes[root].right_or_first as usize;
        let (low, high) = choices[1..].split_at_mut(right - root - 1);
        let (low, high) = rayon::join(|| self.choose_subtree(root + 1, low), || self.choose_subtree(right, high));
        choices[0] = self.choice(root, root, choices);
        low.and(high)
    }

    /// The choice for node `index`; `choices`, which start at node `first`, hold its children's.
    fn choice(&self, index: usize, first: usize, choices: &[Choice]) -> Choice {
        let node = &self.bvh2.nodes[index];
        let area = self.half_area(node);
        if node.is_leaf() {
            let (first, count) = (node.right_or_first, node.count);
            let cost = area * self.leaf_cost(first, count);
            return Choice { costs: [cost; WIDTH - 1], left: [0; WIDTH], is_leaf: true, first, count };
        }
        let (left, right) = (&choices[index + 1 - first], &choices[node.right_or_first as usize - first]);
        let mut choice = Choice { first: left.first, count: left.count + right.count, ..Choice::default() };
        let mut split = [0.0; WIDTH + 1];
        for (roots, cheapest) in split.iter_mut().enumerate().skip(2) {
            let (mut best, mut best_left) = (f32::INFINITY, 1);
            for to_left in 1..roots {
                let cost = left.costs[to_left - 1] + right.costs[roots - to_left - 1];
                if cost < best {
                    (best, best_left) = (cost, to_left);
                }
            }
            *cheapest = best;
            choice.left[roots - 1] = best_left as u8;
        }
        let inner_cost = split[WIDTH] + NODE_COST * area;
        choice.costs[0] = inner_cost;
        if choice.count <= self.max_leaf {
            let cost = area * self.leaf_cost(choice.first, choice.count);
            if cost <= inner_cost {
                (choice.costs[0], choice.is_leaf) = (cost, true);
            }
        }
        for (roots, &cost) in split.iter().enumerate().take(WIDTH).skip(2) {
            if cost < choice.costs[roots - 2] {
                choice.costs[roots - 1] = cost;
            } else {
                choice.costs[roots - 1] = choice.costs[roots - 2];
                choice.left[roots - 1] = 0;
            }
        }
        choice
    }

    fn leaf_cost(&self, first: u32, count: u32) -> f32 {
        (self.entries)(&self.bvh2.primitives[first as usize..(first + count) as usize]) as f32
    }

    fn half_area(&self, node: &Bvh2Node) -> f32 {
        let e = Vec3A::from_array(node.max) * self.scale - Vec3A::from_array(node.min) * self.scale;
        e.x * e.y + e.y * e.z + e.z * e.x
    }
}

/// The roots of the cheapest forest below inner node `node`, from left to right.
fn distribute(bvh2: &Bvh2, choices: &[Choice], node: u32, roots: usize, found: &mut impl FnMut(u32)) {
    let to_left = usize::from(choices[node as usize].left[roots - 1]);
    for (child, roots) in [(node + 1, to_left), (bvh2.nodes[node as usize].right_or_first, roots - to_left)] {
        let mut roots = roots;
        while roots > 1 && choices[child as usize].left[roots - 1] == 0 {
            roots -= 1;
        }
        if roots == 1 {
            found(child);
        } else {
            distribute(bvh2, choices, child, roots, found);
        }
    }
}
