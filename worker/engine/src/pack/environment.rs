//! The environment and the tables that importance-sample it.
//!
//! A map is a piecewise-constant density over its texels, `luminance * sin(theta)` plus a floor, sampled row first,
//! then column (Pharr, Jakob and Humphreys 2023, section 12.5).

use glam::Vec3;

use super::{NONE, PackError, PackedEnvironment, index};
use crate::integrate::math::luminance;
use crate::settings::Environment;

/// Share of the density that is uniform over the sphere: bilinear look-ups are never far above what was sampled for.
const UNIFORM_SHARE: f64 = 0.1;

pub(super) struct PackedMap {
    pub header: PackedEnvironment,
    pub texels: Vec<[f32; 4]>,
    pub cdf: Vec<f32>,
    /// Radiance averaged over the sphere.
    pub mean_radiance: Vec3,
}

pub(super) fn pack_environment(environment: &Environment) -> Result<PackedMap, PackError> {
    let invalid = |detail: String| PackError::InvalidSetting { field: "environment", detail };
    let mut header = PackedEnvironment { rotation_cos: 1.0, light: NONE, ..PackedEnvironment::default() };
    let (image, intensity, rotation) = match environment {
        Environment::Constant(radiance) => {
            if !radiance.is_finite() || radiance.min_element() < 0.0 {
                return Err(invalid(format!("radiance is {radiance}, must be finite and not negative")));
            }
            header.radiance = radiance.to_array();
            return Ok(PackedMap { header, texels: Vec::new(), cdf: Vec::new(), mean_radiance: *radiance });
        }
        Environment::Map { image, intensity, rotation_y_rad } => (image, *intensity, *rotation_y_rad),
    };
    if !intensity.is_finite() || intensity < 0.0 || !rotation.is_finite() {
        return Err(invalid("intensity must be finite and not negative, the rotation finite".into()));
    }
    let (width, height) = (image.width as usize, image.height as usize);
    if width == 0 || height == 0 || image.rgb.len() != width * height {
        return Err(invalid(format!("map has {} texels for {width}x{height}", image.rgb.len())));
    }
    index("environment texels", width * height + height)?;
    header.radiance = [intensity; 3];
    header.width = image.width;
    header.height = image.height;
    header.rotation_cos = rotation.cos();
    header.rotation_sin = rotation.sin();

    let clean = |c: f32| if c.is_finite() { c.max(0.0) } else { 0.0 };
    let texels: Vec<[f32; 4]> = image.rgb.iter().map(|&[r, g, b]| [clean(r), clean(g), clean(b), 0.0]).collect();
    let (cdf, mean) = tables(&texels, width, height);
    Ok(PackedMap { header, texels, cdf, mean_radiance: mean * intensity })
}

/// The inclusive cumulative probabilities of the rows, then of the texels in each row; and the mean radiance.
fn tables(texels: &[[f32; 4]], width: usize, height: usize) -> (Vec<f32>, Vec3) {
    let sine = |row: usize| (std::f64::consts::PI * (row as f64 + 0.5) / height as f64).sin();
    let weights = bilinear_luminance(texels, width, height);
    let (mut total, mut area, mut mean) = (0.0, 0.0, [0.0f64; 3]);
    for (i, t) in texels.iter().enumerate() {
        let sine = sine(i / width);
        total += weights[i] * sine;
        area += sine;
        (0..3).for_each(|c| mean[c] += f64::from(t[c]) * sine);
    }
    let floor = if total > 0.0 { UNIFORM_SHARE / (1.0 - UNIFORM_SHARE) * total / area } else { 1.0 };
    let mut rows = Vec::with_capacity(height);
    let mut columns = Vec::with_capacity(width * height);
    let mut row_sum = 0.0;
    for (row, line) in weights.chunks_exact(width).enumerate() {
        let line_total: f64 = line.iter().map(|weight| weight + floor).sum();
        let mut sum = 0.0;
        for weight in line {
            sum += weight + floor;
            columns.push((sum / line_total) as f32);
        }
        row_sum += line_total * sine(row);
        rows.push(row_sum);
        if let Some(last) = columns.last_mut() {
            *last = 1.0;
        }
    }
    let mut cdf: Vec<f32> = rows.iter().map(|r| (r / row_sum) as f32).collect();
    cdf[height - 1] = 1.0;
    cdf.append(&mut columns);
    (cdf, Vec3::from_array(mean.map(|c| (c / area) as f32)))
}

/// Luminance of the bilinear look-up averaged over each texel: 6/8 of its own and 1/8 of each neighbour's, along both
/// axes. So the density follows what is looked up, also around a single bright texel.
fn bilinear_luminance(texels: &[[f32; 4]], width: usize, height: usize) -> Vec<f64> {
    let own: Vec<f64> = texels.iter().map(|t| f64::from(luminance(Vec3::new(t[0], t[1], t[2])))).collect();
    let across: Vec<f64> = (0..own.len())
        .map(|i| {
            let (row, x) = (i / width * width, i % width);
            0.125 * (own[row + (x + width - 1) % width] + own[row + (x + 1) % width]) + 0.75 * own[i]
        })
        .collect();
    (0..own.len())
        .map(|i| {
            let (y, x) = (i / width, i % width);
            let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
            0.125 * (across[above * width + x] + across[below * width + x]) + 0.75 * across[i]
        })
        .collect()
}
