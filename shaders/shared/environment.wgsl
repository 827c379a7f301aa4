// Twin of integrate/environment.rs.

fn direction_to_uv(d: vec3<f32>) -> vec2<f32> {
    let x = scene.environment.rotation_cos * d.x - scene.environment.rotation_sin * d.z;
    let z = scene.environment.rotation_sin * d.x + scene.environment.rotation_cos * d.z;
    let u = 0.5 + precise_atan2(x, -z) * (0.5 * INV_PI);
    return vec2<f32>(u - floor(u), precise_acos(clamp(d.y, -1.0, 1.0)) * INV_PI);
}

fn uv_to_direction(u: f32, v: f32) -> vec3<f32> {
    let theta = unit_circle(PI * v);
    let phi = unit_circle(TWO_PI * (u - 0.5));
    let x = theta.y * phi.y;
    let z = -theta.y * phi.x;
    return vec3<f32>(
        scene.environment.rotation_cos * x + scene.environment.rotation_sin * z,
        theta.x,
        scene.environment.rotation_cos * z - scene.environment.rotation_sin * x,
    );
}

fn environment_radiance(d: vec3<f32>) -> vec3<f32> {
    let scale = scene.environment.radiance;
    if scene.environment.width == 0u {
        return scale;
    }
    let uv = direction_to_uv(d);
    let x = uv.x * f32(scene.environment.width) - 0.5;
    let y = uv.y * f32(scene.environment.height) - 0.5;
    let fx = x - floor(x);
    let fy = y - floor(y);
    let x0 = i32(floor(x));
    let y0 = i32(floor(y));
    let top = map_texel(x0, y0) * (1.0 - fx) + map_texel(x0 + 1, y0) * fx;
    let bottom = map_texel(x0, y0 + 1) * (1.0 - fx) + map_texel(x0 + 1, y0 + 1) * fx;
    return (top * (1.0 - fy) + bottom * fy) * scale;
}

fn map_texel(x: i32, y: i32) -> vec3<f32> {
    let w = i32(scene.environment.width);
    let h = i32(scene.environment.height);
    let column = select(select(x, x - w, x >= w), x + w, x < 0);
    let i = scene.environment_texels + 4u * u32(clamp(y, 0, h - 1) * w + column);
    return bitcast<vec3<f32>>(vec3<u32>(texels_at(i), texels_at(i + 1u), texels_at(i + 2u)));
}

fn environment_cdf_at(i: u32) -> f32 {
    return bitcast<f32>(texels_at(scene.environment_cdf + i));
}

fn sample_environment(normal: vec3<f32>, u: f32, v: f32) -> vec3<f32> {
    if scene.environment.width == 0u {
        return to_world(basis(normal), normal, cosine_hemisphere(u, v));
    }
    let width = scene.environment.width;
    let height = scene.environment.height;
    let row = sample_cdf(0u, height, v);
    let column = sample_cdf(height + row.entry * width, width, u);
    return uv_to_direction(
        (f32(column.entry) + column.fraction) / f32(width),
        (f32(row.entry) + row.fraction) / f32(height),
    );
}

fn environment_pdf(normal: vec3<f32>, d: vec3<f32>) -> f32 {
    if scene.environment.width == 0u {
        return max(dot(normal, d), 0.0) * INV_PI;
    }
    let width = scene.environment.width;
    let height = scene.environment.height;
    let uv = direction_to_uv(d);
    let column = min(u32(uv.x * f32(width)), width - 1u);
    let row = min(u32(uv.y * f32(height)), height - 1u);
    let p_row = cdf_step(0u, row);
    let p_column = cdf_step(height + row * width, column);
    let sine = sqrt(max(1.0 - d.y * d.y, 0.0));
    if sine <= 1e-6 {
        return 0.0;
    }
    return p_row * p_column * f32(width) * f32(height) / (TWO_PI * PI * sine);
}

fn cdf_step(start: u32, i: u32) -> f32 {
    let upto = environment_cdf_at(start + i);
    if i == 0u {
        return upto;
    }
    return upto - environment_cdf_at(start + i - 1u);
}

struct CdfSample {
    entry: u32,
    fraction: f32,
}

fn sample_cdf(start: u32, count: u32, u: f32) -> CdfSample {
    var low = 0u;
    var high = count - 1u;
    while low < high {
        let middle = (low + high) / 2u;
        if environment_cdf_at(start + middle) > u {
            high = middle;
        } else {
            low = middle + 1u;
        }
    }
    var before = 0.0;
    if low > 0u {
        before = environment_cdf_at(start + low - 1u);
    }
    let width = environment_cdf_at(start + low) - before;
    var fraction = 0.5;
    if width > 0.0 {
        fraction = (u - before) / width;
    }
    return CdfSample(low, clamp(fraction, 0.0, 0.9999999));
}
