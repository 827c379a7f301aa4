//! Looks for false EMPTY and OPAQUE shafts: `cargo run --release --example attack_line_space -- RAYS FILE…`.
//!
//! Every mesh of the files (with at least 100 triangles) is gated by its Line Space, and random and adversarial rays
//! (along borders of patches, edges, corners and axes, from near and far) are traced with and without. Prints how many
//! answers differ: there may be none.

#[path = "../tests/common/meshes.rs"]
mod meshes;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::{Affine3A, DVec3, Vec3};
use lightshaft_engine::accel::line_space::{GateCounters, LineSpace, LineSpaceParams, ShaftGrid};
use lightshaft_engine::accel::{BuildParams, HitFilter, MeshStructure, Placement, SceneAccel};
use lightshaft_engine::scene::{Aabb, Limits, import_file};
use lightshaft_engine::trace::{Counters, Hit, Ray};
use meshes::Random;
use rayon::prelude::*;

struct AcceptAll;

impl HitFilter for AcceptAll {
    fn accept(&self, _: &Ray, _: &Hit) -> bool {
        true
    }
}

/// A point of the box, often on borders of patches.
fn target(random: &mut Random, grid: &ShaftGrid, bounds: &Aabb) -> Vec3 {
    if random.next().is_multiple_of(2) {
        return bounds.min + random.point() * bounds.extent();
    }
    let n = u64::from(grid.n());
    let mut step = || (random.next() % (n + 1)) as f64 / n as f64;
    grid.from_unit(DVec3::new(step(), step(), step())).as_vec3()
}

fn ray(random: &mut Random, grid: &ShaftGrid, bounds: &Aabb) -> Ray {
    let (from, to) = (target(random, grid, bounds), target(random, grid, bounds));
    let mut ray = Ray::new(from, to - from);
    match random.next() % 6 {
        0 => ray.direction[random.next() as usize % 3] = 0.0,
        1 => ray.direction[random.next() as usize % 3] *= 1e-9,
        2 => ray.t_max = 2.0 * random.unit(),
        _ => {}
    }
    // Mostly from outside, where a whole chord is asked for; up to a hundred boxes away.
    let back = [0.0, 1.5, 3.0, 3.0, 10.0, 100.0][random.next() as usize % 6];
    ray.origin -= back * (0.5 + random.unit()) * ray.direction;
    ray
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let rays: u64 = arguments.next().ok_or("how many rays?")?.parse()?;
    let never = AtomicBool::new(false);
    let mut meshes = vec![];
    for file in arguments {
        meshes.extend(import_file(Path::new(&file), &Limits::default())?.meshes);
    }
    meshes.retain(|mesh| mesh.primitive_count() >= 100);
    let (mut all, mut differing, mut counted) = (0, 0, GateCounters::default());
    for mesh in &meshes {
        let structure = Arc::new(MeshStructure::build(mesh, &BuildParams::default(), &never)?);
        let space = Arc::new(LineSpace::build(mesh, &structure, &LineSpaceParams::DEFAULT_CLASSES, u64::MAX, &never)?);
        let Some(&grid) = space.grid() else { continue };
        let placement = [Placement { mesh: 0, transform: Affine3A::IDENTITY, filtered: false }];
        let plain = SceneAccel::build(vec![structure.clone()], &placement);
        let gated = SceneAccel::build(vec![structure.clone()], &placement).with_line_spaces(vec![Some(space)])?;
        let bounds = structure.bvh2().bounds();
        let started = Instant::now();
        let chunks = rays.div_ceil(meshes.len() as u64 * 10_000);
        let (wrong, counters) = (0..chunks)
            .into_par_iter()
            .map(|chunk| {
                let mut random = Random(chunk);
                let mut counters = Counters::default();
                let mut wrong = 0_u64;
                for _ in 0..10_000 {
                    let ray = ray(&mut random, &grid, &bounds);
                    let found = gated.occluded(&ray, &AcceptAll, &mut counters);
                    if found != plain.occluded(&ray, &AcceptAll, &mut Counters::default()) {
                        wrong += 1;
                        eprintln!("{}: {found} is wrong for {ray:?}", mesh.name);
                    }
                }
                (wrong, counters.gates)
            })
            .reduce(
                || (0, GateCounters::default()),
                |mut a, b| {
                    a.0 += b.0;
                    a.1 += b.1;
                    a
                },
            );
        let [empty, opaque, mixed] = counters.full_chord;
        println!(
            "{}: {} rays in {:.1} s, {wrong} wrong; full chords: {empty} EMPTY, {opaque} OPAQUE, {mixed} MIXED",
            mesh.name,
            chunks * 10_000,
            started.elapsed().as_secs_f64()
        );
        all += chunks * 10_000;
        differing += wrong;
        counted += counters;
    }
    let [empty, opaque, _] = counted.full_chord;
    let decided = empty + opaque + counted.ends_inside[0];
    println!("{all} rays, {decided} decided by a shaft, {differing} wrong");
    Ok(())
}
