//! Texture look-ups: wrap modes, nearest and bilinear filtering, sRGB decoding.
//!
//! There are no mip levels: a path tracer's supersampling takes their place. sRGB texels are decoded before they are
//! filtered, and alpha never is (glTF 2.0, section 3.9.2).

use std::sync::LazyLock;

use glam::Vec4;

use crate::pack::{
    PackedScene, TEXTURE_NEAREST, TEXTURE_SRGB, TEXTURE_UV1, TEXTURE_WRAP_V_SHIFT, WRAP_CLAMP, WRAP_MIRRORED,
};

/// sRGB electro-optical transfer function (IEC 61966-2-1), from 0..1 to 0..1.
pub fn srgb_to_linear(c: f32) -> f32 {
    if c <= 0.040_45 { c * (1.0 / 12.92) } else { ((c + 0.055) * (1.0 / 1.055)).powf(2.4) }
}

/// `srgb_to_linear(byte / 255)`; the GPU computes it, the CPU looks it up.
static SRGB_TABLE: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|byte| srgb_to_linear(byte as f32 * (1.0 / 255.0))));

/// Linear RGBA of texture use `texture` at the surface's two sets of texture coordinates.
pub fn sample_texture(scene: &PackedScene, texture: u32, uv0: [f32; 2], uv1: [f32; 2]) -> [f32; 4] {
    let t = &scene.textures[texture as usize];
    let (wrap_u, wrap_v) = (t.flags & 3, (t.flags >> TEXTURE_WRAP_V_SHIFT) & 3);
    let (width, height) = (t.width as i32, t.height as i32);
    let uv = if t.flags & TEXTURE_UV1 != 0 { uv1 } else { uv0 };
    let u = t.transform[0][0] * uv[0] + t.transform[0][1] * uv[1] + t.transform[0][2];
    let v = t.transform[1][0] * uv[0] + t.transform[1][1] * uv[1] + t.transform[1][2];
    let x = wrap_coordinate(u, wrap_u) * t.width as f32;
    let y = wrap_coordinate(v, wrap_v) * t.height as f32;
    let srgb = (t.flags & TEXTURE_SRGB != 0).then(|| &*SRGB_TABLE);
    let texel = |x: i32, y: i32| {
        let number = t.texel_offset + y as u32 * t.width + x as u32;
        decode(scene.texels[number as usize], srgb)
    };
    if t.flags & TEXTURE_NEAREST != 0 {
        return texel(wrap_texel(floor(x), width, wrap_u), wrap_texel(floor(y), height, wrap_v)).to_array();
    }
    let (x, y) = (x - 0.5, y - 0.5);
    let (i, j) = (floor(x), floor(y));
    let (fx, fy) = (x - i as f32, y - j as f32);
    let (x0, x1) = (wrap_texel(i, width, wrap_u), wrap_texel(i + 1, width, wrap_u));
    let (y0, y1) = (wrap_texel(j, height, wrap_v), wrap_texel(j + 1, height, wrap_v));
    let top = mix(texel(x0, y0), texel(x1, y0), fx);
    let bottom = mix(texel(x0, y1), texel(x1, y1), fx);
    mix(top, bottom, fy).to_array()
}

/// The largest whole number that is not above `x`, for texel coordinates: `f32::floor` is a call on x86 without SSE 4.1.
fn floor(x: f32) -> i32 {
    let truncated = x as i32;
    truncated - i32::from(truncated as f32 > x)
}

/// A texture coordinate brought into 0..1, so that texel numbers stay small integers however far it lies out; what is
/// not a number becomes 0.
fn wrap_coordinate(u: f32, mode: u32) -> f32 {
    if (0.0..1.0).contains(&u) {
        return u;
    }
    let wrapped = if mode == WRAP_CLAMP {
        u.clamp(0.0, 1.0)
    } else if mode == WRAP_MIRRORED {
        let p = u - 2.0 * (u * 0.5).floor();
        if p > 1.0 { 2.0 - p } else { p }
    } else {
        u - u.floor()
    };
    if (0.0..=1.0).contains(&wrapped) { wrapped } else { 0.0 }
}

/// The texel next to the border is the wrap mode's: the other side's (repeat) or the border's own (clamp, mirrored).
fn wrap_texel(i: i32, size: i32, mode: u32) -> i32 {
    if mode == WRAP_CLAMP || mode == WRAP_MIRRORED {
        return i.clamp(0, size - 1);
    }
    if i < 0 {
        i + size
    } else if i >= size {
        i - size
    } else {
        i
    }
}

fn decode(bits: u32, srgb: Option<&[f32; 256]>) -> Vec4 {
    let [r, g, b, a] = bits.to_le_bytes();
    let linear = Vec4::new(f32::from(r), f32::from(g), f32::from(b), f32::from(a)) * (1.0 / 255.0);
    match srgb {
        Some(table) => Vec4::new(table[r as usize], table[g as usize], table[b as usize], linear.w),
        None => linear,
    }
}

fn mix(a: Vec4, b: Vec4, t: f32) -> Vec4 {
    a + (b - a) * t
}
