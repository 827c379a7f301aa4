//! Our own demonstration scene: a still life in a room, lit by a window and a lamp.
//!
//! It shows what the renderer knows: metals and dielectrics from mirror to matte, textures, alpha masks, emissive
//! triangles and spheres as area lights, spheres as primitives, and instances that share a mesh.

use std::f32::consts::TAU;

use glam::{Affine3A, Quat, Vec3};

use super::nature::{leaf_card, leaf_material};
use super::rng::Rng;
use super::shapes::{closed_tube, cuboid, floor, frustum, lathe, quad, sphere, torus, torus_knot};
use super::{Amounts, textures};
use crate::scene::write_glb::{Geometry, GlbWriter, MaterialSpec, Place, Shape};

pub(super) fn demo(amounts: &Amounts) -> GlbWriter {
    let mut glb = GlbWriter::new();
    room(&mut glb, amounts.seed);
    sculpture(&mut glb);
    vase(&mut glb);
    plant(&mut glb, amounts.seed);
    spheres(&mut glb);
    pebbles(&mut glb, amounts.seed);
    glb.perspective_camera("main", Vec3::new(0.35, 1.62, 5.3), Vec3::new(0.02, 0.98, 0.0), 34.0);
    glb.perspective_camera("close", Vec3::new(-1.3, 1.1, 2.6), Vec3::new(0.0, 0.95, 0.0), 34.0);
    glb
}

fn matte(name: &'static str, base_color: [f32; 3]) -> MaterialSpec {
    MaterialSpec { name, base_color, roughness: 0.9, ..MaterialSpec::default() }
}

fn metal(name: &'static str, base_color: [f32; 3], roughness: f32) -> MaterialSpec {
    MaterialSpec { name, base_color, metallic: 1.0, roughness, ..MaterialSpec::default() }
}

fn light(name: &'static str, emissive: [f32; 3], emissive_strength: f32) -> MaterialSpec {
    MaterialSpec { name, base_color: [0.0; 3], emissive, emissive_strength, ..MaterialSpec::default() }
}

fn place(glb: &mut GlbWriter, name: &str, shapes: &[(Shape, usize)], place: Place) {
    let mesh = glb.mesh(name, shapes);
    glb.instance(name, mesh, place);
}

/// A room without a front wall; the window on the left is the main light, a lamp above gives warmth.
fn room(glb: &mut GlbWriter, seed: u64) {
    let tiles = glb.texture("terrazzo", &textures::tiles(seed));
    let ground = glb.material(&MaterialSpec {
        base_color: [0.9; 3],
        base_color_texture: Some(tiles),
        roughness: 0.28,
        ..matte("terrazzo", [1.0; 3])
    });
    let plaster = glb.material(&matte("plaster", [0.70, 0.42, 0.29]));
    let white = glb.material(&matte("white", [0.78, 0.76, 0.72]));
    let blue = glb.material(&matte("blue wall", [0.16, 0.30, 0.36]));
    let window = glb.material(&light("window", [0.82, 0.92, 1.0], 12.0));
    let lamp = glb.material(&light("lamp", [1.0, 0.74, 0.44], 18.0));

    const WIDTH: f32 = 3.4;
    const HEIGHT: f32 = 3.6;
    const BACK: f32 = -2.2;
    const FRONT: f32 = 6.0;
    let depth = FRONT - BACK;
    let back = quad(Vec3::new(-WIDTH, 0.0, BACK), Vec3::X * 2.0 * WIDTH, Vec3::Y * HEIGHT);
    let ceiling = quad(Vec3::new(-WIDTH, HEIGHT, BACK), Vec3::X * 2.0 * WIDTH, Vec3::Z * depth);
    let left = quad(Vec3::new(-WIDTH, 0.0, FRONT), Vec3::NEG_Z * depth, Vec3::Y * HEIGHT);
    let right = quad(Vec3::new(WIDTH, 0.0, BACK), Vec3::Z * depth, Vec3::Y * HEIGHT);
    let shapes = [
        (Shape::Triangles(floor(0.0, 8.0, 8.0)), ground),
        (Shape::Triangles(back), plaster),
        (Shape::Triangles(ceiling), white),
        (Shape::Triangles(left), white),
        (Shape::Triangles(right), blue),
    ];
    place(glb, "room", &shapes, Place::default());

    // Two panes side by side, a hand in front of the wall, with a frame between and around them.
    let mut panes = Geometry::default();
    let mut bars = Geometry::default();
    let wall = -WIDTH + 0.03;
    for start in [1.75, 0.2] {
        panes.append(&quad(Vec3::new(wall, 0.9, start), Vec3::NEG_Z * 1.4, Vec3::Y * 2.1));
        bars.append(&cuboid(Vec3::new(-WIDTH, 0.8, start), Vec3::new(wall + 0.06, 3.1, start + 0.12)));
    }
    bars.append(&cuboid(Vec3::new(-WIDTH, 0.8, -1.32), Vec3::new(wall + 0.06, 3.1, -1.2)));
    place(glb, "window", &[(Shape::Triangles(panes), window), (Shape::Triangles(bars), white)], Place::default());
    let panel = quad(Vec3::new(0.9, HEIGHT - 0.02, 0.4), Vec3::X * 1.1, Vec3::Z * 1.1);
    place(glb, "lamp", &[(Shape::Triangles(panel), lamp)], Place::default());
}

/// A golden knot on a plinth, and a copper ring behind it.
fn sculpture(glb: &mut GlbWriter) {
    let stone = glb.material(&MaterialSpec { roughness: 0.55, ..matte("stone", [0.62, 0.6, 0.57]) });
    let gold = glb.material(&metal("gold", [1.0, 0.71, 0.29], 0.18));
    let copper = glb.material(&metal("copper", [0.93, 0.55, 0.42], 0.32));
    let mut plinth = cuboid(Vec3::new(-0.46, 0.0, -0.46), Vec3::new(0.46, 0.08, 0.46));
    plinth.append(&cuboid(Vec3::new(-0.38, 0.08, -0.38), Vec3::new(0.38, 0.52, 0.38)));
    plinth.append(&cuboid(Vec3::new(-0.43, 0.52, -0.43), Vec3::new(0.43, 0.6, 0.43)));
    let turned = Quat::from_rotation_y(0.5);
    place(glb, "plinth", &[(Shape::Triangles(plinth), stone)], Place { rotation: turned, ..Place::default() });
    let knot = closed_tube(480, 32, 0.19, |t| torus_knot(2.0, 3.0, t));
    let upright = Quat::from_rotation_y(0.35) * Quat::from_rotation_x(1.25);
    place(
        glb,
        "knot",
        &[(Shape::Triangles(knot), gold)],
        Place { translation: Vec3::new(0.0, 1.2, 0.0), rotation: upright, scale: Vec3::splat(0.52) },
    );
    let ring = torus(0.045, 160, 24);
    place(
        glb,
        "ring",
        &[(Shape::Triangles(ring), copper)],
        Place {
            translation: Vec3::new(0.0, 1.3, -1.5),
            rotation: Quat::from_rotation_x(TAU / 4.0),
            scale: Vec3::splat(1.22),
        },
    );
}

fn vase(glb: &mut GlbWriter) {
    let texture = glb.texture("glaze", &textures::glaze());
    let glaze = glb.material(&MaterialSpec {
        base_color_texture: Some(texture),
        roughness: 0.12,
        double_sided: true,
        ..matte("glaze", [1.0; 3])
    });
    let profile: Vec<(f32, f32)> = (0..=64)
        .map(|i| {
            let t = i as f32 / 64.0;
            // Foot, belly, neck and lip.
            let belly = 0.2 + 0.24 * (std::f32::consts::PI * t.powf(0.75)).sin().max(0.0);
            let lip = 0.1 * ((t - 0.86) / 0.14).max(0.0).powi(2);
            let neck = 0.06 * ((t - 0.55) / 0.3).clamp(0.0, 1.0);
            (belly - neck + lip, 1.25 * t)
        })
        .collect();
    let body = lathe(&profile, 96);
    place(glb, "vase", &[(Shape::Triangles(body), glaze)], Place::at(Vec3::new(1.5, 0.0, -0.55)));
}

/// A pot, stems that lean outward, and leaves along them.
fn plant(glb: &mut GlbWriter, seed: u64) {
    let mut rng = Rng::new(seed, 8);
    let clay = glb.material(&matte("clay", [0.50, 0.22, 0.13]));
    let soil = glb.material(&matte("soil", [0.09, 0.06, 0.04]));
    let stem = glb.material(&matte("stem", [0.16, 0.25, 0.08]));
    let leaf = leaf_material(glb);
    let pot = lathe(&[(0.2, 0.0), (0.27, 0.38), (0.31, 0.4), (0.32, 0.5), (0.27, 0.5), (0.26, 0.42)], 64);
    let earth = frustum(Vec3::Y * 0.44, Vec3::Y * 0.45, 0.27, 0.0, 32);
    let (mut stems, mut leaves) = (Geometry::default(), Geometry::default());
    for i in 0..13 {
        let turn = TAU * (i as f32 * 0.381_966 + rng.range(0.0, 0.05));
        let outward = Vec3::new(turn.cos(), 0.0, turn.sin());
        let lean = rng.range(0.12, 0.5);
        let length = rng.range(0.7, 1.25);
        let point = |t: f32| Vec3::Y * (0.42 + length * t * (1.0 - 0.22 * lean * t)) + outward * (0.06 + lean * t * t);
        const SEGMENTS: u32 = 7;
        for k in 0..SEGMENTS {
            let (t, next) = (k as f32 / SEGMENTS as f32, (k + 1) as f32 / SEGMENTS as f32);
            stems.append(&frustum(point(t), point(next), 0.012 * (1.1 - t), 0.012 * (1.1 - next), 8));
            if k < 2 {
                continue;
            }
            for _ in 0..3 {
                let aside = rng.direction() * Vec3::new(1.0, 0.45, 1.0);
                let direction = (outward * 0.5 + aside + Vec3::Y * 0.35).try_normalize().unwrap_or(Vec3::Y);
                let size = rng.range(0.17, 0.3);
                let card = leaf_card(&mut rng, direction, size);
                leaves.append(&card.transformed(Affine3A::from_translation(point(next))));
            }
        }
    }
    let shapes = [
        (Shape::Triangles(pot), clay),
        (Shape::Triangles(earth), soil),
        (Shape::Triangles(stems), stem),
        (Shape::Triangles(leaves), leaf),
    ];
    place(glb, "plant", &shapes, Place::at(Vec3::new(-1.55, 0.0, -0.5)));
}

/// Spheres as primitives: a mirror, two lacquered balls, and a string of glowing beads on the floor.
fn spheres(glb: &mut GlbWriter) {
    let chrome = glb.material(&metal("chrome", [0.95, 0.95, 0.96], 0.03));
    let red = glb.material(&MaterialSpec { roughness: 0.08, ..matte("red lacquer", [0.62, 0.05, 0.04]) });
    let jade = glb.material(&MaterialSpec { roughness: 0.35, ..matte("jade", [0.12, 0.42, 0.3]) });
    let glow = glb.material(&light("beads", [1.0, 0.62, 0.26], 3.0));
    let beads: Vec<(Vec3, f32)> = (0..27)
        .map(|i| {
            let turn = 0.55 + TAU * 0.42 * i as f32 / 26.0;
            let away = 1.32 + 0.1 * (turn * 5.0).sin();
            (Vec3::new(away * turn.cos(), 0.035, away * turn.sin()), 0.035)
        })
        .collect();
    let shapes = [
        (Shape::Spheres(vec![(Vec3::new(-0.82, 0.3, 0.72), 0.3)]), chrome),
        (Shape::Spheres(vec![(Vec3::new(0.8, 0.2, 0.95), 0.2)]), red),
        (Shape::Spheres(vec![(Vec3::new(1.12, 0.13, 0.62), 0.13), (Vec3::new(-0.3, 0.1, 1.15), 0.1)]), jade),
        (Shape::Spheres(beads), glow),
    ];
    place(glb, "spheres", &shapes, Place::default());
}

/// One pebble, many times, around the plinth.
fn pebbles(glb: &mut GlbWriter, seed: u64) {
    let mut rng = Rng::new(seed, 9);
    let tones = [[0.34, 0.31, 0.28], [0.52, 0.49, 0.45], [0.22, 0.23, 0.24]];
    let meshes = tones.map(|tone| {
        let material = glb.material(&MaterialSpec { roughness: 0.5, ..matte("pebble", tone) });
        glb.mesh("pebble", &[(Shape::Triangles(sphere(Vec3::ZERO, 1.0, 24)), material)])
    });
    for i in 0..90 {
        let turn = rng.range(0.0, TAU);
        let away = rng.range(0.62, 0.86);
        let size = rng.range(0.03, 0.065);
        let scale = Vec3::new(size, size * rng.range(0.5, 0.75), size * rng.range(0.75, 1.0));
        let place = Place {
            translation: Vec3::new(away * turn.cos(), scale.y * 0.9, away * turn.sin()),
            rotation: Quat::from_rotation_y(rng.range(0.0, TAU)),
            scale,
        };
        glb.instance(&format!("pebble {i}"), meshes[rng.below(meshes.len())], place);
    }
}
