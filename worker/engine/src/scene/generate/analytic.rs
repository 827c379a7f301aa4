//! Scenes whose right picture is known, or whose geometry is awkward on purpose.

use glam::{Quat, Vec3};

use super::rng::Rng;
use super::shapes::{cuboid, floor, quad, sphere};
use super::{Amounts, sphere_rows};
use crate::scene::write_glb::{Geometry, GlbWriter, MaterialSpec, Place, Shape};

const WHITE: [f32; 3] = [0.73, 0.73, 0.73];

/// Five and a half units wide, high and deep, open towards the camera, as at Cornell (Goral et al. 1984).
pub(super) fn cornell_box(_: &Amounts) -> GlbWriter {
    const SIDE: f32 = 5.5;
    let mut glb = GlbWriter::new();
    let matte = |name, base_color| MaterialSpec { name, base_color, ..MaterialSpec::default() };
    let white = glb.material(&matte("white", WHITE));
    let red = glb.material(&matte("red", [0.61, 0.05, 0.05]));
    let green = glb.material(&matte("green", [0.11, 0.43, 0.15]));
    let light = glb.material(&MaterialSpec {
        name: "light",
        base_color: [0.78; 3],
        emissive: [1.0, 0.75, 0.4],
        emissive_strength: 17.0,
        ..MaterialSpec::default()
    });
    let half = SIDE / 2.0;
    let (x, y, z) = (Vec3::X * SIDE, Vec3::Y * SIDE, Vec3::Z * SIDE);
    let mut room = quad(Vec3::new(-half, 0.0, half), x, -z);
    room.append(&quad(Vec3::new(-half, SIDE, -half), x, z));
    room.append(&quad(Vec3::new(-half, 0.0, -half), x, y));
    let left = quad(Vec3::new(-half, 0.0, half), -z, y);
    let right = quad(Vec3::new(half, 0.0, -half), z, y);
    let walls = [(Shape::Triangles(room), white), (Shape::Triangles(left), red), (Shape::Triangles(right), green)];
    let walls = glb.mesh("room", &walls);
    glb.instance("room", walls, Place::default());
    let lamp = quad(Vec3::new(-0.65, SIDE - 0.0005, -0.55), Vec3::X * 1.3, Vec3::Z * 1.05);
    let lamp = glb.mesh("lamp", &[(Shape::Triangles(lamp), light)]);
    glb.instance("lamp", lamp, Place::default());

    let block = cuboid(Vec3::new(-0.5, 0.0, -0.5), Vec3::new(0.5, 1.0, 0.5));
    let block = glb.mesh("block", &[(Shape::Triangles(block), white)]);
    let turned = |degrees: f32| Quat::from_rotation_y(degrees.to_radians());
    glb.instance(
        "tall block",
        block,
        Place { translation: Vec3::new(-0.93, 0.0, -0.85), rotation: turned(17.0), scale: Vec3::new(1.65, 3.3, 1.65) },
    );
    glb.instance(
        "short block",
        block,
        Place { translation: Vec3::new(0.95, 0.0, 0.9), rotation: turned(-17.0), scale: Vec3::splat(1.65) },
    );
    glb.perspective_camera("main", Vec3::new(0.0, 2.75, 10.75), Vec3::new(0.0, 2.75, 0.0), 39.3);
    glb
}

pub(super) fn furnace_sphere(amounts: &Amounts) -> GlbWriter {
    let mut glb = GlbWriter::new();
    let white = glb.material(&MaterialSpec { name: "white", base_color: [1.0; 3], ..MaterialSpec::default() });
    let ball = sphere(Vec3::ZERO, 1.0, sphere_rows(amounts.triangles));
    let ball = glb.mesh("sphere", &[(Shape::Triangles(ball), white)]);
    glb.instance("sphere", ball, Place::default());
    glb.perspective_camera("main", Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, 40.0);
    glb
}

/// Step `i` rises from `y = i` to `y = i + 1` in the plane `z = -(i + 1)`; the camera sits at `z = 0` and looks along -Z,
/// so that every depth is a whole number.
pub(super) fn staircase(amounts: &Amounts) -> GlbWriter {
    let mut glb = GlbWriter::new();
    let steps = amounts.count as f32;
    let mut risers = Geometry::default();
    let mut treads = Geometry::default();
    for step in 0..amounts.count {
        let i = step as f32;
        let across = Vec3::X * 4.0 * steps;
        risers.append(&quad(Vec3::new(-2.0 * steps, i, -(i + 1.0)), across, Vec3::Y));
        treads.append(&quad(Vec3::new(-2.0 * steps, i + 1.0, -(i + 1.0)), across, Vec3::NEG_Z));
    }
    let riser = glb.material(&MaterialSpec { name: "riser", base_color: [0.8; 3], ..MaterialSpec::default() });
    let tread = glb.material(&MaterialSpec { name: "tread", base_color: [0.5, 0.4, 0.3], ..MaterialSpec::default() });
    let stairs = glb.mesh("stairs", &[(Shape::Triangles(risers), riser), (Shape::Triangles(treads), tread)]);
    glb.instance("stairs", stairs, Place::default());
    let middle = 0.5 * steps;
    glb.orthographic_camera("main", Vec3::new(0.0, middle, 0.0), Vec3::new(0.0, middle, -1.0), middle);
    glb
}

/// Haines' sphere flake (Standard Procedural Databases, 1987): nine spheres of a third of the size on each sphere.
pub(super) fn sphere_flake(amounts: &Amounts) -> GlbWriter {
    let mut levels = 0;
    let mut total = 1_u64;
    while total + 9_u64.pow(levels + 1) <= u64::from(amounts.count) {
        levels += 1;
        total += 9_u64.pow(levels);
    }
    let mut spheres = Vec::with_capacity(total as usize);
    flake(Vec3::ZERO, 0.5, Quat::IDENTITY, levels, &mut spheres);

    let mut glb = GlbWriter::new();
    let metal = glb.material(&MaterialSpec {
        name: "metal",
        base_color: [0.9, 0.78, 0.55],
        metallic: 1.0,
        roughness: 0.15,
        ..MaterialSpec::default()
    });
    let ground =
        glb.material(&MaterialSpec { name: "ground", base_color: [0.35, 0.4, 0.45], ..MaterialSpec::default() });
    let flake = glb.mesh("flake", &[(Shape::Spheres(spheres), metal)]);
    glb.instance("flake", flake, Place::default());
    let plane = glb.mesh("ground", &[(Shape::Triangles(floor(-0.5, 12.0, 1.0)), ground)]);
    glb.instance("ground", plane, Place::default());
    glb.sun("sun", Vec3::new(1.0, 2.0, 1.5), [1.0, 0.95, 0.85], 4.0);
    glb.perspective_camera("main", Vec3::new(1.6, 1.3, 2.0), Vec3::new(0.0, 0.05, 0.0), 36.0);
    glb
}

fn flake(center: Vec3, radius: f32, frame: Quat, levels: u32, spheres: &mut Vec<(Vec3, f32)>) {
    spheres.push((center, radius));
    if levels == 0 {
        return;
    }
    // Six around the equator, three on the upper half; the ninth direction never points back at the parent.
    let ring = |count: u32, polar_deg: f32, turn_deg: f32| {
        (0..count).map(move |i| (polar_deg, turn_deg + 360.0 * i as f32 / count as f32))
    };
    for (polar_deg, azimuth_deg) in ring(6, 90.0, 0.0).chain(ring(3, 35.0, 30.0)) {
        let (polar, azimuth) = (polar_deg.to_radians(), azimuth_deg.to_radians());
        let local = Vec3::new(polar.sin() * azimuth.cos(), polar.cos(), polar.sin() * azimuth.sin());
        let direction = frame * local;
        let child = radius / 3.0;
        let turned = Quat::from_rotation_arc(Vec3::Y, direction);
        flake(center + direction * (radius + child), child, turned, levels - 1, spheres);
    }
}

pub(super) fn far_sphere(amounts: &Amounts) -> GlbWriter {
    let center = Vec3::new(100_000.0, 50_000.0, -70_000.0);
    let mut glb = GlbWriter::new();
    let material = glb.material(&MaterialSpec { name: "clay", base_color: [0.7, 0.5, 0.4], ..MaterialSpec::default() });
    let ball = sphere(center, 50.0, sphere_rows(amounts.triangles));
    // Rounding moves vertices here; smooth normals of the exact sphere stay right, empty triangles are dropped on import.
    let ball = glb.mesh("sphere", &[(Shape::Triangles(ball), material)]);
    glb.instance("sphere", ball, Place::default());
    glb.sun("sun", Vec3::new(1.0, 2.0, 1.5), [1.0; 3], 3.0);
    glb.perspective_camera("main", center + Vec3::new(60.0, 40.0, 140.0), center, 45.0);
    glb
}

pub(super) fn soup(amounts: &Amounts) -> GlbWriter {
    let mut rng = Rng::new(amounts.seed, 1);
    let mut soup = Geometry::default();
    let mut previous = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let flat = Vec3::new(1.0, 0.1, 1.0);
    let tones = [[0.72, 0.70, 0.66], [0.30, 0.42, 0.52], [0.70, 0.44, 0.24], [0.24, 0.38, 0.34]];
    for _ in 0..amounts.triangles {
        let a = rng.in_box(Vec3::ONE);
        let (u, v) = (rng.direction(), rng.direction());
        let triangle = match rng.below(16) {
            // A sliver: a million times longer than wide.
            0 | 1 => [a, a + u, a + u * 0.5 + v * 1e-6],
            // A needle that nearly closes on itself.
            2 => [a, a + u * 0.5, a + u * 0.5 + v * 1e-4],
            // A speck.
            3 => [a, a + u * 1e-5, a + v * 1e-5],
            // A giant through half of the others; it lies so that the camera sees it from the edge.
            4 if rng.below(50) == 0 => {
                let (u, v) = ((u * flat).normalize_or(Vec3::X), (v * flat).normalize_or(Vec3::Z));
                [a + u * 1.5, a + v * 1.5, a - (u + v) * 1.5]
            }
            // The previous one once more, turned around.
            5 => [previous[0], previous[2], previous[1]],
            // Without area: two corners in one place, or all on a line.
            6 => [a, a + u * 0.1, a],
            7 => [a, a + u * 0.25, a + u * 0.5],
            _ => [a, a + u * rng.range(0.01, 0.1), a + v * rng.range(0.01, 0.1)],
        };
        let base = soup.positions.len() as u32;
        soup.positions.extend(triangle);
        soup.colors.extend([tones[base as usize / 3 % tones.len()]; 3]);
        soup.triangles.push([base, base + 1, base + 2]);
        previous = triangle;
    }
    let mut glb = GlbWriter::new();
    let material = glb.material(&MaterialSpec {
        name: "soup",
        base_color: [1.0; 3],
        double_sided: true,
        ..MaterialSpec::default()
    });
    let soup = glb.mesh("soup", &[(Shape::Triangles(soup), material)]);
    glb.instance("soup", soup, Place::default());
    glb.perspective_camera("main", Vec3::new(0.0, 0.5, 4.5), Vec3::ZERO, 40.0);
    glb
}
