//! Directional albedo of the GGX lobe over roughness and angle.
//!
//! With Schlick's Fresnel the albedo is `F0 * A + B` (Karis 2013's split sum), so two tables serve every material.
//! Layout: `GGX_TABLE_SIZE` rows of roughness 0..1, each of `GGX_TABLE_SIZE` cosines 0..1, `(A, B)` pairs; then for
//! each roughness the pair averaged over the cosine-weighted hemisphere. About 8 KiB.

use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;

use crate::integrate::bsdf::{MIN_ALPHA, ggx_g1, ggx_g2, sample_visible_normal, schlick};

/// Entries of the table in each of its two dimensions.
pub const GGX_TABLE_SIZE: usize = 32;

/// Points of the quasi-Monte-Carlo sum behind each entry; the error is below 1e-3.
const SAMPLES: u32 = 1024;

/// The table; computed once in a process (some milliseconds).
pub(super) fn ggx_albedo() -> &'static [f32] {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let rows: Vec<_> = (0..GGX_TABLE_SIZE).into_par_iter().map(row).collect();
        let averages: Vec<_> = rows.iter().flat_map(|row| average(row)).collect();
        rows.into_iter().flatten().flatten().chain(averages).collect()
    })
}

fn row(roughness_index: usize) -> Vec<[f32; 2]> {
    let last = (GGX_TABLE_SIZE - 1) as f32;
    let roughness = roughness_index as f32 / last;
    let alpha = (roughness * roughness).max(MIN_ALPHA);
    (0..GGX_TABLE_SIZE).map(|i| entry(alpha, (i as f32 / last).max(1e-3))).collect()
}

/// `(A, B)`: the mean of `G2 / G1` over visible normals, without and with Schlick's fifth power.
fn entry(alpha: f32, cosine: f32) -> [f32; 2] {
    let wo = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
    let (mut a, mut b) = (0.0f64, 0.0f64);
    for i in 0..SAMPLES {
        let u = (i as f32 + 0.5) / SAMPLES as f32;
        let v = i.reverse_bits() as f32 / u32::MAX as f32;
        let h = sample_visible_normal(alpha, wo, u, v);
        let wi = h * (2.0 * wo.dot(h)) - wo;
        if wi.z > 0.0 {
            let weight = f64::from(ggx_g2(alpha, wo, wi) / ggx_g1(alpha, wo));
            let fresnel = f64::from(schlick(wo.dot(h)));
            a += weight * (1.0 - fresnel);
            b += weight * fresnel;
        }
    }
    [a, b].map(|sum| (sum / f64::from(SAMPLES)) as f32)
}

/// The integral of `2 cos * entry(cos)`, exact for the piecewise linear function that look-ups see.
fn average(row: &[[f32; 2]]) -> [f32; 2] {
    let last = (GGX_TABLE_SIZE - 1) as f64;
    let mut sum = [0.0f64; 2];
    for i in 0..GGX_TABLE_SIZE - 1 {
        let (x0, x1) = (i as f64 / last, (i + 1) as f64 / last);
        let width = x1 - x0;
        for c in 0..2 {
            let (y0, y1) = (f64::from(row[i][c]), f64::from(row[i + 1][c]));
            sum[c] += width * (x0 * (2.0 * y0 + y1) + x1 * (y0 + 2.0 * y1)) / 3.0;
        }
    }
    sum.map(|s| s as f32)
}

#[cfg(test)]
mod tests {
    use std::f32::consts::TAU;

    use super::*;

    /// Brute force over the hemisphere with the evaluated lobe, independent of visible-normal sampling.
    fn albedo_by_quadrature(alpha: f32, cosine: f32) -> f64 {
        use crate::integrate::bsdf::ggx_d;
        let wo = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
        let (nz, np) = (400, 400);
        let mut sum = 0.0f64;
        for i in 0..nz {
            let z = (i as f32 + 0.5) / nz as f32;
            let r = (1.0 - z * z).sqrt();
            for j in 0..np {
                let phi = TAU * (j as f32 + 0.5) / np as f32;
                let wi = Vec3::new(r * phi.cos(), r * phi.sin(), z);
                let h = (wo + wi).normalize();
                sum += f64::from(ggx_d(alpha, h) * ggx_g2(alpha, wo, wi) / (4.0 * cosine));
            }
        }
        sum * f64::from(TAU) / f64::from(nz * np)
    }

    #[test]
    fn table_agrees_with_quadrature() {
        let table = ggx_albedo();
        assert_eq!(table.len(), GGX_TABLE_SIZE * GGX_TABLE_SIZE * 2 + GGX_TABLE_SIZE * 2);
        for (r, m) in [(31, 31), (31, 10), (20, 31), (20, 6), (15, 16)] {
            let i = (r * GGX_TABLE_SIZE + m) * 2;
            let roughness = r as f32 / 31.0;
            let expected = albedo_by_quadrature(roughness * roughness, m as f32 / 31.0);
            let got = f64::from(table[i] + table[i + 1]);
            assert!((got - expected).abs() < 3e-3, "row {r}, column {m}: {got} but {expected}");
        }
    }

    #[test]
    fn averages_integrate_the_rows() {
        let ones = vec![[1.0, 0.5]; GGX_TABLE_SIZE];
        assert_eq!(average(&ones), [1.0, 0.5]);
        let linear: Vec<_> = (0..GGX_TABLE_SIZE).map(|i| [i as f32 / 31.0, 0.0]).collect();
        assert!((average(&linear)[0] - 2.0 / 3.0).abs() < 1e-6);
    }
}
