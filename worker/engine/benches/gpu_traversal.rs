//! Rays per second of the GPU's traversal kernel beside a plain BVH2 kernel with a private stack, in the same run.
//!
//! `cargo bench -p lightshaft-engine --bench gpu_traversal -- [--rounds 5] [--rays 250000] [--adapter llvmpipe]
//! [--quality medium|high]`
//!
//! Rounds are interleaved, so that a machine's moods meet both alike; the table shows medians. Both kernels walk the
//! same two-level scene with the same primitive test, and their answers are compared.

mod common;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use common::{Random, median, number, terrain, timed, values};
use glam::{Affine3A, Vec3};
use lightshaft_engine::accel::{BuildParams, MeshStructure, Placement, Quality, SceneAccel};
use lightshaft_engine::device::gpu::{Batch, Context, HostStructure, Kernel, MeshView, PlacementView, Tracer};
use lightshaft_engine::scene::Mesh;
use lightshaft_engine::trace::Ray;

struct RaySet {
    name: &'static str,
    any_hit: bool,
    rays: Vec<Ray>,
}

fn main() {
    let context = Context::open(values("--adapter").first().map(String::as_str)).expect("an adapter");
    let mesh = terrain();
    let quality = if values("--quality").iter().any(|q| q == "high") { Quality::High } else { Quality::Medium };
    let params = BuildParams { quality, spatial_splits: false };
    let structure = MeshStructure::build(&mesh, &params, &AtomicBool::new(false)).expect("builds");
    let placement = Placement { mesh: 0, transform: Affine3A::IDENTITY, filtered: false };
    let structure = Arc::new(structure);
    let scene = SceneAccel::build(vec![Arc::clone(&structure)], &[placement]);
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
    let view = MeshView { structure: &structure, positions: &positions, triangles: &mesh.triangles, spheres: &[] };
    let placements = [PlacementView::new(0, Affine3A::IDENTITY, false)];
    let base = HostStructure::baseline(scene.top(), &[view], &placements);
    let (upload_s, wide) = timed(|| HostStructure::wide(&scene, &[view], &placements));
    let base = Tracer::new(&context, &base, Kernel::Baseline).expect("fits");
    let wide = Tracer::new(&context, &wide, Kernel::Product).expect("fits");

    let rounds = number("--rounds", 5);
    println!("{} ({}, {})", context.info.name, context.info.driver, context.info.backend);
    println!(
        "{} triangles; wide layout made in {upload_s:.2} s, {:.1} B/tri (base {:.1}); medians of {rounds} interleaved rounds",
        mesh.triangles.len(),
        wide.bytes() as f64 / mesh.triangles.len() as f64,
        base.bytes() as f64 / mesh.triangles.len() as f64
    );
    println!("{:<24}{:>10}{:>14}{:>14}{:>8}", "", "rays", "base MRays/s", "ours MRays/s", "ratio");
    for set in ray_sets(&mesh, &wide, number("--rays", 250_000)) {
        assert_same_answers(&set, &base, &wide);
        let batches = [&base, &wide].map(|tracer| tracer.prepare(&set.rays, set.any_hit).expect("fits"));
        let mut rates = [vec![], vec![]];
        for round in 0..=rounds {
            for ((tracer, batch), rates) in [&base, &wide].into_iter().zip(&batches).zip(&mut rates) {
                let rate = set.rays.len() as f64 / 1e6 / run(tracer, batch);
                // The first round pays for the driver's compiler.
                if round > 0 {
                    rates.push(rate);
                }
            }
        }
        let [base_rate, our_rate] = rates.map(|mut rates| median(&mut rates));
        println!(
            "{:<24}{:>10}{base_rate:>14.3}{our_rate:>14.3}{:>8.2}",
            set.name,
            set.rays.len(),
            our_rate / base_rate
        );
    }
}

fn run(tracer: &Tracer<'_>, batch: &Batch) -> f64 {
    timed(|| tracer.run(batch).expect("traces")).0
}

fn assert_same_answers(set: &RaySet, base: &Tracer<'_>, wide: &Tracer<'_>) {
    let differing = if set.any_hit {
        let [a, b] = [base, wide].map(|tracer| tracer.occluded(&set.rays).expect("traces"));
        a.iter().zip(&b).filter(|(a, b)| a != b).count()
    } else {
        let [a, b] = [base, wide].map(|tracer| tracer.closest(&set.rays).expect("traces"));
        a.iter().zip(&b).filter(|(a, b)| a != b).count()
    };
    assert!(differing * 100_000 <= set.rays.len(), "{}: {differing} answers differ", set.name);
}

/// Primary rays in image order, and from each point that they hit four AO and four diffuse rays.
fn ray_sets(mesh: &Mesh, tracer: &Tracer<'_>, count: usize) -> Vec<RaySet> {
    let side = ((count / 4) as f64).sqrt() as usize;
    let target = mesh.bounds.center();
    let eye = target + mesh.bounds.extent().length() * Vec3::new(-0.25, 0.21, -0.39);
    let forward = (target - eye).normalize();
    let right = forward.cross(Vec3::Y).normalize();
    let up = right.cross(forward);
    let primary: Vec<Ray> = (0..side * side)
        .map(|i| {
            let at = |k: usize| 2.0 * (k as f32 + 0.5) / side as f32 - 1.0;
            Ray::new(eye, (forward + 0.5 * at(i % side) * right - 0.5 * at(i / side) * up).normalize())
        })
        .collect();
    let reach = mesh.bounds.extent().length() / 7.0;
    let mut random = Random(1);
    let (mut ao, mut diffuse) = (vec![], vec![]);
    for (ray, hit) in primary.iter().zip(tracer.closest(&primary).expect("traces")) {
        let Some(hit) = hit else { continue };
        let [a, b, c] = mesh.triangles[hit.primitive as usize].map(|v| mesh.positions[v as usize]);
        let normal = (b - a).cross(c - a).normalize();
        let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
        let origin = ray.origin + hit.t * ray.direction + 1e-5 * reach * normal;
        for _ in 0..4 {
            let direction = (normal + direction(&mut random)).normalize_or(normal);
            ao.push(Ray { origin, t_min: 0.0, direction, t_max: reach });
            diffuse.push(Ray::new(origin, direction));
        }
    }
    vec![
        RaySet { name: "primary", any_hit: false, rays: primary },
        RaySet { name: "AO, any hit", any_hit: true, rays: ao },
        RaySet { name: "diffuse, closest hit", any_hit: false, rays: diffuse },
    ]
}

/// Uniform over the sphere.
fn direction(random: &mut Random) -> Vec3 {
    let z = 2.0 * random.unit() - 1.0;
    let (sin, cos) = (std::f32::consts::TAU * random.unit()).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, z)
}
