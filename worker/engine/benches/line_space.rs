//! What Line Spaces cost and gain: any-hit rays through two-level scenes, without and with.
//!
//! ```text
//! cargo bench --bench line_space -- [--scene FILE]… [--rays COUNT] [--n N] [--resolution R] [--cluster T] [--samples S]
//!                                   [--repeats COUNT] [--surface proven|sampled|none]…
//! ```
//! Without a scene, a generated forest and pile. Per scene: build seconds and bytes, then for shadow and
//! ambient-occlusion rays from points that cameras around the scene see: MRays/s of the plain scene and of each
//! configuration, taken in turn, the median of the ratios, and what was asked and answered. A configuration that is not
//! exact says how many of its rays are wrong.

mod common;
#[path = "common/points.rs"]
mod points;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use common::{Random, median, number, timed, values};
use lightshaft_engine::accel::line_space::{
    ClassLayout, Evidence, LineSpace, LineSpaceParams, Payload, SurfaceShaftParams, SurfaceShafts,
};
use lightshaft_engine::accel::{BuildParams, MeshStructure, SceneAccel, SurfaceStart};
use lightshaft_engine::pack::placements;
use lightshaft_engine::scene::{Limits, Mesh, Params, Scene, generate, import_file};
use lightshaft_engine::trace::{Counters, Ray};
use points::{AcceptAll, ao_rays, shadow_rays, surface_points, trace};

fn main() {
    let files = values("--scene");
    for file in &files {
        let scene = import_file(Path::new(file), &Limits::default()).unwrap_or_else(|error| panic!("{file}: {error}"));
        measure(file, &scene);
    }
    if files.is_empty() {
        for kind in ["forest", "pile"] {
            let folder = tempfile::tempdir().expect("a temporary folder");
            let file = folder.path().join("scene.glb");
            std::fs::write(&file, generate(kind, &Params::default()).expect("a kind")).expect("writes");
            measure(kind, &import_file(&file, &Limits::default()).expect("our own file"));
        }
    }
}

fn measure(name: &str, scene: &Scene) {
    let never = AtomicBool::new(false);
    println!("\n{name}: {} meshes, {} instances", scene.meshes.len(), scene.instances.len());
    let structures: Vec<Arc<MeshStructure>> = scene
        .meshes
        .iter()
        .map(|mesh| Arc::new(MeshStructure::build(mesh, &BuildParams::default(), &never).expect("builds")))
        .collect();
    let classes = LineSpaceParams {
        n: number("--n", 16) as u32,
        payload: Payload::Classes { layout: ClassLayout::Tree, resolution: number("--resolution", 128) as u32 },
    };
    let spaces = built(&classes.canonical(), scene, &structures, |mesh, structure| {
        let space = LineSpace::build(mesh, structure, &classes, u64::MAX, &never).expect("builds");
        (space.bytes(), Arc::new(space))
    });
    let surfaces = |evidence| {
        let params = SurfaceShaftParams { n: 8, cluster: number("--cluster", 128) as u32, evidence };
        built(&params.canonical(), scene, &structures, |mesh, structure| {
            let surface = SurfaceShafts::build(mesh, structure, &params, u64::MAX, &never).expect("builds");
            (surface.bytes(), Arc::new(surface))
        })
    };
    let placements = placements(scene);
    let plain = SceneAccel::build(structures.clone(), &placements);
    let scene_of = || SceneAccel::build(structures.clone(), &placements);
    let gated = || scene_of().with_line_spaces(spaces.clone()).expect("one each");
    let (seconds, measured) = timed(|| gated().asking_where_it_pays());
    let (asked, all) = (measured.asked_line_spaces(), spaces.len());
    println!("  measured in {seconds:.4} s: {asked} of {all} meshes are asked");
    let approximate = gated().approximating_occlusion();
    let mut configurations =
        vec![("box shafts", gated()), ("box shafts where they pay", measured), ("approximate occlusion", approximate)];
    let chosen = values("--surface");
    let wants = |kind: &str| chosen.is_empty() || chosen.iter().any(|chosen| chosen == kind);
    if wants("proven") {
        let proven = surfaces(Evidence::Proven);
        let alone = scene_of().with_surface_shafts(proven.clone()).expect("one each");
        configurations.push(("proven surface shafts", alone));
        let both = gated().with_surface_shafts(proven).expect("one each");
        configurations.push(("box and proven surface shafts", both));
    }
    if wants("sampled") {
        let sampled = surfaces(Evidence::Sampled { rays: number("--samples", 24) as u32 });
        let both = gated().with_surface_shafts(sampled).expect("one each");
        configurations.push(("box and sampled surface shafts", both));
    }
    let points = surface_points(scene, &plain, number("--rays", 400_000) / 8);
    for (kind, rays) in [("shadow", shadow_rays(&plain, &points)), ("ao", ao_rays(&points))] {
        compare(kind, &plain, &configurations, &rays);
    }
}

/// Builds something for each mesh, and says what it took.
fn built<T>(
    what: &str,
    scene: &Scene,
    structures: &[Arc<MeshStructure>],
    build: impl Fn(&Mesh, &MeshStructure) -> (usize, T),
) -> Vec<Option<T>> {
    println!("  {what}");
    let pairs = scene.meshes.iter().zip(structures);
    pairs
        .map(|(mesh, structure)| {
            let (seconds, (bytes, made)) = timed(|| build(mesh, structure));
            let primitives = mesh.primitive_count();
            if primitives >= 1000 {
                let each = bytes as f64 / primitives as f64;
                println!(
                    "    {:24} {primitives:8} primitives: {seconds:7.2} s, {bytes:8} bytes, {each:.2} each",
                    mesh.name
                );
            }
            Some(made)
        })
        .collect()
}

fn occluded(accel: &SceneAccel, rays: &[(Ray, SurfaceStart)]) -> (f64, Vec<bool>, Counters) {
    trace(rays, |(ray, start), counters| accel.occluded_from(ray, start, &AcceptAll, counters))
}

fn compare(kind: &str, plain: &SceneAccel, configurations: &[(&str, SceneAccel)], rays: &[(Ray, SurfaceStart)]) {
    let repeats = number("--repeats", 5);
    let (_, expected, plain_counters) = occluded(plain, rays);
    let mut base = vec![];
    let mut ratios = vec![vec![]; configurations.len()];
    let mut outcomes = vec![None; configurations.len()];
    for _ in 0..repeats {
        for (at, (_, accel)) in configurations.iter().enumerate() {
            let (plain_seconds, ..) = occluded(plain, rays);
            let (seconds, blocked, counters) = occluded(accel, rays);
            base.push(rays.len() as f64 / plain_seconds / 1e6);
            ratios[at].push(plain_seconds / seconds);
            let wrong = blocked.iter().zip(&expected).filter(|(a, b)| a != b).count();
            outcomes[at] = Some((wrong, counters));
        }
    }
    let blocked = expected.iter().filter(|blocked| **blocked).count() as f64 / rays.len() as f64;
    let base = median(&mut base);
    let per_ray = |value: u64| value as f64 / rays.len() as f64;
    println!(
        "  {kind}: {} rays, {:.1} % blocked; plain {base:.3} MRays/s, {:.1} box and {:.1} triangle tests a ray",
        rays.len(),
        100.0 * blocked,
        per_ray(plain_counters.box_tests),
        per_ray(plain_counters.triangle_tests),
    );
    for (at, (name, _)) in configurations.iter().enumerate() {
        let Some((wrong, counters)) = outcomes[at] else { continue };
        let ratio = median(&mut ratios[at]);
        let (least, most) = (ratios[at][0], ratios[at][repeats - 1]);
        let verdict = if ratio < 1.0 { "LOSES" } else { "gains" };
        println!(
            "    {name}: {verdict}, ratio {ratio:.3} ({least:.3} to {most:.3}), {wrong} rays wrong ({:.4} %)",
            100.0 * wrong as f64 / rays.len() as f64
        );
        let gates = counters.gates;
        println!(
            "      per ray {:.1} box and {:.1} triangle tests, {:.2} gates, {:.2} look-ups",
            per_ray(counters.box_tests),
            per_ray(counters.triangle_tests),
            per_ray(gates.rays()),
            per_ray(gates.look_ups()),
        );
        for (class, counts) in
            [("full chord", gates.full_chord), ("ends inside", gates.ends_inside), ("own mesh", gates.own_mesh)]
        {
            let [empty, opaque, mixed] = counts.map(per_ray);
            println!("      {class:14} a ray: EMPTY {empty:.3}  OPAQUE {opaque:.3}  MIXED {mixed:.3}");
        }
        println!(
            "      approximated {:.3}, starts inside {:.3}, beside {:.3}, too far {:.4}",
            per_ray(gates.approximated),
            per_ray(gates.starts_inside),
            per_ray(gates.beside),
            per_ray(gates.too_far)
        );
    }
}
