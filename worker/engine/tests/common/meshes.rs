//! Random numbers and meshes for tests and benchmarks.
#![allow(dead_code, reason = "each test and benchmark uses its part")]

use glam::Vec3;
use lightshaft_engine::scene::{Mesh, MeshHash, Sphere};

/// SplitMix64: small, good enough, and the same everywhere.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub(crate) fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1 << 24) as f32
    }

    pub(crate) fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit())
    }

    pub(crate) fn direction(&mut self) -> Vec3 {
        let z = 2.0 * self.unit() - 1.0;
        let (sin, cos) = (std::f32::consts::TAU * self.unit()).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * cos, r * sin, z)
    }
}

pub(crate) fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, spheres: Vec<Sphere>) -> Mesh {
    Mesh { hash: MeshHash([7; 32]), ..Mesh::of_shapes("test", positions, triangles, spheres) }
}

/// Separate random triangles in the unit cube.
pub(crate) fn soup(count: usize, size: f32, seed: u64) -> Mesh {
    let mut random = Random(seed);
    let positions = (0..count)
        .flat_map(|_| {
            let center = random.point();
            [(); 3].map(|()| center + size * (random.point() - 0.5))
        })
        .collect();
    mesh(positions, (0..count as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(), vec![])
}

pub(crate) fn spheres(count: usize, radius: f32, seed: u64) -> Vec<Sphere> {
    let mut random = Random(seed);
    (0..count).map(|_| Sphere { center: random.point(), radius: radius * (0.2 + random.unit()), slot: 0 }).collect()
}

/// A closed, bumpy ball of `2 * rings * rings` or so triangles that share their vertices.
pub(crate) fn ball(rings: u32, center: Vec3, radius: f32) -> Mesh {
    let columns = 2 * rings;
    let mut positions = vec![center + Vec3::Z * radius];
    for ring in 1..rings {
        for column in 0..columns {
            let theta = std::f32::consts::PI * ring as f32 / rings as f32;
            let phi = std::f32::consts::TAU * column as f32 / columns as f32;
            let bump = 1.0 + 0.1 * (5.0 * phi).sin() * (7.0 * theta).sin();
            let direction = Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
            positions.push(center + radius * bump * direction);
        }
    }
    positions.push(center - Vec3::Z * radius);
    let last = positions.len() as u32 - 1;
    let vertex = |ring: u32, column: u32| match ring {
        0 => 0,
        r if r == rings => last,
        r => 1 + (r - 1) * columns + column % columns,
    };
    let mut triangles = vec![];
    for ring in 0..rings {
        for column in 0..columns {
            let [a, b] = [vertex(ring, column), vertex(ring, column + 1)];
            let [c, d] = [vertex(ring + 1, column), vertex(ring + 1, column + 1)];
            if ring > 0 {
                triangles.push([a, c, b]);
            }
            if ring + 1 < rings {
                triangles.push([b, c, d]);
            }
        }
    }
    mesh(positions, triangles, vec![])
}
