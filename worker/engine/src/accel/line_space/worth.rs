//! Whether it pays to ask a Line Space before a mesh is walked.
//!
//! A look-up costs about as much as a few nodes of a BVH, so it must often enough spare more than that. Which meshes it is
//! worth for depends on their size and shape and on the machine: it is measured, on a few rays that cross the mesh's box.

use std::time::{Duration, Instant};

use glam::Vec3;

use super::surface_rows::Scatter;
use super::{GateCounters, LineSpace, Verdict};
use crate::accel::{CellShafts, CellTree, Structure};
use crate::scene::Aabb;
use crate::trace::{Counters, Hit, Kernels, ObjectRay, Ray, Sink};

/// Rays that are timed, so many times; the best time counts.
const RAYS: usize = 512;
const REPEATS: usize = 3;

/// What a look-up has to spare, as a multiple of what it takes: in a scene its table is less often in the cache.
const MARGIN: f64 = 1.5;
/// The same of a whole walk through an N-tree: more than noise.
const MARGIN_IN_CELLS: f64 = 1.1;

/// Whether any-hit rays through the mesh are answered faster with its Line Space.
pub(crate) fn pays(space: &LineSpace, structure: &Structure, kernels: Kernels) -> bool {
    if !space.params().is_conservative() || space.grid().is_none() {
        return false;
    }
    let bounds = structure.bounds();
    let rays = crossing(&bounds);
    let mut decided = Vec::new();
    let asking = least_time(|| {
        decided.clear();
        let mut counters = GateCounters::default();
        let is_decided = |ray: &&Ray| space.verdict(ray, &mut counters) != Verdict::Unknown;
        decided.extend(rays.iter().filter(is_decided).copied());
    });
    let walking = least_time(|| {
        let mut counters = Counters::default();
        let mut hits = 0_u32;
        for ray in &decided {
            let Some(ray) = ObjectRay::new(ray, &bounds) else { continue };
            hits += u32::from(structure.walk(kernels, &ray, 0, &mut AnyHit, &mut counters));
        }
        std::hint::black_box((hits, counters));
    });
    walking.as_secs_f64() > MARGIN * asking.as_secs_f64()
}

/// Whether any-hit rays through an N-tree are answered faster with the Line Spaces of its nodes, by [`MARGIN_IN_CELLS`].
pub(crate) fn pays_in_cells(shafts: &CellShafts, tree: &CellTree, kernels: Kernels) -> bool {
    let bounds = tree.bounds();
    let rays = crossing(&bounds);
    let time = |shafts: Option<&CellShafts>| {
        least_time(|| {
            let mut counters = Counters::default();
            let mut hits = 0_u32;
            for ray in &rays {
                let Some(ray) = ObjectRay::new(ray, &bounds) else { continue };
                hits += u32::from(kernels.walk_cells(tree, shafts, &ray, 0, &mut AnyHit, &mut counters));
            }
            std::hint::black_box((hits, counters));
        })
    };
    time(None).as_secs_f64() > MARGIN_IN_CELLS * time(Some(shafts)).as_secs_f64()
}

fn least_time(mut work: impl FnMut()) -> Duration {
    let time = |work: &mut dyn FnMut()| {
        let started = Instant::now();
        work();
        started.elapsed()
    };
    (0..REPEATS).map(|_| time(&mut work)).min().unwrap_or_default()
}

/// Rays from around the box to points in it, the same ones every time.
fn crossing(bounds: &Aabb) -> Vec<Ray> {
    let mut random = Scatter(1);
    let (center, extent) = (bounds.center(), bounds.extent());
    let mut point = || Vec3::from([(); 3].map(|()| random.unit() as f32 - 0.5));
    let between = |_| {
        let target = center + 0.9 * extent * point();
        let origin = center + 3.0 * extent.length() * point().normalize_or(Vec3::X);
        Ray::new(origin, target - origin)
    };
    (0..RAYS).map(between).collect()
}

struct AnyHit;

impl Sink for AnyHit {
    #[inline(always)]
    fn t_limit(&self) -> f32 {
        f32::INFINITY
    }

    #[inline(always)]
    fn offer(&mut self, _: Hit) -> bool {
        true
    }
}
