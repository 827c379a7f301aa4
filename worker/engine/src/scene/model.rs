//! The scene model: unique meshes, the instances that place them, and what they look like.
//!
//! A [`Mesh`] is one glTF mesh with all its primitives merged; each triangle (and each sphere) carries a *slot*, and
//! each [`Instance`] says which material every slot has. So two instances of one geometry with different materials
//! still share one mesh, one hash and one spatial structure.

use std::fmt;
use std::sync::Arc;

use glam::{Affine3A, Vec3};

/// BLAKE3 over a mesh's canonical content. Written as 64 lower-case hex digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MeshHash(pub [u8; 32]);

impl fmt::Display for MeshHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for byte in self.0 {
            write!(f, "{byte:02x}")?;
        }
        Ok(())
    }
}

impl fmt::Debug for MeshHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// An axis-aligned box. The empty box has `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    pub min: Vec3,
    pub max: Vec3,
}

impl Aabb {
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    pub fn grow(&mut self, point: Vec3) {
        self.min = self.min.min(point);
        self.max = self.max.max(point);
    }

    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    pub fn is_empty(&self) -> bool {
        self.min.cmpgt(self.max).any()
    }

    pub fn center(&self) -> Vec3 {
        0.5 * (self.min + self.max)
    }

    pub fn extent(&self) -> Vec3 {
        self.max - self.min
    }
}

/// A whole scene, independent of any job's settings.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    pub name: String,
    /// Unique meshes: no two have the same hash.
    pub meshes: Vec<Arc<Mesh>>,
    pub instances: Vec<Instance>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub images: Vec<Arc<Image>>,
    pub lights: Vec<PunctualLight>,
    pub cameras: Vec<Camera>,
    /// What was skipped or repaired on import, in plain words.
    pub warnings: Vec<String>,
}

/// One unique mesh in object space. All per-vertex arrays are empty or as long as `positions`.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    pub hash: MeshHash,
    pub name: String,
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    /// Material slot of each triangle.
    pub triangle_slots: Vec<u32>,
    pub normals: Vec<Vec3>,
    /// xyz and handedness, as glTF's TANGENT.
    pub tangents: Vec<[f32; 4]>,
    pub uv0: Vec<[f32; 2]>,
    pub uv1: Vec<[f32; 2]>,
    /// Linear RGBA.
    pub colors: Vec<[f32; 4]>,
    /// Spheres are numbered after the triangles: primitive `triangles.len() + i` is sphere `i`.
    pub spheres: Vec<Sphere>,
    /// How many material slots the mesh has.
    pub slots: u32,
    pub bounds: Aabb,
}

impl Mesh {
    /// A mesh of one material slot that is nothing but shapes: no normals, texture coordinates or colours, and not hashed
    /// yet ([`super::mesh_hash`]).
    pub fn of_shapes(name: &str, positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, spheres: Vec<Sphere>) -> Self {
        let mut mesh = Self {
            hash: MeshHash([0; 32]),
            name: name.into(),
            triangle_slots: vec![0; triangles.len()],
            positions,
            triangles,
            normals: Vec::new(),
            tangents: Vec::new(),
            uv0: Vec::new(),
            uv1: Vec::new(),
            colors: Vec::new(),
            spheres,
            slots: 1,
            bounds: Aabb::EMPTY,
        };
        mesh.bounds = mesh.shape_bounds();
        mesh
    }

    /// The box of all triangles and spheres; vertices that no triangle uses do not count.
    pub fn shape_bounds(&self) -> Aabb {
        let mut bounds = Aabb::EMPTY;
        for vertex in self.triangles.iter().flatten() {
            bounds.grow(self.positions[*vertex as usize]);
        }
        for sphere in &self.spheres {
            bounds.grow(sphere.center - sphere.radius.abs());
            bounds.grow(sphere.center + sphere.radius.abs());
        }
        bounds
    }

    /// Triangles and spheres together.
    pub fn primitive_count(&self) -> usize {
        self.triangles.len() + self.spheres.len()
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    pub center: Vec3,
    pub radius: f32,
    pub slot: u32,
}

#[derive(Clone, Debug)]
pub struct Instance {
    /// Shared, as the materials are, by the instances that one node makes: there may be millions.
    pub name: Arc<str>,
    /// Index into [`Scene::meshes`].
    pub mesh: u32,
    pub transform: Affine3A,
    /// Index into [`Scene::materials`] for each of the mesh's slots.
    pub materials: Arc<[u32]>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum AlphaMode {
    #[default]
    Opaque,
    Mask,
    Blend,
}

/// glTF metallic-roughness, or specular-glossiness without metal. Texture fields index [`Scene::textures`].
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    pub name: String,
    pub base_color: [f32; 4],
    pub base_color_texture: Option<TextureRef>,
    pub metallic: f32,
    pub roughness: f32,
    /// Green is roughness and blue metalness; with [`Self::specular_glossiness`] see there.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Reflectance at normal incidence of what is not metal, linear.
    pub dielectric_f0: Vec3,
    /// KHR_materials_pbrSpecularGlossiness: sRGB colour in `metallic_roughness_texture` multiplies `dielectric_f0`, its
    /// alpha multiplies the glossiness `1 - roughness`.
    pub specular_glossiness: bool,
    pub normal_texture: Option<TextureRef>,
    pub normal_scale: f32,
    /// Linear emitted radiance, KHR_materials_emissive_strength multiplied in.
    pub emissive: Vec3,
    pub emissive_texture: Option<TextureRef>,
    pub alpha_mode: AlphaMode,
    pub alpha_cutoff: f32,
    pub unlit: bool,
}

impl Material {
    /// Reflectance of an index of refraction of 1.5, which metallic-roughness materials have.
    pub const DIELECTRIC_F0: f32 = 0.04;
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [1.0; 4],
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            dielectric_f0: Vec3::splat(Self::DIELECTRIC_F0),
            specular_glossiness: false,
            normal_texture: None,
            normal_scale: 1.0,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            alpha_mode: AlphaMode::Opaque,
            alpha_cutoff: 0.5,
            unlit: false,
        }
    }
}

/// A use of a texture by a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureRef {
    /// Index into [`Scene::textures`].
    pub texture: u32,
    /// 0 or 1.
    pub uv_set: u32,
    /// Rows of the 2x3 matrix that maps (u, v, 1) to the texture's coordinates (KHR_texture_transform).
    pub transform: [[f32; 3]; 2],
}

impl TextureRef {
    pub const IDENTITY: [[f32; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Wrap {
    #[default]
    Repeat,
    MirroredRepeat,
    ClampToEdge,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Filter {
    Nearest,
    #[default]
    Linear,
}

/// An image with its sampler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Index into [`Scene::images`].
    pub image: u32,
    pub wrap_u: Wrap,
    pub wrap_v: Wrap,
    /// The magnification filter; there are no mip levels, supersampling takes their place.
    pub filter: Filter,
}

/// Decoded RGBA, 8 bits a channel, row 0 at the top (v = 0), as stored in the file (colour space is the user's business).
#[derive(Clone, PartialEq, Eq)]
pub struct Image {
    pub name: String,
    pub width: u32,
    pub height: u32,
    pub rgba8: Vec<u8>,
}

impl fmt::Debug for Image {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Image({:?}, {}x{})", self.name, self.width, self.height)
    }
}

/// KHR_lights_punctual in world space.
#[derive(Clone, Debug, PartialEq)]
pub struct PunctualLight {
    pub name: String,
    pub position: Vec3,
    /// Unit vector along which the light shines (node's -Z).
    pub direction: Vec3,
    /// Linear colour times intensity: candela (point, spot) or lux (directional).
    pub intensity: Vec3,
    /// Infinite when not given.
    pub range: f32,
    pub kind: PunctualKind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PunctualKind {
    Point,
    Directional,
    Spot { inner_cone_rad: f32, outer_cone_rad: f32 },
}

#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    pub name: String,
    pub position: Vec3,
    /// Unit.
    pub forward: Vec3,
    /// Unit, orthogonal to `forward`.
    pub up: Vec3,
    pub projection: Projection,
    /// Width over height of the frame that the camera was made for (glTF `aspectRatio`, or `xmag` over `ymag`). A picture
    /// that is narrower keeps that frame's width and shows more above and below; without a frame, and in a wider picture,
    /// the height of the view stays.
    pub frame_aspect: Option<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    Perspective {
        fov_y_rad: f32,
    },
    /// Half height of the view in world units (glTF `ymag`).
    Orthographic {
        half_height: f32,
    },
}
