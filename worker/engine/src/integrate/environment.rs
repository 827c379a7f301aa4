//! Light from infinitely far away: look-up, importance sampling and its density.
//!
//! A map is equirectangular: `+Y` up, the image's centre at `-Z`, its right quarter at `+X`; a positive rotation turns
//! it about `+Y` by the right-hand rule. A constant environment needs no table: directions are cosine-distributed about
//! the shading normal.

use glam::Vec3;

use super::math::{INV_PI, PI, TWO_PI, basis, cosine_hemisphere, to_world};
use crate::pack::PackedScene;

/// World direction to map coordinates in 0..1.
fn direction_to_uv(scene: &PackedScene, d: Vec3) -> (f32, f32) {
    let env = &scene.environment;
    let x = env.rotation_cos * d.x - env.rotation_sin * d.z;
    let z = env.rotation_sin * d.x + env.rotation_cos * d.z;
    let u = 0.5 + x.atan2(-z) * (0.5 * INV_PI);
    (u - u.floor(), d.y.clamp(-1.0, 1.0).acos() * INV_PI)
}

fn uv_to_direction(scene: &PackedScene, u: f32, v: f32) -> Vec3 {
    let env = &scene.environment;
    let (theta, phi) = (PI * v, TWO_PI * (u - 0.5));
    let sine = theta.sin();
    let (x, z) = (sine * phi.sin(), -sine * phi.cos());
    Vec3::new(env.rotation_cos * x + env.rotation_sin * z, theta.cos(), env.rotation_cos * z - env.rotation_sin * x)
}

/// Radiance that arrives from the unit direction `d`; maps are bilinear, wrapping around horizontally.
pub fn environment_radiance(scene: &PackedScene, d: Vec3) -> Vec3 {
    let env = &scene.environment;
    let scale = Vec3::from_array(env.radiance);
    if env.width == 0 {
        return scale;
    }
    let (u, v) = direction_to_uv(scene, d);
    let (x, y) = (u * env.width as f32 - 0.5, v * env.height as f32 - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let (x0, y0) = (x0 as i32, y0 as i32);
    let top = map_texel(scene, x0, y0) * (1.0 - fx) + map_texel(scene, x0 + 1, y0) * fx;
    let bottom = map_texel(scene, x0, y0 + 1) * (1.0 - fx) + map_texel(scene, x0 + 1, y0 + 1) * fx;
    (top * (1.0 - fy) + bottom * fy) * scale
}

fn map_texel(scene: &PackedScene, x: i32, y: i32) -> Vec3 {
    let (w, h) = (scene.environment.width as i32, scene.environment.height as i32);
    let x = if x < 0 {
        x + w
    } else if x >= w {
        x - w
    } else {
        x
    };
    let t = scene.environment_texels[(y.clamp(0, h - 1) * w + x) as usize];
    Vec3::new(t[0], t[1], t[2])
}

/// A direction towards the environment for a point with shading normal `normal`.
pub fn sample_environment(scene: &PackedScene, normal: Vec3, u: f32, v: f32) -> Vec3 {
    let env = &scene.environment;
    if env.width == 0 {
        let (t, b) = basis(normal);
        return to_world(t, b, normal, cosine_hemisphere(u, v));
    }
    let (row, fy) = sample_cdf(scene, 0, env.height, v);
    let (column, fx) = sample_cdf(scene, env.height + row * env.width, env.width, u);
    uv_to_direction(scene, (column as f32 + fx) / env.width as f32, (row as f32 + fy) / env.height as f32)
}

/// Solid-angle density of [`sample_environment`].
pub fn environment_pdf(scene: &PackedScene, normal: Vec3, d: Vec3) -> f32 {
    let env = &scene.environment;
    if env.width == 0 {
        return normal.dot(d).max(0.0) * INV_PI;
    }
    let (u, v) = direction_to_uv(scene, d);
    let column = ((u * env.width as f32) as u32).min(env.width - 1);
    let row = ((v * env.height as f32) as u32).min(env.height - 1);
    let p_row = cdf_step(scene, 0, row);
    let p_column = cdf_step(scene, env.height + row * env.width, column);
    let sine = (1.0 - d.y * d.y).max(0.0).sqrt();
    if sine <= 1e-6 {
        return 0.0;
    }
    p_row * p_column * env.width as f32 * env.height as f32 / (TWO_PI * PI * sine)
}

/// Probability of entry `i` of the cumulative table that starts at `start`.
fn cdf_step(scene: &PackedScene, start: u32, i: u32) -> f32 {
    let upto = scene.environment_cdf[(start + i) as usize];
    if i == 0 { upto } else { upto - scene.environment_cdf[(start + i - 1) as usize] }
}

/// The entry that `u` falls into and where in it.
fn sample_cdf(scene: &PackedScene, start: u32, count: u32, u: f32) -> (u32, f32) {
    let (mut low, mut high) = (0, count - 1);
    while low < high {
        let middle = (low + high) / 2;
        if scene.environment_cdf[(start + middle) as usize] > u {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    let before = if low == 0 { 0.0 } else { scene.environment_cdf[(start + low - 1) as usize] };
    let width = scene.environment_cdf[(start + low) as usize] - before;
    let fraction = if width > 0.0 { (u - before) / width } else { 0.5 };
    (low, fraction.clamp(0.0, 0.999_999_9))
}
