//! Every builder and every kernel finds what a tree-less loop in double precision finds.

mod common;

use common::*;
use glam::Vec3;
use lightshaft_engine::accel::{BuildParams, SceneAccel};
use lightshaft_engine::scene::{Mesh, Sphere};
use lightshaft_engine::trace::Ray;

/// Compares `rays` random rays with the oracle. Hits may differ where single precision cannot tell two surfaces, or a
/// hit from a near miss, apart: at most one ray in a thousand, and never by more than rounding.
fn assert_agrees(mesh: &Mesh, scenes: &[SceneAccel], rays: usize, seed: u64) {
    let mut random = Random(seed);
    let mut hits = 0;
    let mut close_calls = 0;
    for _ in 0..rays {
        let ray = random_ray(&mut random, &mesh.bounds);
        let expected = oracle(mesh, &ray);
        hits += usize::from(expected.is_some());
        let found = closest(&scenes[0], &ray);
        for scene in scenes {
            assert_eq!(closest(scene, &ray), found, "kernels and builders differ on {ray:?}");
            assert_eq!(occluded(scene, &ray), found.is_some(), "any-hit differs from closest-hit on {ray:?}");
        }
        match (expected, found) {
            (None, None) => {}
            (Some((t, u, v, primitive)), Some(hit)) if hit.primitive == primitive => {
                assert!((f64::from(hit.t) - t).abs() <= 2e-4 * t.max(1e-3), "{ray:?}: t {} instead of {t}", hit.t);
                if (primitive as usize) < mesh.triangles.len() {
                    let error = (f64::from(hit.u) - u).abs().max((f64::from(hit.v) - v).abs());
                    assert!(error < 2e-3, "{ray:?}: u, v {}, {} instead of {u}, {v}", hit.u, hit.v);
                }
            }
            _ => close_calls += 1,
        }
    }
    assert!(hits > rays / 40, "only {hits} of {rays} rays hit anything: the test says little");
    assert!(close_calls * 1000 <= rays, "{close_calls} of {rays} rays differ from the oracle");
}

fn all_scenes(mesh: &Mesh) -> Vec<SceneAccel> {
    ALL_PARAMS.into_iter().flat_map(|params| scenes(mesh, params)).collect()
}

#[test]
fn a_soup_of_triangles_agrees_with_the_oracle() {
    for (count, size, seed) in [(1, 1.0, 1), (2, 1.0, 2), (5, 0.8, 3), (40, 0.5, 4), (900, 0.15, 5)] {
        let mesh = soup(count, size, seed);
        assert_agrees(&mesh, &all_scenes(&mesh), 4000, 11);
    }
}

#[test]
fn spheres_agree_with_the_oracle() {
    let mesh = mesh(vec![], vec![], spheres(300, 0.06, 3));
    assert_agrees(&mesh, &all_scenes(&mesh), 8000, 12);
}

#[test]
fn triangles_and_spheres_together_agree_with_the_oracle() {
    let triangles = soup(300, 0.2, 8);
    let mesh = mesh(triangles.positions, triangles.triangles, spheres(300, 0.05, 9));
    assert_agrees(&mesh, &all_scenes(&mesh), 8000, 13);
}

#[test]
fn a_mesh_with_shared_vertices_agrees_with_the_oracle() {
    let mesh = ball(12, Vec3::new(0.3, -0.2, 5.0), 2.0);
    assert_agrees(&mesh, &all_scenes(&mesh), 8000, 14);
}

#[test]
fn extreme_sizes_agree_with_the_oracle() {
    for scale in [1e-12_f32, 1e-6, 1e6, 1e12] {
        let mut mesh = soup(200, 0.3, 21);
        mesh.positions.iter_mut().for_each(|p| *p *= scale);
        mesh.bounds.min *= scale;
        mesh.bounds.max *= scale;
        assert_agrees(&mesh, &all_scenes(&mesh), 3000, 15);
    }
}

#[test]
fn rays_that_cannot_hit_miss() {
    let sphere = Sphere { center: Vec3::ZERO, radius: 0.5, slot: 0 };
    let quad = vec![Vec3::new(-1.0, -1.0, 1.0), Vec3::new(1.0, -1.0, 1.0), Vec3::new(0.0, 1.0, 1.0)];
    let mesh = mesh(quad, vec![[0, 1, 2]], vec![sphere]);
    let good = Ray::new(Vec3::new(0.0, 0.0, -3.0), Vec3::Z);
    let bad = [
        Ray { origin: Vec3::new(f32::NAN, 0.0, 0.0), ..good },
        Ray { origin: Vec3::new(0.0, 0.0, f32::NEG_INFINITY), ..good },
        Ray { direction: Vec3::new(0.0, f32::NAN, 1.0), ..good },
        Ray { direction: Vec3::new(0.0, f32::INFINITY, 1.0), ..good },
        Ray { direction: Vec3::ZERO, ..good },
        Ray { direction: Vec3::splat(1e-42), ..good },
        Ray { t_min: f32::NAN, ..good },
        Ray { t_max: f32::NAN, ..good },
        Ray { t_min: 2.0, t_max: 1.0, ..good },
        Ray { t_max: -1.0, ..good },
        Ray { direction: Vec3::NEG_Z, ..good },
    ];
    for scene in all_scenes(&mesh) {
        assert!(closest(&scene, &good).is_some());
        for ray in &bad {
            assert_eq!(closest(&scene, ray), None, "{ray:?}");
            assert!(!occluded(&scene, ray), "{ray:?}");
        }
    }
}

#[test]
fn the_interval_is_open_at_both_ends() {
    let mesh = mesh(
        vec![Vec3::new(-9.0, -9.0, 2.0), Vec3::new(9.0, -9.0, 2.0), Vec3::new(0.0, 9.0, 2.0)],
        vec![[0, 1, 2]],
        vec![],
    );
    for scene in scenes(&mesh, BuildParams::default()) {
        let ray = Ray::new(Vec3::ZERO, Vec3::Z);
        assert_eq!(closest(&scene, &ray).map(|hit| hit.t), Some(2.0));
        for outside in [Ray { t_min: 2.0, ..ray }, Ray { t_max: 2.0, ..ray }] {
            assert_eq!(closest(&scene, &outside), None);
            assert!(!occluded(&scene, &outside));
        }
        let inside = Ray { t_min: 2.0_f32.next_down(), t_max: 2.0_f32.next_up(), ..ray };
        assert!(closest(&scene, &inside).is_some() && occluded(&scene, &inside));
    }
}

#[test]
fn of_several_hits_at_one_distance_the_lowest_primitive_counts() {
    let corner = [Vec3::new(-1.0, -1.0, 1.0), Vec3::new(1.0, -1.0, 1.0), Vec3::new(0.0, 1.0, 1.0)];
    let copies = 37;
    let mesh = mesh(corner.to_vec(), vec![[0, 1, 2]; copies], vec![]);
    for scene in all_scenes(&mesh) {
        let hit = closest(&scene, &Ray::new(Vec3::ZERO, Vec3::new(0.1, 0.05, 1.0))).expect("hits");
        assert_eq!((hit.t, hit.primitive), (1.0, 0));
    }
}

#[test]
fn barycentrics_belong_to_vertices_one_and_two() {
    let corners = [Vec3::new(0.0, 0.0, 1.0), Vec3::new(4.0, 0.0, 1.0), Vec3::new(0.0, 4.0, 1.0)];
    let mesh = mesh(corners.to_vec(), vec![[0, 1, 2]], vec![]);
    let scene = scene(&mesh, BuildParams::default());
    let hit = closest(&scene, &Ray::new(Vec3::new(1.0, 2.0, 0.0), Vec3::Z)).expect("hits");
    assert_eq!((hit.u, hit.v), (0.25, 0.5));
}

#[test]
fn degenerate_triangles_hit_nothing_and_harm_nothing() {
    let p = Vec3::new(0.5, 0.5, 0.5);
    let mut mesh = soup(50, 0.4, 5);
    let base = mesh.positions.len() as u32;
    mesh.positions.extend([p, p + Vec3::X, p + 2.0 * Vec3::X, Vec3::splat(f32::NAN), Vec3::splat(f32::INFINITY)]);
    let good = mesh.triangles.clone();
    for bad in [[0, 0, 0], [0, 1, 2], [1, 1, 2], [0, 1, 3], [4, 1, 0]] {
        mesh.triangles.push(bad.map(|v| v + base));
    }
    let scenes = all_scenes(&mesh);
    mesh.triangles = good;
    assert_agrees(&mesh, &scenes, 3000, 16);
}

#[test]
fn no_ray_escapes_from_a_closed_mesh() {
    // Rays from inside, a good part of them aimed exactly at vertices and at points of edges.
    for (center, radius) in [(Vec3::ZERO, 1.0), (Vec3::splat(1e6), 500.0), (Vec3::new(0.0, 7e-6, 0.0), 1e-5)] {
        let mesh = ball(24, center, radius);
        let scenes = scenes(&mesh, BuildParams::default());
        let mut random = Random(99);
        for number in 0..350_000 {
            let origin = center + 0.3 * radius * random.direction();
            let triangle = mesh.triangles[random.next() as usize % mesh.triangles.len()];
            let [a, b] = [mesh.positions[triangle[0] as usize], mesh.positions[triangle[1] as usize]];
            let direction = match number % 4 {
                0 => a - origin,
                1 => a + random.unit() * (b - a) - origin,
                2 => [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z][random.next() as usize % 6],
                _ => random.direction(),
            };
            let ray = Ray::new(origin, direction);
            // Both kernels on a part of the rays: they are compared ray by ray elsewhere.
            let scene = if number % 8 < 4 { &scenes[0] } else { scenes.last().expect("one at least") };
            assert!(closest(scene, &ray).is_some(), "{ray:?} escaped from the ball at {center}");
        }
    }
}

#[test]
fn rays_in_the_plane_of_flat_boxes_find_the_edges_they_meet() {
    // A cube whose faces lie in coordinate planes; rays run exactly in the planes x = 0 and y = 0 through its edges.
    let positions = (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2 & 1) as f32)).collect();
    let quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let mesh = mesh(positions, triangles, vec![]);
    for scene in all_scenes(&mesh) {
        for (x, y) in [(0.0, 0.5), (0.5, 0.0), (0.0, 0.0), (1.0, 1.0), (0.25, 0.25), (-0.0, 1.0)] {
            for direction in [Vec3::new(0.0, 0.0, 1.0), Vec3::new(-0.0, -0.0, 1.0)] {
                let hit = closest(&scene, &Ray::new(Vec3::new(x, y, -1.0), direction));
                assert_eq!(hit.map(|hit| hit.t), Some(1.0), "at {x}, {y}");
            }
        }
    }
}
