// Twin of integrate/bsdf.rs.

const MIN_ALPHA = 1e-3;
const GGX_TABLE_SIZE = 32u;

struct Bsdf {
    alpha: f32,
    roughness: f32,
    f0: vec3<f32>,
    multiple: vec3<f32>,
    diffuse: vec3<f32>,
    dielectric_f0: f32,
    dielectric_multiple: f32,
    wo: vec3<f32>,
    lost_o: f32,
    left_o: f32,
    specular_probability: f32,
}

struct BsdfSample {
    wi: vec3<f32>,
    weight: vec3<f32>,
    pdf: f32,
}

fn table_pair(i: u32) -> vec2<f32> {
    return vec2<f32>(float_at(scene.ggx_albedo + i), float_at(scene.ggx_albedo + i + 1u));
}

fn ggx_albedo(roughness: f32, cosine: f32) -> vec2<f32> {
    let last = f32(GGX_TABLE_SIZE - 1u);
    let x = clamp(cosine, 0.0, 1.0) * last;
    let y = clamp(roughness, 0.0, 1.0) * last;
    let x0 = min(floor(x), last - 1.0);
    let y0 = min(floor(y), last - 1.0);
    let fx = x - x0;
    let fy = y - y0;
    let i = (u32(y0) * GGX_TABLE_SIZE + u32(x0)) * 2u;
    let j = i + 2u * GGX_TABLE_SIZE;
    return (table_pair(i) * (1.0 - fx) + table_pair(i + 2u) * fx) * (1.0 - fy)
        + (table_pair(j) * (1.0 - fx) + table_pair(j + 2u) * fx) * fy;
}

fn ggx_average_albedo(roughness: f32) -> vec2<f32> {
    let last = f32(GGX_TABLE_SIZE - 1u);
    let y = clamp(roughness, 0.0, 1.0) * last;
    let y0 = min(floor(y), last - 1.0);
    let fy = y - y0;
    let i = GGX_TABLE_SIZE * GGX_TABLE_SIZE * 2u + u32(y0) * 2u;
    return table_pair(i) * (1.0 - fy) + table_pair(i + 2u) * fy;
}

fn multiple_fresnel(f0: f32, average: f32) -> f32 {
    let f = f0 + (1.0 - f0) * (1.0 / 21.0);
    return f * f * average / (1.0 - f * (1.0 - average));
}

fn multiple_color(f0: vec3<f32>, average: f32) -> vec3<f32> {
    return vec3<f32>(
        multiple_fresnel(f0.x, average),
        multiple_fresnel(f0.y, average),
        multiple_fresnel(f0.z, average),
    );
}

fn make_bsdf(
    base_color: vec3<f32>, metallic: f32, roughness: f32, dielectric_f0: vec3<f32>, wo: vec3<f32>,
) -> Bsdf {
    var bsdf: Bsdf;
    bsdf.wo = wo;
    bsdf.roughness = roughness;
    bsdf.alpha = max(roughness * roughness, MIN_ALPHA);
    bsdf.f0 = dielectric_f0 * (1.0 - metallic) + base_color * metallic;
    let ab_o = ggx_albedo(roughness, wo.z);
    let ab_mean = ggx_average_albedo(roughness);
    let average = ab_mean.x + ab_mean.y;

    let metal_multiple = multiple_color(base_color, average);
    let glossy_multiple = multiple_color(dielectric_f0, average);
    bsdf.dielectric_f0 = max(max(dielectric_f0.x, dielectric_f0.y), dielectric_f0.z);
    bsdf.dielectric_multiple = multiple_fresnel(bsdf.dielectric_f0, average);
    let lost_average = max(1.0 - average, 1e-6);
    bsdf.multiple = (glossy_multiple * (1.0 - metallic) + metal_multiple * metallic) * (INV_PI / lost_average);

    bsdf.lost_o = max(1.0 - ab_o.x - ab_o.y, 0.0);
    bsdf.left_o = max(1.0 - (bsdf.dielectric_f0 * ab_o.x + ab_o.y + bsdf.dielectric_multiple * bsdf.lost_o), 0.0);
    let left_average = 1.0 - (bsdf.dielectric_f0 * ab_mean.x + ab_mean.y + bsdf.dielectric_multiple * lost_average);
    bsdf.diffuse = base_color * ((1.0 - metallic) * INV_PI / max(left_average, 1e-6));

    let specular = luminance(bsdf.f0 * ab_o.x + vec3<f32>(ab_o.y));
    let cosine_lobes =
        PI * luminance(bsdf.diffuse * (bsdf.left_o * left_average) + bsdf.multiple * (bsdf.lost_o * lost_average));
    let sum = specular + cosine_lobes;
    bsdf.specular_probability = select(clamp(specular / sum, 0.05, 0.95), 1.0, cosine_lobes <= 1e-4);
    return bsdf;
}

fn ggx_d(alpha: f32, h: vec3<f32>) -> f32 {
    let a2 = alpha * alpha;
    let e = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
    return 1.0 / (PI * a2 * e * e);
}

fn ggx_lambda(alpha: f32, w: vec3<f32>) -> f32 {
    let tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    return 0.5 * (sqrt(1.0 + alpha * alpha * tan2) - 1.0);
}

fn ggx_g1(alpha: f32, w: vec3<f32>) -> f32 {
    return 1.0 / (1.0 + ggx_lambda(alpha, w));
}

fn ggx_g2(alpha: f32, wo: vec3<f32>, wi: vec3<f32>) -> f32 {
    return 1.0 / (1.0 + ggx_lambda(alpha, wo) + ggx_lambda(alpha, wi));
}

fn schlick(cosine: f32) -> f32 {
    let m = clamp(1.0 - cosine, 0.0, 1.0);
    let m2 = m * m;
    return m2 * m2 * m;
}

fn sample_visible_normal(alpha: f32, wo: vec3<f32>, u: f32, v: f32) -> vec3<f32> {
    let stretched = vec3<f32>(alpha * wo.x, alpha * wo.y, wo.z);
    let view = stretched * (1.0 / sqrt(dot(stretched, stretched)));
    let length2 = view.x * view.x + view.y * view.y;
    var t1 = vec3<f32>(1.0, 0.0, 0.0);
    if length2 > 1e-12 {
        t1 = vec3<f32>(-view.y, view.x, 0.0) * (1.0 / sqrt(length2));
    }
    let t2 = cross(view, t1);
    let r = sqrt(u);
    let p = r * unit_circle(TWO_PI * v);
    let s = 0.5 * (1.0 + view.z);
    let p2 = (1.0 - s) * sqrt(max(1.0 - p.x * p.x, 0.0)) + s * p.y;
    let n = t1 * p.x + t2 * p2 + view * sqrt(max(1.0 - p.x * p.x - p2 * p2, 0.0));
    let h = vec3<f32>(alpha * n.x, alpha * n.y, max(n.z, 1e-6));
    return h * (1.0 / sqrt(dot(h, h)));
}

// The diffuse and the multiple-scattering lobe, times the cosine.
fn eval_cosine_lobes(bsdf: Bsdf, wi: vec3<f32>) -> vec3<f32> {
    if wi.z <= 0.0 || bsdf.wo.z <= 0.0 {
        return vec3<f32>(0.0);
    }
    let ab_i = ggx_albedo(bsdf.roughness, wi.z);
    let lost_i = max(1.0 - ab_i.x - ab_i.y, 0.0);
    let left_i = max(1.0 - (bsdf.dielectric_f0 * ab_i.x + ab_i.y + bsdf.dielectric_multiple * lost_i), 0.0);
    return (bsdf.multiple * (bsdf.lost_o * lost_i) + bsdf.diffuse * (bsdf.left_o * left_i)) * wi.z;
}

fn eval_bsdf(bsdf: Bsdf, wi: vec3<f32>) -> vec3<f32> {
    if wi.z <= 0.0 || bsdf.wo.z <= 0.0 {
        return vec3<f32>(0.0);
    }
    let sum = bsdf.wo + wi;
    let h = sum * (1.0 / sqrt(dot(sum, sum)));
    let fresnel = bsdf.f0 + (vec3<f32>(1.0) - bsdf.f0) * schlick(dot(bsdf.wo, h));
    let specular = fresnel * (ggx_d(bsdf.alpha, h) * ggx_g2(bsdf.alpha, bsdf.wo, wi) / (4.0 * bsdf.wo.z));
    return specular + eval_cosine_lobes(bsdf, wi);
}

fn pdf_bsdf(bsdf: Bsdf, wi: vec3<f32>) -> f32 {
    if wi.z <= 0.0 || bsdf.wo.z <= 0.0 {
        return 0.0;
    }
    let sum = bsdf.wo + wi;
    let h = sum * (1.0 / sqrt(dot(sum, sum)));
    let specular = ggx_d(bsdf.alpha, h) * ggx_g1(bsdf.alpha, bsdf.wo) / (4.0 * bsdf.wo.z);
    return bsdf.specular_probability * specular + (1.0 - bsdf.specular_probability) * wi.z * INV_PI;
}

fn sample_bsdf(bsdf: Bsdf, lobe: f32, u: f32, v: f32) -> BsdfSample {
    var wi: vec3<f32>;
    if lobe < bsdf.specular_probability {
        let h = sample_visible_normal(bsdf.alpha, bsdf.wo, u, v);
        wi = h * (2.0 * dot(bsdf.wo, h)) - bsdf.wo;
    } else {
        wi = cosine_hemisphere(u, v);
    }
    let pdf = pdf_bsdf(bsdf, wi);
    if pdf <= 0.0 {
        return BsdfSample(wi, vec3<f32>(0.0), 0.0);
    }
    return BsdfSample(wi, eval_bsdf(bsdf, wi) * (1.0 / pdf), pdf);
}
