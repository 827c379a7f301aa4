//! The light list: everything that next-event estimation can aim at, and how likely it does so.
//!
//! A light's probability is proportional to the power that it sends into the scene: area times mean emission for
//! emitters, the flux through the scene's bounding sphere for directional lights. The environment gets its share by
//! the same measure, held between bounds where there are other lights, since power says little about what a given
//! point sees (an interior's lamp beside a bright sky, or the reverse).

use glam::Vec3;
use rayon::prelude::*;

use super::{
    LIGHT_DIRECTIONAL, LIGHT_ENVIRONMENT, LIGHT_POINT, LIGHT_SPHERE, LIGHT_SPOT, LIGHT_TRIANGLE, MATERIAL_UNLIT, NONE,
    PackError, PackedLight, PackedScene, index,
};
use crate::integrate::math::{PI, transform_point, transform_vector, uniform_sphere};
use crate::integrate::surface::{emission, material_index, sphere_point, triangle_corners, triangle_point};
use crate::scene::{PunctualKind, PunctualLight};

/// Bounds of the environment's share of light samples in a scene with other lights.
const ENVIRONMENT_SHARE: (f64, f64) = (0.2, 0.8);
/// The emitters of a scene beyond which a list of them is no longer sensible.
const MAX_EMITTERS: u64 = 1 << 24;
/// Textured emitters are averaged over this many points a side of a grid.
const TEXTURE_GRID: u32 = 6;
/// Share of the untextured emission given to emitters that are black at every grid point: detail may hide between.
const UNSEEN_SHARE: f32 = 1e-3;

/// Fills `lights`, `light_cdf`, `emitter_lights`, the instances' `emitter_base` and `environment.light`.
pub(super) fn pack_lights<'a>(
    packed: &mut PackedScene,
    punctual: impl Iterator<Item = &'a PunctualLight>,
    environment_mean: Vec3,
) -> Result<(), PackError> {
    let radius = f64::from(packed.radius());
    let mut lights = Vec::new();
    let mut powers: Vec<f64> = Vec::new();
    for light in punctual {
        let (packed_light, power) = pack_punctual(light, radius)?;
        if power > 0.0 {
            lights.push(packed_light);
            powers.push(power);
        }
    }
    pack_emitters(packed, &mut lights, &mut powers)?;

    let local: f64 = powers.iter().sum();
    let sky = f64::from(mean(environment_mean)) * 4.0 * std::f64::consts::PI.powi(2) * radius * radius;
    if sky > 0.0 {
        let share =
            if local > 0.0 { (sky / (sky + local)).clamp(ENVIRONMENT_SHARE.0, ENVIRONMENT_SHARE.1) } else { 1.0 };
        powers.iter_mut().for_each(|p| *p *= (1.0 - share) / local.max(f64::MIN_POSITIVE));
        powers.push(share);
        packed.environment.light = index("lights", lights.len())?;
        lights.push(PackedLight { kind: LIGHT_ENVIRONMENT, ..blank() });
    }
    index("lights", lights.len())?;
    packed.light_cdf = cumulative(&powers);
    // What selection really does with the rounded table: nothing is lost to rounding.
    let mut before = 0.0;
    for (light, &upto) in lights.iter_mut().zip(&packed.light_cdf) {
        light.selection = upto - before;
        before = upto;
    }
    packed.lights = lights;
    Ok(())
}

fn cumulative(weights: &[f64]) -> Vec<f32> {
    let total: f64 = weights.iter().sum();
    let mut sum = 0.0;
    let mut cdf: Vec<f32> = weights
        .iter()
        .map(|w| {
            sum += w;
            (sum / total) as f32
        })
        .collect();
    if let Some(last) = cdf.last_mut() {
        *last = 1.0;
    }
    cdf
}

fn mean(c: Vec3) -> f32 {
    (c.x + c.y + c.z) * (1.0 / 3.0)
}

fn blank() -> PackedLight {
    PackedLight {
        position: [0.0; 3],
        kind: LIGHT_POINT,
        direction: [0.0, -1.0, 0.0],
        range: f32::INFINITY,
        intensity: [0.0; 3],
        selection: 0.0,
        spot_scale: 0.0,
        spot_offset: 1.0,
        instance: NONE,
        primitive: NONE,
    }
}

/// A punctual light and its power.
fn pack_punctual(light: &PunctualLight, radius: f64) -> Result<(PackedLight, f64), PackError> {
    let finite = light.position.is_finite() && light.intensity.is_finite() && light.intensity.min_element() >= 0.0;
    let direction = light.direction.try_normalize();
    let needs_direction = !matches!(light.kind, PunctualKind::Point);
    if !finite || light.range.is_nan() || (needs_direction && direction.is_none()) {
        let detail = format!("light {:?} has a position, direction, range or intensity that is no number", light.name);
        return Err(PackError::InvalidScene(detail));
    }
    let mut packed = PackedLight {
        position: light.position.to_array(),
        direction: direction.unwrap_or(Vec3::NEG_Y).to_array(),
        range: if light.range > 0.0 { light.range } else { f32::INFINITY },
        intensity: light.intensity.to_array(),
        ..blank()
    };
    let intensity = f64::from(mean(light.intensity));
    let pi = std::f64::consts::PI;
    let power = match light.kind {
        PunctualKind::Point => {
            packed.kind = LIGHT_POINT;
            4.0 * pi * intensity
        }
        PunctualKind::Directional => {
            packed.kind = LIGHT_DIRECTIONAL;
            pi * radius * radius * intensity
        }
        PunctualKind::Spot { inner_cone_rad, outer_cone_rad } => {
            packed.kind = LIGHT_SPOT;
            packed.spot_scale = 1.0 / (inner_cone_rad.cos() - outer_cone_rad.cos()).max(1e-3);
            packed.spot_offset = -outer_cone_rad.cos() * packed.spot_scale;
            2.0 * pi * (1.0 - f64::from(outer_cone_rad.cos())) * intensity
        }
    };
    Ok((packed, power))
}

/// All primitives that emit, instance by instance.
fn pack_emitters(
    packed: &mut PackedScene,
    lights: &mut Vec<PackedLight>,
    powers: &mut Vec<f64>,
) -> Result<(), PackError> {
    let glows: Vec<bool> =
        packed.materials.iter().map(|m| m.emissive.iter().any(|&e| e > 0.0) && m.flags & MATERIAL_UNLIT == 0).collect();
    let mut emitters = 0u64;
    for number in 0..packed.instances.len() {
        let instance = packed.instances[number];
        let mesh = packed.meshes[instance.mesh as usize];
        let count = mesh.triangle_count + mesh.sphere_count;
        let is_emitter = |p: u32| glows[material_index(packed, &instance, &mesh, p) as usize];
        if instance.world_to_object == [[0.0; 4]; 3] || !(0..count).any(is_emitter) {
            continue;
        }
        emitters += u64::from(count);
        if emitters > MAX_EMITTERS {
            return Err(PackError::TooLarge { what: "emitting primitives", count: emitters, limit: MAX_EMITTERS });
        }
        let scene = &*packed;
        let found: Vec<(u32, Vec3, f32)> = (0..count)
            .into_par_iter()
            .filter(|&p| is_emitter(p))
            .map(|p| {
                let (emitted, area) = emitter(scene, number as u32, p);
                (p, emitted, area)
            })
            .collect();
        let base = index("emitting primitives", packed.emitter_lights.len())?;
        packed.emitter_lights.resize(base as usize + count as usize, NONE);
        packed.instances[number].emitter_base = base;
        for (primitive, emitted, area) in found {
            let power = f64::from(mean(emitted)) * f64::from(area) * f64::from(PI);
            if power > 0.0 && power.is_finite() {
                packed.emitter_lights[(base + primitive) as usize] = index("lights", lights.len())?;
                let kind = if primitive < mesh.triangle_count { LIGHT_TRIANGLE } else { LIGHT_SPHERE };
                let instance = number as u32;
                lights.push(PackedLight { kind, intensity: emitted.to_array(), instance, primitive, ..blank() });
                powers.push(power);
            }
        }
    }
    Ok(())
}

/// Mean emitted radiance and world-space area of a primitive.
fn emitter(scene: &PackedScene, instance: u32, primitive: u32) -> (Vec3, f32) {
    let inst = &scene.instances[instance as usize];
    let mesh = &scene.meshes[inst.mesh as usize];
    let material = &scene.materials[material_index(scene, inst, mesh, primitive) as usize];
    let textured = material.emissive_texture != NONE;
    let grid = if textured { TEXTURE_GRID } else { 1 };
    let cell = |i: u32| (i as f32 + 0.5) / grid as f32;
    let mut sum = Vec3::ZERO;
    if primitive < mesh.triangle_count {
        for i in 0..grid * grid {
            let (mut u, mut v) = (cell(i % grid), cell(i / grid));
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            sum += emission(scene, material, &triangle_point(scene, instance, primitive, u, v));
        }
    } else {
        for i in 0..grid * grid {
            let n = uniform_sphere(cell(i % grid), cell(i / grid));
            sum += emission(scene, material, &sphere_point(scene, instance, primitive, n));
        }
    }
    let mut emitted = sum / (grid * grid) as f32;
    if textured && mean(emitted) == 0.0 {
        emitted = Vec3::from_array(material.emissive) * UNSEEN_SHARE;
    }
    (emitted, area(scene, instance, primitive))
}

fn area(scene: &PackedScene, instance: u32, primitive: u32) -> f32 {
    let inst = &scene.instances[instance as usize];
    let mesh = &scene.meshes[inst.mesh as usize];
    if primitive < mesh.triangle_count {
        let triangle = scene.triangles[(mesh.triangle_offset + primitive) as usize];
        let [a, b, c] = triangle_corners(scene, mesh, triangle).map(|p| transform_point(&inst.object_to_world, p));
        return 0.5 * (b - a).cross(c - a).length();
    }
    // Ellipsoids: Thomsen's approximation over the images of the axes; only the selection depends on it.
    let radius = scene.spheres[(mesh.sphere_offset + primitive - mesh.triangle_count) as usize][3];
    let axes = [Vec3::X, Vec3::Y, Vec3::Z].map(|a| transform_vector(&inst.object_to_world, a * radius).length());
    let products = [axes[0] * axes[1], axes[0] * axes[2], axes[1] * axes[2]];
    let p = 1.6075;
    4.0 * PI * (products.iter().map(|x| x.powf(p)).sum::<f32>() / 3.0).powf(1.0 / p)
}
