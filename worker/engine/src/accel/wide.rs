//! The 8-wide tree that the CPU walks, made from the binary one.
//!
//! Which nodes of the binary tree become children of a wide node is chosen in [`roles`]. A node keeps, for each of the eight direction octants, the order in which to visit its children
//! (Fuetterling, Lojewski, Pfreundt, Ebert 2017, "Accelerated single ray tracing for wide vector units").

mod roles;

use std::sync::atomic::AtomicBool;

use bytemuck::Zeroable;
use rayon::prelude::*;

pub(super) use self::roles::{Role, choose, for_each_slot};
use super::BuildError;
use super::build::check;
use super::bvh2::Bvh2;
use super::memory::fresh;
use crate::scene::Mesh;

pub(crate) const WIDTH: usize = 8;
/// Primitives that are tested at once.
pub(crate) const LANES: usize = 4;

/// A subtree of a mesh with more primitives never becomes a leaf.
const MAX_LEAF_PRIMITIVES: u32 = 8;

/// Eight boxes side by side. A slot that is not used has an inverted box, which no ray meets.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug, Zeroable)]
pub(crate) struct Node {
    /// Minima in x, y, z, then maxima in x, y, z.
    pub bounds: [[f32; WIDTH]; 6],
    pub children: [u32; WIDTH],
    /// Bits `3 * octant ..` of entry `i`: the slot to put on the stack as number `i`, the farthest first. Bit `k` of
    /// the octant is set when the ray's direction is negative on axis `k`.
    pub order: [u32; WIDTH],
}
const _: () = assert!(size_of::<Node>() == 256);

/// What a slot of a node refers to: another node, or a range of leaf entries (packets, or instances).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ChildRef(pub u32);

impl ChildRef {
    const LEAF: u32 = 1 << 31;
    const COUNT_SHIFT: u32 = 27;
    const MAX_COUNT: u32 = 16;
    const FIRST_MASK: u32 = (1 << Self::COUNT_SHIFT) - 1;
    pub(crate) const ROOT: Self = Self(0);
    pub(super) const UNUSED: Self = Self(u32::MAX);

    /// `count` is 1 to [`Self::MAX_COUNT`]; a `first` beyond 2^27 is refused by [`plan`].
    fn leaf(first: u32, count: u32) -> Self {
        Self(Self::LEAF | (count - 1) << Self::COUNT_SHIFT | first)
    }

    /// Stands for a leaf until its entries have their place; fewer than 2^31 - 1.
    fn to_plan(leaf: usize) -> Self {
        Self(Self::LEAF | leaf as u32)
    }

    fn planned_leaf(self) -> usize {
        (self.0 & !Self::LEAF) as usize
    }

    #[inline(always)]
    pub(crate) fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    #[inline(always)]
    pub(crate) fn leaf_range(self) -> std::ops::Range<usize> {
        let first = (self.0 & Self::FIRST_MASK) as usize;
        first..first + (self.0 >> Self::COUNT_SHIFT & 15) as usize + 1
    }
}

/// Four triangles or four spheres. Lanes that are not used repeat the last primitive under the number [`NO_PRIMITIVE`].
#[repr(C, align(32))]
#[derive(Clone, Copy, Debug, Zeroable)]
pub(crate) struct Packet {
    /// Triangles: row `3 * vertex + axis`. Spheres: centre x, y, z and radius in the first four rows.
    pub rows: [[f32; LANES]; 9],
    pub ids: [u32; LANES],
}
const _: () = assert!(size_of::<Packet>() == 160);

pub(crate) const NO_PRIMITIVE: u32 = u32::MAX;

/// A wide tree over a mesh.
#[derive(Debug)]
pub(crate) struct WideBvh {
    pub nodes: Vec<Node>,
    pub packets: Vec<Packet>,
    /// Primitives below this number are triangles, the others spheres.
    pub triangle_count: u32,
}

impl WideBvh {
    /// What the nodes of a tree over a mesh are to become.
    pub(super) fn choose(bvh2: &Bvh2, mesh: &Mesh, cancel: &AtomicBool) -> Result<Vec<Role>, BuildError> {
        choose(bvh2, MAX_LEAF_PRIMITIVES, &|primitives| packets_of(primitives, mesh), cancel)
    }

    /// The wide tree with the nodes that were chosen.
    pub(super) fn over_mesh(bvh2: &Bvh2, roles: &[Role], mesh: &Mesh, cancel: &AtomicBool) -> Result<Self, BuildError> {
        let (plan, leaves) = plan(bvh2, roles, |primitives| packets_of(primitives, mesh))?;
        check(cancel)?;
        let nodes = emit(&plan, bvh2, cancel)?;
        let mut packets = fresh(leaves.iter().map(|leaf| leaf.entries as usize).sum());
        fill_packets(&leaves, &mut packets, bvh2, mesh, cancel)?;
        Ok(Self { nodes, packets, triangle_count: mesh.triangles.len() as u32 })
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.packets.as_slice())
    }
}

/// What refers to each node of the binary tree that stands in a slot of the wide one; [`ChildRef::UNUSED`] for others.
pub(super) fn slots(bvh2: &Bvh2, roles: &[Role], mesh: &Mesh) -> Result<Vec<ChildRef>, BuildError> {
    let (nodes, _) = plan(bvh2, roles, |primitives| packets_of(primitives, mesh))?;
    let mut slots = vec![ChildRef::UNUSED; bvh2.nodes.len()];
    let filled = nodes.iter().flat_map(|node| node.sources.iter().zip(node.children));
    filled.filter(|(source, _)| **source != NO_NODE).for_each(|(&source, child)| slots[source as usize] = child);
    Ok(slots)
}

/// Packets that some primitives fill: those of spheres and of triangles are apart.
fn packets_of(primitives: &[u32], mesh: &Mesh) -> u32 {
    let is_sphere = |primitive: &&u32| **primitive as usize >= mesh.triangles.len();
    let spheres = if mesh.spheres.is_empty() { 0 } else { primitives.iter().filter(is_sphere).count() };
    (spheres.div_ceil(LANES) + (primitives.len() - spheres).div_ceil(LANES)) as u32
}

/// The wide nodes over a tree of instances.
#[derive(Debug)]
pub(super) struct WideTop {
    /// What the nodes of the binary tree are in this one.
    pub roles: Vec<Role>,
    pub nodes: Vec<Node>,
    /// The instance of each leaf entry.
    pub entries: Vec<u32>,
}

impl WideTop {
    pub(super) fn bytes(&self) -> usize {
        self.roles.len() + size_of_val(self.nodes.as_slice()) + size_of_val(self.entries.as_slice())
    }
}

pub(super) fn over_instances(bvh2: &Bvh2) -> Result<WideTop, BuildError> {
    // Each instance is entered for itself, which costs several node visits: leaves of one.
    let never = AtomicBool::new(false);
    let count = |primitives: &[u32]| primitives.len() as u32;
    let roles = choose(bvh2, 1, &count, &never)?;
    let (plan, leaves) = plan(bvh2, &roles, count)?;
    let entries = leaves.iter().flat_map(|leaf| leaf.primitives(bvh2)).copied().collect();
    let nodes = emit(&plan, bvh2, &never)?;
    Ok(WideTop { roles, nodes, entries })
}

#[derive(Clone, Copy)]
struct PlannedNode {
    /// Which binary node stands in each slot; [`NO_NODE`] for none.
    sources: [u32; WIDTH],
    children: [ChildRef; WIDTH],
}

const NO_NODE: u32 = u32::MAX;

impl PlannedNode {
    const EMPTY: Self = Self { sources: [NO_NODE; WIDTH], children: [ChildRef::UNUSED; WIDTH] };

    /// Puts a binary node into the next free slot; none where all are taken.
    fn add(&mut self, source: usize, child: ChildRef) -> Option<()> {
        let slot = self.sources.iter().position(|&source| source == NO_NODE)?;
        (self.sources[slot], self.children[slot]) = (source as u32, child);
        Some(())
    }
}

/// A subtree that became a leaf.
#[derive(Clone, Copy)]
struct Leaf {
    /// Range in [`Bvh2::primitives`].
    first: u32,
    count: u32,
    /// How many leaf entries it takes.
    entries: u32,
}

impl Leaf {
    fn primitives<'a>(&self, bvh2: &'a Bvh2) -> &'a [u32] {
        &bvh2.primitives[self.first as usize..(self.first + self.count) as usize]
    }
}

/// Whether roles make a wide tree over a tree that passed [`Bvh2::check_topology`].
pub(super) fn check_roles(bvh2: &Bvh2, roles: &[Role]) -> Result<(), BuildError> {
    plan(bvh2, roles, |_| 1).map(|_| ())
}

/// Wide nodes and leaves by their roles, in depth-first order, for a tree that passed [`Bvh2::check_topology`].
///
/// # Errors
/// [`BuildError::Unsupported`] for roles that make no wide tree, and for more leaf entries than can be numbered.
fn plan(
    bvh2: &Bvh2,
    roles: &[Role],
    entries: impl Fn(&[u32]) -> u32,
) -> Result<(Vec<PlannedNode>, Vec<Leaf>), BuildError> {
    /// Under what a node stands.
    #[derive(Clone, Copy)]
    enum Owner {
        Nothing,
        Node(usize),
        Leaf(usize),
    }
    let wrong = |index: usize| BuildError::Unsupported(format!("node {index} has the wrong role in the wide tree"));
    if roles.len() != bvh2.nodes.len() {
        return Err(BuildError::Unsupported(format!("{} roles for {} nodes", roles.len(), bvh2.nodes.len())));
    }
    let mut nodes: Vec<PlannedNode> = Vec::with_capacity(bvh2.nodes.len() / 6 + 1);
    let mut leaves: Vec<Leaf> = Vec::with_capacity(bvh2.nodes.len() / 2 + 1);
    // For each node that is still to come, the next one last.
    let mut owners = vec![Owner::Nothing];
    for (index, (node, &role)) in bvh2.nodes.iter().zip(roles).enumerate() {
        let owner = owners.pop().ok_or_else(|| wrong(index))?;
        let children_owner = match (role, owner) {
            (Role::Inside, Owner::Node(_)) if !node.is_leaf() => owner,
            (Role::Node, Owner::Nothing | Owner::Node(_)) if !node.is_leaf() => {
                let number = nodes.len();
                if let Owner::Node(parent) = owner {
                    nodes[parent].add(index, ChildRef(number as u32)).ok_or_else(|| wrong(index))?;
                }
                nodes.push(PlannedNode::EMPTY);
                Owner::Node(number)
            }
            (Role::Leaf, Owner::Nothing | Owner::Node(_)) => {
                // Only the root of a tiny tree has no node above it.
                let parent = if let Owner::Node(parent) = owner { parent } else { nodes.len() };
                nodes.resize(nodes.len().max(parent + 1), PlannedNode::EMPTY);
                nodes[parent].add(index, ChildRef::to_plan(leaves.len())).ok_or_else(|| wrong(index))?;
                leaves.push(Leaf { first: u32::MAX, count: 0, entries: 0 });
                Owner::Leaf(leaves.len() - 1)
            }
            (Role::Below, Owner::Leaf(_)) => owner,
            _ => return Err(wrong(index)),
        };
        if !node.is_leaf() {
            owners.extend([children_owner; 2]);
        } else if let Owner::Leaf(leaf) = children_owner {
            leaves[leaf].first = leaves[leaf].first.min(node.right_or_first);
            leaves[leaf].count += node.count;
        }
    }
    let leaves = number_entries(&mut nodes, leaves, |leaf| entries(leaf.primitives(bvh2)))?;
    Ok((nodes, leaves))
}

/// Gives leaves their places among the leaf entries, those of a wide node together; the leaves in that order.
fn number_entries(
    nodes: &mut [PlannedNode],
    mut leaves: Vec<Leaf>,
    entries: impl Fn(&Leaf) -> u32,
) -> Result<Vec<Leaf>, BuildError> {
    let mut ordered = Vec::with_capacity(leaves.len());
    let mut next_entry = 0_u32;
    for child in nodes.iter_mut().flat_map(|node| &mut node.children) {
        if *child == ChildRef::UNUSED || !child.is_leaf() {
            continue;
        }
        let leaf = &mut leaves[child.planned_leaf()];
        leaf.entries = entries(leaf);
        if next_entry + leaf.entries > ChildRef::FIRST_MASK || leaf.entries > ChildRef::MAX_COUNT {
            return Err(BuildError::Unsupported(format!(
                "a structure holds at most {} leaf entries, {} in one leaf",
                ChildRef::FIRST_MASK,
                ChildRef::MAX_COUNT
            )));
        }
        *child = ChildRef::leaf(next_entry, leaf.entries);
        next_entry += leaf.entries;
        ordered.push(*leaf);
    }
    Ok(ordered)
}

fn emit(plan: &[PlannedNode], bvh2: &Bvh2, cancel: &AtomicBool) -> Result<Vec<Node>, BuildError> {
    let mut nodes: Vec<Node> = fresh(plan.len());
    nodes.par_iter_mut().zip(plan).with_min_len(1024).try_for_each(|(node, planned)| {
        check(cancel)?;
        node.bounds = [
            [f32::INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
        ];
        let mut centers = [[f32::INFINITY; 3]; WIDTH];
        for (slot, &source) in planned.sources.iter().enumerate().filter(|(_, source)| **source != NO_NODE) {
            let from = &bvh2.nodes[source as usize];
            for (axis, (&low, &high)) in from.min.iter().zip(&from.max).enumerate() {
                node.bounds[axis][slot] = low;
                node.bounds[axis + 3][slot] = high;
                centers[slot][axis] = 0.5 * low + 0.5 * high;
            }
        }
        node.children = planned.children.map(|child| child.0);
        node.order = visit_order(&centers);
        Ok(())
    })?;
    Ok(nodes)
}

/// For each octant the slots from the farthest to the nearest centre, as [`Node::order`] wants them.
fn visit_order(centers: &[[f32; 3]; WIDTH]) -> [u32; WIDTH] {
    let mut order = [0; WIDTH];
    for octant in 0..8 {
        let keys: [f32; WIDTH] = centers.map(|center| {
            if center[0] == f32::INFINITY {
                return f32::INFINITY;
            }
            (0..3).map(|axis| if octant >> axis & 1 == 1 { -center[axis] } else { center[axis] }).sum()
        });
        let mut slots: [u32; WIDTH] = std::array::from_fn(|slot| slot as u32);
        // Insertion sort: stable, and fast for eight.
        for end in 1..WIDTH {
            let mut at = end;
            while at > 0 && keys[slots[at - 1] as usize] < keys[slots[at] as usize] {
                slots.swap(at - 1, at);
                at -= 1;
            }
        }
        for (entry, slot) in order.iter_mut().zip(slots) {
            *entry |= slot << (3 * octant);
        }
    }
    order
}

fn fill_packets(
    leaves: &[Leaf],
    packets: &mut [Packet],
    bvh2: &Bvh2,
    mesh: &Mesh,
    cancel: &AtomicBool,
) -> Result<(), BuildError> {
    check(cancel)?;
    if leaves.len() > 4096 {
        let (low, high) = leaves.split_at(leaves.len() / 2);
        let (low_packets, high_packets) = packets.split_at_mut(low.iter().map(|leaf| leaf.entries as usize).sum());
        let (low, high) = rayon::join(
            || fill_packets(low, low_packets, bvh2, mesh, cancel),
            || fill_packets(high, high_packets, bvh2, mesh, cancel),
        );
        return low.and(high);
    }
    let mut rest = packets.iter_mut();
    for leaf in leaves {
        let primitives = leaf.primitives(bvh2);
        for spheres in [false, true] {
            let mut lane = 0;
            let mut packet = None;
            for &primitive in primitives.iter().filter(|&&p| (p as usize >= mesh.triangles.len()) == spheres) {
                let into: &mut Packet = match packet.take() {
                    Some(packet) if lane < LANES => packet,
                    _ => {
                        lane = 0;
                        rest.next().expect("the plan counted the packets")
                    }
                };
                set_lanes(into, lane, primitive, mesh);
                lane += 1;
                packet = Some(into);
            }
        }
    }
    Ok(())
}

/// Puts a primitive into a lane and, without its number, into all lanes behind.
pub(super) fn set_lanes(packet: &mut Packet, lane: usize, primitive: u32, mesh: &Mesh) {
    let mut values = [0.0; 9];
    if let Some(triangle) = mesh.triangles.get(primitive as usize) {
        for (row, value) in triangle.iter().flat_map(|&v| mesh.positions[v as usize].to_array()).enumerate() {
            values[row] = value;
        }
    } else {
        let sphere = &mesh.spheres[primitive as usize - mesh.triangles.len()];
        values[..3].copy_from_slice(&sphere.center.to_array());
        values[3] = sphere.radius;
    }
    for (row, value) in packet.rows.iter_mut().zip(values) {
        row[lane..].fill(value);
    }
    packet.ids[lane] = primitive;
    packet.ids[lane + 1..].fill(NO_PRIMITIVE);
}
