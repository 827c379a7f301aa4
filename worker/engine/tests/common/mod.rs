//! Meshes, rays and a tree-less oracle for the tests of structures and kernels.
#![allow(dead_code, reason = "each test binary uses its part")]

mod meshes;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, DVec3, Vec3};
use lightshaft_engine::accel::line_space::ShaftGrid;
use lightshaft_engine::accel::{BuildParams, HitFilter, MeshStructure, Placement, Quality, SceneAccel};
use lightshaft_engine::scene::{Aabb, Mesh};
use lightshaft_engine::trace::{Counters, Hit, Kernels, Ray};

pub(crate) use meshes::*;

pub(crate) const ALL_PARAMS: [BuildParams; 6] = {
    const fn params(quality: Quality, spatial_splits: bool) -> BuildParams {
        BuildParams { quality, spatial_splits }
    }
    [
        params(Quality::Fast, false),
        params(Quality::Medium, false),
        params(Quality::High, false),
        params(Quality::Fast, true),
        params(Quality::Medium, true),
        params(Quality::High, true),
    ]
};

pub(crate) fn build(mesh: &Mesh, params: BuildParams) -> MeshStructure {
    let structure = MeshStructure::build(mesh, &params, &AtomicBool::new(false)).expect("builds");
    structure.validate(mesh).expect("is valid");
    structure
}

pub(crate) fn place(transform: Affine3A) -> Placement {
    Placement { mesh: 0, transform, filtered: false }
}

/// The mesh alone, where it is.
pub(crate) fn scene(mesh: &Mesh, params: BuildParams) -> SceneAccel {
    SceneAccel::build(vec![Arc::new(build(mesh, params))], &[place(Affine3A::IDENTITY)])
}

/// The same scene for each of this CPU's kernels.
pub(crate) fn scenes(mesh: &Mesh, params: BuildParams) -> Vec<SceneAccel> {
    Kernels::available().into_iter().map(|kernels| scene(mesh, params).with_kernels(kernels)).collect()
}

pub(crate) struct AcceptAll;

impl HitFilter for AcceptAll {
    fn accept(&self, _: &Ray, _: &Hit) -> bool {
        true
    }
}

pub(crate) fn closest(scene: &SceneAccel, ray: &Ray) -> Option<Hit> {
    scene.closest(ray, &AcceptAll, &mut Counters::default())
}

pub(crate) fn occluded(scene: &SceneAccel, ray: &Ray) -> bool {
    scene.occluded(ray, &AcceptAll, &mut Counters::default())
}

/// All hits of a ray on a primitive in double precision: Möller-Trumbore, and the textbook quadratic for spheres.
fn exact_hits(mesh: &Mesh, primitive: usize, ray: &Ray) -> Vec<(f64, f64, f64)> {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let Some(triangle) = mesh.triangles.get(primitive) else {
        let sphere = &mesh.spheres[primitive - mesh.triangles.len()];
        let f = o - sphere.center.as_dvec3();
        let (a, b) = (d.length_squared(), f.dot(d));
        let r = f64::from(sphere.radius);
        let nearest: DVec3 = f - b / a * d;
        let discriminant = a * (r * r - nearest.length_squared());
        if discriminant.is_nan() || discriminant < 0.0 {
            return vec![];
        }
        return vec![((-b - discriminant.sqrt()) / a, 0.0, 0.0), ((-b + discriminant.sqrt()) / a, 0.0, 0.0)];
    };
    let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
    let (e1, e2, s) = (b - a, c - a, o - a);
    let p = d.cross(e2);
    let determinant = e1.dot(p);
    let (u, v) = (s.dot(p) / determinant, d.dot(s.cross(e1)) / determinant);
    let hit = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
    if hit { vec![(e2.dot(s.cross(e1)) / determinant, u, v)] } else { vec![] }
}

/// What an infinitely patient and precise tracer finds: `t`, `u`, `v` and the primitive.
pub(crate) fn oracle(mesh: &Mesh, ray: &Ray) -> Option<(f64, f64, f64, u32)> {
    (0..mesh.primitive_count())
        .flat_map(|p| exact_hits(mesh, p, ray).into_iter().map(move |(t, u, v)| (t, u, v, p as u32)))
        .filter(|hit| hit.0 > f64::from(ray.t_min.max(0.0)) && hit.0 < f64::from(ray.t_max))
        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.3.cmp(&b.3)))
}

/// A ray that reaches into the mesh's surroundings, in the manner of cameras, bounces and shadow rays.
pub(crate) fn random_ray(random: &mut Random, bounds: &Aabb) -> Ray {
    let at = |random: &mut Random, grow: f32| bounds.center() + (1.0 + grow) * (random.point() - 0.5) * bounds.extent();
    let grow = if random.next().is_multiple_of(2) { 2.0 } else { 0.0 };
    let origin = at(random, grow);
    let direction = match random.next() % 4 {
        0 => [Vec3::X, Vec3::NEG_Y, Vec3::Z][random.next() as usize % 3] * bounds.extent(),
        1 => random.direction() * bounds.extent().length(),
        _ => at(random, 0.0) - origin,
    };
    let t_max = if random.next().is_multiple_of(3) { random.unit() } else { f32::INFINITY };
    Ray { origin, t_min: 0.0, direction, t_max }
}

/// A ray that comes from near or far, and often along an axis, an edge or a corner.
pub(crate) fn hard_ray(random: &mut Random, grid: &ShaftGrid, bounds: &Aabb) -> Ray {
    let mut ray = random_ray(random, bounds);
    let extent = bounds.extent().max(Vec3::splat(bounds.extent().max_element() / 256.0));
    let border = |random: &mut Random| {
        let step = |random: &mut Random| (random.next() % u64::from(grid.n() + 1)) as f64 / f64::from(grid.n());
        grid.from_unit(DVec3::new(step(random), step(random), step(random))).as_vec3()
    };
    match random.next() % 8 {
        0 => ray.direction[random.next() as usize % 3] = 0.0,
        1 => ray.origin = border(random),
        2 => ray.direction = border(random) - ray.origin,
        3 => {
            ray.origin = border(random);
            ray.direction = border(random) - ray.origin;
        }
        4 => ray.origin -= ray.direction.normalize_or_zero() * extent.max_element() * 100.0 * random.unit(),
        5 => ray.direction[random.next() as usize % 3] *= 1e-12,
        6 => ray.t_min = random.unit(),
        _ => {}
    }
    if ray.direction == Vec3::ZERO {
        ray.direction = extent;
    }
    ray
}
