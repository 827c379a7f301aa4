//! Structs that Rust and WGSL share. Only 4-byte scalars and arrays of them, ordered so that WGSL adds no padding.

use bytemuck::{Pod, Zeroable};

/// "None" in every index field.
pub const NONE: u32 = u32::MAX;

/// Offsets are in elements of the array that they point into; [`NONE`] where the mesh lacks the attribute.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PackedMesh {
    pub position_offset: u32,
    pub triangle_offset: u32,
    pub triangle_count: u32,
    pub sphere_offset: u32,
    pub sphere_count: u32,
    pub slot_offset: u32,
    /// 3 floats a vertex.
    pub normal_offset: u32,
    /// 4 floats a vertex.
    pub tangent_offset: u32,
    /// 2 floats a vertex.
    pub uv0_offset: u32,
    /// 2 floats a vertex.
    pub uv1_offset: u32,
    /// 4 floats a vertex, linear RGBA.
    pub color_offset: u32,
    pub _pad: u32,
}
const _: () = assert!(size_of::<PackedMesh>() == 48);

/// Some triangle of the instance has a material with alpha mask or blend: hits need the alpha test.
pub const INSTANCE_ALPHA: u32 = 1;
/// The transform mirrors (negative determinant): front faces wind the other way.
pub const INSTANCE_MIRRORED: u32 = 2;
/// The transform only rotates, moves and scales evenly: spheres stay spheres.
pub const INSTANCE_SIMILARITY: u32 = 4;

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PackedInstance {
    /// Rows of the 3x4 matrix.
    pub object_to_world: [[f32; 4]; 3],
    /// Rows of the 3x4 inverse.
    pub world_to_object: [[f32; 4]; 3],
    pub mesh: u32,
    pub material_base: u32,
    /// [`NONE`] where the instance emits no light.
    pub emitter_base: u32,
    pub flags: u32,
}
const _: () = assert!(size_of::<PackedInstance>() == 112);

pub const MATERIAL_ALPHA_MASK: u32 = 1;
pub const MATERIAL_ALPHA_BLEND: u32 = 2;
pub const MATERIAL_UNLIT: u32 = 8;
/// `metallic_roughness_texture` holds the dielectric's reflectance (RGB) and the glossiness (alpha).
pub const MATERIAL_SPECULAR_GLOSSINESS: u32 = 16;

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PackedMaterial {
    pub base_color: [f32; 4],
    pub emissive: [f32; 3],
    pub metallic: f32,
    /// Reflectance at normal incidence of what is not metal.
    pub dielectric_f0: [f32; 3],
    pub roughness: f32,
    pub normal_scale: f32,
    pub alpha_cutoff: f32,
    pub flags: u32,
    /// Indices into `PackedScene::textures`, or [`NONE`].
    pub base_color_texture: u32,
    pub metallic_roughness_texture: u32,
    pub normal_texture: u32,
    pub emissive_texture: u32,
    pub _pad: u32,
}
const _: () = assert!(size_of::<PackedMaterial>() == 80);

/// Wrap modes in [`PackedTexture::flags`]: bits 0..1 for u, 2..3 for v.
pub const WRAP_REPEAT: u32 = 0;
pub const WRAP_MIRRORED: u32 = 1;
pub const WRAP_CLAMP: u32 = 2;
pub const TEXTURE_WRAP_V_SHIFT: u32 = 2;
/// Nearest texel instead of bilinear.
pub const TEXTURE_NEAREST: u32 = 16;
/// RGB is sRGB-encoded and decoded before filtering; alpha never is.
pub const TEXTURE_SRGB: u32 = 32;
/// Looks up the second UV set.
pub const TEXTURE_UV1: u32 = 64;

/// One use of an image by a material: sampler, UV set and transform included.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PackedTexture {
    /// Rows of the 2x3 UV transform.
    pub transform: [[f32; 3]; 2],
    /// First texel in `PackedScene::texels`.
    pub texel_offset: u32,
    pub width: u32,
    pub height: u32,
    pub flags: u32,
    pub _pad: [u32; 2],
}
const _: () = assert!(size_of::<PackedTexture>() == 48);

pub const LIGHT_POINT: u32 = 0;
pub const LIGHT_DIRECTIONAL: u32 = 1;
pub const LIGHT_SPOT: u32 = 2;
pub const LIGHT_TRIANGLE: u32 = 3;
pub const LIGHT_SPHERE: u32 = 4;
pub const LIGHT_ENVIRONMENT: u32 = 5;

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PackedLight {
    /// Position (point, spot); unused otherwise.
    pub position: [f32; 3],
    pub kind: u32,
    /// Unit direction in which the light shines (directional, spot).
    pub direction: [f32; 3],
    pub range: f32,
    /// Candela or lux times linear colour (punctual); mean emitted radiance (area).
    pub intensity: [f32; 3],
    /// Probability with which sampling picks this light.
    pub selection: f32,
    /// Spot: `1 / max(cos_inner - cos_outer, 1e-3)` and `-cos_outer * scale` (glTF's formula).
    pub spot_scale: f32,
    pub spot_offset: f32,
    /// Area lights: where the emitter is.
    pub instance: u32,
    pub primitive: u32,
}
const _: () = assert!(size_of::<PackedLight>() == 64);

#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PackedEnvironment {
    /// Radiance when there is no map; multiplies the map otherwise.
    pub radiance: [f32; 3],
    /// 0 without a map.
    pub width: u32,
    pub height: u32,
    /// Cosine and sine of the rotation about +Y.
    pub rotation_cos: f32,
    pub rotation_sin: f32,
    /// Number of the environment in `lights`, or [`NONE`] when it is black.
    pub light: u32,
}
const _: () = assert!(size_of::<PackedEnvironment>() == 32);

/// The camera, prepared so that a primary ray costs a few multiplications.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PackedCamera {
    pub position: [f32; 3],
    /// 1 for an orthographic camera, 0 for a perspective one.
    pub orthographic: u32,
    /// Unit.
    pub forward: [f32; 3],
    /// Picture width in pixels.
    pub width: u32,
    /// From the picture's centre to the middle of its right edge: at distance 1 (perspective) or in world units.
    pub right: [f32; 3],
    /// Picture height in pixels.
    pub height: u32,
    /// From the picture's centre to the middle of its upper edge.
    pub up: [f32; 3],
    pub _pad: u32,
}
const _: () = assert!(size_of::<PackedCamera>() == 64);
