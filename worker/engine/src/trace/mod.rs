//! Rays, hits, and the CPU kernels that bring them together.

mod cells;
mod kernel;
mod object_ray;
mod packet;
mod simd;

use glam::Vec3;

use crate::accel::line_space::GateCounters;

pub use kernel::Kernels;
pub(crate) use kernel::{LeafVisitor, NodeSink, Sink, Way};
pub(crate) use object_ray::ObjectRay;

/// A ray segment `origin + t * direction`, `t_min < t < t_max`. The direction need not be a unit vector. A negative
/// `t_min` counts as 0; a ray with a NaN, an infinite origin or direction, or no direction hits nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    pub origin: Vec3,
    pub t_min: f32,
    pub direction: Vec3,
    pub t_max: f32,
}

impl Ray {
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, t_min: 0.0, direction, t_max: f32::INFINITY }
    }
}

/// Where a ray meets a surface. `t` is in units of the ray's direction, in world and object space alike.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub t: f32,
    /// Barycentric coordinates of vertices 1 and 2 (triangles); unused for spheres.
    pub u: f32,
    pub v: f32,
    /// Index into the scene's instances.
    pub instance: u32,
    /// Triangle index in the mesh, or `triangle_count + sphere index`.
    pub primitive: u32,
}

/// Work that one or many rays did. Kernels that test several boxes or primitives at once count all of them, used or
/// not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Boxes tested, and cells stepped through.
    pub box_tests: u64,
    pub triangle_tests: u64,
    /// Of a scene with Line Spaces.
    pub gates: GateCounters,
}

impl Counters {
    /// Adds the tests alone, of a walk that asked no gate.
    #[inline(always)]
    pub(crate) fn add_tests(&mut self, other: &Self) {
        self.box_tests += other.box_tests;
        self.triangle_tests += other.triangle_tests;
    }
}

impl Counters {
    /// Adds what a walk counts that asks the Line Spaces of nodes: a few numbers of many, for each ray.
    #[inline(always)]
    pub(crate) fn add_walk(&mut self, other: &Self) {
        self.add_tests(other);
        let (gates, other) = (&mut self.gates, &other.gates);
        gates.starts_inside += other.starts_inside;
        gates.beside += other.beside;
        gates.too_far += other.too_far;
        gates.approximated += other.approximated;
        gates.node_look_ups += other.node_look_ups;
        gates.skipped_nodes += other.skipped_nodes;
    }
}

impl std::ops::AddAssign for Counters {
    fn add_assign(&mut self, other: Self) {
        self.add_tests(&other);
        self.gates += other.gates;
    }
}
