//! Policies that trade truth for speed: rays that end at the shafts of a mesh's nodes instead of at its geometry.
//!
//! - **Occlusion** (Keul 2020, chapter 5): an occlusion ray is blocked by every shaft of the deepest cut that holds something.
//! - **Adaptive** (section 8.3): so, at a depth that the usage heuristic chooses for each object that the ray meets,
//!   `gamma = (b_d / b_s) (L_s / L_d) delta`: the distance of the object's box in sizes of that box, times the size of the light
//!   in its distances. Below 1 the object is traced exactly, at 1 the deepest cut answers, and each further 1 takes
//!   one level less. (The thesis subtracts gamma itself from the deepest level, which would then answer for no gamma at all.)
//! - **Representative** (chapters 6 and 7): an indirect ray ends at the plane of the candidate of its shaft.
//!
//! Camera rays, instances with filtered hits, and rays that end in a node are always exact; of the node, or the
//! object, in which a ray starts the policy decides.

mod cells;

use std::sync::Arc;

use glam::Vec3;

pub(super) use cells::CellsWalk;

use super::line_space::{
    CandidateRules, CandidateTriangle, CellSpaces, GateCounters, Location, NodeSpace, NodeSpaces, ShaftGrid, Shafts,
    chance,
};
use super::two_level::Scene;
use super::{HitFilter, MeshStructure, Structure};
use crate::scene::Aabb;
use crate::trace::{Counters, Hit, Kernels, LeafVisitor, ObjectRay, Ray, Sink, Way};

/// What the rays of one bounce may take for true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BouncePolicy {
    Exact,
    Occlusion,
    Adaptive,
    Representative,
}

/// The usage heuristic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdaptiveRules {
    /// Scales gamma: 0 traces everything exactly.
    pub delta: f32,
    /// Chooses between two depths at random, by gamma's fraction, so that no border shows between them.
    pub interpolate: bool,
    /// Moves ambient-occlusion rays at random within a disc before their shaft is looked up (section 8.3.3), up to half a patch wide
    /// where gamma is 2 and more.
    pub disc: bool,
    /// An object in whose box a ray starts is traced exactly; otherwise its deepest cut is asked, but for the nodes in which the
    /// ray starts.
    pub exact_origin: bool,
}

impl Default for AdaptiveRules {
    fn default() -> Self {
        Self { delta: 1.0, interpolate: true, disc: true, exact_origin: true }
    }
}

/// What a scene may take for true, bounce by bounce.
#[derive(Clone, Debug, PartialEq)]
pub struct Approximation {
    /// Of the camera's rays and the shadow rays of what they hit, then of each bounce; the last repeats.
    pub bounces: Vec<BouncePolicy>,
    /// Of [`BouncePolicy::Occlusion`]: nodes in which a ray starts are tested exactly; otherwise they are skipped (section 5.4.1).
    pub exact_origin: bool,
    /// Of [`BouncePolicy::Occlusion`]: nodes nearer to a ray's start, or to its end, than so many of their longest edges count as those
    /// in which it starts. A ray leaves the node in which it starts near the surface from which it comes, which goes on in the next
    /// node; and it ends on a lamp, which began in the node before.
    pub origin_reach: f32,
    pub adaptive: AdaptiveRules,
    pub candidates: CandidateRules,
}

/// What an occlusion ray is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Purpose {
    /// Bounces before its start: 0 for what the camera sees.
    pub bounce: u32,
    /// Size of the light by its distance; 1 for ambient occlusion and lights all around.
    pub light: f32,
    pub is_ambient: bool,
}

/// The Line Spaces of a scene's nodes, and what they are used for.
#[derive(Debug)]
pub(super) struct Approximating {
    /// Of BVHs: one, or none, for each structure.
    pub nodes: Vec<Option<Arc<NodeSpaces>>>,
    /// Of the N-tree of a flat scene.
    pub cells: Option<Arc<CellSpaces>>,
    pub rules: Approximation,
}

/// What one ray asks. Small and plain, and only lent, never copied: so rays of objects that are exact pay nearly nothing for it.
pub(super) struct Question<'a> {
    pub asked: &'a Approximating,
    policy: BouncePolicy,
    /// Of adaptive: the light's size by its distance, times delta.
    scale: f32,
    is_ambient: bool,
}

impl Approximating {
    fn policy(&self, bounce: u32) -> BouncePolicy {
        let bounces = &self.rules.bounces;
        let policy = bounces.get(bounce as usize).or(bounces.last());
        policy.copied().unwrap_or(BouncePolicy::Exact)
    }

    /// What an occlusion ray asks; none for one that is to be exact.
    #[inline(always)]
    pub(super) fn occlusion(&self, purpose: Purpose) -> Option<Question<'_>> {
        let (rules, policy) = (&self.rules, self.policy(purpose.bounce));
        let Purpose { light, is_ambient, .. } = purpose;
        let is_asked = match policy {
            BouncePolicy::Exact | BouncePolicy::Representative => false,
            BouncePolicy::Occlusion => true,
            BouncePolicy::Adaptive => rules.adaptive.delta > 0.0 && (light > 0.0 || !rules.adaptive.exact_origin),
        };
        is_asked.then_some(Question { asked: self, policy, scale: light * rules.adaptive.delta, is_ambient })
    }

    /// What a ray asks that looks for its nearest hit.
    #[inline(always)]
    pub(super) fn nearest(&self, bounce: u32) -> Option<Question<'_>> {
        let policy = self.policy(bounce);
        let may = bounce > 0 && policy == BouncePolicy::Representative;
        may.then_some(Question { asked: self, policy, scale: 0.0, is_ambient: false })
    }

    pub(super) fn spaces(&self, structure: u32) -> Option<&NodeSpaces> {
        self.nodes.get(structure as usize)?.as_deref()
    }
}

/// How a ray goes on in one object.
struct Plan {
    depth: u32,
    exact_origin: bool,
    /// See [`Approximation::origin_reach`].
    origin_reach: f32,
    /// By how much its line moves before shafts are looked up.
    shift: Vec3,
}

impl Question<'_> {
    /// None for an object that is to be traced exactly. `ray` is in its space.
    #[inline(always)]
    fn plan(&self, spaces: &NodeSpaces, ray: &Ray) -> Option<Plan> {
        let deepest = spaces.params().depth;
        let rules = &self.asked.rules;
        match self.policy {
            BouncePolicy::Exact => None,
            BouncePolicy::Occlusion => Some(rules.plan_of_occlusion(deepest)),
            BouncePolicy::Representative => Some(Plan::at(deepest, rules.candidates.exact_origin)),
            BouncePolicy::Adaptive => {
                let rules = &rules.adaptive;
                let gap = gap_squared(spaces, ray);
                if gap == 0.0 && !rules.exact_origin {
                    return Some(Plan::at(deepest, true));
                }
                // Most objects are found near enough here, without a root; also where it is not a number.
                let is_far = gap * (self.scale * self.scale) >= 1.0;
                if !is_far {
                    return None;
                }
                let gamma = gap.sqrt() * self.scale;
                let fraction = if rules.interpolate { chance(ray, 1) } else { 0.0 };
                // The cast saturates.
                let depth = ((deepest as f32 + 1.0 - gamma + fraction) as u32).min(deepest);
                let shift = if rules.disc && self.is_ambient {
                    let n = spaces.params().each.n as f32;
                    let radius = (gamma - 1.0).min(1.0) * spaces.bounds().extent().max_element();
                    on_disc(ray, 0.5 * radius / (n * (1 << (depth / 3)) as f32))
                } else {
                    Vec3::ZERO
                };
                Some(Plan { shift, ..Plan::at(depth, true) })
            }
        }
    }
}

impl Plan {
    fn at(depth: u32, exact_origin: bool) -> Self {
        Self { depth, exact_origin, origin_reach: 0.0, shift: Vec3::ZERO }
    }
}

impl Approximation {
    fn plan_of_occlusion(&self, depth: u32) -> Plan {
        Plan { origin_reach: self.origin_reach, ..Plan::at(depth, self.exact_origin) }
    }
}

/// A box with a Line Space that a ray comes to.
struct AskedBox<'a> {
    grid: &'a ShaftGrid,
    shafts: &'a Shafts,
    bounds: &'a Aabb,
    /// Sets what is chosen at random apart from other boxes.
    salt: u32,
    triangles: &'a [CandidateTriangle],
    instance: u32,
}

impl AskedBox<'_> {
    /// Whether a point is nearer than `reach` longest edges, on each axis. False where it is infinitely far.
    #[inline(always)]
    fn is_near(&self, point: Vec3, reach: f32) -> bool {
        let margin = reach * self.bounds.extent().max_element();
        let gap = (self.bounds.min - point).max(point - self.bounds.max).max_element();
        gap < margin
    }
}

impl Question<'_> {
    /// What is taken for true of a box, which the ray's line may pass by.
    #[inline(always)]
    fn ask(&self, asked: &AskedBox<'_>, ray: &Ray, plan: &Plan, sink: &mut impl Sink, gates: &mut GateCounters) -> Way {
        let is_near = |point| plan.origin_reach > 0.0 && asked.is_near(point, plan.origin_reach);
        let end = ray.origin + ray.t_max * ray.direction;
        let starts_inside = asked.grid.holds(ray.origin) || is_near(ray.origin) || is_near(end);
        if starts_inside {
            gates.starts_inside += 1;
            if plan.exact_origin {
                return Way::Down;
            }
        }
        let line = Ray { origin: ray.origin + plan.shift, ..*ray };
        let chord = match asked.grid.locate(&line) {
            Location::Beside => {
                gates.beside += 1;
                return Way::Past;
            }
            Location::TooFar => {
                gates.too_far += 1;
                return Way::Down;
            }
            Location::Through(chord) => chord,
        };
        if self.policy == BouncePolicy::Representative {
            let rules = &self.asked.rules.candidates;
            gates.node_look_ups += 1;
            gates.approximated += 1;
            let Shafts::Candidates(candidates) = asked.shafts else { return Way::Down };
            let Some(candidate) = candidates.candidate(chord.entry, chord.exit) else { return Way::Past };
            let triangle = &asked.triangles[candidate as usize];
            let Some([t, u, v]) = triangle.hit(ray, asked.bounds, rules) else { return Way::Past };
            let hit = Hit { t, u, v, instance: asked.instance, primitive: triangle.primitive };
            return if t <= sink.t_limit() && sink.offer(hit) { Way::Stop } else { Way::Past };
        }
        if starts_inside {
            return Way::Past;
        }
        if !(chord.starts_outside && chord.reaches_exit) {
            return Way::Down;
        }
        gates.node_look_ups += 1;
        gates.approximated += 1;
        let is_blocked = match asked.shafts {
            Shafts::Binary(binary) => binary.is_marked(chord.entry, chord.exit),
            Shafts::Candidates(candidates) => candidates.candidate(chord.entry, chord.exit).is_some(),
            Shafts::Coverage(coverage) => coverage.blocked(chord.entry, chord.exit) > chance(ray, asked.salt),
            Shafts::Table(_) | Shafts::Tree(_) => return Way::Down,
        };
        gates.skipped_nodes += u64::from(!is_blocked);
        if is_blocked { Way::Stop } else { Way::Past }
    }
}

/// Looks for the largest gamma of the objects that an occlusion ray comes to. Nothing asks for it while a picture is made.
pub(super) struct GammaSearch<'a> {
    scene: Scene<'a>,
    approximating: &'a Approximating,
    ray: &'a Ray,
    /// The light's size by its distance, times delta.
    scale: f32,
    pub largest: f32,
}

impl<'a> GammaSearch<'a> {
    /// None where the policy is not adaptive.
    pub(super) fn new(
        scene: Scene<'a>,
        approximating: &'a Approximating,
        purpose: Purpose,
        ray: &'a Ray,
    ) -> Option<Self> {
        let is_adaptive = approximating.policy(purpose.bounce) == BouncePolicy::Adaptive;
        let scale = purpose.light * approximating.rules.adaptive.delta;
        is_adaptive.then_some(Self { scene, approximating, ray, scale, largest: 0.0 })
    }

    pub(super) fn meet(&mut self, number: u32, object_ray: &Ray) {
        let (structure, filtered) = self.scene.structure_of(number);
        if let (Some(spaces), false) = (self.approximating.spaces(structure), filtered) {
            self.largest = self.largest.max(gap_squared(spaces, object_ray).sqrt() * self.scale);
        }
    }
}

impl LeafVisitor for GammaSearch<'_> {
    fn visit(&mut self, entries: std::ops::Range<usize>) -> bool {
        for entry in entries {
            let (number, object_ray) = self.scene.entry(entry, self.ray, self.ray.t_max);
            self.meet(number, &object_ray);
        }
        false
    }

    fn t_limit(&self) -> f32 {
        self.ray.t_max
    }
}

/// How far the ray's origin is from the object's box, in diagonals of it, squared; 0 inside.
#[inline(always)]
fn gap_squared(spaces: &NodeSpaces, ray: &Ray) -> f32 {
    let bounds = spaces.bounds();
    let outside = (bounds.min - ray.origin).max(ray.origin - bounds.max).max(Vec3::ZERO);
    outside.length_squared() * spaces.inverse_size_squared()
}

/// A random point of a disc across the ray. The distance from its centre is uniform, so that points are denser there.
fn on_disc(ray: &Ray, radius: f32) -> Vec3 {
    let (across, other) = ray.direction.normalize_or(Vec3::X).any_orthonormal_pair();
    let (sin, cos) = (std::f32::consts::TAU * chance(ray, 2)).sin_cos();
    radius * chance(ray, 3) * (cos * across + sin * other)
}

/// A ray on its way through a scene of instances.
pub(super) struct InstanceWalk<'a, S> {
    pub scene: Scene<'a>,
    pub question: &'a Question<'a>,
    pub ray: &'a Ray,
    pub filter: &'a dyn HitFilter,
    pub sink: &'a mut S,
    pub counters: Counters,
}

impl<S: Sink> InstanceWalk<'_, S> {
    #[inline(always)]
    pub(super) fn enter(&mut self, number: u32, object_ray: &Ray) -> bool {
        let (structure, filtered) = self.scene.structure_of(number);
        let spaces = if filtered { None } else { self.question.asked.spaces(structure) };
        if let (Some(spaces), Structure::Bvh(bvh)) = (spaces, self.scene.structure(structure))
            && let Some(plan) = self.question.plan(spaces, object_ray)
        {
            let walk = ObjectWalk { spaces, bvh, kernels: self.scene.kernels(), question: self.question, number };
            return walk.walk(object_ray, &plan, self.sink, &mut self.counters);
        }
        self.scene.enter(number, self.ray, object_ray, self.filter, self.sink, &mut self.counters)
    }
}

impl<S: Sink> LeafVisitor for InstanceWalk<'_, S> {
    #[inline(always)]
    fn visit(&mut self, entries: std::ops::Range<usize>) -> bool {
        for entry in entries {
            let (number, object_ray) = self.scene.entry(entry, self.ray, self.sink.t_limit());
            if self.enter(number, &object_ray) {
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

/// A ray on its way through one object.
pub(super) struct ObjectWalk<'a> {
    pub spaces: &'a NodeSpaces,
    pub bvh: &'a MeshStructure,
    pub kernels: Kernels,
    pub question: &'a Question<'a>,
    pub number: u32,
}

impl ObjectWalk<'_> {
    /// Not inline: where objects are exact, what is around it shall stay small.
    #[inline(never)]
    fn walk(&self, ray: &Ray, plan: &Plan, sink: &mut impl Sink, counters: &mut Counters) -> bool {
        let Some(object_ray) = ObjectRay::new(ray, self.spaces.bounds()) else { return false };
        let top = &self.spaces.cut(plan.depth).top;
        let counted = Counters::default();
        let mut visitor =
            NodeVisitor { walk: self, entries: &top.entries, ray, object_ray, plan, sink, counters: counted };
        let stopped = if top.entries.len() == 1 {
            visitor.visit(0..1)
        } else {
            self.kernels.walk_top(&top.nodes, &object_ray, &mut visitor, counters)
        };
        counters.add_walk(&visitor.counters);
        stopped
    }

    /// The whole question, of an object in world space.
    pub(super) fn ask(&self, ray: &Ray, sink: &mut impl Sink, counters: &mut Counters) -> Option<bool> {
        let plan = self.question.plan(self.spaces, ray)?;
        Some(self.walk(ray, &plan, sink, counters))
    }
}

struct NodeVisitor<'a, S> {
    walk: &'a ObjectWalk<'a>,
    entries: &'a [u32],
    /// In the object's space.
    ray: &'a Ray,
    object_ray: ObjectRay,
    plan: &'a Plan,
    sink: &'a mut S,
    counters: Counters,
}

impl<S: Sink> NodeVisitor<'_, S> {
    #[inline(always)]
    fn visit_node(&mut self, space: &NodeSpace) -> bool {
        let Some((grid, shafts)) = &space.content else { return self.exactly(space) };
        let ObjectWalk { spaces, question, number, .. } = *self.walk;
        let asked = AskedBox {
            grid,
            shafts,
            bounds: &space.bounds,
            salt: space.node,
            triangles: spaces.triangles(),
            instance: number,
        };
        match question.ask(&asked, self.ray, self.plan, self.sink, &mut self.counters.gates) {
            Way::Down => self.exactly(space),
            Way::Past => false,
            Way::Stop => true,
        }
    }

    fn exactly(&mut self, space: &NodeSpace) -> bool {
        let ObjectWalk { spaces, bvh, kernels, number, .. } = self.walk;
        let roots = spaces.roots(space);
        kernels.walk_mesh_from(bvh.wide(), roots, &self.object_ray, *number, self.sink, &mut self.counters)
    }
}

impl<S: Sink> LeafVisitor for NodeVisitor<'_, S> {
    #[inline(always)]
    fn visit(&mut self, entries: std::ops::Range<usize>) -> bool {
        let spaces = self.walk.spaces;
        self.entries[entries].iter().any(|&number| self.visit_node(spaces.space(number)))
    }

    #[inline(always)]
    fn t_limit(&self) -> f32 {
        self.sink.t_limit()
    }
}
