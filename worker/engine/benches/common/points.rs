//! Points on what cameras around a scene see, and the rays that renderers send from there: the same in every run; and
//! tracing them.

use glam::Vec3;
use lightshaft_engine::accel::{HitFilter, SceneAccel, SurfaceStart};
use lightshaft_engine::scene::Scene;
use lightshaft_engine::trace::{Counters, Hit, Ray};
use rayon::prelude::*;

use crate::{Random, timed};

pub(crate) struct AcceptAll;

impl HitFilter for AcceptAll {
    fn accept(&self, _: &Ray, _: &Hit) -> bool {
        true
    }
}

/// A point above a surface, the normal there towards who sees it, and which surface it is.
pub(crate) struct Point {
    pub position: Vec3,
    pub normal: Vec3,
    instance: u32,
    triangle: u32,
    /// Whether the normal is that of the side from which the triangle's corners run counter-clockwise.
    is_front: bool,
}

/// What cameras on a sphere around the scene see of it.
pub(crate) fn surface_points(scene: &Scene, accel: &SceneAccel, count: usize) -> Vec<Point> {
    let bounds = accel.top().bounds();
    let (center, radius) = (bounds.center(), 0.5 * bounds.extent().length());
    let mut random = Random(7);
    let mut points = Vec::with_capacity(count);
    let mut tries = 0;
    while points.len() < count && tries < 100 * count {
        tries += 1;
        // Eight neighbouring pixels of one camera, as a renderer's tile has them.
        let eye = center + radius * direction(&mut random) * Vec3::new(1.0, 0.6, 1.0);
        let target = center + (Vec3::new(random.unit(), random.unit(), random.unit()) - 0.5) * bounds.extent() * 0.8;
        for _ in 0..8 {
            let ray = Ray::new(eye, (target - eye).normalize() + 0.01 * direction(&mut random));
            let Some(hit) = accel.closest(&ray, &AcceptAll, &mut Counters::default()) else { continue };
            let instance = &scene.instances[hit.instance as usize];
            let mesh = &scene.meshes[instance.mesh as usize];
            let Some(triangle) = mesh.triangles.get(hit.primitive as usize) else { continue };
            let [a, b, c] = triangle.map(|v| instance.transform.transform_point3(mesh.positions[v as usize]));
            let front = (b - a).cross(c - a).normalize_or_zero() * instance.transform.matrix3.determinant().signum();
            let is_front = front.dot(ray.direction) < 0.0;
            let normal = if is_front { front } else { -front };
            if normal != Vec3::ZERO {
                let position = ray.origin + hit.t * ray.direction + 1e-5 * radius * normal;
                let (instance, triangle) = (hit.instance, hit.primitive);
                points.push(Point { position, normal, instance, triangle, is_front });
            }
        }
    }
    points
}

impl Point {
    fn start(&self) -> SurfaceStart {
        SurfaceStart { instance: self.instance, triangle: self.triangle, is_front: self.is_front }
    }
}

fn direction(random: &mut Random) -> Vec3 {
    let z = 2.0 * random.unit() - 1.0;
    let (sin, cos) = (std::f32::consts::TAU * random.unit()).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, z)
}

/// Eight rays a point to a square light above the scene, as wide as a third of it.
pub(crate) fn shadow_rays(accel: &SceneAccel, points: &[Point]) -> Vec<(Ray, SurfaceStart)> {
    let bounds = accel.top().bounds();
    let extent = bounds.extent();
    let mut random = Random(8);
    let mut rays = Vec::with_capacity(8 * points.len());
    for point in points {
        for _ in 0..8 {
            let spread = Vec3::new(random.unit() - 0.5, 0.0, random.unit() - 0.5) * extent / 3.0;
            let light = bounds.center() + Vec3::new(0.3, 1.2, 0.2) * extent.max_element() + spread;
            let to_light = light - point.position;
            if to_light.dot(point.normal) > 0.0 {
                let ray = Ray { origin: point.position, t_min: 0.0, direction: to_light, t_max: 1.0 };
                rays.push((ray, point.start()));
            }
        }
    }
    rays
}

/// Eight cosine-distributed rays a point, without a limit.
pub(crate) fn ao_rays(points: &[Point]) -> Vec<(Ray, SurfaceStart)> {
    let mut random = Random(9);
    let mut rays = Vec::with_capacity(8 * points.len());
    for point in points {
        for _ in 0..8 {
            let direction = (point.normal + 0.999 * direction(&mut random)).normalize();
            rays.push((Ray::new(point.position, direction), point.start()));
        }
    }
    rays
}

/// Asks about all rays on all cores: seconds, what each says, and what it took.
pub(crate) fn trace<R: Sync, A: Send>(
    rays: &[R],
    ask: impl Fn(&R, &mut Counters) -> A + Sync,
) -> (f64, Vec<A>, Counters) {
    let (seconds, parts) = timed(|| {
        rays.par_chunks(4096)
            .map(|rays| {
                let mut counters = Counters::default();
                let said: Vec<A> = rays.iter().map(|ray| ask(ray, &mut counters)).collect();
                (said, counters)
            })
            .collect::<Vec<_>>()
    });
    let mut counters = Counters::default();
    let mut said = Vec::with_capacity(rays.len());
    for (part, counted) in parts {
        said.extend(part);
        counters += counted;
    }
    (seconds, said, counters)
}
