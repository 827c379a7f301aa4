//! How long structures take to build, to store and to load, and how much memory they need.
//!
//! `cargo bench -p lightshaft-engine --bench build -- [--rounds 3] [--threads 2]`

mod common;

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use common::{median, number, terrain, timed};
use lightshaft_engine::accel::{BuildParams, MeshStructure, Quality};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::triangle::Triangle;

fn main() {
    let (rounds, threads) = (number("--rounds", 3), number("--threads", 2));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    pool.install(|| run(rounds, threads));
}

fn run(rounds: usize, threads: usize) {
    let mesh = terrain();
    let count = mesh.triangles.len() as f64;
    println!("{count} triangles, {threads} threads, medians of {rounds} rounds");
    println!("{:<28}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}", "", "build s", "encode s", "decode s", "SAH", "B/tri", "stored");
    for quality in [Quality::Fast, Quality::Medium, Quality::High] {
        for spatial_splits in [false, true] {
            let params = BuildParams { quality, spatial_splits };
            let mut times = [vec![], vec![], vec![]];
            let mut last = None;
            for _ in 0..rounds {
                let (build_s, structure) = timed(|| MeshStructure::build(&mesh, &params, &AtomicBool::new(false)));
                let structure = structure.expect("builds");
                let (encode_s, bytes) = timed(|| structure.encode());
                let (decode_s, decoded) = timed(|| MeshStructure::decode(&bytes, &mesh));
                assert_eq!(decoded.expect("decodes").bvh2(), structure.bvh2());
                for (times, time) in times.iter_mut().zip([build_s, encode_s, decode_s]) {
                    times.push(time);
                }
                last = Some((structure.bvh2().sah_cost(), structure.bytes() as f64, bytes.len() as f64));
            }
            let [build_s, encode_s, decode_s] = times.map(|mut times| median(&mut times));
            let (cost, bytes, stored) = last.expect("one round at least");
            println!(
                "{:<28}{build_s:>9.3}{encode_s:>9.3}{decode_s:>9.3}{cost:>9.2}{:>9.1}{:>9.1}",
                params.canonical().replace("quality=", "").replace("spatial_", ""),
                bytes / count,
                stored / count
            );
        }
    }
    let triangles: Vec<Triangle> = mesh
        .triangles
        .iter()
        .map(|t| t.map(|v| mesh.positions[v as usize].into()))
        .map(|[v0, v1, v2]| Triangle { v0, v1, v2 })
        .collect();
    for (name, params) in [("fast", BvhBuildParams::fast_build()), ("medium", BvhBuildParams::medium_build())] {
        let mut times: Vec<f64> = (0..rounds)
            .map(|_| timed(|| build_cwbvh_from_tris(&triangles, params, &mut Duration::default())).0)
            .collect();
        println!("{:<28}{:>9.3}", format!("obvhs CWBVH {name}"), median(&mut times));
    }
}
