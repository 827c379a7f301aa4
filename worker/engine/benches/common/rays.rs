//! The rays that the CPU benchmarks trace: the same in every run.
#![allow(dead_code, reason = "each benchmark uses its part")]

use glam::Vec3;
use lightshaft_engine::accel::{HitFilter, SceneAccel};
use lightshaft_engine::scene::Aabb;
use lightshaft_engine::trace::{Counters, Hit, Ray};
use rayon::prelude::*;

use crate::Random;

pub(crate) struct RaySet {
    pub name: &'static str,
    pub any_hit: bool,
    pub rays: Vec<Ray>,
}

/// Something that traces rays.
pub(crate) trait Engine: Sync {
    /// Distance of the nearest hit.
    fn closest(&self, ray: &Ray) -> Option<f32>;
    fn occluded(&self, ray: &Ray) -> bool;
}

/// Our own kernels, with nothing to filter.
pub(crate) struct Ours(pub SceneAccel);

struct AcceptAll;

impl HitFilter for AcceptAll {
    fn accept(&self, _: &Ray, _: &Hit) -> bool {
        true
    }
}

impl Ours {
    pub(crate) fn hit(&self, ray: &Ray) -> Option<Hit> {
        self.0.closest(ray, &AcceptAll, &mut Counters::default())
    }
}

impl Engine for Ours {
    fn closest(&self, ray: &Ray) -> Option<f32> {
        self.hit(ray).map(|hit| hit.t)
    }

    fn occluded(&self, ray: &Ray) -> bool {
        self.0.occluded(ray, &AcceptAll, &mut Counters::default())
    }
}

/// Traces all rays of a set in rayon's pool; how many hit anything.
pub(crate) fn trace(engine: &dyn Engine, set: &RaySet) -> usize {
    let count = |rays: &[Ray]| {
        rays.iter().filter(|ray| if set.any_hit { engine.occluded(ray) } else { engine.closest(ray).is_some() }).count()
    };
    set.rays.par_chunks(4096).map(count).sum()
}

/// About `count` primary rays in image order, then from the points that they hit AO rays (any hit, up to a seventh of
/// the scene) and diffuse rays (closest hit) in an order that no cache likes. `surface` gives the point that a ray meets
/// and the normal on its side.
pub(crate) fn ray_sets(bounds: &Aabb, count: usize, surface: impl Fn(&Ray) -> Option<(Vec3, Vec3)>) -> Vec<RaySet> {
    let side = (count as f64).sqrt() as usize;
    let target = bounds.center();
    let eye = target + bounds.extent().length() * Vec3::new(-0.25, 0.21, -0.39);
    let forward = (target - eye).normalize();
    let right = forward.cross(Vec3::Y).normalize();
    let up = right.cross(forward);
    let primary: Vec<Ray> = (0..side * side)
        .map(|i| {
            let [x, y] = [i % side, i / side].map(|i| 1.1 * ((i as f32 + 0.5) / side as f32 - 0.5));
            Ray::new(eye, (forward + x * right - y * up).normalize())
        })
        .collect();
    let points: Vec<(Vec3, Vec3)> = primary.iter().filter_map(surface).collect();
    assert!(!points.is_empty(), "no primary ray hits anything");
    let mut random = Random(7);
    let reach = bounds.extent().max_element() / 7.0;
    let mut scattered = |t_max: f32| -> Vec<Ray> {
        (0..count)
            .map(|_| {
                let (point, normal) = points[random.next() as usize % points.len()];
                let (sin, cos) = (std::f32::consts::TAU * random.unit()).sin_cos();
                let z = random.unit().sqrt();
                let r = (1.0 - z * z).sqrt();
                let (tangent, bitangent) = normal.any_orthonormal_pair();
                let direction = r * cos * tangent + r * sin * bitangent + z * normal;
                Ray { origin: point + 1e-4 * reach * normal, t_min: 0.0, direction, t_max }
            })
            .collect()
    };
    let (ao, diffuse) = (scattered(reach), scattered(f32::INFINITY));
    vec![
        RaySet { name: "primary", any_hit: false, rays: primary },
        RaySet { name: "AO any-hit", any_hit: true, rays: ao },
        RaySet { name: "diffuse closest", any_hit: false, rays: diffuse },
    ]
}
