//! Rays per second against a million triangles, beside `obvhs` and a plain loop, in the same run.
//!
//! `cargo bench -p lightshaft-engine --bench traversal -- [--rounds 5] [--threads 2] [--rays 1000000] [--very-slow 1]
//! [--scene FILE.glb]...`
//!
//! Rounds are interleaved, so that a machine's moods meet all alike; the table shows medians. Rays: see `common/rays.rs`.

mod common;
#[path = "common/rays.rs"]
mod rays;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use common::{Random, median, mesh, number, terrain, timed, values};
use glam::{Affine3A, Vec3, Vec3A};
use lightshaft_engine::accel::{BuildParams, Bvh2, MeshStructure, Placement, Quality, SceneAccel};
use lightshaft_engine::scene::{Limits, Mesh, Scene, import_file};
use lightshaft_engine::trace::{Kernels, Ray};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::RayHit;
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;
use rays::{Engine, Ours, ray_sets, trace};

fn main() {
    let threads = number("--threads", 2);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let files = values("--scene");
    if files.is_empty() {
        pool.install(|| run("terrain", &terrain(), threads));
    }
    for file in files {
        let scene = import_file(Path::new(&file), &Limits::default()).expect("a scene");
        pool.install(|| run(&file, &flatten(&scene), threads));
    }
}

/// All instances as one mesh in world space: `obvhs` has no instances of its own.
fn flatten(scene: &Scene) -> Mesh {
    let (mut positions, mut triangles) = (vec![], vec![]);
    for instance in &scene.instances {
        let (from, base) = (&scene.meshes[instance.mesh as usize], positions.len() as u32);
        positions.extend(from.positions.iter().map(|&p| instance.transform.transform_point3(p)));
        triangles.extend(from.triangles.iter().map(|t| t.map(|v| v + base)));
    }
    mesh(positions, triangles, vec![])
}

fn run(name: &str, mesh: &Mesh, threads: usize) {
    let structure = |quality, spatial_splits| {
        let params = BuildParams { quality, spatial_splits };
        let structure = MeshStructure::build(mesh, &params, &AtomicBool::new(false)).expect("builds");
        let placement = Placement { mesh: 0, transform: Affine3A::IDENTITY, filtered: false };
        SceneAccel::build(vec![Arc::new(structure)], &[placement])
    };
    let medium = structure(Quality::Medium, false);
    let plain = Plain::new(medium.structures()[0].bvh2().expect("a BVH").clone(), mesh);
    let mut engines: Vec<(&str, Box<dyn Engine>)> = vec![
        ("obvhs CWBVH medium", Box::new(Obvhs::new(mesh, BvhBuildParams::medium_build()))),
        ("plain BVH2", Box::new(plain)),
        ("lightshaft fast", Box::new(Ours(structure(Quality::Fast, false)))),
        ("lightshaft medium", Box::new(Ours(medium))),
        ("lightshaft high", Box::new(Ours(structure(Quality::High, false)))),
        (
            "lightshaft medium portable",
            Box::new(Ours(structure(Quality::Medium, false).with_kernels(Kernels::Portable))),
        ),
    ];
    if number("--very-slow", 0) != 0 {
        engines.push(("obvhs CWBVH very slow", Box::new(Obvhs::new(mesh, BvhBuildParams::very_slow_build()))));
    }
    // Normals point up: right for most of the terrain, and the same for every engine.
    let surface = |ray: &Ray| Some((ray.origin + engines[3].1.closest(ray)? * ray.direction, Vec3::Y));
    let sets = ray_sets(&mesh.bounds, number("--rays", 1_000_000), surface);
    let rounds = number("--rounds", 5);
    println!(
        "{name}: {} triangles, {threads} threads, medians of {rounds} interleaved rounds, MRays/s (times obvhs medium)",
        mesh.triangles.len()
    );

    let mut rates = vec![vec![vec![]; sets.len()]; engines.len()];
    let mut hits = vec![vec![0; sets.len()]; engines.len()];
    for _ in 0..rounds {
        for (set_number, set) in sets.iter().enumerate() {
            for (number, (_, engine)) in engines.iter().enumerate() {
                let (seconds, count) = timed(|| trace(engine.as_ref(), set));
                rates[number][set_number].push(set.rays.len() as f64 / seconds / 1e6);
                hits[number][set_number] = count;
            }
        }
    }
    print!("{:<28}", "");
    sets.iter().for_each(|set| print!("{:>22}", set.name));
    println!();
    let medians: Vec<Vec<f64>> =
        rates.iter_mut().map(|sets| sets.iter_mut().map(|rates| median(rates)).collect()).collect();
    for (number, (name, _)) in engines.iter().enumerate() {
        print!("{name:<28}");
        for (rate, base) in medians[number].iter().zip(&medians[0]) {
            print!("{:>22}", format!("{rate:.2} ({:.2})", rate / base));
        }
        println!("   hits {:?}", hits[number]);
    }
}

/// `obvhs`, used as its documentation says: triangles in the order of the leaves.
struct Obvhs {
    bvh: CwBvh,
    triangles: Vec<RtTriangle>,
}

impl Obvhs {
    fn new(mesh: &Mesh, params: BvhBuildParams) -> Self {
        let triangles: Vec<Triangle> = mesh
            .triangles
            .iter()
            .map(|t| t.map(|v| Vec3A::from(mesh.positions[v as usize])))
            .map(|[v0, v1, v2]| Triangle { v0, v1, v2 })
            .collect();
        let bvh = build_cwbvh_from_tris(&triangles, params, &mut Duration::default());
        let triangles = bvh.primitive_indices.iter().map(|&i| RtTriangle::from(&triangles[i as usize])).collect();
        Self { bvh, triangles }
    }
}

impl Engine for Obvhs {
    fn closest(&self, ray: &Ray) -> Option<f32> {
        let ray = obvhs::ray::Ray::new(ray.origin.into(), ray.direction.into(), ray.t_min, ray.t_max);
        let mut hit = RayHit::none();
        self.bvh.ray_traverse(ray, &mut hit, |ray, primitive| self.triangles[primitive].intersect(ray)).then_some(hit.t)
    }

    fn occluded(&self, ray: &Ray) -> bool {
        let ray = obvhs::ray::Ray::new(ray.origin.into(), ray.direction.into(), ray.t_min, ray.t_max);
        !self.bvh.ray_traverse_miss(ray, |ray, primitive| self.triangles[primitive].intersect(ray))
    }
}

/// What one writes first: the binary tree, a stack, the nearer child first, Möller-Trumbore.
struct Plain {
    bvh: Bvh2,
    /// In leaf order: a vertex and two edges.
    triangles: Vec<[Vec3A; 3]>,
}

impl Plain {
    fn new(bvh: Bvh2, mesh: &Mesh) -> Self {
        let triangle = |primitive: &u32| {
            let [a, b, c] = mesh.triangles[*primitive as usize].map(|v| Vec3A::from(mesh.positions[v as usize]));
            [a, b - a, c - a]
        };
        let triangles = bvh.primitives.iter().map(triangle).collect();
        Self { bvh, triangles }
    }

    fn walk(&self, ray: &Ray, any_hit: bool) -> Option<f32> {
        let (origin, direction) = (Vec3A::from(ray.origin), Vec3A::from(ray.direction));
        let inverse = direction.recip();
        let mut t_max = ray.t_max;
        let mut found = None;
        let entry = |node: u32, t_max: f32| {
            let node = &self.bvh.nodes[node as usize];
            let a = (Vec3A::from_array(node.min) - origin) * inverse;
            let b = (Vec3A::from_array(node.max) - origin) * inverse;
            let (near, far) = (a.min(b).max_element().max(ray.t_min), a.max(b).min_element().min(t_max));
            (near <= far).then_some(near)
        };
        let mut stack = [(0, 0.0); 128];
        let mut size = usize::from(entry(0, t_max).is_some());
        while size > 0 {
            size -= 1;
            let (index, distance) = stack[size];
            if distance > t_max {
                continue;
            }
            let node = &self.bvh.nodes[index as usize];
            if node.is_leaf() {
                let first = node.right_or_first as usize;
                for [a, e1, e2] in &self.triangles[first..first + node.count as usize] {
                    let p = direction.cross(*e2);
                    let scale = 1.0 / e1.dot(p);
                    let s = origin - a;
                    let q = s.cross(*e1);
                    let (u, v, t) = (s.dot(p) * scale, direction.dot(q) * scale, e2.dot(q) * scale);
                    if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > ray.t_min && t < t_max {
                        (t_max, found) = (t, Some(t));
                        if any_hit {
                            return found;
                        }
                    }
                }
                continue;
            }
            let children = [index + 1, node.right_or_first];
            let mut push = |child: u32, distance: f32| {
                stack[size] = (child, distance);
                size += 1;
            };
            match children.map(|child| entry(child, t_max)) {
                [Some(a), Some(b)] if a <= b => {
                    push(children[1], b);
                    push(children[0], a);
                }
                [Some(a), Some(b)] => {
                    push(children[0], a);
                    push(children[1], b);
                }
                [Some(a), None] => push(children[0], a),
                [None, Some(b)] => push(children[1], b),
                [None, None] => {}
            }
        }
        found
    }
}

impl Engine for Plain {
    fn closest(&self, ray: &Ray) -> Option<f32> {
        self.walk(ray, false)
    }

    fn occluded(&self, ray: &Ray) -> bool {
        self.walk(ray, true).is_some()
    }
}
