//! The layered build of the tri-state payload: each class with a proof, so that its use is exact.
//!
//! A shaft is the union of its sections: the points at `(1 - s) a + s b` for all `a` and `b` on its two patches, which
//! fill a box that moves and grows linearly with `s`. Slabs of sections are held against voxel grids of the surface and
//! of the rim (edges with an odd number of triangles).
//!
//! - EMPTY: no slab holds surface.
//! - OPAQUE by parity. Take two sections that hold no surface, and no rim between them. Between the two, all lines of
//!   the shaft cross the surface equally often modulo 2: moving a line can change that only where it sweeps over a
//!   rim edge, or where an end crosses the surface. So if one line crosses it an odd number of times, all are blocked.
//!   The mesh need not be closed anywhere else.
//! - OPAQUE by one triangle: the lines between all corners of the patches cross it, hence all lines do.
//!
//! Patches are grown by [`DILATION`], which covers what rounding does to a ray when its shaft is looked up and when
//! primitives are tested; the watertight triangle test then sees a mesh whose vertices have moved by less, and to which
//! the same proofs apply.

use std::sync::atomic::AtomicBool;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::classes::{ALL_MIXED, CODES, Class, ClassTree, SPLIT};
use super::shaft::{DILATION, symmetric_count, symmetric_patches};
use super::voxels::{Occupancy, Voxels};
use super::{Patch, ShaftGrid};
use crate::accel::build::check;
use crate::accel::{BuildError, MeshStructure};
use crate::scene::Mesh;
use crate::trace::{Counters, Hit, Kernels, ObjectRay, Ray, Sink};

/// Most voxels along an axis; also the most slabs of a shaft.
pub(super) const MAX_RESOLUTION: u32 = 256;

/// A hit with a barycentric coordinate nearer to 0 may count twice, for both triangles of an edge.
const EDGE: f32 = 1e-6;

/// Where a line starts and ends within its patches, in turn, until one meets no edge exactly.
const TRIES: [[f64; 4]; 3] = [[0.5, 0.5, 0.5, 0.5], [0.37, 0.58, 0.61, 0.43], [0.71, 0.29, 0.33, 0.77]];

/// Classifies all shafts of `grid`, beginning with `root_n` patches; `grid.n()` is `root_n` times a power of two.
pub(super) fn build(
    mesh: &Mesh,
    structure: &MeshStructure,
    grid: &ShaftGrid,
    root_n: u32,
    resolution: u32,
    cancel: &AtomicBool,
) -> Result<ClassTree, BuildError> {
    let voxels = Voxels::build(mesh, &structure.bvh2().bounds(), grid, resolution, cancel)?;
    let classifier = Classifier::new(mesh, structure, grid, &voxels, resolution);
    let depth = (grid.n() / root_n).trailing_zeros();
    let roots: Vec<u32> = (0..symmetric_count(root_n) as u32).collect();
    // A chunk is one block of the coarsest level.
    let parts: Vec<Vec<Vec<u32>>> = roots
        .par_chunks(CODES)
        .map(|chunk| {
            check(cancel)?;
            let mut levels = vec![Vec::new(); depth as usize + 1];
            let shafts: Vec<_> = chunk.iter().map(|&index| symmetric_patches(root_n, index)).collect();
            let mut refinement = Refinement { classifier: &classifier, root_n, levels: &mut levels, hits: Vec::new() };
            refinement.block(0, &shafts);
            Ok(levels)
        })
        .collect::<Result<_, BuildError>>()?;
    let level = |level: usize| parts.iter().flat_map(|part| part[level].iter().copied()).collect();
    let levels = (0..=depth as usize).map(level).collect();
    Ok(ClassTree::from_levels(root_n, levels).expect("blocks are made for splits"))
}

/// Writes the blocks of some shafts and of all below them.
struct Refinement<'a> {
    classifier: &'a Classifier<'a>,
    root_n: u32,
    levels: &'a mut [Vec<u32>],
    /// Scratch.
    hits: Vec<Crossing>,
}

impl Refinement<'_> {
    /// Writes the block of up to sixteen shafts.
    fn block(&mut self, level: usize, shafts: &[(Patch, Patch)]) -> u32 {
        let at = self.levels[level].len();
        self.levels[level].push(0);
        let mut word = 0;
        for (slot, &(a, b)) in shafts.iter().enumerate() {
            let beam = Beam::new(self.root_n << level, a, b);
            let class = self.classifier.classify(&beam, &mut self.hits);
            let is_last = level + 1 == self.levels.len();
            let mut code = class as u32;
            if class == Class::Mixed && !is_last {
                let below = self.block(level + 1, &ClassTree::children(a, b));
                if below == ALL_MIXED {
                    self.levels[level + 1].pop();
                } else {
                    code = SPLIT;
                }
            }
            word |= code << (2 * slot);
        }
        self.levels[level][at] = word;
        word
    }
}

/// A shaft, grown by [`DILATION`], in the unit cube.
struct Beam {
    /// The patches themselves.
    patches: [[DVec3; 2]; 2],
    /// The grown patches' lower and upper corners: at the start, and what is added towards the end.
    low: [DVec3; 2],
    high: [DVec3; 2],
}

impl Beam {
    fn new(n: u32, a: Patch, b: Patch) -> Self {
        let patches = [a.unit_bounds(n), b.unit_bounds(n)];
        let [[a_low, a_high], [b_low, b_high]] = patches;
        Self { patches, low: [a_low - DILATION, b_low - a_low], high: [a_high + DILATION, b_high - a_high] }
    }

    /// The box around the sections from `from` to `to`.
    #[inline]
    fn bounds(&self, from: f64, to: f64) -> [DVec3; 2] {
        let at = |[start, along]: [DVec3; 2], s: f64| start + s * along;
        [at(self.low, from).min(at(self.low, to)), at(self.high, from).max(at(self.high, to))]
    }

    /// The eight corners of a grown patch's box; `end` is 0 or 1.
    fn corners(&self, end: usize) -> [DVec3; 8] {
        let s = end as f64;
        let (low, high) = (self.low[0] + s * self.low[1], self.high[0] + s * self.high[1]);
        std::array::from_fn(|corner| {
            DVec3::new(
                if corner & 1 == 0 { low.x } else { high.x },
                if corner & 2 == 0 { low.y } else { high.y },
                if corner & 4 == 0 { low.z } else { high.z },
            )
        })
    }
}

/// Where a line of a shaft crosses the surface.
#[derive(Clone, Copy, PartialEq)]
struct Crossing {
    /// From 0 at the first patch to 1 at the second.
    at: f32,
    primitive: u32,
    on_edge: bool,
}

/// Finds the classes of a mesh's shafts.
pub(crate) struct Classifier<'a> {
    mesh: &'a Mesh,
    structure: &'a MeshStructure,
    grid: &'a ShaftGrid,
    voxels: &'a Voxels,
    resolution: u32,
    kernels: Kernels,
    /// The longest side of any triangle, in the unit cube: what is wider than this is never covered by one.
    longest_side: f64,
}

impl<'a> Classifier<'a> {
    pub(crate) fn new(
        mesh: &'a Mesh,
        structure: &'a MeshStructure,
        grid: &'a ShaftGrid,
        voxels: &'a Voxels,
        resolution: u32,
    ) -> Self {
        let scale = grid.unit_scale();
        let longest_side = mesh.triangles.par_iter().with_min_len(4096).map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize].as_dvec3() * scale);
            let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
            if longest.is_finite() { longest } else { 0.0 }
        });
        let longest_side = longest_side.reduce(|| 0.0, f64::max).sqrt();
        Self { mesh, structure, grid, voxels, resolution, kernels: Kernels::detect(), longest_side }
    }

    /// The class of the shaft between two patches, of which `n` make an edge of the box.
    pub(crate) fn class(&self, n: u32, a: Patch, b: Patch) -> Class {
        self.classify(&Beam::new(n, a, b), &mut Vec::new())
    }

    /// Whether some triangle may be as wide as a patch, of which `n` make an edge of the box.
    pub(crate) fn has_triangles_as_wide_as_a_patch(&self, n: u32) -> bool {
        1.0 / f64::from(n) <= self.longest_side * (1.0 + 1e-9)
    }

    fn classify(&self, beam: &Beam, hits: &mut Vec<Crossing>) -> Class {
        if !self.any_slab(&self.voxels.surface, beam, 0, self.resolution) {
            return Class::Empty;
        }
        let is_opaque = self.is_opaque_by_parity(beam, hits) || self.is_behind_one_triangle(beam, hits);
        if is_opaque { Class::Opaque } else { Class::Mixed }
    }

    /// Whether one line crosses the surface an odd number of times between two sections without surface, with no rim
    /// between them.
    ///
    /// Where any such sections exist, some lie around a run of slabs with surface in which the line crosses an odd
    /// number of times: so it is enough to look at the runs that hold its crossings.
    fn is_opaque_by_parity(&self, beam: &Beam, hits: &mut Vec<Crossing>) -> bool {
        if !TRIES.iter().any(|tried| self.crossings(beam, tried, hits)) {
            return false;
        }
        hits.sort_unstable_by(|a, b| a.at.total_cmp(&b.at));
        let mut rest = hits.as_slice();
        while let Some(first) = rest.first() {
            let Some(slab) = self.slab_of(beam, first.at) else { return false };
            let (mut from, mut end) = (slab, slab + 1);
            while from > 0 && self.holds(&self.voxels.surface, beam, from - 1, from) {
                from -= 1;
            }
            while end < self.resolution && self.holds(&self.voxels.surface, beam, end, end + 1) {
                end += 1;
            }
            // In the free slab behind there are only crossings that rounding has moved there, by much less than half of it.
            let behind = (end as f32 + 0.5) / self.resolution as f32;
            let inside = rest.iter().take_while(|hit| hit.at < behind).count().max(1);
            if inside % 2 == 1 && !self.any_slab(&self.voxels.rim, beam, from, end) {
                return true;
            }
            rest = &rest[inside..];
        }
        false
    }

    /// Whether a slab of `first..end` holds something.
    fn any_slab(&self, occupancy: &Occupancy, beam: &Beam, first: u32, end: u32) -> bool {
        if !self.holds(occupancy, beam, first, end) {
            return false;
        }
        let middle = first.midpoint(end);
        end - first == 1 || self.any_slab(occupancy, beam, first, middle) || self.any_slab(occupancy, beam, middle, end)
    }

    #[inline]
    fn holds(&self, occupancy: &Occupancy, beam: &Beam, first: u32, end: u32) -> bool {
        let slabs = f64::from(self.resolution);
        let [low, high] = beam.bounds(f64::from(first) / slabs, f64::from(end) / slabs);
        occupancy.any(low, high)
    }

    /// The slab with surface in which a crossing lies; rounding may have put it into the next one.
    fn slab_of(&self, beam: &Beam, at: f32) -> Option<u32> {
        let last = self.resolution - 1;
        let slab = ((at * self.resolution as f32) as u32).min(last);
        let beside = [slab, slab.saturating_sub(1), (slab + 1).min(last)];
        beside.into_iter().find(|&slab| self.holds(&self.voxels.surface, beam, slab, slab + 1))
    }

    /// Finds all crossings of one line of the shaft. False when they cannot be counted for certain.
    fn crossings(&self, beam: &Beam, &[au, av, bu, bv]: &[f64; 4], hits: &mut Vec<Crossing>) -> bool {
        let point_of = |end: usize, u: f64, v: f64| {
            let [low, high] = beam.patches[end];
            point(self.grid, low, high - low, [u, v])
        };
        let (from, to) = (point_of(0, au, av), point_of(1, bu, bv));
        // One difference, so that a device comes to the same line.
        let ray = Ray { origin: from, t_min: 0.0, direction: to - from, t_max: 1.0 };
        self.all_hits(&ray, hits);
        hits.iter().all(|hit| !hit.on_edge)
    }

    /// All hits of a ray, each once.
    fn all_hits(&self, ray: &Ray, hits: &mut Vec<Crossing>) {
        hits.clear();
        let bounds = self.structure.bvh2().bounds();
        let Some(ray) = ObjectRay::new(ray, &bounds) else { return };
        let triangles = self.mesh.triangles.len() as u32;
        let mut sink = AllHits { hits, triangles };
        self.kernels.walk_mesh(self.structure.wide(), &ray, 0, &mut sink, &mut Counters::default());
        // With spatial splits, one hit may have been found in several leaves.
        hits.sort_unstable_by(|a, b| a.primitive.cmp(&b.primitive).then(a.at.total_cmp(&b.at)));
        hits.dedup();
    }

    /// Whether the whole shaft passes through one triangle: one of those that one of its lines crosses.
    fn is_behind_one_triangle(&self, beam: &Beam, hits: &[Crossing]) -> bool {
        // A section is at least as wide as the narrower patch.
        let width = |[low, high]: [DVec3; 2]| (high - low).max_element();
        if width(beam.patches[0]).min(width(beam.patches[1])) > self.longest_side {
            return false;
        }
        let (starts, ends) = (beam.corners(0), beam.corners(1));
        let triangles = hits.iter().filter_map(|hit| self.mesh.triangles.get(hit.primitive as usize));
        let mut corners = triangles.map(|t| t.map(|v| self.grid.to_unit(self.mesh.positions[v as usize].as_dvec3())));
        corners.any(|triangle| starts.iter().all(|&p| ends.iter().all(|&q| crosses(triangle, p, q))))
    }
}

/// The middle of a patch, of which `n` make an edge of the box: where the line that is tried first begins or ends.
pub(crate) fn middle(grid: &ShaftGrid, n: u32, patch: Patch) -> Vec3 {
    let [low, high] = patch.unit_bounds(n);
    let [u, v, ..] = TRIES[0];
    point(grid, low, high - low, [u, v])
}

/// A point of a patch that begins at `low`.
fn point(grid: &ShaftGrid, low: DVec3, extent: DVec3, [u, v]: [f64; 2]) -> Vec3 {
    // On the patch's own axis the extent is 0.
    let part = DVec3::new(u, if extent.x == 0.0 { u } else { v }, v);
    grid.from_unit(low + extent * part).as_vec3()
}

/// Whether the line from `p` to `q` passes through the triangle's inside for certain, between the two.
fn crosses([a, b, c]: [DVec3; 3], p: DVec3, q: DVec3) -> bool {
    const CERTAIN: f64 = 1e-12;
    let normal = (b - a).cross(c - a);
    let (before, behind) = (normal.dot(p - a), normal.dot(q - a));
    let volume = |from: DVec3, to: DVec3| (q - p).dot((from - p).cross(to - p));
    let (u, v, w) = (volume(a, b), volume(b, c), volume(c, a));
    let one_side = u.min(v).min(w) > CERTAIN || u.max(v).max(w) < -CERTAIN;
    one_side && before.abs().min(behind.abs()) > CERTAIN && (before < 0.0) != (behind < 0.0)
}

struct AllHits<'a> {
    hits: &'a mut Vec<Crossing>,
    triangles: u32,
}

impl Sink for AllHits<'_> {
    fn t_limit(&self) -> f32 {
        1.0
    }

    fn offer(&mut self, hit: Hit) -> bool {
        let is_triangle = hit.primitive < self.triangles;
        // A NaN is not inside.
        let is_inside = hit.u > EDGE && hit.v > EDGE && 1.0 - hit.u - hit.v > EDGE;
        let on_edge = is_triangle && !is_inside;
        self.hits.push(Crossing { at: hit.t, primitive: hit.primitive, on_edge });
        false
    }
}
