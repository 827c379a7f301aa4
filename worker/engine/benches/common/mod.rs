//! The scene that the benchmarks measure on: a rough terrain with balls on it, about a million triangles.
#![allow(dead_code, reason = "each benchmark uses its part")]

#[path = "../../tests/common/meshes.rs"]
mod meshes;

use std::time::Instant;

use glam::Vec3;
use lightshaft_engine::scene::Mesh;

pub(crate) use meshes::{Random, mesh};

/// 1,003,520 triangles, 20 units wide.
pub(crate) fn terrain() -> Mesh {
    let mut positions = vec![];
    let mut triangles = vec![];
    let size = 600_u32;
    let height = |x: f32, z: f32| {
        let (mut height, mut scale, mut amplitude) = (0.0, 0.35, 1.2);
        for octave in 0..6 {
            let shift = octave as f32 * 1.7;
            height += amplitude * ((x * scale + shift).sin() * (z * scale * 1.13 - shift).cos());
            (scale, amplitude) = (scale * 2.1, amplitude * 0.47);
        }
        height
    };
    let at = |i: u32| 20.0 * (i as f32 / size as f32 - 0.5);
    for z in 0..=size {
        positions.extend((0..=size).map(|x| Vec3::new(at(x), height(at(x), at(z)), at(z))));
    }
    for z in 0..size {
        for x in 0..size {
            let [a, c] = [z, z + 1].map(|z| z * (size + 1) + x);
            triangles.extend([[a, c, a + 1], [a + 1, c, c + 1]]);
        }
    }
    let mut random = Random(42);
    for _ in 0..20 {
        let [x, z] = [(); 2].map(|()| 16.0 * (random.unit() - 0.5));
        let radius = 0.3 + 0.6 * random.unit();
        ball(Vec3::new(x, height(x, z) + 0.8 * radius, z), radius, 84, &mut positions, &mut triangles);
    }
    mesh(positions, triangles, vec![])
}

fn ball(center: Vec3, radius: f32, rings: u32, positions: &mut Vec<Vec3>, triangles: &mut Vec<[u32; 3]>) {
    let base = positions.len() as u32;
    let columns = rings + 1;
    for ring in 0..=rings {
        for column in 0..columns {
            let (theta, phi) = (
                std::f32::consts::PI * ring as f32 / rings as f32,
                std::f32::consts::TAU * column as f32 / columns as f32,
            );
            positions.push(center + radius * Vec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()));
        }
    }
    for ring in 0..rings {
        for column in 0..columns {
            let next = (column + 1) % columns;
            let [a, b] = [column, next].map(|column| base + ring * columns + column);
            triangles.extend([[a, b, a + columns], [b, b + columns, a + columns]]);
        }
    }
}

pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let result = work();
    (start.elapsed().as_secs_f64(), result)
}

pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The value behind `--name`, as a number; `default` where it is not given.
pub(crate) fn number(name: &str, default: usize) -> usize {
    let mut arguments = std::env::args().skip_while(|argument| argument != name).skip(1);
    arguments.next().map_or(default, |value| value.parse().unwrap_or_else(|_| panic!("{name} wants a number")))
}

/// The values behind each `--name`.
pub(crate) fn values(name: &str) -> Vec<String> {
    let arguments: Vec<String> = std::env::args().collect();
    arguments.windows(2).filter(|pair| pair[0] == name).map(|pair| pair[1].clone()).collect()
}
