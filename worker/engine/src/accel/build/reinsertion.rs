//! Makes a built tree better: subtrees move to where they cost less.
//!
//! Meister, Bittner 2018, "Parallel reinsertion for bounding volume hierarchy optimization": for many nodes at once, the
//! place in the whole tree at which the node would enlarge the fewest boxes is searched by branch and bound; then those
//! moves that do not touch each other are made, the most rewarding first. The searches run in parallel on a tree that
//! does not change, and the moves are made in one fixed order: so the result does not depend on the number of threads.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::{Bounds, check};
use crate::accel::BuildError;
use crate::accel::bvh2::{Bvh2, Bvh2Node, MAX_DEPTH};

/// Every so many nodes are searched for in one round (the paper's sparse search), with another start in each.
const STRIDE: usize = 4;
/// Rounds at most; two for each node.
const MAX_ROUNDS: usize = 2 * STRIDE;
/// It ends after a round that took away less than this part of the cost.
const MIN_PROGRESS: f64 = 1e-3;
/// Nodes that one search may look at: bounds the time where all boxes overlap.
const MAX_VISITED: usize = 2048;
/// Searches between two looks at whether somebody cancelled.
const CHECKED_SEARCHES: usize = 256;

const NO_NODE: u32 = u32::MAX;

/// The same tree over the same primitives, better arranged; as it was where the better one would be too deep.
pub(super) fn optimize(tree: Bvh2, cancel: &AtomicBool) -> Result<Bvh2, BuildError> {
    if tree.nodes.len() < 5 {
        return Ok(tree);
    }
    let mut linked = LinkedTree::new(&tree);
    let mut cost = linked.cost();
    for round in 0..MAX_ROUNDS {
        let moves = linked.search_all(round % STRIDE, cancel)?;
        linked.make(&moves);
        let before = std::mem::replace(&mut cost, linked.cost());
        if cost > (1.0 - MIN_PROGRESS) * before {
            break;
        }
    }
    Ok(linked.flatten(&tree).unwrap_or(tree))
}

/// Nodes that know their parents, under the numbers that they had in the flat tree.
struct LinkedTree {
    boxes: Vec<Bounds>,
    parents: Vec<u32>,
    /// [`NO_NODE`] twice for leaves.
    children: Vec<[u32; 2]>,
}

/// `node` shall become the sibling of `to`.
#[derive(Clone, Copy)]
struct Move {
    node: u32,
    to: u32,
    /// By how much the sum of half areas falls.
    gain: f32,
}

impl LinkedTree {
    fn new(tree: &Bvh2) -> Self {
        let mut parents = vec![NO_NODE; tree.nodes.len()];
        let children: Vec<[u32; 2]> = (0_u32..)
            .zip(&tree.nodes)
            .map(|(i, node)| if node.is_leaf() { [NO_NODE; 2] } else { [i + 1, node.right_or_first] })
            .collect();
        for (i, pair) in (0_u32..).zip(&children) {
            pair.iter().filter(|&&child| child != NO_NODE).for_each(|&child| parents[child as usize] = i);
        }
        Self { boxes: tree.nodes.iter().map(Bounds::of).collect(), parents, children }
    }

    fn is_leaf(&self, node: u32) -> bool {
        self.children[node as usize][0] == NO_NODE
    }

    fn area(&self, node: u32) -> f32 {
        self.boxes[node as usize].half_area()
    }

    fn sibling(&self, node: u32) -> u32 {
        let [left, right] = self.children[self.parents[node as usize] as usize];
        if left == node { right } else { left }
    }

    /// Sum of the half areas of all inner nodes: what moves change.
    fn cost(&self) -> f64 {
        (0_u32..)
            .take(self.boxes.len())
            .filter(|&node| !self.is_leaf(node))
            .map(|node| f64::from(self.area(node)))
            .sum()
    }

    /// The best move of every [`STRIDE`]th node, the most rewarding first.
    fn search_all(&self, start: usize, cancel: &AtomicBool) -> Result<Vec<Move>, BuildError> {
        let candidates: Vec<u32> = (start..self.boxes.len()).step_by(STRIDE).map(|node| node as u32).collect();
        let found = candidates
            .par_chunks(CHECKED_SEARCHES)
            .map(|nodes| {
                check(cancel)?;
                let mut pending = Vec::with_capacity(64);
                Ok(nodes.iter().filter_map(|&node| self.search(node, &mut pending)).collect())
            })
            .collect::<Result<Vec<Vec<Move>>, BuildError>>()?;
        let mut moves = found.concat();
        moves.par_sort_unstable_by(|a, b| b.gain.total_cmp(&a.gain).then(a.node.cmp(&b.node)));
        Ok(moves)
    }

    /// Where `node` would cost the least. None for the root, its children, and a node that is best where it is.
    fn search(&self, node: u32, pending: &mut Vec<(u32, f32)>) -> Option<Move> {
        let parent = self.parents[node as usize];
        if parent == NO_NODE || self.parents[parent as usize] == NO_NODE {
            return None;
        }
        let own = self.boxes[node as usize];
        let own_area = own.half_area();
        let mut best = Move { node, to: NO_NODE, gain: 0.0 };
        let mut visited = 0;
        // Taking the node out removes its parent; farther up boxes shrink to what else they hold.
        let mut pivot = parent;
        let mut sibling = self.sibling(node);
        let mut rest = self.boxes[sibling as usize];
        let mut gain = self.area(parent);
        loop {
            pending.push((sibling, gain));
            while let Some((at, gain)) = pending.pop() {
                // Wherever it goes, the new parent there is no smaller than the node.
                if gain - own_area <= best.gain || visited == MAX_VISITED {
                    continue;
                }
                visited += 1;
                let merged = own.union(self.boxes[at as usize]).half_area();
                if gain - merged > best.gain {
                    best = Move { node, to: at, gain: gain - merged };
                }
                // Below it, this box grows.
                let below = gain - (merged - self.area(at));
                if !self.is_leaf(at) && below - own_area > best.gain {
                    pending.extend(self.children[at as usize].map(|child| (child, below)));
                }
            }
            let up = self.parents[pivot as usize];
            if up == NO_NODE {
                break;
            }
            if pivot != parent {
                rest = rest.union(self.boxes[sibling as usize]);
                gain += self.area(pivot) - rest.half_area();
            }
            sibling = self.sibling(pivot);
            pivot = up;
        }
        (best.to != NO_NODE && best.gain > 0.0).then_some(best)
    }

    /// Makes all moves of which no node was touched before.
    fn make(&mut self, moves: &[Move]) {
        let mut touched = vec![false; self.boxes.len()];
        for &Move { node, to, .. } in moves {
            let parent = self.parents[node as usize];
            let grandparent = self.parents[parent as usize];
            let new_grandparent = self.parents[to as usize];
            let sibling = self.sibling(node);
            let involved = [node, sibling, parent, grandparent, to, new_grandparent];
            if involved.iter().any(|&n| n == NO_NODE || touched[n as usize]) || self.is_below(to, node) {
                continue;
            }
            involved.iter().for_each(|&n| touched[n as usize] = true);
            self.replace_child(grandparent, parent, sibling);
            self.replace_child(new_grandparent, to, parent);
            self.children[parent as usize] = [to, node];
            self.parents[to as usize] = parent;
            self.parents[node as usize] = parent;
            self.refit_upwards(grandparent);
            self.refit_upwards(parent);
        }
    }

    /// Whether `node` is `above` or lies under it: an earlier move may have brought it there.
    fn is_below(&self, node: u32, above: u32) -> bool {
        std::iter::successors(Some(node), |&n| Some(self.parents[n as usize]).filter(|&parent| parent != NO_NODE))
            .any(|n| n == above)
    }

    fn replace_child(&mut self, parent: u32, old: u32, new: u32) {
        let children = &mut self.children[parent as usize];
        children[usize::from(children[1] == old)] = new;
        self.parents[new as usize] = parent;
    }

    fn refit_upwards(&mut self, mut node: u32) {
        while node != NO_NODE {
            let [left, right] = self.children[node as usize];
            let bounds = self.boxes[left as usize].union(self.boxes[right as usize]);
            let old = std::mem::replace(&mut self.boxes[node as usize], bounds);
            if bounds.to_arrays() == old.to_arrays() {
                break;
            }
            node = self.parents[node as usize];
        }
    }

    /// In depth-first order again, with the leaves of `tree`. None where a leaf would lie too deep.
    fn flatten(&self, tree: &Bvh2) -> Option<Bvh2> {
        let mut flat =
            Bvh2 { nodes: Vec::with_capacity(tree.nodes.len()), primitives: Vec::with_capacity(tree.primitives.len()) };
        // (node, its depth, whose right child it is)
        let mut pending = vec![(0_u32, 0, None)];
        while let Some((node, depth, right_of)) = pending.pop() {
            if depth > MAX_DEPTH {
                return None;
            }
            if let Some(parent) = right_of {
                let number = flat.nodes.len() as u32;
                let parent: &mut Bvh2Node = &mut flat.nodes[parent];
                parent.right_or_first = number;
            }
            let (bounds, old) = (self.boxes[node as usize], &tree.nodes[node as usize]);
            if old.is_leaf() {
                flat.nodes.push(bounds.leaf(flat.primitives.len(), old.count as usize));
                let range = old.right_or_first as usize..(old.right_or_first + old.count) as usize;
                flat.primitives.extend_from_slice(&tree.primitives[range]);
            } else {
                let [left, right] = self.children[node as usize];
                pending.push((right, depth + 1, Some(flat.nodes.len())));
                pending.push((left, depth + 1, None));
                flat.nodes.push(bounds.inner(0));
            }
        }
        Some(flat)
    }
}
