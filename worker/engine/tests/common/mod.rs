//! Meshes, rays and a tree-less oracle for the tests of structures and kernels.
#![allow(dead_code, reason = "each test binary uses its part")]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, DVec3, Vec3};
use lightshaft_engine::accel::{BuildParams, HitFilter, MeshStructure, Placement, Quality, SceneAccel};
use lightshaft_engine::scene::{Aabb, Mesh, MeshHash, Sphere};
use lightshaft_engine::trace::{Counters, Hit, Kernels, Ray};

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

/// SplitMix64: small, good enough, and the same everywhere.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub(crate) fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1 << 24) as f32
    }

    pub(crate) fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit())
    }

    pub(crate) fn direction(&mut self) -> Vec3 {
        let z = 2.0 * self.unit() - 1.0;
        let (sin, cos) = (std::f32::consts::TAU * self.unit()).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * cos, r * sin, z)
    }
}

pub(crate) fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, spheres: Vec<Sphere>) -> Mesh {
    let mut bounds = Aabb::EMPTY;
    positions.iter().for_each(|&p| bounds.grow(p));
    for sphere in &spheres {
        bounds.grow(sphere.center - sphere.radius);
        bounds.grow(sphere.center + sphere.radius);
    }
    Mesh {
        hash: MeshHash([7; 32]),
        name: "test".into(),
        triangle_slots: vec![0; triangles.len()],
        positions,
        triangles,
        normals: vec![],
        tangents: vec![],
        uv0: vec![],
        uv1: vec![],
        colors: vec![],
        spheres,
        slots: 1,
        bounds,
    }
}

/// Separate random triangles in the unit cube.
pub(crate) fn soup(count: usize, size: f32, seed: u64) -> Mesh {
    let mut random = Random(seed);
    let positions = (0..count)
        .flat_map(|_| {
            let center = random.point();
            [(); 3].map(|()| center + size * (random.point() - 0.5))
        })
        .collect();
    mesh(positions, (0..count as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(), vec![])
}

pub(crate) fn spheres(count: usize, radius: f32, seed: u64) -> Vec<Sphere> {
    let mut random = Random(seed);
    (0..count).map(|_| Sphere { center: random.point(), radius: radius * (0.2 + random.unit()), slot: 0 }).collect()
}

/// A closed, bumpy ball of `2 * rings * rings` or so triangles that share their vertices.
pub(crate) fn ball(rings: u32, center: Vec3, radius: f32) -> Mesh {
    let columns = 2 * rings;
    let mut positions = vec![center + Vec3::Z * radius];
    for ring in 1..rings {
        for column in 0..columns {
            let theta = std::f32::consts::PI * ring as f32 / rings as f32;
            let phi = std::f32::consts::TAU * column as f32 / columns as f32;
            let bump = 1.0 + 0.1 * (5.0 * phi).sin() * (7.0 * theta).sin();
            let direction = Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
            positions.push(center + radius * bump * direction);
        }
    }
    positions.push(center - Vec3::Z * radius);
    let last = positions.len() as u32 - 1;
    let vertex = |ring: u32, column: u32| match ring {
        0 => 0,
        r if r == rings => last,
        r => 1 + (r - 1) * columns + column % columns,
    };
    let mut triangles = vec![];
    for ring in 0..rings {
        for column in 0..columns {
            let [a, b] = [vertex(ring, column), vertex(ring, column + 1)];
            let [c, d] = [vertex(ring + 1, column), vertex(ring + 1, column + 1)];
            if ring > 0 {
                triangles.push([a, c, b]);
            }
            if ring + 1 < rings {
                triangles.push([b, c, d]);
            }
        }
    }
    mesh(positions, triangles, vec![])
}

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
