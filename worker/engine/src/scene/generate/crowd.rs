//! Many instances that overlap, and scenes of very unequal scales.

use std::f32::consts::TAU;

use glam::Vec3;

use super::rng::Rng;
use super::shapes::{closed_tube, cuboid, floor, frustum, sphere, surface, torus, torus_knot};
use super::{Amounts, sphere_rows};
use crate::scene::write_glb::{Geometry, GlbWriter, MaterialSpec, Place, Shape};

/// Closed curves of `triangles` triangles, four times as many cells along as around.
fn knot(triangles: u32, p: f32, q: f32, radius: f32) -> Geometry {
    let sides = (((triangles as f32 / 16.0).sqrt()) as u32).max(6);
    closed_tube(8 * sides, sides, radius, |t| torus_knot(p, q, t))
}

pub(super) fn pile(amounts: &Amounts) -> GlbWriter {
    let mut rng = Rng::new(amounts.seed, 5);
    let mut glb = GlbWriter::new();
    let each = amounts.triangles / 4;
    let rounded = (((each as f32 / 4.0).sqrt()) as u32).max(6);
    let kinds: [(&str, Geometry, [f32; 3], f32, f32); 5] = [
        ("cube", cuboid(Vec3::splat(-0.6), Vec3::splat(0.6)), [0.75, 0.24, 0.14], 0.0, 0.7),
        ("ball", sphere(Vec3::ZERO, 0.7, sphere_rows(each)), [0.9, 0.9, 0.92], 1.0, 0.15),
        ("ring", torus(0.35, 2 * rounded, rounded), [0.15, 0.35, 0.6], 0.0, 0.3),
        ("knot", knot(each, 2.0, 3.0, 0.16), [0.95, 0.72, 0.32], 1.0, 0.3),
        ("loop", knot(each, 3.0, 2.0, 0.13), [0.2, 0.5, 0.27], 0.0, 0.5),
    ];
    let meshes = kinds.map(|(name, geometry, base_color, metallic, roughness)| {
        let material = MaterialSpec { name, base_color, metallic, roughness, ..MaterialSpec::default() };
        let material = glb.material(&material);
        glb.mesh(name, &[(Shape::Triangles(geometry), material)])
    });
    // A heap: as wide as its volume needs, its height falling off to the rim; neighbours sink into each other.
    let radius = (amounts.count as f32).cbrt() * 0.95;
    for i in 0..amounts.count {
        let angle = rng.range(0.0, TAU);
        let away = radius * rng.unit().sqrt();
        let top = 1.1 * (radius - away);
        let translation = Vec3::new(away * angle.cos(), 0.45 + top * rng.unit(), away * angle.sin());
        let place = Place { translation, rotation: rng.rotation(), scale: Vec3::splat(rng.range(0.5, 1.0)) };
        glb.instance(&format!("object {i}"), meshes[rng.below(meshes.len())], place);
    }
    let ground =
        glb.material(&MaterialSpec { name: "ground", base_color: [0.5, 0.47, 0.43], ..MaterialSpec::default() });
    let plane = glb.mesh("ground", &[(Shape::Triangles(floor(0.0, 8.0 * radius, 1.0)), ground)]);
    glb.instance("ground", plane, Place::default());
    glb.sun("sun", Vec3::new(1.0, 1.6, 0.8), [1.0, 0.95, 0.85], 3.5);
    let eye = Vec3::new(1.1, 1.15, 2.1) * radius;
    glb.perspective_camera("main", eye, Vec3::Y * 0.38 * radius, 38.0);
    glb
}

/// The teapot in the stadium, with a knot for a teapot: half of the triangles in a hand's breadth, half around it.
pub(super) fn stadium(amounts: &Amounts) -> GlbWriter {
    let mut glb = GlbWriter::new();
    let concrete =
        glb.material(&MaterialSpec { name: "concrete", base_color: [0.55, 0.54, 0.52], ..MaterialSpec::default() });
    let grass =
        glb.material(&MaterialSpec { name: "grass", base_color: [0.09, 0.22, 0.05], ..MaterialSpec::default() });
    let brass = glb.material(&MaterialSpec {
        name: "brass",
        base_color: [0.9, 0.68, 0.32],
        metallic: 1.0,
        roughness: 0.2,
        ..MaterialSpec::default()
    });
    // Rows of seats: a profile of steps, swept around an oval.
    let rows = 40_u32;
    let profile: Vec<(f32, f32)> = (0..=rows)
        .flat_map(|row| {
            let (away, height) = (55.0 + 0.9 * row as f32, 1.5 + 0.55 * row as f32);
            [(away, height), (away + 0.9, height)]
        })
        .collect();
    let around = (amounts.triangles / 4 / profile.len() as u32).max(24);
    let last = profile.len() - 1;
    let mut bowl = surface(around, last as u32, |u, v| {
        let angle = if u == 1.0 { 0.0 } else { -u * TAU };
        let (away, height) = profile[(v * last as f32).round() as usize];
        (Vec3::new(1.45 * away * angle.sin(), height, away * angle.cos()), Vec3::Y)
    });
    // Steps are flat: shaded by their faces.
    bowl.normals.clear();
    bowl.uvs.clear();
    let bowl = glb.mesh("stands", &[(Shape::Triangles(bowl), concrete)]);
    glb.instance("stands", bowl, Place::default());
    let field = glb.mesh("field", &[(Shape::Triangles(floor(0.0, 125.0, 1.0)), grass)]);
    glb.instance("field", field, Place::default());
    let plinth = frustum(Vec3::ZERO, Vec3::Y, 0.2, 0.15, 48);
    let mut top = frustum(Vec3::Y, Vec3::Y * 1.0001, 0.15, 0.0, 48);
    top.append(&plinth);
    let plinth = glb.mesh("plinth", &[(Shape::Triangles(top), concrete)]);
    glb.instance("plinth", plinth, Place::default());
    let object = glb.mesh("object", &[(Shape::Triangles(knot(amounts.triangles / 2, 2.0, 3.0, 0.17)), brass)]);
    let place = Place { translation: Vec3::Y * 1.06, scale: Vec3::splat(0.12), ..Place::default() };
    glb.instance("object", object, place);
    glb.sun("sun", Vec3::new(0.8, 1.4, 1.0), [1.0, 0.96, 0.88], 4.0);
    glb.perspective_camera("main", Vec3::new(0.25, 1.25, 0.55), Vec3::new(0.0, 1.04, 0.0), 45.0);
    glb.perspective_camera("from the stands", Vec3::new(0.0, 24.0, 88.0), Vec3::new(0.0, 0.0, -8.0), 60.0);
    glb
}
