//! Texture look-ups: wrap modes, nearest and bilinear filtering, sRGB decoding.
//!
//! There are no mip levels: a path tracer's supersampling takes their place. sRGB texels are decoded before they are
//! filtered, and alpha never is (glTF 2.0, section 3.9.2).

use std::sync::LazyLock;

use crate::pack::{
    PackedScene, PackedTexture, TEXTURE_NEAREST, TEXTURE_SRGB, TEXTURE_UV1, TEXTURE_WRAP_V_SHIFT, WRAP_CLAMP,
    WRAP_MIRRORED,
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
    let uv = if t.flags & TEXTURE_UV1 != 0 { uv1 } else { uv0 };
    let u = t.transform[0][0] * uv[0] + t.transform[0][1] * uv[1] + t.transform[0][2];
    let v = t.transform[1][0] * uv[0] + t.transform[1][1] * uv[1] + t.transform[1][2];
    let x = wrap_coordinate(u, t.flags & 3) * t.width as f32;
    let y = wrap_coordinate(v, (t.flags >> TEXTURE_WRAP_V_SHIFT) & 3) * t.height as f32;
    if t.flags & TEXTURE_NEAREST != 0 {
        return texel(scene, t, x.floor() as i32, y.floor() as i32);
    }
    let (x, y) = (x - 0.5, y - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let (x0, y0) = (x0 as i32, y0 as i32);
    let top = mix(texel(scene, t, x0, y0), texel(scene, t, x0 + 1, y0), fx);
    let bottom = mix(texel(scene, t, x0, y0 + 1), texel(scene, t, x0 + 1, y0 + 1), fx);
    mix(top, bottom, fy)
}

/// A texture coordinate brought into 0..1, so that texel numbers stay small integers however far it lies out; what is
/// not a number becomes 0.
fn wrap_coordinate(u: f32, mode: u32) -> f32 {
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

fn texel(scene: &PackedScene, t: &PackedTexture, x: i32, y: i32) -> [f32; 4] {
    let x = wrap_texel(x, t.width as i32, t.flags & 3);
    let y = wrap_texel(y, t.height as i32, (t.flags >> TEXTURE_WRAP_V_SHIFT) & 3);
    let bits = scene.texels[(t.texel_offset + y as u32 * t.width + x as u32) as usize];
    let [r, g, b, a] = bits.to_le_bytes();
    let alpha = f32::from(a) * (1.0 / 255.0);
    if t.flags & TEXTURE_SRGB != 0 {
        [SRGB_TABLE[r as usize], SRGB_TABLE[g as usize], SRGB_TABLE[b as usize], alpha]
    } else {
        [f32::from(r) * (1.0 / 255.0), f32::from(g) * (1.0 / 255.0), f32::from(b) * (1.0 / 255.0), alpha]
    }
}

fn mix(a: [f32; 4], b: [f32; 4], t: f32) -> [f32; 4] {
    [0, 1, 2, 3].map(|c| a[c] + (b[c] - a[c]) * t)
}
