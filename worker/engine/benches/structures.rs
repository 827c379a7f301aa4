//! Rays per second, memory and build time of every acceleration structure beside the two-level BVH, in the same run.
//!
//! `cargo bench -p lightshaft-engine --bench structures -- [--rounds 5] [--threads 2] [--rays 500000]
//! [--scene FILE.glb]... [--only PREFIX]... [--patches N]...`
//!
//! Each N-tree is also measured with the Line Spaces of its nodes (`--patches N`: also of so many patches), right behind it;
//! the ratio in brackets is to the tree without.
//!
//! Rounds are interleaved, so that a machine's moods meet all alike; the table shows medians, and in brackets the ratio
//! to `two_level`. Rays: see `common/rays.rs`.

#[path = "common/mod.rs"]
mod common;
#[path = "common/rays.rs"]
mod rays;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use common::{Random, median, number, terrain, timed, values};
use glam::{Affine3A, Vec3};
use lightshaft_engine::accel::{
    BuildParams, CellShaftParams, CellShafts, GridParams, GridResolution, NTreeParams, OctreeParams, Placement,
    Quality, SceneAccel, Structure, StructureParams, flatten,
};
use lightshaft_engine::pack::placements;
use lightshaft_engine::scene::{Limits, Mesh, import_file};
use lightshaft_engine::trace::Ray;
use rays::{Ours, ray_sets, trace};

fn main() {
    let threads = number("--threads", 2);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let files = values("--scene");
    if files.is_empty() {
        let placement = Placement { mesh: 0, transform: Affine3A::IDENTITY, filtered: false };
        pool.install(|| run("terrain", &[Arc::new(terrain())], &[placement], threads));
    }
    for file in files {
        let scene = import_file(Path::new(&file), &Limits::default()).expect("a scene");
        pool.install(|| run(&file, &scene.meshes, &placements(&scene), threads));
    }
}

/// What is compared, all over the whole scene.
fn flat_structures() -> Vec<(&'static str, StructureParams)> {
    let budget_bytes = 8 << 30;
    let bvh = |quality| StructureParams::Bvh(BuildParams { quality, spatial_splits: false });
    let grid =
        |cells| StructureParams::Grid(GridParams { resolution: GridResolution::PerPrimitive(cells), budget_bytes });
    let ntree = |n, depth| StructureParams::NTree(NTreeParams { n, depth, max_leaf: 8, budget_bytes });
    let asked = values("--only");
    vec![
        ("bvh medium", bvh(Quality::Medium)),
        ("bvh high", bvh(Quality::High)),
        ("grid, 4 cells/primitive", grid(4)),
        ("octree, depth 12", StructureParams::Octree(OctreeParams { depth: 12, max_leaf: 8, budget_bytes })),
        ("ntree (4, 5)", ntree(4, 5)),
        ("ntree (6, 3)", ntree(6, 3)),
        ("ntree (6, 4)", ntree(6, 4)),
        ("ntree (8, 3)", ntree(8, 3)),
        ("ntree (10, 3)", ntree(10, 3)),
    ]
    .into_iter()
    .filter(|(name, _)| asked.is_empty() || asked.iter().any(|asked| name.starts_with(asked.as_str())))
    .collect()
}

/// The Line Spaces of an N-tree's nodes that are compared: `--patches N` for each is in all levels, none stands for the default.
fn shaft_params(levels: u32) -> Vec<(String, CellShaftParams)> {
    let mut all = vec![];
    for levels in [1, levels - 1] {
        all.push((format!("  + {levels} levels"), CellShaftParams { levels, patches: None }));
        for patches in values("--patches").iter().map(|value| value.parse().expect("--patches wants a number")) {
            let label = format!("  + {levels} levels, {patches} patches");
            all.push((label, CellShaftParams { levels, patches: Some(patches) }));
        }
    }
    all
}

struct Candidate {
    name: String,
    build_s: f64,
    bytes: usize,
    nodes: usize,
    /// The candidate that its ratios are to.
    base: usize,
    scene: Ours,
}

impl Candidate {
    fn new(name: String, build_s: f64, scene: SceneAccel) -> Self {
        let bytes = scene.structures().iter().map(Structure::bytes).sum::<usize>() + scene.top_bytes();
        let nodes = scene.structures().iter().map(Structure::node_count).sum::<usize>() + scene.top().nodes.len();
        Self { name, build_s, bytes, nodes, base: 0, scene: Ours(scene) }
    }
}

fn two_level(meshes: &[Arc<Mesh>], placements: &[Placement], quality: Quality) -> SceneAccel {
    let params = StructureParams::Bvh(BuildParams { quality, spatial_splits: false });
    let build = |mesh: &Arc<Mesh>| Structure::build(mesh, &params, &AtomicBool::new(false)).expect("builds");
    SceneAccel::build(meshes.iter().map(build).collect(), placements)
}

fn run(name: &str, meshes: &[Arc<Mesh>], placements: &[Placement], threads: usize) {
    let mut candidates = vec![];
    for (name, quality) in [("two_level", Quality::Medium), ("two_level high", Quality::High)] {
        let (build_s, scene) = timed(|| two_level(meshes, placements, quality));
        candidates.push(Candidate::new(name.to_owned(), build_s, scene));
    }
    let (flatten_s, flat) = timed(|| flatten(meshes, placements));
    let (flat, names) = flat.expect("flattens");
    let rounds = number("--rounds", 5);
    println!(
        "{name}: {} primitives in {} instances (made flat in {flatten_s:.2} s), {threads} threads, medians of {rounds} \
         interleaved rounds, MRays/s (times two_level)",
        flat.primitive_count(),
        placements.len()
    );
    for (name, params) in flat_structures() {
        match timed(|| Structure::build(&flat, &params, &AtomicBool::new(false))) {
            (build_s, Ok(built)) => {
                let is_ntree = params.kind() == "ntree";
                candidates.push(Candidate::new(
                    name.to_owned(),
                    build_s,
                    SceneAccel::flat(built.clone(), names.clone()),
                ));
                let (base, tree) = (candidates.len() - 1, built.cells().filter(|_| is_ntree));
                for (label, params) in tree.map_or(vec![], |tree| shaft_params(tree.levels())) {
                    let tree = built.cells().expect("an N-tree");
                    let never = AtomicBool::new(false);
                    // Once before, for the atlas of its masks.
                    CellShafts::build(tree, &params, 8 << 30, &never).expect("builds");
                    let (shafts_s, shafts) =
                        timed(|| CellShafts::build(tree, &params, 8 << 30, &never).expect("builds"));
                    println!(
                        "{name}{label}: {} nodes, {:.2} MB, {:.3} of their shafts marked",
                        shafts.count(),
                        shafts.bytes() as f64 / 1e6,
                        shafts.marked_share()
                    );
                    let bytes = shafts.bytes();
                    let scene = SceneAccel::flat(built.clone(), names.clone());
                    let scene = scene.with_cell_shafts(Arc::new(shafts)).expect("fits");
                    candidates.push(Candidate { bytes, base, ..Candidate::new(label, shafts_s, scene) });
                }
            }
            (_, Err(error)) => println!("{name}: {error}"),
        }
    }
    let on_surface = Ours(SceneAccel::build(
        vec![Structure::build(&flat, &BuildParams::default().into(), &AtomicBool::new(false)).expect("builds")],
        &[Placement { mesh: 0, transform: Affine3A::IDENTITY, filtered: false }],
    ));
    let surface = |ray: &Ray| {
        let hit = on_surface.hit(ray)?;
        let point = ray.origin + hit.t * ray.direction;
        let normal = match flat.triangles.get(hit.primitive as usize) {
            Some(triangle) => {
                let [a, b, c] = triangle.map(|vertex| flat.positions[vertex as usize]);
                (b - a).cross(c - a)
            }
            None => point - flat.spheres[hit.primitive as usize - flat.triangles.len()].center,
        };
        let normal = normal.normalize_or(Vec3::Y);
        Some((point, if normal.dot(ray.direction) > 0.0 { -normal } else { normal }))
    };
    let sets = ray_sets(&flat.bounds, number("--rays", 500_000), surface);

    let mut rates = vec![vec![vec![]; sets.len()]; candidates.len()];
    let mut hits = vec![vec![0; sets.len()]; candidates.len()];
    for _ in 0..rounds {
        for (set_number, set) in sets.iter().enumerate() {
            for (number, candidate) in candidates.iter().enumerate() {
                let (seconds, count) = timed(|| trace(&candidate.scene, set));
                rates[number][set_number].push(set.rays.len() as f64 / seconds / 1e6);
                hits[number][set_number] = count;
            }
        }
    }
    print!("{:<26}{:>9}{:>9}{:>10}", "", "build s", "MB", "nodes");
    sets.iter().for_each(|set| print!("{:>18}", set.name));
    println!();
    let medians: Vec<Vec<f64>> =
        rates.iter_mut().map(|sets| sets.iter_mut().map(|rates| median(rates)).collect()).collect();
    for (number, candidate) in candidates.iter().enumerate() {
        let megabytes = candidate.bytes as f64 / 1e6;
        print!("{:<26}{:>9.2}{megabytes:>9.1}{:>10}", candidate.name, candidate.build_s, candidate.nodes);
        for (rate, base) in medians[number].iter().zip(&medians[candidate.base]) {
            print!("{:>18}", format!("{rate:.2} ({:.2})", rate / base));
        }
        println!("   hits {:?}", hits[number]);
    }
}
