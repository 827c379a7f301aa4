//! The top level: instances of structures, placed in the world.
//!
//! It is built per job, over world-space boxes that are tight: not the turned root box of a mesh, but the union of the
//! turned boxes of a cut through the upper part of its tree. A ray goes into an instance's space without being
//! normalised, so `t` means the same everywhere.

use glam::{Affine3A, DMat3, Mat3, Vec3};
use rayon::prelude::*;

use super::approximate::{Approximating, GammaSearch, InstanceWalk, Purpose, Question};
use super::bvh2::Bvh2;
use super::compressed::CompressedBvh;
use super::line_space::{Gates, Verdict};
use super::wide::{self, WideTop};
use super::{HitFilter, Placement, Structure, SurfaceStart, build};
use crate::scene::Aabb;
use crate::trace::{Counters, Hit, Kernels, LeafVisitor, ObjectRay, Ray, Sink};

/// Boxes of a mesh that bound its instances.
const CUT_SIZE: usize = 32;

/// The instances of a scene, and the tree over them.
#[derive(Debug)]
pub(super) struct TwoLevel {
    /// As many as placements were given.
    instances: Vec<Instance>,
    top: Bvh2,
    wide_top: WideTop,
    bounds: Aabb,
    /// The one instance there is, when object space is world space: the top level is then not walked.
    only: Option<u32>,
}

/// An instance as a ray meets it.
#[derive(Clone, Copy, Debug)]
struct Instance {
    /// World to object directions.
    inverse: Mat3,
    /// Taken off before `inverse` is applied: so nothing is lost far from the world's origin.
    translation: Vec3,
    structure: u32,
    filtered: bool,
}

impl TwoLevel {
    pub(super) fn build(structures: &[Structure], placements: &[Placement]) -> Self {
        let cuts: Vec<Vec<Aabb>> = structures.par_iter().map(cut).collect();
        let (instances, boxes): (Vec<Instance>, Vec<Aabb>) = placements
            .par_iter()
            .with_min_len(256)
            .map(|placement| {
                let cut = &cuts[placement.mesh as usize];
                let is_visible = is_visible(placement);
                let bounds = if is_visible { world_bounds(cut, &placement.transform) } else { Aabb::EMPTY };
                (Instance::new(placement), bounds)
            })
            .unzip();
        let top = build::build_over_boxes(&boxes, 1);
        let wide_top = wide::over_instances(&top).expect("fewer than 2^27 instances");
        let bounds = top.bounds();
        let only = match *top.primitives {
            [only] if placements[only as usize].transform == Affine3A::IDENTITY => Some(only),
            _ => None,
        };
        Self { instances, top, wide_top, bounds, only }
    }

    /// Ready to be walked.
    pub(super) fn scene<'a>(&'a self, structures: &'a [Structure], gates: &'a Gates, kernels: Kernels) -> Scene<'a> {
        Scene { top: self, structures, gates, kernels }
    }

    pub(super) fn bytes(&self) -> usize {
        self.top.bytes() + self.wide_top.bytes() + size_of_val(self.instances.as_slice())
    }

    pub(super) fn tree(&self) -> &Bvh2 {
        &self.top
    }

    /// The tree as GPUs walk it; its leaf entries are instance numbers.
    pub(super) fn compressed(&self) -> CompressedBvh {
        // Only a leaf's own box is known of the instances in it.
        let mut boxes = vec![Aabb::EMPTY; self.instances.len()];
        for leaf in self.top.nodes.iter().filter(|node| node.is_leaf()) {
            let first = leaf.right_or_first as usize;
            for &instance in &self.top.primitives[first..first + leaf.count as usize] {
                boxes[instance as usize] = leaf.bounds();
            }
        }
        CompressedBvh::new(&self.top, &self.wide_top.roles, &|instance| boxes[instance as usize])
    }
}

/// What a walk needs of the scene.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    top: &'a TwoLevel,
    structures: &'a [Structure],
    gates: &'a Gates,
    kernels: Kernels,
}

impl Scene<'_> {
    /// `ANY`: the sink stops at any hit, so that a gate may answer for it. `GATED`: there are Line Spaces to ask.
    #[inline(always)]
    pub(super) fn walk<const ANY: bool, const GATED: bool>(
        &self,
        ray: &Ray,
        filter: &dyn HitFilter,
        sink: &mut impl Sink,
        counters: &mut Counters,
    ) -> bool {
        match self.top.only {
            Some(only) => self.walk_instance::<ANY, GATED>(only, ray, ray, filter, sink, counters),
            None => self.walk_top::<ANY, GATED>(None, ray, filter, sink, counters),
        }
    }

    /// Whether any hit stops the sink, of a ray that starts on a triangle: its own mesh comes first.
    pub(super) fn walk_from(
        &self,
        start: &SurfaceStart,
        ray: &Ray,
        filter: &dyn HitFilter,
        sink: &mut impl Sink,
        counters: &mut Counters,
    ) -> bool {
        let Some(instance) = self.top.instances.get(start.instance as usize) else {
            return self.walk::<true, true>(ray, filter, sink, counters);
        };
        let object_ray = if self.top.only.is_some() { *ray } else { instance.to_object(ray, ray.t_max) };
        let verdict = match self.gates.surface(instance.structure) {
            Some(shafts) if start.is_front => shafts.verdict(&object_ray, start.triangle, &mut counters.gates.own_mesh),
            _ => Verdict::Unknown,
        };
        let stopped = match verdict {
            Verdict::Miss => false,
            // The filter may let the ray pass through what is there.
            Verdict::Hit if !instance.filtered => true,
            Verdict::Hit | Verdict::Unknown => {
                // The box says nothing of a ray that starts inside and is not known to leave.
                self.enter(start.instance, ray, &object_ray, filter, sink, counters)
            }
        };
        let is_all = self.top.only.is_some();
        stopped || (!is_all && self.walk_top::<true, true>(Some(start.instance), ray, filter, sink, counters))
    }

    /// A walk that ends at the Line Spaces of nodes, as `question` asks.
    pub(super) fn walk_nodes(
        &self,
        question: &Question<'_>,
        ray: &Ray,
        filter: &dyn HitFilter,
        sink: &mut impl Sink,
        counters: &mut Counters,
    ) -> bool {
        let counted = Counters::default();
        let mut walk = InstanceWalk { scene: *self, question, ray, filter, sink, counters: counted };
        let stopped = match self.top.only {
            Some(only) => walk.enter(only, ray),
            None => {
                let Some(world_ray) = ObjectRay::new(ray, &self.top.bounds) else { return false };
                self.kernels.walk_top(&self.top.wide_top.nodes, &world_ray, &mut walk, counters)
            }
        };
        counters.add_walk(&walk.counters);
        stopped
    }

    /// The largest gamma of the objects that a ray comes to.
    pub(super) fn largest_gamma(&self, approximating: &Approximating, purpose: Purpose, ray: &Ray) -> f32 {
        let Some(mut search) = GammaSearch::new(*self, approximating, purpose, ray) else { return 0.0 };
        match (self.top.only, ObjectRay::new(ray, &self.top.bounds)) {
            (Some(only), _) => search.meet(only, ray),
            (None, Some(world_ray)) => {
                self.kernels.walk_top(&self.top.wide_top.nodes, &world_ray, &mut search, &mut Counters::default());
            }
            (None, None) => {}
        }
        search.largest
    }

    /// The structure of an instance, and whether its hits are filtered.
    pub(super) fn structure_of(&self, number: u32) -> (u32, bool) {
        let instance = &self.top.instances[number as usize];
        (instance.structure, instance.filtered)
    }

    pub(super) fn structure(&self, number: u32) -> &Structure {
        &self.structures[number as usize]
    }

    pub(super) fn kernels(&self) -> Kernels {
        self.kernels
    }

    /// The instance of a leaf entry, and the ray in its space.
    #[inline(always)]
    pub(super) fn entry(&self, entry: usize, ray: &Ray, t_max: f32) -> (u32, Ray) {
        let number = self.top.wide_top.entries[entry];
        (number, self.top.instances[number as usize].to_object(ray, t_max))
    }

    /// Walks all instances but one.
    #[inline(always)]
    fn walk_top<const ANY: bool, const GATED: bool>(
        &self,
        without: Option<u32>,
        ray: &Ray,
        filter: &dyn HitFilter,
        sink: &mut impl Sink,
        counters: &mut Counters,
    ) -> bool {
        let Some(world_ray) = ObjectRay::new(ray, &self.top.bounds) else { return false };
        let counted = Counters::default();
        let mut visitor =
            InstanceVisitor::<_, ANY, GATED> { scene: *self, without, ray, filter, sink, counters: counted };
        let stopped = self.kernels.walk_top(&self.top.wide_top.nodes, &world_ray, &mut visitor, counters);
        if GATED {
            *counters += visitor.counters;
        } else {
            counters.add_tests(&visitor.counters);
        }
        stopped
    }

    #[inline(always)]
    fn walk_instance<const ANY: bool, const GATED: bool>(
        &self,
        number: u32,
        ray: &Ray,
        object_ray: &Ray,
        filter: &dyn HitFilter,
        sink: &mut impl Sink,
        counters: &mut Counters,
    ) -> bool {
        let instance = &self.top.instances[number as usize];
        if GATED && let Some(space) = self.gates.asked(instance.structure) {
            let verdict = if ANY && self.gates.approximate && !instance.filtered {
                space.approximate_verdict(object_ray, &mut counters.gates)
            } else {
                space.verdict(object_ray, &mut counters.gates)
            };
            match verdict {
                Verdict::Miss => return false,
                // The filter may let the ray pass through what is there.
                Verdict::Hit if ANY && !instance.filtered => return true,
                Verdict::Hit | Verdict::Unknown => {}
            }
        }
        self.enter(number, ray, object_ray, filter, sink, counters)
    }

    /// Walks the structure of an instance.
    #[inline(always)]
    pub(super) fn enter(
        &self,
        number: u32,
        ray: &Ray,
        object_ray: &Ray,
        filter: &dyn HitFilter,
        sink: &mut impl Sink,
        counters: &mut Counters,
    ) -> bool {
        let instance = &self.top.instances[number as usize];
        let structure = &self.structures[instance.structure as usize];
        let Some(object_ray) = ObjectRay::new(object_ray, &structure.bounds()) else { return false };
        if instance.filtered {
            let mut sink = Filtered { sink, filter, ray };
            structure.walk(self.kernels, &object_ray, number, &mut sink, counters)
        } else {
            structure.walk(self.kernels, &object_ray, number, sink, counters)
        }
    }
}

impl Instance {
    fn new(placement: &Placement) -> Self {
        // The inverse in double precision, so that one rounding is all it suffers.
        let linear = DMat3::from_cols(
            placement.transform.matrix3.x_axis.as_dvec3(),
            placement.transform.matrix3.y_axis.as_dvec3(),
            placement.transform.matrix3.z_axis.as_dvec3(),
        );
        Self {
            inverse: linear.inverse_or_zero().as_mat3(),
            translation: placement.transform.translation.into(),
            structure: placement.mesh,
            filtered: placement.filtered,
        }
    }

    #[inline(always)]
    fn to_object(self, ray: &Ray, t_max: f32) -> Ray {
        Ray {
            origin: self.inverse * (ray.origin - self.translation),
            t_min: ray.t_min,
            direction: self.inverse * ray.direction,
            t_max,
        }
    }
}

/// Whether a transform leaves anything of a surface: it can be inverted.
pub(super) fn is_visible(placement: &Placement) -> bool {
    let Instance { inverse, translation, .. } = Instance::new(placement);
    inverse.is_finite() && inverse != Mat3::ZERO && translation.is_finite()
}

/// Boxes that together hold the mesh: of a BVH's nodes the largest are opened first.
fn cut(structure: &Structure) -> Vec<Aabb> {
    let Some(bvh2) = structure.bvh2() else { return vec![structure.bounds()] };
    let area = |index: usize| {
        let e = bvh2.nodes[index].bounds().extent();
        e.x * e.y + e.y * e.z + e.z * e.x
    };
    let mut cut: Vec<usize> = if bvh2.nodes.is_empty() { Vec::new() } else { vec![0] };
    while cut.len() < CUT_SIZE {
        let inner = (0..cut.len()).filter(|&at| !bvh2.nodes[cut[at]].is_leaf());
        let Some(largest) = inner.max_by(|&a, &b| area(cut[a]).total_cmp(&area(cut[b]))) else { break };
        let node = cut[largest];
        cut[largest] = node + 1;
        cut.push(bvh2.nodes[node].right_or_first as usize);
    }
    cut.into_iter().map(|index| bvh2.nodes[index].bounds()).collect()
}

/// The box around transformed boxes, a few ulps larger than rounding can make it too small.
fn world_bounds(cut: &[Aabb], transform: &Affine3A) -> Aabb {
    let matrix = Mat3::from(transform.matrix3);
    let absolute = Mat3::from_cols(matrix.x_axis.abs(), matrix.y_axis.abs(), matrix.z_axis.abs());
    let mut bounds = Aabb::EMPTY;
    let mut magnitude = Vec3::from(transform.translation).abs();
    for part in cut {
        let center = 0.5 * part.min + 0.5 * part.max;
        let half = (0.5 * part.max - 0.5 * part.min) * (1.0 + 2.0 * f32::EPSILON);
        let (center, half) = (matrix * center + Vec3::from(transform.translation), absolute * half);
        bounds = bounds.union(Aabb { min: center - half, max: center + half });
        magnitude = magnitude.max(absolute * part.min.abs().max(part.max.abs()));
    }
    if bounds.is_empty() || !(bounds.min.is_finite() && bounds.max.is_finite()) {
        return Aabb::EMPTY;
    }
    let slack = magnitude * (8.0 * f32::EPSILON);
    Aabb { min: bounds.min - slack, max: bounds.max + slack }
}

struct InstanceVisitor<'a, S, const ANY: bool, const GATED: bool> {
    scene: Scene<'a>,
    /// An instance that has been dealt with.
    without: Option<u32>,
    ray: &'a Ray,
    filter: &'a dyn HitFilter,
    sink: &'a mut S,
    counters: Counters,
}

impl<S: Sink, const ANY: bool, const GATED: bool> LeafVisitor for InstanceVisitor<'_, S, ANY, GATED> {
    #[inline(always)]
    fn visit(&mut self, entries: std::ops::Range<usize>) -> bool {
        for entry in entries {
            let number = self.scene.top.wide_top.entries[entry];
            if self.without == Some(number) {
                continue;
            }
            let object_ray = self.scene.top.instances[number as usize].to_object(self.ray, self.sink.t_limit());
            let (scene, ray, filter) = (self.scene, self.ray, self.filter);
            let counters = &mut self.counters;
            if scene.walk_instance::<ANY, GATED>(number, ray, &object_ray, filter, self.sink, counters) {
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

/// Lets only hits through that the filter accepts.
struct Filtered<'a, S> {
    sink: &'a mut S,
    filter: &'a dyn HitFilter,
    /// In world space.
    ray: &'a Ray,
}

impl<S: Sink> Sink for Filtered<'_, S> {
    #[inline(always)]
    fn t_limit(&self) -> f32 {
        self.sink.t_limit()
    }

    #[inline(always)]
    fn offer(&mut self, hit: Hit) -> bool {
        hit.t <= self.sink.t_limit() && self.filter.accept(self.ray, &hit) && self.sink.offer(hit)
    }
}
