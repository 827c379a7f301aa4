//! The metallic-roughness BSDF of glTF 2.0 (appendix B), made to conserve energy.
//!
//! Three reflections, all in a frame whose +Z is the shading normal:
//!
//! * a GGX lobe with height-correlated Smith masking and Schlick's Fresnel, `F0 = mix(dielectric, base, metallic)`, where
//!   a dielectric has 0.04 unless its material says otherwise (KHR_materials_pbrSpecularGlossiness); sampled by its
//!   visible normals (Heitz 2018, "Sampling the GGX Distribution of Visible Normals", JCGT 7(4));
//! * the light that bounces between microfacets more than once, which that lobe loses, as a diffuse-like lobe (Kulla and
//!   Conty 2017, "Revisiting Physically Based Shading at Imageworks");
//! * Lambert's diffuse under the dielectric, weighted by what the specular lobes leave over in both directions (same
//!   source): reciprocal, and a white non-metal reflects exactly all light at every roughness.
//!
//! The directional albedos this needs are tabulated when a scene is packed; see `pack/ggx_table.rs`.

use glam::Vec3;

use super::math::{INV_PI, PI, TWO_PI, cosine_hemisphere, luminance};
use crate::pack::GGX_TABLE_SIZE;

/// Smallest GGX alpha: mirrors are very narrow lobes, so that every technique can sample and evaluate them.
pub const MIN_ALPHA: f32 = 1e-3;

/// A material at one point, seen from one direction.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf {
    pub alpha: f32,
    pub roughness: f32,
    pub f0: Vec3,
    /// Factor of the multiple-scattering lobe (its angular part comes from the table).
    pub multiple: Vec3,
    /// Factor of the diffuse lobe.
    pub diffuse: Vec3,
    /// Of the dielectric's specular lobes, in the channel that reflects most: `F0` and the factor of `1 - E`, for the
    /// share left to diffuse.
    pub dielectric_f0: f32,
    pub dielectric_multiple: f32,
    /// Unit, towards the viewer, `z > 0`.
    pub wo: Vec3,
    /// `1 - E(wo)` and the dielectric's `1 - specular albedo(wo)`.
    pub lost_o: f32,
    pub left_o: f32,
    /// Probability of sampling the GGX lobe.
    pub specular_probability: f32,
}

#[derive(Clone, Copy, Debug)]
pub struct BsdfSample {
    pub wi: Vec3,
    /// `f * cos / pdf`.
    pub weight: Vec3,
    /// Solid-angle density; 0 for a failed sample.
    pub pdf: f32,
}

/// `(A, B)` of the table at a roughness and cosine: the lobe's albedo is `F0 * A + B`, for `F = 1` it is `A + B`.
pub fn ggx_albedo(table: &[f32], roughness: f32, cosine: f32) -> (f32, f32) {
    let last = (GGX_TABLE_SIZE - 1) as f32;
    let x = cosine.clamp(0.0, 1.0) * last;
    let y = roughness.clamp(0.0, 1.0) * last;
    let (x0, y0) = ((x as usize).min(GGX_TABLE_SIZE - 2), (y as usize).min(GGX_TABLE_SIZE - 2));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let i = (y0 * GGX_TABLE_SIZE + x0) * 2;
    let j = i + 2 * GGX_TABLE_SIZE;
    let a = (table[i] * (1.0 - fx) + table[i + 2] * fx) * (1.0 - fy) + (table[j] * (1.0 - fx) + table[j + 2] * fx) * fy;
    let b = (table[i + 1] * (1.0 - fx) + table[i + 3] * fx) * (1.0 - fy)
        + (table[j + 1] * (1.0 - fx) + table[j + 3] * fx) * fy;
    (a, b)
}

/// `(A, B)` averaged over the cosine-weighted hemisphere.
pub fn ggx_average_albedo(table: &[f32], roughness: f32) -> (f32, f32) {
    let last = (GGX_TABLE_SIZE - 1) as f32;
    let y = roughness.clamp(0.0, 1.0) * last;
    let y0 = (y as usize).min(GGX_TABLE_SIZE - 2);
    let fy = y - y0 as f32;
    let i = GGX_TABLE_SIZE * GGX_TABLE_SIZE * 2 + y0 * 2;
    (table[i] * (1.0 - fy) + table[i + 2] * fy, table[i + 1] * (1.0 - fy) + table[i + 3] * fy)
}

/// Share of the light lost to masking that comes out after all, for a Fresnel reflectance `f0` (Kulla and Conty: the
/// geometric series over the average Fresnel `F0 + (1 - F0) / 21`).
fn multiple_fresnel(f0: f32, average: f32) -> f32 {
    let f = f0 + (1.0 - f0) * (1.0 / 21.0);
    f * f * average / (1.0 - f * (1.0 - average))
}

/// [`multiple_fresnel`] of each channel.
fn multiple_color(f0: Vec3, average: f32) -> Vec3 {
    Vec3::new(multiple_fresnel(f0.x, average), multiple_fresnel(f0.y, average), multiple_fresnel(f0.z, average))
}

/// Prepares the BSDF for a viewer in the local direction `wo` (`z > 0`).
pub fn make_bsdf(
    table: &[f32],
    base_color: Vec3,
    metallic: f32,
    roughness: f32,
    dielectric_f0: Vec3,
    wo: Vec3,
) -> Bsdf {
    let alpha = (roughness * roughness).max(MIN_ALPHA);
    let f0 = dielectric_f0 * (1.0 - metallic) + base_color * metallic;
    let (a_o, b_o) = ggx_albedo(table, roughness, wo.z);
    let (a_mean, b_mean) = ggx_average_albedo(table, roughness);
    let average = a_mean + b_mean;

    let metal_multiple = multiple_color(base_color, average);
    let glossy_multiple = multiple_color(dielectric_f0, average);
    let dielectric_f0 = dielectric_f0.x.max(dielectric_f0.y).max(dielectric_f0.z);
    let dielectric_multiple = multiple_fresnel(dielectric_f0, average);
    let lost_average = (1.0 - average).max(1e-6);
    let multiple = (glossy_multiple * (1.0 - metallic) + metal_multiple * metallic) * (INV_PI / lost_average);

    let lost_o = (1.0 - a_o - b_o).max(0.0);
    let left_o = (1.0 - (dielectric_f0 * a_o + b_o + dielectric_multiple * lost_o)).max(0.0);
    let left_average = 1.0 - (dielectric_f0 * a_mean + b_mean + dielectric_multiple * lost_average);
    let diffuse = base_color * ((1.0 - metallic) * INV_PI / left_average.max(1e-6));

    // Albedos of the two strategies seen from here.
    let specular = luminance(f0 * a_o + Vec3::splat(b_o));
    let cosine_lobes = PI * luminance(diffuse * (left_o * left_average) + multiple * (lost_o * lost_average));
    let sum = specular + cosine_lobes;
    let specular_probability = if cosine_lobes <= 1e-4 { 1.0 } else { (specular / sum).clamp(0.05, 0.95) };
    Bsdf {
        alpha,
        roughness,
        f0,
        multiple,
        diffuse,
        dielectric_f0,
        dielectric_multiple,
        wo,
        lost_o,
        left_o,
        specular_probability,
    }
}

/// GGX distribution of microfacet normals.
pub fn ggx_d(alpha: f32, h: Vec3) -> f32 {
    let a2 = alpha * alpha;
    let e = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
    1.0 / (PI * a2 * e * e)
}

/// Smith's auxiliary function for a direction.
fn ggx_lambda(alpha: f32, w: Vec3) -> f32 {
    let tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    0.5 * ((1.0 + alpha * alpha * tan2).sqrt() - 1.0)
}

/// Smith masking of one direction.
pub fn ggx_g1(alpha: f32, w: Vec3) -> f32 {
    1.0 / (1.0 + ggx_lambda(alpha, w))
}

/// Height-correlated masking and shadowing.
pub fn ggx_g2(alpha: f32, wo: Vec3, wi: Vec3) -> f32 {
    1.0 / (1.0 + ggx_lambda(alpha, wo) + ggx_lambda(alpha, wi))
}

/// Schlick's fifth power.
pub fn schlick(cosine: f32) -> f32 {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

/// A microfacet normal visible from `wo` (Heitz 2018, listing 1); its density is `G1(wo) D(h) max(wo.h, 0) / wo.z`.
pub fn sample_visible_normal(alpha: f32, wo: Vec3, u: f32, v: f32) -> Vec3 {
    let stretched = Vec3::new(alpha * wo.x, alpha * wo.y, wo.z);
    let view = stretched * (1.0 / stretched.dot(stretched).sqrt());
    let length2 = view.x * view.x + view.y * view.y;
    let t1 = if length2 > 1e-12 {
        Vec3::new(-view.y, view.x, 0.0) * (1.0 / length2.sqrt())
    } else {
        Vec3::new(1.0, 0.0, 0.0)
    };
    let t2 = view.cross(t1);
    let r = u.sqrt();
    let phi = TWO_PI * v;
    let p1 = r * phi.cos();
    let s = 0.5 * (1.0 + view.z);
    let p2 = (1.0 - s) * (1.0 - p1 * p1).max(0.0).sqrt() + s * (r * phi.sin());
    let n = t1 * p1 + t2 * p2 + view * (1.0 - p1 * p1 - p2 * p2).max(0.0).sqrt();
    let h = Vec3::new(alpha * n.x, alpha * n.y, n.z.max(1e-6));
    h * (1.0 / h.dot(h).sqrt())
}

/// `f * cos` of all lobes for light from the local direction `wi`; zero below the surface.
pub fn eval_bsdf(table: &[f32], bsdf: &Bsdf, wi: Vec3) -> Vec3 {
    if wi.z <= 0.0 || bsdf.wo.z <= 0.0 {
        return Vec3::ZERO;
    }
    let sum = bsdf.wo + wi;
    let h = sum * (1.0 / sum.dot(sum).sqrt());
    let fresnel = bsdf.f0 + (Vec3::ONE - bsdf.f0) * schlick(bsdf.wo.dot(h));
    let specular = fresnel * (ggx_d(bsdf.alpha, h) * ggx_g2(bsdf.alpha, bsdf.wo, wi) / (4.0 * bsdf.wo.z));
    specular + eval_cosine_lobes(table, bsdf, wi)
}

/// `f * cos` of the diffuse and the multiple-scattering lobe.
pub fn eval_cosine_lobes(table: &[f32], bsdf: &Bsdf, wi: Vec3) -> Vec3 {
    if wi.z <= 0.0 || bsdf.wo.z <= 0.0 {
        return Vec3::ZERO;
    }
    let (a_i, b_i) = ggx_albedo(table, bsdf.roughness, wi.z);
    let lost_i = (1.0 - a_i - b_i).max(0.0);
    let left_i = (1.0 - (bsdf.dielectric_f0 * a_i + b_i + bsdf.dielectric_multiple * lost_i)).max(0.0);
    (bsdf.multiple * (bsdf.lost_o * lost_i) + bsdf.diffuse * (bsdf.left_o * left_i)) * wi.z
}

/// Solid-angle density with which [`sample_bsdf`] picks `wi`.
pub fn pdf_bsdf(bsdf: &Bsdf, wi: Vec3) -> f32 {
    if wi.z <= 0.0 || bsdf.wo.z <= 0.0 {
        return 0.0;
    }
    let sum = bsdf.wo + wi;
    let h = sum * (1.0 / sum.dot(sum).sqrt());
    let specular = ggx_d(bsdf.alpha, h) * ggx_g1(bsdf.alpha, bsdf.wo) / (4.0 * bsdf.wo.z);
    bsdf.specular_probability * specular + (1.0 - bsdf.specular_probability) * wi.z * INV_PI
}

/// Samples a direction: `lobe` picks the strategy, `(u, v)` the direction.
pub fn sample_bsdf(table: &[f32], bsdf: &Bsdf, lobe: f32, u: f32, v: f32) -> BsdfSample {
    let wi = if lobe < bsdf.specular_probability {
        let h = sample_visible_normal(bsdf.alpha, bsdf.wo, u, v);
        h * (2.0 * bsdf.wo.dot(h)) - bsdf.wo
    } else {
        cosine_hemisphere(u, v)
    };
    let pdf = pdf_bsdf(bsdf, wi);
    if pdf <= 0.0 {
        return BsdfSample { wi, weight: Vec3::ZERO, pdf: 0.0 };
    }
    BsdfSample { wi, weight: eval_bsdf(table, bsdf, wi) * (1.0 / pdf), pdf }
}
