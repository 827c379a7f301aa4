//! The BSDF by quadrature over the hemisphere: energy, reciprocity, densities.

use glam::Vec3;

use crate::integrate::bsdf::{Bsdf, eval_bsdf, make_bsdf, pdf_bsdf, sample_bsdf};
use crate::integrate::sampler::{hash, unit_float};
use crate::integrate::tests::{matte, prepare, scene, settings, sphere};
use crate::scene::Material;
use crate::settings::Integrator;

fn table() -> Vec<f32> {
    let view = super::camera(Vec3::ZERO, Vec3::Z, 3.0, 1.0);
    let scene = scene(vec![(sphere(), matte(0.5, 1.0), glam::Affine3A::IDENTITY)]);
    prepare(&scene, &settings(Integrator::Aov, view, 0.0)).ggx_albedo
}

fn direction(cosine: f32, phi: f32) -> Vec3 {
    let sine = (1.0 - cosine * cosine).sqrt();
    Vec3::new(sine * phi.cos(), sine * phi.sin(), cosine)
}

/// Midpoint rule over the hemisphere, finer towards the mirror direction through the substitution of cosine squared.
fn integrate(f: impl Fn(Vec3) -> Vec3) -> Vec3 {
    let (nz, np) = (600, 600);
    let mut sum = glam::DVec3::ZERO;
    for i in 0..nz {
        for j in 0..np {
            let z = (i as f32 + 0.5) / nz as f32;
            let phi = std::f32::consts::TAU * (j as f32 + 0.5) / np as f32;
            sum += f(direction(z, phi)).as_dvec3();
        }
    }
    (sum * (std::f64::consts::TAU / f64::from(nz * np))).as_vec3()
}

/// The reflectance of dielectrics without one of their own.
const F0: Vec3 = Vec3::splat(Material::DIELECTRIC_F0);

/// Materials wide enough for the quadrature.
fn cases(table: &[f32]) -> Vec<(Vec3, f32, f32, Bsdf)> {
    let mut out = Vec::new();
    let colored = Vec3::new(0.8, 0.4, 0.1);
    for (color, f0) in [(Vec3::ONE, F0), (colored, F0), (Vec3::ONE, Vec3::ZERO), (colored, Vec3::new(0.2, 0.6, 0.9))] {
        for metallic in [0.0, 0.5, 1.0] {
            for roughness in [0.35, 0.6, 1.0] {
                for cosine in [0.25, 0.7, 1.0] {
                    let bsdf = make_bsdf(table, color, metallic, roughness, f0, direction(cosine, 0.3));
                    out.push((color, metallic, roughness, bsdf));
                }
            }
        }
    }
    out
}

#[test]
fn never_reflects_more_than_arrives_and_white_reflects_all() {
    let table = table();
    for (color, metallic, roughness, bsdf) in cases(&table) {
        let albedo = integrate(|wi| eval_bsdf(&table, &bsdf, wi));
        let what = format!("{color}, metallic {metallic}, roughness {roughness}, view {}: {albedo}", bsdf.wo);
        assert!(albedo.max_element() <= 1.01, "{what}");
        if color == Vec3::ONE {
            assert!((albedo - Vec3::ONE).abs().max_element() < 0.015, "{what}");
        }
    }
}

#[test]
fn is_reciprocal() {
    let table = table();
    for roughness in [0.1, 0.4, 0.9] {
        for metallic in [0.0, 0.6, 1.0] {
            let color = Vec3::new(0.9, 0.5, 0.2);
            for i in 0..50 {
                let a = direction(0.05 + 0.95 * unit_float(hash(i)), 6.0 * unit_float(hash(i + 100)));
                let b = direction(0.05 + 0.95 * unit_float(hash(i + 200)), 6.0 * unit_float(hash(i + 300)));
                let f0 = if i % 2 == 0 { F0 } else { Vec3::new(0.5, 0.2, 0.0) };
                let there = eval_bsdf(&table, &make_bsdf(&table, color, metallic, roughness, f0, a), b) / b.z;
                let back = eval_bsdf(&table, &make_bsdf(&table, color, metallic, roughness, f0, b), a) / a.z;
                let error = (there - back).abs().max_element() / there.max_element().max(1e-3);
                assert!(error < 2e-3, "roughness {roughness}, metallic {metallic}: {there} and {back}");
            }
        }
    }
}

#[test]
fn densities_integrate_to_the_share_that_leaves_upwards() {
    let table = table();
    for (_, metallic, roughness, bsdf) in cases(&table) {
        let total = integrate(|wi| Vec3::splat(pdf_bsdf(&bsdf, wi))).x;
        // Visible normals may reflect below the horizon; those samples fail and carry no light.
        let n = 40_000;
        let ok = (0..n).filter(|&i| numbers(i, &table, &bsdf).1 > 0.0).count() as f32 / n as f32;
        assert!((total - ok).abs() < 0.01, "metallic {metallic}, roughness {roughness}: {total} but {ok} succeed");
        assert!(total < 1.005);
    }
}

fn numbers(i: u32, table: &[f32], bsdf: &Bsdf) -> (Vec3, f32) {
    let u = |k: u32| unit_float(hash(i * 3 + k + 1));
    let sample = sample_bsdf(table, bsdf, u(0), u(1), u(2));
    (sample.wi, sample.pdf)
}

/// Chi-square test of the sampled directions against the density, over cells of equal solid angle.
#[test]
fn samples_follow_their_density() {
    let table = table();
    for (_, metallic, roughness, bsdf) in cases(&table).into_iter().filter(|c| c.0 == Vec3::ONE) {
        let (rows, columns, n) = (8usize, 12usize, 60_000u32);
        let cell = |w: Vec3| {
            let phi = w.y.atan2(w.x).rem_euclid(std::f32::consts::TAU) / std::f32::consts::TAU;
            let row = ((w.z * rows as f32) as usize).min(rows - 1);
            row * columns + ((phi * columns as f32) as usize).min(columns - 1)
        };
        let mut observed = vec![0.0f64; rows * columns];
        for i in 0..n {
            let (wi, pdf) = numbers(i, &table, &bsdf);
            if pdf > 0.0 {
                observed[cell(wi)] += 1.0;
            }
        }
        let mut expected = vec![0.0f64; rows * columns];
        let fine = 40;
        let (nz, np) = (rows * fine, columns * fine);
        for i in 0..nz {
            for j in 0..np {
                let phi = std::f32::consts::TAU * (j as f32 + 0.5) / np as f32;
                let w = direction((i as f32 + 0.5) / nz as f32, phi);
                expected[cell(w)] += f64::from(pdf_bsdf(&bsdf, w));
            }
        }
        let scale = f64::from(n) * std::f64::consts::TAU / (nz * np) as f64;
        let (mut chi, mut cells) = (0.0, 0);
        for (o, e) in observed.iter().zip(expected.iter().map(|e| e * scale)) {
            if e > 8.0 {
                chi += (o - e) * (o - e) / e;
                cells += 1;
            }
        }
        // The quantile for 1e-6 lies below mean + 6 standard deviations for this many cells.
        let limit = f64::from(cells) + 6.0 * (2.0 * f64::from(cells)).sqrt();
        assert!(chi < limit, "metallic {metallic}, roughness {roughness}, view {}: {chi} over {cells} cells", bsdf.wo);
    }
}

#[test]
fn smooth_mirrors_reflect_their_fresnel_term() {
    let table = table();
    let gold = Vec3::new(1.0, 0.77, 0.34);
    let bsdf = make_bsdf(&table, gold, 1.0, 0.0, F0, direction(1.0, 0.0));
    let n = 1000;
    let sum: Vec3 = (0..n)
        .map(|i| sample_bsdf(&table, &bsdf, unit_float(hash(i)), unit_float(hash(i + n)), unit_float(hash(i + 2 * n))))
        .map(|s| s.weight)
        .sum();
    assert!((sum / n as f32 - gold).abs().max_element() < 0.01, "{}", sum / n as f32);
}

/// A dielectric that reflects all: its colour is that of the reflection, and nothing is left to diffuse.
#[test]
fn the_dielectrics_reflectance_has_a_colour() {
    let table = table();
    for roughness in [0.35, 0.8] {
        let wo = direction(0.8, 0.3);
        let albedo = |base: Vec3, f0: Vec3| {
            let bsdf = make_bsdf(&table, base, 0.0, roughness, f0, wo);
            integrate(|wi| eval_bsdf(&table, &bsdf, wi))
        };
        let f0 = Vec3::new(1.0, 0.6, 0.2);
        let as_metal = {
            let bsdf = make_bsdf(&table, f0, 1.0, roughness, F0, wo);
            integrate(|wi| eval_bsdf(&table, &bsdf, wi))
        };
        let got = albedo(Vec3::ONE, f0);
        assert!((got - as_metal).abs().max_element() < 0.01, "roughness {roughness}: {got}, as metal {as_metal}");
        // Without any reflectance at normal incidence the diffuse colour is nearly all there is.
        let got = albedo(Vec3::splat(0.5), Vec3::ZERO);
        assert!((got.x - 0.5).abs() < 0.03, "roughness {roughness}: {got}");
    }
}
