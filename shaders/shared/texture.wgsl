// Twin of integrate/texture.rs.

fn sample_texture(number: u32, uv0: vec2<f32>, uv1: vec2<f32>) -> vec4<f32> {
    let t = texture_at(number);
    let uv = select(uv0, uv1, (t.flags & TEXTURE_UV1) != 0u);
    let u = t.transform[0] * uv.x + t.transform[1] * uv.y + t.transform[2];
    let v = t.transform[3] * uv.x + t.transform[4] * uv.y + t.transform[5];
    let x = wrap_coordinate(u, t.flags & 3u) * f32(t.width);
    let y = wrap_coordinate(v, (t.flags >> TEXTURE_WRAP_V_SHIFT) & 3u) * f32(t.height);
    if (t.flags & TEXTURE_NEAREST) != 0u {
        return texel(t.texel_offset, t.width, t.height, t.flags, i32(floor(x)), i32(floor(y)));
    }
    let x0 = floor(x - 0.5);
    let y0 = floor(y - 0.5);
    let fx = (x - 0.5) - x0;
    let fy = (y - 0.5) - y0;
    let i = i32(x0);
    let j = i32(y0);
    let t00 = texel(t.texel_offset, t.width, t.height, t.flags, i, j);
    let t10 = texel(t.texel_offset, t.width, t.height, t.flags, i + 1, j);
    let t01 = texel(t.texel_offset, t.width, t.height, t.flags, i, j + 1);
    let t11 = texel(t.texel_offset, t.width, t.height, t.flags, i + 1, j + 1);
    let top = t00 + (t10 - t00) * fx;
    let bottom = t01 + (t11 - t01) * fx;
    return top + (bottom - top) * fy;
}

fn wrap_coordinate(u: f32, mode: u32) -> f32 {
    let p = u - 2.0 * floor(u * 0.5);
    let mirrored = select(p, 2.0 - p, p > 1.0);
    let repeated = u - floor(u);
    let wrapped = select(select(repeated, mirrored, mode == WRAP_MIRRORED), clamp(u, 0.0, 1.0), mode == WRAP_CLAMP);
    // What is not a number is not in 0..1 either.
    return select(0.0, wrapped, bitcast<u32>(wrapped) <= 0x3f800000u);
}

fn wrap_texel(i: i32, size: i32, mode: u32) -> i32 {
    if mode == WRAP_CLAMP || mode == WRAP_MIRRORED {
        return clamp(i, 0, size - 1);
    }
    return select(select(i, i - size, i >= size), i + size, i < 0);
}

fn texel(offset: u32, width: u32, height: u32, flags: u32, x: i32, y: i32) -> vec4<f32> {
    let column = wrap_texel(x, i32(width), flags & 3u);
    let row = wrap_texel(y, i32(height), (flags >> TEXTURE_WRAP_V_SHIFT) & 3u);
    let bits = texels_at(offset + u32(row) * width + u32(column));
    let bytes = vec4<u32>(bits & 0xffu, (bits >> 8u) & 0xffu, (bits >> 16u) & 0xffu, bits >> 24u);
    let linear = vec4<f32>(bytes) * (1.0 / 255.0);
    if (flags & TEXTURE_SRGB) != 0u {
        let s = scene.srgb;
        return vec4<f32>(float_at(s + bytes.x), float_at(s + bytes.y), float_at(s + bytes.z), linear.w);
    }
    return linear;
}
