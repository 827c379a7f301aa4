//! Leaves, hairs, mountains and forests.

use std::f32::consts::TAU;

use glam::{Affine3A, Quat, Vec3};

use super::rng::Rng;
use super::shapes::{floor, frustum, quad, sphere, surface};
use super::{Amounts, textures};
use crate::scene::write_glb::{Geometry, GlbWriter, MaterialSpec, Place, Shape};

/// A leaf card of `size`, its stalk at the origin, pointing along `direction`.
pub(super) fn leaf_card(rng: &mut Rng, direction: Vec3, size: f32) -> Geometry {
    let roll = Quat::from_axis_angle(direction, rng.range(0.0, TAU));
    let side = roll * direction.any_orthonormal_vector() * size * 0.6;
    quad(-0.5 * side, side, direction * size)
}

pub(super) fn leaf_material(glb: &mut GlbWriter) -> usize {
    let leaf = glb.texture("leaf", &textures::leaf());
    glb.material(&MaterialSpec {
        name: "leaf",
        base_color: [1.0; 3],
        base_color_texture: Some(leaf),
        roughness: 0.6,
        alpha_cutoff: Some(0.5),
        double_sided: true,
        ..MaterialSpec::default()
    })
}

pub(super) fn foliage_cards(amounts: &Amounts) -> GlbWriter {
    let mut rng = Rng::new(amounts.seed, 2);
    let mut glb = GlbWriter::new();
    let leaf = leaf_material(&mut glb);
    let bark = glb.material(&MaterialSpec { name: "bark", base_color: [0.23, 0.16, 0.11], ..MaterialSpec::default() });
    let ground =
        glb.material(&MaterialSpec { name: "ground", base_color: [0.32, 0.3, 0.24], ..MaterialSpec::default() });
    let mut crown = Geometry::default();
    for _ in 0..amounts.count {
        let outward = rng.direction();
        // Denser towards the surface of the crown, as where the light is.
        let place = Vec3::new(0.0, 2.3, 0.0) + outward * Vec3::new(1.3, 1.0, 1.3) * rng.unit().cbrt();
        let direction = (outward + rng.direction() * 0.8 - Vec3::Y * 0.3).try_normalize().unwrap_or(Vec3::Y);
        let size = rng.range(0.16, 0.3);
        crown.append(&leaf_card(&mut rng, direction, size).transformed(Affine3A::from_translation(place)));
    }
    let trunk = frustum(Vec3::ZERO, Vec3::new(0.05, 2.4, 0.0), 0.16, 0.06, 16);
    let tree = glb.mesh("tree", &[(Shape::Triangles(trunk), bark), (Shape::Triangles(crown), leaf)]);
    glb.instance("tree", tree, Place::default());
    let plane = glb.mesh("ground", &[(Shape::Triangles(floor(0.0, 12.0, 1.0)), ground)]);
    glb.instance("ground", plane, Place::default());
    glb.sun("sun", Vec3::new(1.0, 2.2, 1.2), [1.0, 0.95, 0.85], 4.0);
    glb.perspective_camera("main", Vec3::new(2.6, 2.2, 5.0), Vec3::new(0.0, 1.8, 0.0), 40.0);
    glb
}

/// Hairs of three-sided tubes; each wanders around the sphere that it starts on.
pub(super) fn hairball(amounts: &Amounts) -> GlbWriter {
    const SEGMENTS: u32 = 40;
    const SIDES: u32 = 3;
    const TRIANGLES_PER_HAIR: u32 = SEGMENTS * SIDES * 2;
    let mut rng = Rng::new(amounts.seed, 3);
    let mut hairs = Geometry::default();
    for _ in 0..(amounts.triangles / TRIANGLES_PER_HAIR).max(1) {
        let mut place = rng.direction() * rng.range(0.4, 0.6);
        let mut heading = rng.direction();
        let mut curl = rng.direction();
        let mut line = vec![place];
        for _ in 0..SEGMENTS {
            curl = (curl + rng.direction() * 0.35).normalize();
            let inward = -place * (place.length() - 0.8).max(0.0) * 2.0;
            heading = (heading + curl * 0.22 + inward + place.normalize() * 0.03).normalize();
            place += heading * 0.05;
            line.push(place);
        }
        append_tube(&mut hairs, &line, 0.0025, SIDES);
    }
    let mut glb = GlbWriter::new();
    let hair = glb.material(&MaterialSpec {
        name: "hair",
        base_color: [0.42, 0.24, 0.13],
        roughness: 0.5,
        ..MaterialSpec::default()
    });
    let ball = glb.mesh("hairball", &[(Shape::Triangles(hairs), hair)]);
    glb.instance("hairball", ball, Place::default());
    glb.sun("sun", Vec3::new(1.0, 1.5, 1.2), [1.0, 0.95, 0.9], 4.0);
    glb.perspective_camera("main", Vec3::new(0.0, 0.6, 3.4), Vec3::ZERO, 40.0);
    glb
}

/// A tube of constant radius along a line of points that turns gently.
fn append_tube(geometry: &mut Geometry, line: &[Vec3], radius: f32, sides: u32) {
    let base = geometry.positions.len() as u32;
    let mut side = (line[1] - line[0]).normalize().any_orthonormal_vector();
    for (i, center) in line.iter().enumerate() {
        let tangent = (line[(i + 1).min(line.len() - 1)] - line[i.saturating_sub(1)]).normalize();
        // Carried along without twist, so that the sides stay straight.
        side = (side - tangent * side.dot(tangent)).try_normalize().unwrap_or_else(|| tangent.any_orthonormal_vector());
        let other = tangent.cross(side);
        for k in 0..sides {
            let angle = TAU * k as f32 / sides as f32;
            let normal = side * angle.cos() + other * angle.sin();
            geometry.positions.push(center + normal * radius);
            geometry.normals.push(normal.normalize());
        }
    }
    for ring in 0..line.len() as u32 - 1 {
        for k in 0..sides {
            let a = base + ring * sides + k;
            let b = base + ring * sides + (k + 1) % sides;
            geometry.triangles.push([a, b, b + sides]);
            geometry.triangles.push([a, b + sides, a + sides]);
        }
    }
}

/// Value noise on a lattice, smooth, about -1..1.
struct Noise {
    seed: u64,
}

impl Noise {
    fn lattice(&self, x: i32, z: i32) -> f32 {
        let cell = (u64::from(x as u32) << 32) | u64::from(z as u32);
        Rng::new(self.seed, cell).range(-1.0, 1.0)
    }

    fn at(&self, x: f32, z: f32) -> f32 {
        let (cell_x, cell_z) = (x.floor(), z.floor());
        let smooth = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let (u, v) = (smooth(x - cell_x), smooth(z - cell_z));
        let (i, j) = (cell_x as i32, cell_z as i32);
        let low = self.lattice(i, j) + u * (self.lattice(i + 1, j) - self.lattice(i, j));
        let high = self.lattice(i, j + 1) + u * (self.lattice(i + 1, j + 1) - self.lattice(i, j + 1));
        low + v * (high - low)
    }

    /// Octaves of falling height, the steep ones folded into ridges.
    fn mountains(&self, x: f32, z: f32, octaves: u32) -> f32 {
        let (mut height, mut amplitude, mut frequency) = (0.0, 1.0, 0.35);
        for _ in 0..octaves {
            let ridge = 1.0 - self.at(x * frequency + 31.7, z * frequency - 12.3).abs();
            height += amplitude * (ridge * ridge - 0.4);
            amplitude *= 0.46;
            frequency *= 2.03;
        }
        height
    }
}

pub(super) fn terrain(amounts: &Amounts) -> GlbWriter {
    const HALF: f32 = 6.0;
    let side = (((amounts.triangles as f32 / 2.0).sqrt().round()) as u32).max(2);
    let noise = Noise { seed: amounts.seed };
    let height = |x: f32, z: f32| noise.mountains(x, z, 8);
    let mut land = surface(side, side, |u, v| {
        let (x, z) = ((u - 0.5) * 2.0 * HALF, (0.5 - v) * 2.0 * HALF);
        let step = HALF / side as f32;
        let slope_x = (height(x + step, z) - height(x - step, z)) / (2.0 * step);
        let slope_z = (height(x, z + step) - height(x, z - step)) / (2.0 * step);
        (Vec3::new(x, height(x, z), z), Vec3::new(-slope_x, 1.0, -slope_z).normalize())
    });
    land.uvs.clear();
    land.colors = land
        .positions
        .iter()
        .zip(&land.normals)
        .map(|(position, normal)| match (normal.y, position.y) {
            (steep, _) if steep < 0.55 => [0.24, 0.21, 0.19],
            (_, high) if high > 0.75 => [0.85, 0.87, 0.9],
            (_, low) if low < 0.05 => [0.16, 0.24, 0.07],
            _ => [0.2, 0.21, 0.12],
        })
        .collect();
    let mut glb = GlbWriter::new();
    let ground = glb.material(&MaterialSpec { name: "land", base_color: [1.0; 3], ..MaterialSpec::default() });
    let land = glb.mesh("terrain", &[(Shape::Triangles(land), ground)]);
    glb.instance("terrain", land, Place::default());
    glb.sun("sun", Vec3::new(1.5, 1.0, 0.6), [1.0, 0.92, 0.8], 4.0);
    let eye = Vec3::new(-4.0, height(-4.0, 5.0).max(0.4) + 1.6, 5.0);
    glb.perspective_camera("main", eye, Vec3::new(1.0, 0.1, -1.5), 45.0);
    glb
}

pub(super) fn forest(amounts: &Amounts) -> GlbWriter {
    let mut rng = Rng::new(amounts.seed, 4);
    let noise = Noise { seed: amounts.seed };
    let mut glb = GlbWriter::new();
    let bark = glb.material(&MaterialSpec { name: "bark", base_color: [0.2, 0.14, 0.1], ..MaterialSpec::default() });
    let greens = [[0.05, 0.16, 0.06], [0.14, 0.26, 0.05], [0.3, 0.22, 0.04]];
    let names = ["fir", "oak", "birch"];
    let per_tree = amounts.triangles / 3;
    let trees: Vec<usize> = (0..3)
        .map(|kind| {
            let green =
                glb.material(&MaterialSpec { name: names[kind], base_color: greens[kind], ..MaterialSpec::default() });
            let (trunk, crown) = if kind == 0 { fir(per_tree) } else { broadleaf(&mut rng, per_tree, kind == 2) };
            glb.mesh(names[kind], &[(Shape::Triangles(trunk), bark), (Shape::Triangles(crown), green)])
        })
        .collect();
    let half = (amounts.count as f32).sqrt() * 1.1;
    let height = |x: f32, z: f32| 1.2 * noise.at(x * 0.08, z * 0.08) + 0.3 * noise.at(x * 0.3, z * 0.3);
    let side = 96;
    let land = surface(side, side, |u, v| {
        let (x, z) = ((u - 0.5) * 2.4 * half, (0.5 - v) * 2.4 * half);
        let slope = |dx: f32, dz: f32| (height(x + dx, z + dz) - height(x - dx, z - dz)) / 0.2;
        (Vec3::new(x, height(x, z), z), Vec3::new(-slope(0.1, 0.0), 1.0, -slope(0.0, 0.1)).normalize())
    });
    let soil = glb.material(&MaterialSpec { name: "soil", base_color: [0.17, 0.15, 0.08], ..MaterialSpec::default() });
    let land = glb.mesh("ground", &[(Shape::Triangles(land), soil)]);
    glb.instance("ground", land, Place::default());
    for i in 0..amounts.count {
        let (x, z) = (rng.range(-half, half), rng.range(-half, half));
        let place = Place {
            translation: Vec3::new(x, height(x, z) - 0.05, z),
            rotation: Quat::from_rotation_y(rng.range(0.0, TAU)),
            scale: Vec3::new(1.0, rng.range(0.85, 1.3), 1.0) * rng.range(0.7, 1.4),
        };
        glb.instance(&format!("tree {i}"), trees[rng.below(3)], place);
    }
    glb.sun("sun", Vec3::new(1.2, 1.3, 0.5), [1.0, 0.93, 0.8], 4.0);
    let target = Vec3::new(0.0, 0.5, 0.0);
    glb.perspective_camera("main", Vec3::new(0.35 * half, 0.45 * half, 1.25 * half), target, 40.0);
    glb
}

/// Tiers of cones.
fn fir(triangles: u32) -> (Geometry, Geometry) {
    const TIERS: u32 = 9;
    let sides = (triangles / TIERS / 2).clamp(5, 4096);
    let mut crown = Geometry::default();
    for tier in 0..TIERS {
        let t = tier as f32 / TIERS as f32;
        let bottom = 0.6 + 2.6 * t;
        let cone = frustum(Vec3::Y * bottom, Vec3::Y * (bottom + 0.75), 0.95 * (1.0 - t) + 0.1, 0.0, sides);
        crown.append(&cone);
    }
    (frustum(Vec3::ZERO, Vec3::Y * 1.0, 0.12, 0.1, 10), crown)
}

/// Blobs on a stem.
fn broadleaf(rng: &mut Rng, triangles: u32, slender: bool) -> (Geometry, Geometry) {
    const BLOBS: u32 = 12;
    let rows = super::sphere_rows(triangles / BLOBS);
    let spread = if slender { Vec3::new(0.35, 0.9, 0.35) } else { Vec3::new(0.8, 0.5, 0.8) };
    let mut crown = Geometry::default();
    for _ in 0..BLOBS {
        let center = Vec3::Y * if slender { 2.2 } else { 1.9 } + rng.direction() * spread;
        crown.append(&sphere(center, rng.range(0.35, 0.6), rows));
    }
    (frustum(Vec3::ZERO, Vec3::Y * 1.8, 0.14, 0.07, 10), crown)
}
