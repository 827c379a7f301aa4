//! Rows of surface shafts: sampled and proven.

use std::collections::HashMap;

use glam::DVec3;

use super::shaft::DILATION;
use super::{Class, Patch, ShaftGrid};
use crate::accel::MeshStructure;
use crate::scene::Mesh;
use crate::trace::{Counters, Hit, Kernels, ObjectRay, Ray, Sink};

pub(super) struct RowBuilder<'a> {
    pub mesh: &'a Mesh,
    pub structure: &'a MeshStructure,
    pub grid: &'a ShaftGrid,
    pub kernels: Kernels,
}

impl RowBuilder<'_> {
    fn facet(&self, triangle: u32) -> Facet {
        let corners = self.mesh.triangles[triangle as usize].map(|v| self.mesh.positions[v as usize].as_dvec3());
        let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize_or_zero();
        let unit = corners.map(|corner| self.grid.to_unit(corner));
        Facet { corners: unit, normal: normal(unit), facing: normal(corners) }
    }

    /// A random ray from just above a triangle's front side to a patch; None where there is none.
    pub(super) fn ray(&self, triangle: u32, patch: Patch, random: &mut Scatter) -> Option<Ray> {
        let corners = self.mesh.triangles.get(triangle as usize)?;
        let [a, b, c] = corners.map(|v| self.mesh.positions[v as usize].as_dvec3());
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let (u, v) = (random.unit(), random.unit());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let [low, high] = patch.unit_bounds(self.grid.n());
        let part = DVec3::new(random.unit(), random.unit(), random.unit());
        let end = self.grid.from_unit(low + part * (high - low));
        // As high as rounding of the mesh's coordinates asks for.
        let bounds = self.structure.bvh2().bounds();
        let extent = bounds.min.abs().max(bounds.max.abs()).max_element();
        let start = a + u * (b - a) + v * (c - a) + normal * f64::from(extent * 16.0 * f32::EPSILON);
        let direction = end - start;
        let leaves = normal.dot(direction) > 1e-3 * direction.length();
        leaves.then(|| Ray::new(start.as_vec3(), direction.as_vec3()))
    }

    pub(super) fn is_blocked(&self, ray: &Ray) -> bool {
        struct AnyHit;
        impl Sink for AnyHit {
            fn t_limit(&self) -> f32 {
                f32::INFINITY
            }
            fn offer(&mut self, _: Hit) -> bool {
                true
            }
        }
        let Some(ray) = ObjectRay::new(ray, &self.structure.bvh2().bounds()) else { return false };
        self.kernels.walk_mesh(self.structure.wide(), &ray, 0, &mut AnyHit, &mut Counters::default())
    }

    /// What `rays` random rays from a cluster towards each patch do.
    pub(super) fn sampled<'b>(
        &'b self,
        number: u32,
        members: &'b [u32],
        rays: u32,
    ) -> Box<dyn FnMut(Patch) -> Class + 'b> {
        Box::new(move |patch| {
            let seed = u64::from(number) << 32 | u64::from(patch.index(self.grid.n())) << 11;
            let mut random = Scatter(seed);
            let (mut free, mut blocked) = (false, false);
            for _ in 0..rays {
                let Some(&triangle) = members.get(random.below(members.len().max(1) as u32) as usize) else { break };
                let Some(ray) = self.ray(triangle, patch, &mut random) else { continue };
                if self.is_blocked(&ray) {
                    blocked = true;
                } else {
                    free = true;
                }
                if free && blocked {
                    break;
                }
            }
            match (free, blocked) {
                (true, false) => Class::Empty,
                (false, true) => Class::Opaque,
                _ => Class::Mixed,
            }
        })
    }

    /// EMPTY where it is proven.
    pub(super) fn proven<'b>(&'b self, members: &'b [u32]) -> Box<dyn FnMut(Patch) -> Class + 'b> {
        let starts: Vec<Facet> = members.iter().map(|&triangle| self.facet(triangle)).collect();
        let corners = || starts.iter().flat_map(|facet| facet.corners);
        let low = corners().fold(DVec3::INFINITY, DVec3::min) - DILATION;
        let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max) + DILATION;
        let mut relations: HashMap<u32, Option<Relation>> = HashMap::new();
        Box::new(move |patch| {
            let [patch_low, patch_high] = patch.unit_bounds(self.grid.n());
            let beam = BoxBeam { start: [low, high], end: [patch_low - DILATION, patch_high + DILATION] };
            let ends = beam.end_corners();
            let reaches: Vec<bool> = starts.iter().map(|start| start.reaches(&ends)).collect();
            let is_clear = self.all_triangles_in(&beam, |triangle| {
                let relate = || Relation::new(&starts, &self.facet(triangle));
                let relation = relations.entry(triangle).or_insert_with(relate);
                relation.as_ref().is_some_and(|relation| relation.allows(&reaches, &ends))
            });
            if is_clear && !starts.is_empty() { Class::Empty } else { Class::Mixed }
        })
    }

    /// Whether the test holds for all triangles that may be in the beam. A sphere in it fails.
    fn all_triangles_in(&self, beam: &BoxBeam, mut test: impl FnMut(u32) -> bool) -> bool {
        let bvh2 = self.structure.bvh2();
        let mut pending = vec![0_usize];
        while let Some(index) = pending.pop() {
            let node = &bvh2.nodes[index];
            let bounds = node.bounds();
            if !beam.meets(self.grid.to_unit(bounds.min.as_dvec3()), self.grid.to_unit(bounds.max.as_dvec3())) {
                continue;
            }
            if !node.is_leaf() {
                pending.extend([node.right_or_first as usize, index + 1]);
                continue;
            }
            let range = node.right_or_first as usize..(node.right_or_first + node.count) as usize;
            for &primitive in &bvh2.primitives[range] {
                if primitive as usize >= self.mesh.triangles.len() {
                    return false;
                }
                let [a, b, c] = self.facet(primitive).corners;
                if beam.meets(a.min(b).min(c), a.max(b).max(c)) && !test(primitive) {
                    return false;
                }
            }
        }
        true
    }
}

/// The hull of two boxes.
struct BoxBeam {
    start: [DVec3; 2],
    end: [DVec3; 2],
}

impl BoxBeam {
    /// Whether a box meets the hull: whether a section of it, which is a box that moves and grows linearly, ever does.
    fn meets(&self, low: DVec3, high: DVec3) -> bool {
        let (mut first, mut last) = (0.0_f64, 1.0_f64);
        // Keeps the s at which `at_start + s * (at_end - at_start) <= 0`.
        let mut keep = |at_start: f64, at_end: f64| {
            if at_start <= 0.0 && at_end <= 0.0 {
                return;
            }
            let crossing = at_start / (at_start - at_end);
            match (at_start <= 0.0, at_end <= 0.0) {
                (true, false) => last = last.min(crossing),
                (false, true) => first = first.max(crossing),
                _ => last = -1.0,
            }
        };
        for axis in 0..3 {
            keep(self.start[0][axis] - high[axis], self.end[0][axis] - high[axis]);
            keep(low[axis] - self.start[1][axis], low[axis] - self.end[1][axis]);
        }
        first <= last
    }

    fn end_corners(&self) -> [DVec3; 8] {
        let [low, high] = self.end;
        std::array::from_fn(|corner| {
            DVec3::select(glam::BVec3::new(corner & 1 == 0, corner & 2 == 0, corner & 4 == 0), low, high)
        })
    }
}

/// A triangle with its plane, in the unit cube.
struct Facet {
    corners: [DVec3; 3],
    /// Of length 1, or 0 for a triangle without area.
    normal: DVec3,
    /// The normal in the mesh's own space, in which rays are moved off it.
    facing: DVec3,
}

/// Distances in the unit cube that count as none: what double precision rounds away.
const NOTHING: f64 = 1e-13;
/// Least cosine between a triangle's normal and the plane from which rays that start on it must rise: a ray starts a
/// little above its triangle, and so above that plane too.
const LEAST_COSINE: f64 = 0.1;

impl Facet {
    /// Least and greatest height of the other's corners above this plane.
    fn heights(&self, other: &Self) -> (f64, f64) {
        let heights = other.corners.map(|corner| self.normal.dot(corner - self.corners[0]));
        (heights[0].min(heights[1]).min(heights[2]), heights[0].max(heights[1]).max(heights[2]))
    }

    /// Whether a ray that rises from this triangle can end at what has these corners: not if all lies below its plane.
    fn reaches(&self, ends: &[DVec3; 8]) -> bool {
        self.normal == DVec3::ZERO || ends.iter().any(|&end| self.normal.dot(end - self.corners[0]) > -DILATION)
    }
}

/// Why rays from a cluster may not meet a triangle.
struct Relation {
    /// A point of the triangle's plane.
    point: DVec3,
    normal: DVec3,
    /// Starts that the triangle is not below of: which, and how high above the triangle's plane they reach.
    open: Vec<(u32, f64)>,
}

impl Relation {
    /// None when nothing can be said.
    fn new(starts: &[Facet], triangle: &Facet) -> Option<Self> {
        if triangle.normal == DVec3::ZERO {
            return None;
        }
        let mut open = Vec::new();
        for (number, start) in (0..).zip(starts) {
            let is_below = start.normal != DVec3::ZERO && start.heights(triangle).1 <= NOTHING;
            if is_below {
                continue;
            }
            let (low, high) = triangle.heights(start);
            if low < -NOTHING || triangle.facing.dot(start.facing) < LEAST_COSINE {
                return None;
            }
            open.push((number, high));
        }
        Some(Self { point: triangle.corners[0], normal: triangle.normal, open })
    }

    /// Whether no ray from the cluster to what has these corners meets the triangle; `reaches` says from which starts there
    /// are any.
    fn allows(&self, reaches: &[bool], ends: &[DVec3; 8]) -> bool {
        let open = self.open.iter().filter(|(start, _)| reaches[*start as usize]);
        let Some(highest) = open.map(|(_, high)| *high).reduce(f64::max) else { return true };
        ends.iter().all(|&end| self.normal.dot(end - self.point) > highest + DILATION)
    }
}

/// Random numbers for one pair or ray: SplitMix64.
pub(super) struct Scatter(pub u64);

impl Scatter {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(super) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(super) fn below(&mut self, end: u32) -> u32 {
        (self.next() % u64::from(end)) as u32
    }
}
