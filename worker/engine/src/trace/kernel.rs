//! The walk through a wide tree, for meshes and for the top level over them.
//!
//! The loop is single-ray: eight boxes are tested at once, the children that are met go to the stack in the node's
//! order for the ray's octant (Fuetterling et al. 2017), and what lies behind the nearest hit so far is dropped when it
//! is popped. It is written once over [`Isa`] and compiled for each instruction set.

use std::mem::MaybeUninit;
use std::ops::Range;

use super::cells::{walk_cells, walk_cells_to_nodes};
use super::object_ray::{BoxRay, ObjectRay};
use super::packet::{PacketRay, test_packet};
use super::simd::{Isa, Lanes, Portable};
use super::{Counters, Hit};
use crate::accel::bvh2::MAX_DEPTH;
use crate::accel::cells::{CellShafts, CellTree};
use crate::accel::wide::{ChildRef, Node, WIDTH, WideBvh};

/// Takes hits as they are found.
pub(crate) trait Sink {
    /// Nothing farther is of interest.
    fn t_limit(&self) -> f32;
    /// A hit in the ray's interval. True: stop the walk.
    fn offer(&mut self, hit: Hit) -> bool;
}

/// What is done with a node that a walk comes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// What is in it is looked at.
    Down,
    /// Nothing is.
    Past,
    /// The walk ends.
    Stop,
}

/// A sink that decides what is done with nodes, by their numbers.
pub(crate) trait NodeSink: Sink {
    fn node(&mut self, number: u32) -> Way;
}

/// What to do at a leaf. True: stop the walk.
pub(crate) trait LeafVisitor {
    fn visit(&mut self, entries: Range<usize>) -> bool;
    fn t_limit(&self) -> f32;
}

/// A node on the stack is replaced by at most eight children, so every level adds at most seven; a step writes whole
/// vectors, of which the last may stick out.
const STACK_SIZE: usize = (WIDTH - 1) * (MAX_DEPTH as usize + 2) + 2 * WIDTH;

/// Walks `nodes` front to back. True when the visitor stopped the walk.
///
/// `nodes` must be a tree at most [`MAX_DEPTH`] + 1 levels deep whose references are in range, as made by
/// [`crate::accel::wide`].
#[inline(always)]
fn walk<I: Isa>(
    nodes: &[Node],
    start: ChildRef,
    ray: &BoxRay<I>,
    t_min: f32,
    visitor: &mut impl LeafVisitor,
    counters: &mut Counters,
) -> bool {
    if nodes.is_empty() {
        return false;
    }
    let mut children = [const { MaybeUninit::<u32>::uninit() }; STACK_SIZE];
    let mut distances = [const { MaybeUninit::<f32>::uninit() }; STACK_SIZE];
    let children = children.as_mut_ptr().cast::<u32>();
    let distances = distances.as_mut_ptr().cast::<f32>();
    let mut size = 0;
    let mut current = start;
    let t_min = I::F8::splat(t_min);
    let mut limit = visitor.t_limit();
    let mut limits = I::F8::splat(limit);
    let mut visited_nodes = 0;
    let stopped = 'walk: loop {
        if current.is_leaf() {
            if visitor.visit(current.leaf_range()) {
                break true;
            }
            limit = visitor.t_limit();
            limits = I::F8::splat(limit);
        } else {
            visited_nodes += 1;
            // SAFETY: references in a tree are in range.
            let node = unsafe { nodes.get_unchecked(current.0 as usize) };
            let (near, far) = ray.slabs(node, t_min, limits);
            // SAFETY: the tree's depth bounds the stack, see STACK_SIZE.
            size +=
                unsafe { I::push_children(node, ray.octant_shift, near, far, children.add(size), distances.add(size)) };
            debug_assert!(size + WIDTH <= STACK_SIZE);
        }
        loop {
            if size == 0 {
                break 'walk false;
            }
            size -= 1;
            // SAFETY: entries below the old size have been written.
            let (child, distance) = unsafe { (*children.add(size), *distances.add(size)) };
            if distance <= limit {
                current = ChildRef(child);
                break;
            }
        }
    };
    counters.box_tests += (WIDTH * visited_nodes) as u64;
    stopped
}

/// Tests the packets of a mesh's leaves.
struct PacketVisitor<'a, I: Isa, S> {
    bvh: &'a WideBvh,
    ray: PacketRay<I>,
    instance: u32,
    sink: &'a mut S,
    tested: u64,
}

impl<I: Isa, S: Sink> LeafVisitor for PacketVisitor<'_, I, S> {
    #[inline(always)]
    fn visit(&mut self, entries: Range<usize>) -> bool {
        self.tested += (entries.end - entries.start) as u64;
        for entry in entries {
            // SAFETY: leaf references of a tree are in range.
            let packet = unsafe { self.bvh.packets.get_unchecked(entry) };
            let is_triangles = packet.ids[0] < self.bvh.triangle_count;
            if test_packet(packet, is_triangles, &self.ray, self.instance, self.sink) {
                return true;
            }
        }
        false
    }

    #[inline(always)]
    fn t_limit(&self) -> f32 {
        self.sink.t_limit()
    }
}

#[inline(always)]
fn walk_mesh<I: Isa, S: Sink>(
    bvh: &WideBvh,
    ray: &ObjectRay,
    instance: u32,
    sink: &mut S,
    counters: &mut Counters,
) -> bool {
    walk_mesh_from::<I, S>(bvh, &[ChildRef::ROOT], ray, instance, sink, counters)
}

/// The same of the subtrees that some references lead to. They must be those of `bvh`.
#[inline(always)]
fn walk_mesh_from<I: Isa, S: Sink>(
    bvh: &WideBvh,
    roots: &[ChildRef],
    ray: &ObjectRay,
    instance: u32,
    sink: &mut S,
    counters: &mut Counters,
) -> bool {
    let mut visitor = PacketVisitor::<I, S> { bvh, ray: PacketRay::new(ray), instance, sink, tested: 0 };
    let boxes = BoxRay::new(ray);
    let mut stopped = false;
    // No closure: it would be compiled for any CPU, and vectors would go through memory.
    for &root in roots {
        if walk::<I>(&bvh.nodes, root, &boxes, ray.t_min, &mut visitor, counters) {
            stopped = true;
            break;
        }
    }
    counters.triangle_tests += visitor.tested * crate::accel::wide::LANES as u64;
    stopped
}

#[inline(always)]
fn walk_top<I: Isa, V: LeafVisitor>(nodes: &[Node], ray: &ObjectRay, visitor: &mut V, counters: &mut Counters) -> bool {
    walk::<I>(nodes, ChildRef::ROOT, &BoxRay::new(ray), ray.t_min, visitor, counters)
}

/// The instruction set that the kernels use, chosen once when a scene is put together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernels {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Kernels {
    /// The best that this CPU can run.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if Self::has_avx2() {
            return Self::Avx2;
        }
        Self::Portable
    }

    /// For people: part of the CPU device's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "AVX2",
        }
    }

    /// All that this CPU can run.
    pub fn available() -> Vec<Self> {
        let best = Self::detect();
        if best == Self::Portable { vec![best] } else { vec![Self::Portable, best] }
    }

    #[cfg(target_arch = "x86_64")]
    fn has_avx2() -> bool {
        is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("popcnt")
            && is_x86_feature_detected!("lzcnt")
    }
}

/// Writes each kernel as a method of [`Kernels`], which runs it as it was compiled for the chosen instruction set.
macro_rules! kernels {
    ($($(#[$doc:meta])* $name:ident<$generic:ident: $bound:ident>($($arg:ident: $type:ty),* $(,)?);)*) => {
        impl Kernels {
            $(
                $(#[$doc])*
                #[inline]
                pub(crate) fn $name<$generic: $bound>(self, $($arg: $type),*) -> bool {
                    match self {
                        Self::Portable => $name::<Portable, $generic>($($arg),*),
                        #[cfg(target_arch = "x86_64")]
                        // SAFETY: `Avx2` is only made after the CPU was asked.
                        Self::Avx2 => unsafe { x86::$name($($arg),*) },
                    }
                }
            )*
        }

        #[cfg(target_arch = "x86_64")]
        mod x86 {
            use super::{
                CellShafts, CellTree, ChildRef, Counters, LeafVisitor, Node, NodeSink, ObjectRay, Sink, WideBvh,
            };
            use crate::trace::simd::Avx2;

            $(
                #[target_feature(enable = "avx2,bmi1,bmi2,popcnt,lzcnt")]
                pub(super) fn $name<$generic: $bound>($($arg: $type),*) -> bool {
                    super::$name::<Avx2, $generic>($($arg),*)
                }
            )*
        }
    };
}

kernels! {
    /// Offers the sink what `ray` (in object space) hits.
    walk_mesh<S: Sink>(bvh: &WideBvh, ray: &ObjectRay, instance: u32, sink: &mut S, counters: &mut Counters);
    /// The same of the parts of the mesh that some references into its tree lead to.
    walk_mesh_from<S: Sink>(
        bvh: &WideBvh,
        roots: &[ChildRef],
        ray: &ObjectRay,
        instance: u32,
        sink: &mut S,
        counters: &mut Counters,
    );
    /// Offers the sink what `ray` (in object space) hits in a tree of cells, past nodes that `shafts` say nothing is met in.
    walk_cells<S: Sink>(
        tree: &CellTree,
        shafts: Option<&CellShafts>,
        ray: &ObjectRay,
        instance: u32,
        sink: &mut S,
        counters: &mut Counters,
    );
    /// The same; the sink decides what is done with the nodes of one level.
    walk_cells_to_nodes<S: NodeSink>(
        tree: &CellTree,
        level: usize,
        ray: &ObjectRay,
        instance: u32,
        sink: &mut S,
        counters: &mut Counters,
    );
    /// Visits the leaves of a top level; a leaf's entries are positions in its tree's primitives.
    walk_top<V: LeafVisitor>(nodes: &[Node], ray: &ObjectRay, visitor: &mut V, counters: &mut Counters);
}
