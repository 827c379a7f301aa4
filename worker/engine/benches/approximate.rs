//! What the approximate policies gain and how wrong they are: the Pareto front over the two-level BVH of the same run.
//!
//! ```text
//! cargo bench --bench approximate -- [--scene FILE]… [--kind forest|pile|…]… [--rays COUNT] [--repeats COUNT] [--what occlusion|indirect]…
//! ```
//! Without a scene or a kind, a generated forest and pile. From points that cameras around the scene see, eight rays each: to a square light
//! a third as wide as the scene, cosine-distributed without a limit (ambient occlusion), and the same for nearest hits (the first
//! indirect bounce). Per configuration: build seconds and bytes of its Line Spaces, the median ratio to the base taken in turn,
//! the share of rays taken wrongly, and the RMSE of what the eight rays of a point say on average: the part of the light that
//! is seen, or the light that comes back when a hit shines with half of one plus the height of its normal, and a miss with 1.

mod common;
#[path = "common/points.rs"]
mod points;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use common::{Random, median, number, timed, values};
use glam::Vec3;
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CandidateRules, CastPattern, LineSpaceParams, NodeSpaceParams, NodeSpaces, Payload,
};
use lightshaft_engine::accel::{
    AdaptiveRules, Approximation, BouncePolicy, BuildParams, MeshStructure, Purpose, SceneAccel,
};
use lightshaft_engine::pack::placements;
use lightshaft_engine::scene::{Limits, Params, Scene, generate, import_file};
use lightshaft_engine::trace::{Counters, Hit, Ray};
use points::{AcceptAll, ao_rays, shadow_rays, surface_points, trace};

/// Rays of a point, next to each other in every set.
const EACH: usize = 8;

fn main() {
    for file in values("--scene") {
        let scene = import_file(Path::new(&file), &Limits::default()).unwrap_or_else(|error| panic!("{file}: {error}"));
        measure(&file, &scene);
    }
    let mut kinds = values("--kind");
    if kinds.is_empty() && values("--scene").is_empty() {
        kinds = vec!["forest".to_owned(), "pile".to_owned()];
    }
    for kind in kinds {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("scene.glb");
        std::fs::write(&file, generate(&kind, &Params::default()).expect("a kind")).expect("writes");
        measure(&kind, &import_file(&file, &Limits::default()).expect("our own file"));
    }
}

struct Configuration {
    name: String,
    accel: SceneAccel,
}

fn rules(policy: BouncePolicy) -> Approximation {
    let (adaptive, candidates) = (AdaptiveRules::default(), CandidateRules::default());
    Approximation { bounces: vec![policy], exact_origin: true, origin_reach: 0.0, adaptive, candidates }
}

fn measure(name: &str, scene: &Scene) {
    let never = AtomicBool::new(false);
    println!("\n{name}: {} meshes, {} instances", scene.meshes.len(), scene.instances.len());
    let structures: Vec<Arc<MeshStructure>> = scene
        .meshes
        .iter()
        .map(|mesh| Arc::new(MeshStructure::build(mesh, &BuildParams::default(), &never).expect("builds")))
        .collect();
    let placements = placements(scene);
    let plain = SceneAccel::build(structures.clone(), &placements);
    let nodes = |params: &NodeSpaceParams| -> Vec<Option<Arc<NodeSpaces>>> {
        let pairs = scene.meshes.iter().zip(&structures);
        let (seconds, built) = timed(|| {
            pairs
                .map(|(mesh, structure)| NodeSpaces::build(mesh, structure, params, u64::MAX, &never).expect("builds"))
                .map(|spaces| Some(Arc::new(spaces)))
                .collect::<Vec<_>>()
        });
        let bytes: usize = built.iter().flatten().map(|spaces| spaces.bytes()).sum();
        let count: usize = built.iter().flatten().map(|spaces| spaces.count()).sum();
        println!("  {}: {count} line spaces, {:.2} MB, {seconds:.2} s", params.canonical(), bytes as f64 / 1e6);
        built
    };
    let configured = |name: String, nodes: &[Option<Arc<NodeSpaces>>], rules: Approximation| {
        let accel = SceneAccel::build(structures.clone(), &placements);
        Configuration { name, accel: accel.approximating(nodes.to_vec(), rules).expect("one each") }
    };
    let points = surface_points(scene, &plain, number("--rays", 200_000) / EACH);
    let chosen = values("--what");
    let wants = |what: &str| chosen.is_empty() || chosen.iter().any(|chosen| chosen == what);
    if wants("occlusion") {
        let mut configurations = vec![];
        let cast = Payload::Binary { builder: BinaryBuilder::Casting(CastPattern::Nine) };
        for (n, depth, payload, label) in [
            (6, 6, cast, "binary"),
            (16, 2, cast, "binary"),
            (8, 1, Payload::Coverage { bits: 8, rays: 16 }, "coverage"),
        ] {
            let nodes = nodes(&NodeSpaceParams { each: LineSpaceParams { n, payload }, depth });
            for exact_origin in [true, false] {
                for delta in [1.0, 4.0, 1e6] {
                    let adaptive = AdaptiveRules { delta, exact_origin, ..AdaptiveRules::default() };
                    let rules = Approximation { adaptive, ..rules(BouncePolicy::Adaptive) };
                    let origin = if exact_origin { "exact" } else { "nodes" };
                    let name = format!("adaptive {label} N={n} d={depth} delta={delta} own object {origin}");
                    configurations.push(configured(name, &nodes, rules));
                }
            }
            let name = format!("approximate_occlusion {label} N={n} d={depth}");
            configurations.push(configured(name, &nodes, rules(BouncePolicy::Occlusion)));
        }
        for (kind, rays) in [("shadow", shadow_rays(&plain, &points)), ("ao", ao_rays(&points))] {
            let rays: Vec<Ray> = rays.into_iter().map(|(ray, _)| ray).collect();
            let width = plain.top().bounds().extent().max_element() / 3.0;
            let is_ambient = kind == "ao";
            let purpose = |ray: &Ray| {
                let light = if is_ambient { 1.0 } else { width / ray.direction.length() };
                Purpose { bounce: 0, light, is_ambient }
            };
            compare(kind, &plain, &configurations, &rays, |accel, ray, counters| {
                f32::from(!accel.blocked(ray, purpose(ray), &AcceptAll, counters))
            });
        }
    }
    if wants("indirect") {
        let mut configurations = vec![];
        for (n, depth) in [(6, 0), (6, 4), (6, 8), (10, 0)] {
            let payload = Payload::Candidates { pattern: CastPattern::Nine };
            let nodes = nodes(&NodeSpaceParams { each: LineSpaceParams { n, payload }, depth });
            for exact_origin in [true, false] {
                let candidates = CandidateRules { exact_origin, ..CandidateRules::default() };
                let rules = Approximation { candidates, ..rules(BouncePolicy::Representative) };
                let origin = if exact_origin { "exact" } else { "approximate" };
                let name = format!("representative N={n} d={depth} origin {origin}");
                configurations.push(configured(name, &nodes, rules));
            }
        }
        let rays: Vec<Ray> = ao_rays(&points).into_iter().map(|(ray, _)| ray).collect();
        compare("indirect", &plain, &configurations, &rays, |accel, ray, counters| {
            accel.nearest(ray, 1, &AcceptAll, counters).map_or(1.0, |hit| shine(scene, &hit))
        });
    }
}

/// Half of one plus the height of the normal at a hit, whose triangle's plane may go on beyond it.
fn shine(scene: &Scene, hit: &Hit) -> f32 {
    let instance = &scene.instances[hit.instance as usize];
    let mesh = &scene.meshes[instance.mesh as usize];
    let Some(&triangle) = mesh.triangles.get(hit.primitive as usize) else { return 0.5 };
    let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
    let normal = match mesh.normals.is_empty() {
        true => (b - a).cross(c - a),
        false => {
            let [a, b, c] = triangle.map(|v| mesh.normals[v as usize]);
            (1.0 - hit.u - hit.v) * a + hit.u * b + hit.v * c
        }
    };
    let normal: Vec3 = (instance.transform.matrix3.inverse().transpose() * normal).normalize_or_zero();
    0.5 + 0.5 * normal.y.abs()
}

fn compare(
    kind: &str,
    plain: &SceneAccel,
    configurations: &[Configuration],
    rays: &[Ray],
    ask: impl Fn(&SceneAccel, &Ray, &mut Counters) -> f32 + Sync,
) {
    let repeats = number("--repeats", 3);
    let (_, expected, _) = trace(rays, |ray, counters| ask(plain, ray, counters));
    let mut ratios = vec![vec![]; configurations.len()];
    let mut base = vec![];
    let mut outcomes = vec![None; configurations.len()];
    for _ in 0..repeats {
        for (at, configuration) in configurations.iter().enumerate() {
            let (plain_seconds, ..) = trace(rays, |ray, counters| ask(plain, ray, counters));
            let (seconds, said, counters) = trace(rays, |ray, counters| ask(&configuration.accel, ray, counters));
            base.push(rays.len() as f64 / plain_seconds / 1e6);
            ratios[at].push(plain_seconds / seconds);
            outcomes[at] = Some((errors(&said, &expected), counters));
        }
    }
    println!("  {kind}: {} rays, plain {:.2} MRays/s", rays.len(), median(&mut base));
    println!("    {:58} {:>6} {:>8} {:>7} {:>9} {:>9}", "", "ratio", "wrong %", "RMSE", "look-ups", "approx.");
    for (at, configuration) in configurations.iter().enumerate() {
        let Some(([wrong, rmse], counters)) = outcomes[at] else { continue };
        let per_ray = |value: u64| value as f64 / rays.len() as f64;
        println!(
            "    {:58} {:6.3} {:8.3} {:7.4} {:9.2} {:9.2}",
            configuration.name,
            median(&mut ratios[at]),
            100.0 * wrong,
            rmse,
            per_ray(counters.gates.node_look_ups),
            per_ray(counters.gates.approximated),
        );
    }
}

/// The share of rays that say something else, and the root of the mean squared error of the points' averages.
fn errors(said: &[f32], expected: &[f32]) -> [f64; 2] {
    let wrong = said.iter().zip(expected).filter(|(a, b)| (*a - *b).abs() > 0.02).count();
    let squares = said.chunks(EACH).zip(expected.chunks(EACH)).map(|(said, expected)| {
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        f64::from(mean(said) - mean(expected)).powi(2)
    });
    let points = said.len().div_ceil(EACH) as f64;
    [wrong as f64 / said.len() as f64, (squares.sum::<f64>() / points).sqrt()]
}
