//! What Line Spaces gain on a GPU: rays through two-level scenes, without and with, in the same run.
//!
//! ```text
//! cargo bench --bench gpu_line_space -- [--scene FILE]… [--rays COUNT] [--n N] [--rounds COUNT] [--adapter NAME]
//! cargo bench --bench gpu_line_space -- --builds [--scene FILE]… [--rounds COUNT] [--adapter NAME]
//! ```
//! With `--builds` the seconds that the CPU and the GPU take to build the Line Space of the largest mesh.
//! Without a scene, a generated forest and pile. Rounds are interleaved; the table shows medians, and what was told.

mod common;
#[path = "common/rays.rs"]
mod rays;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use common::{Random, median, number, timed, values};
use glam::Vec3;
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CastPattern, ClassLayout, LineSpace, LineSpaceParams, Payload,
};
use lightshaft_engine::accel::{BuildParams, MeshStructure, SceneAccel};
use lightshaft_engine::device::gpu::{
    Batch, Context, HostStructure, Kernel, LineSpaceBuilder, MeshView, PlacementView, Tracer,
};
use lightshaft_engine::pack::placements;
use lightshaft_engine::scene::{Limits, Params, Scene, generate, import_file};
use rays::{Ours, RaySet, ray_sets};

fn main() {
    let context = Context::open(values("--adapter").first().map(String::as_str)).expect("an adapter");
    println!("{} ({}, {})", context.info.name, context.info.driver, context.info.backend);
    let context = Arc::new(context);
    let measure = if std::env::args().any(|argument| argument == "--builds") { measure_builds } else { measure };
    let files = values("--scene");
    for file in &files {
        let scene = import_file(Path::new(file), &Limits::default()).unwrap_or_else(|error| panic!("{file}: {error}"));
        measure(&context, file, &scene);
    }
    if files.is_empty() {
        for kind in ["forest", "pile"] {
            let folder = tempfile::tempdir().expect("a temporary folder");
            let file = folder.path().join("scene.glb");
            std::fs::write(&file, generate(kind, &Params::default()).expect("a kind")).expect("writes");
            measure(&context, kind, &import_file(&file, &Limits::default()).expect("our own file"));
        }
    }
}

/// The kinds of build that both devices have, as jobs ask for them.
fn builds() -> Vec<LineSpaceParams> {
    let with = |n, payload| LineSpaceParams { n, payload };
    let cast = |n, pattern| with(n, Payload::Binary { builder: BinaryBuilder::Casting(pattern) });
    vec![
        with(8, Payload::Binary { builder: BinaryBuilder::Masking }),
        cast(10, CastPattern::Centre),
        cast(10, CastPattern::Nine),
        with(10, Payload::Candidates { pattern: CastPattern::Nine }),
        LineSpaceParams::DEFAULT_CLASSES,
        with(32, Payload::Classes { layout: ClassLayout::Tree, resolution: 256 }),
    ]
}

fn measure_builds(context: &Arc<Context>, name: &str, scene: &Scene) {
    let never = AtomicBool::new(false);
    let mesh = scene.meshes.iter().max_by_key(|mesh| mesh.primitive_count()).expect("a mesh");
    let structure = Arc::new(MeshStructure::build(mesh, &BuildParams::default(), &never).expect("builds"));
    let builder = LineSpaceBuilder::new(Arc::clone(context));
    println!("\n{name}: {} triangles", mesh.triangles.len());
    for params in builds() {
        let (mut on_cpu, mut on_gpu, mut longest_s) = (vec![], vec![], 0.0_f64);
        let mut left = 0;
        // The first round pays for the driver's compiler, and for the atlas of masks.
        for round in 0..=number("--rounds", 5) {
            let (cpu_s, expected) = timed(|| LineSpace::build(mesh, &structure, &params, u64::MAX, &never));
            let (gpu_s, built) = timed(|| builder.build(mesh, &structure, &params, u64::MAX, &never));
            let built = built.expect("builds");
            assert!(
                built.on_gpu && built.space == expected.expect("builds"),
                "{params:?} differs: {:?}",
                built.warning
            );
            if round > 0 {
                on_cpu.push(cpu_s);
                on_gpu.push(gpu_s);
                longest_s = longest_s.max(built.longest_submit_s);
            }
            left = built.left_to_cpu;
        }
        println!(
            "  {:<62} CPU {:.3} s, GPU {:.3} s; left to the CPU {left}; longest submit {longest_s:.3} s",
            params.canonical(),
            median(&mut on_cpu),
            median(&mut on_gpu)
        );
    }
}

fn measure(context: &Arc<Context>, name: &str, scene: &Scene) {
    let never = AtomicBool::new(false);
    let n = number("--n", 16) as u32;
    let params = LineSpaceParams { n, payload: Payload::Classes { layout: ClassLayout::Tree, resolution: 128 } };
    let structures: Vec<Arc<MeshStructure>> = scene
        .meshes
        .iter()
        .map(|mesh| Arc::new(MeshStructure::build(mesh, &BuildParams::default(), &never).expect("builds")))
        .collect();
    let spaces: Vec<_> = scene
        .meshes
        .iter()
        .zip(&structures)
        .map(|(mesh, structure)| LineSpace::build(mesh, structure, &params, u64::MAX, &never).expect("builds"))
        .map(|space| Some(Arc::new(space)))
        .collect();
    let placements = placements(scene);
    let plain = Ours(SceneAccel::build(structures.clone(), &placements));
    let gated = || {
        let accel = SceneAccel::build(structures.clone(), &placements);
        accel.with_line_spaces(spaces.clone()).expect("one each")
    };
    let bounds = plain.0.top().bounds();
    let sets = ray_sets(&bounds, number("--rays", 100_000), |ray| {
        let hit = plain.hit(ray)?;
        let instance = &placements[hit.instance as usize];
        let mesh = &scene.meshes[instance.mesh as usize];
        let point = ray.origin + hit.t * ray.direction;
        let normal = mesh.triangles.get(hit.primitive as usize).map_or(-ray.direction, |triangle| {
            let [a, b, c] = triangle.map(|v| instance.transform.transform_point3(mesh.positions[v as usize]));
            (b - a).cross(c - a).normalize_or(Vec3::Y)
        });
        Some((point, if normal.dot(ray.direction) > 0.0 { -normal } else { normal }))
    });

    let positions: Vec<Vec<[f32; 3]>> =
        scene.meshes.iter().map(|mesh| mesh.positions.iter().map(|p| p.to_array()).collect()).collect();
    let spheres: Vec<Vec<[f32; 4]>> = scene
        .meshes
        .iter()
        .map(|mesh| mesh.spheres.iter().map(|s| s.center.extend(s.radius).to_array()).collect())
        .collect();
    let views: Vec<_> = (0..scene.meshes.len())
        .map(|i| MeshView {
            structure: &structures[i],
            positions: &positions[i],
            triangles: &scene.meshes[i].triangles,
            spheres: &spheres[i],
        })
        .collect();
    // Filtered hits would want a scene's materials; what is timed is the walk.
    let placed: Vec<_> = placements.iter().map(|p| PlacementView::new(p.mesh, p.transform, false)).collect();
    let configurations = [("asked always", gated()), ("approximate occlusion", gated().approximating_occlusion())];
    let upload = |accel: &SceneAccel| {
        Tracer::new(context, &HostStructure::wide(accel, &views, &placed), Kernel::Product).expect("fits")
    };
    let base = upload(&plain.0);
    let tracers: Vec<_> = configurations.iter().map(|(name, accel)| (*name, upload(accel))).collect();
    println!("\n{name}: {} meshes, {} instances, {}", scene.meshes.len(), placements.len(), params.canonical());
    for set in &sets {
        compare(set, &base, &tracers);
    }
}

fn compare(set: &RaySet, base: &Tracer<'_>, tracers: &[(&str, Tracer<'_>)]) {
    let batch = |tracer: &Tracer<'_>| tracer.prepare(&set.rays, set.any_hit).expect("fits");
    let run = |tracer: &Tracer<'_>, batch: &Batch| timed(|| tracer.run(batch).expect("traces")).0;
    let base_batch = batch(base);
    let batches: Vec<Batch> = tracers.iter().map(|(_, tracer)| batch(tracer)).collect();
    let mut base_s = vec![];
    let mut seconds = vec![vec![]; tracers.len()];
    // The first round pays for the driver's compiler.
    for round in 0..=number("--rounds", 5) {
        let times: Vec<f64> = tracers.iter().zip(&batches).map(|((_, tracer), batch)| run(tracer, batch)).collect();
        let alone = run(base, &base_batch);
        if round > 0 {
            base_s.push(alone);
            seconds.iter_mut().zip(times).for_each(|(all, time)| all.push(time));
        }
    }
    let base_s = median(&mut base_s);
    println!(
        "  {:<18}{:>10} rays, without {:.3} MRays/s",
        set.name,
        set.rays.len(),
        set.rays.len() as f64 / 1e6 / base_s
    );
    for (((name, tracer), batch), mut seconds) in tracers.iter().zip(&batches).zip(seconds) {
        let told = tracer.gate_counters(batch).expect("reads");
        let share = |count: u64| 100.0 * count as f64 / told.rays().max(1) as f64;
        println!(
            "    {name:<24} ratio {:.2}; asked {:.2} a ray; whole chords EMPTY {:.0} OPAQUE {:.0} MIXED {:.0} %, start inside {:.0} %",
            base_s / median(&mut seconds),
            told.rays() as f64 / (set.rays.len() * (number("--rounds", 5) + 1)) as f64,
            share(told.full_chord[0]),
            share(told.full_chord[1]),
            share(told.full_chord[2]),
            share(told.starts_inside)
        );
    }
}
