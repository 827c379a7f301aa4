//! The light list: everything that next-event estimation can aim at, and how likely it does so.
//!
//! A light's probability follows the power that it sends into the scene: area times mean emission for emitters, the flux
//! through the scene's bounding sphere for directional lights and the environment. But power says little about what a
//! given point sees: a room may be lit by a lamp alone while a sun shines on its roof. So the probability is a mixture.
//! A part of the samples goes evenly to the kinds of light that there are (environment, directional, punctual,
//! emitters), and of each kind's samples a part evenly to its lights; so no light is starved, whatever shines beside it.
//!
//! Probabilities are held in fixed point, as ranges of the 32-bit numbers that select: what is stored is exactly what is
//! done, also for millions of lights.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use super::{
    LIGHT_DIRECTIONAL, LIGHT_ENVIRONMENT, LIGHT_POINT, LIGHT_SPHERE, LIGHT_SPOT, LIGHT_TRIANGLE, MATERIAL_UNLIT, NONE,
    PackError, PackedLight, PackedScene, index,
};
use crate::integrate::math::{PI, transform_point, transform_vector, uniform_sphere};
use crate::integrate::surface::{emission, material_index, sphere_point, triangle_corners, triangle_point};
use crate::scene::{PunctualKind, PunctualLight};

/// Share of the samples that the kinds of light divide evenly among them.
const EVEN_AMONG_KINDS: f64 = 0.4;
/// Share of a kind's samples that its lights divide evenly among them.
const EVEN_AMONG_LIGHTS: f64 = 0.1;
/// The lights of a scene beyond which a list of them is no longer sensible.
const MAX_LIGHTS: u64 = 1 << 24;
// The even share of the weakest of the most lights is still more than one of the numbers that select.
const _: () = assert!(NUMBERS * EVEN_AMONG_KINDS / 4.0 * EVEN_AMONG_LIGHTS / MAX_LIGHTS as f64 > 1.0);
/// Primitives of instances that emit, whether they themselves emit or not: each has an entry that names its light.
const MAX_ENTRIES: u64 = 1 << 28;
/// Textured emitters are averaged over this many points a side of a grid.
const TEXTURE_GRID: u32 = 6;
/// Share of the untextured emission given to emitters that are black at every grid point: detail may hide between.
const UNSEEN_SHARE: f32 = 1e-3;

/// Fills `lights`, `light_cdf`, `emitter_lights`, the instances' `emitter_base` and `environment.light`. `radius` is that
/// of the scene, without a ground that a job laid under it.
pub(super) fn pack_lights<'a>(
    packed: &mut PackedScene,
    punctual: impl Iterator<Item = &'a PunctualLight>,
    environment_mean: Vec3,
    radius: f32,
) -> Result<(), PackError> {
    let radius = f64::from(radius);
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
    let sky = f64::from(mean(environment_mean)) * 4.0 * std::f64::consts::PI.powi(2) * radius * radius;
    if sky > 0.0 {
        packed.environment.light = index("lights", lights.len())?;
        lights.push(PackedLight { kind: LIGHT_ENVIRONMENT, ..blank() });
        powers.push(sky);
    }
    check_limit("lights", lights.len() as u64, MAX_LIGHTS)?;
    packed.light_cdf = thresholds(&probabilities(&lights, &powers));
    let mut before = 0;
    for (light, &last) in lights.iter_mut().zip(&packed.light_cdf) {
        let end = u64::from(last) + 1;
        light.selection = ((end - before) as f64 / NUMBERS) as f32;
        before = end;
    }
    packed.lights = lights;
    Ok(())
}

/// How likely each light is to be chosen. Adds up to 1.
fn probabilities(lights: &[PackedLight], powers: &[f64]) -> Vec<f64> {
    let kind = |light: &PackedLight| match light.kind {
        LIGHT_ENVIRONMENT => 0,
        LIGHT_DIRECTIONAL => 1,
        LIGHT_POINT | LIGHT_SPOT => 2,
        _ => 3,
    };
    let (mut counts, mut sums) = ([0_u32; 4], [0.0_f64; 4]);
    for (light, power) in lights.iter().zip(powers) {
        counts[kind(light)] += 1;
        sums[kind(light)] += power;
    }
    let total: f64 = sums.iter().sum();
    let kinds = counts.iter().filter(|&&count| count > 0).count() as f64;
    let mixed = |share: f64, even: f64, count: f64| (1.0 - even) * share + even / count;
    lights
        .iter()
        .zip(powers)
        .map(|(light, power)| {
            let k = kind(light);
            let of_kind = mixed(sums[k] / total, EVEN_AMONG_KINDS, kinds);
            of_kind * mixed(power / sums[k], EVEN_AMONG_LIGHTS, f64::from(counts[k]))
        })
        .collect()
}

/// How many numbers select.
const NUMBERS: f64 = 4_294_967_296.0;

/// For each light the last number that selects it; the next number selects the next light.
fn thresholds(probabilities: &[f64]) -> Vec<u32> {
    let total: f64 = probabilities.iter().sum();
    let mut sum = 0.0;
    let mut ends: Vec<u32> = probabilities
        .iter()
        .map(|probability| {
            sum += probability;
            (sum / total * NUMBERS - 1.0) as u32
        })
        .collect();
    if let Some(last) = ends.last_mut() {
        *last = u32::MAX;
    }
    ends
}

fn check_limit(what: &'static str, count: u64, limit: u64) -> Result<(), PackError> {
    if count <= limit { Ok(()) } else { Err(PackError::TooLarge { what, count, limit }) }
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
    // Which primitives emit is a matter of the mesh and of the list of materials, which instances share.
    let mut emitting: HashMap<(u32, u32), Vec<u32>> = HashMap::new();
    let mut emitters = 0u64;
    for number in 0..packed.instances.len() {
        let instance = packed.instances[number];
        if instance.world_to_object == [[0.0; 4]; 3] {
            continue;
        }
        let scene = &*packed;
        let mesh = scene.meshes[instance.mesh as usize];
        let count = mesh.triangle_count + mesh.sphere_count;
        let primitives = emitting.entry((instance.mesh, instance.material_base)).or_insert_with(|| {
            let is_emitter = |p: &u32| glows[material_index(scene, &instance, &mesh, *p) as usize];
            (0..count).into_par_iter().filter(is_emitter).collect()
        });
        if primitives.is_empty() {
            continue;
        }
        emitters += primitives.len() as u64;
        check_limit("emitting primitives", emitters, MAX_LIGHTS)?;
        let entries = packed.emitter_lights.len() as u64 + u64::from(count);
        check_limit("primitives of emitting instances", entries, MAX_ENTRIES)?;
        let found: Vec<(u32, Vec3, f32)> = primitives
            .par_iter()
            .map(|&p| {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Lights of the given kinds and powers, as selection sees them: the numbers that select each.
    fn ranges(lights: &[(u32, f64)]) -> Vec<u64> {
        let (packed, powers): (Vec<_>, Vec<_>) =
            lights.iter().map(|&(kind, power)| (PackedLight { kind, ..blank() }, power)).unzip();
        let mut before = 0;
        let ends = thresholds(&probabilities(&packed, &powers));
        assert_eq!(ends.last(), Some(&u32::MAX));
        ends.iter().map(|&last| u64::from(last) + 1 - std::mem::replace(&mut before, u64::from(last) + 1)).collect()
    }

    #[test]
    fn every_light_gets_its_share_whatever_shines_beside_it() {
        for ratio in [1.0, 1e6, 1e30] {
            let ranges = ranges(&[(LIGHT_DIRECTIONAL, ratio), (LIGHT_POINT, 1.0), (LIGHT_POINT, ratio)]);
            let share = |i: usize| ranges[i] as f64 / NUMBERS;
            assert!(share(0) > 0.19 && share(1) > 0.2 * 0.049 && share(2) > 0.2 * 0.049, "{ranges:?}");
        }
    }

    #[test]
    fn hundreds_of_thousands_of_emitters_beside_one_of_a_million_times_their_power() {
        let count = 600_000;
        let mut lights = vec![(LIGHT_TRIANGLE, 1.0); count];
        lights[count / 2].1 = 1e6;
        let ranges = ranges(&lights);
        assert_eq!(ranges.iter().sum::<u64>(), 1 << 32);
        let total = count as f64 - 1.0 + 1e6;
        for (range, (_, power)) in ranges.iter().zip(&lights) {
            let expected = (0.9 * power / total + 0.1 / count as f64) * NUMBERS;
            assert!((*range as f64 - expected).abs() <= 1.0 + 1e-6 * expected, "{range}, expected {expected}");
        }
    }
}
