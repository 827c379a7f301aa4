//! From a hit to everything that shading needs: position, normals, texture coordinates, material values.
//!
//! Both sides of every surface are visible, whatever glTF's `doubleSided` says: culling is a rasteriser's economy, and
//! a path tracer that culls lets light through walls. Normals are turned to the side that the ray comes from.

use glam::Vec3;

use super::math::{basis, normalize_or, surface_error, transform_normal, transform_point, transform_vector};
use super::texture::sample_texture;
use crate::pack::{
    INSTANCE_MIRRORED, MATERIAL_SPECULAR_GLOSSINESS, NONE, PackedInstance, PackedMaterial, PackedMesh, PackedScene,
};
use crate::trace::{Hit, Ray};

/// The smallest cosine between shading normal and view: normals bent further away are pulled back to it.
const MIN_VIEW_COSINE: f32 = 0.01;
/// Mirrored views whose cosine with the geometric normal is smaller than this are lifted to it, or to this share of the
/// view's own cosine if that is less.
const MIN_MIRROR_COSINE: f32 = 0.01;
const MIN_MIRROR_SHARE: f32 = 0.9;

/// A point of a primitive before its material is looked up.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// World space.
    pub position: Vec3,
    /// How far off the surface a ray that leaves it starts ([`surface_error`]).
    pub error: f32,
    /// Unit, outwards (the side that glTF calls front).
    pub geometric_normal: Vec3,
    /// Interpolated unit normal, outwards.
    pub smooth_normal: Vec3,
    /// World-space tangent and the sign of the bitangent `cross(normal, tangent)`; zero sign without tangents.
    pub tangent: Vec3,
    pub bitangent_sign: f32,
    pub uv0: [f32; 2],
    pub uv1: [f32; 2],
    /// Vertex colour, linear RGBA.
    pub color: [f32; 4],
    pub material: u32,
}

/// A shaded point, turned towards the viewer.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    pub position: Vec3,
    pub error: f32,
    /// Unit, on the viewer's side.
    pub geometric_normal: Vec3,
    /// Unit, with the normal map, on the viewer's side; see [`valid_normal`].
    pub normal: Vec3,
    pub base_color: Vec3,
    pub metallic: f32,
    pub roughness: f32,
    /// Reflectance at normal incidence of what is not metal.
    pub dielectric_f0: Vec3,
    /// Emitted radiance (both sides emit, as in Cycles).
    pub emission: Vec3,
    pub material: u32,
    /// `MATERIAL_*` flags.
    pub flags: u32,
}

/// The material number of a primitive of an instance.
pub fn material_index(scene: &PackedScene, instance: &PackedInstance, mesh: &PackedMesh, primitive: u32) -> u32 {
    let slot = scene.slots[(mesh.slot_offset + primitive) as usize];
    scene.instance_materials[(instance.material_base + slot) as usize]
}

fn attribute3(scene: &PackedScene, offset: u32, vertex: u32) -> Vec3 {
    let i = (offset + 3 * vertex) as usize;
    Vec3::new(scene.attributes[i], scene.attributes[i + 1], scene.attributes[i + 2])
}

fn attribute2(scene: &PackedScene, offset: u32, triangle: [u32; 3], b: [f32; 3]) -> [f32; 2] {
    if offset == NONE {
        return [0.0; 2];
    }
    let mut sum = [0.0; 2];
    for k in 0..3 {
        let i = (offset + 2 * triangle[k]) as usize;
        sum[0] += b[k] * scene.attributes[i];
        sum[1] += b[k] * scene.attributes[i + 1];
    }
    sum
}

fn attribute4(scene: &PackedScene, offset: u32, triangle: [u32; 3], b: [f32; 3]) -> [f32; 4] {
    let mut sum = [0.0; 4];
    for k in 0..3 {
        let i = (offset + 4 * triangle[k]) as usize;
        for (c, value) in sum.iter_mut().enumerate() {
            *value += b[k] * scene.attributes[i + c];
        }
    }
    sum
}

/// Object-space corners of a triangle.
pub fn triangle_corners(scene: &PackedScene, mesh: &PackedMesh, triangle: [u32; 3]) -> [Vec3; 3] {
    let corner = |v: u32| Vec3::from_array(scene.positions[(mesh.position_offset + v) as usize]);
    [corner(triangle[0]), corner(triangle[1]), corner(triangle[2])]
}

/// The point with barycentric coordinates `(u, v)` on a triangle.
pub fn triangle_point(scene: &PackedScene, instance: u32, primitive: u32, u: f32, v: f32) -> SurfacePoint {
    let inst = &scene.instances[instance as usize];
    let mesh = &scene.meshes[inst.mesh as usize];
    let triangle = scene.triangles[(mesh.triangle_offset + primitive) as usize];
    let [p0, p1, p2] = triangle_corners(scene, mesh, triangle);
    let b = [1.0 - u - v, u, v];
    let p = p0 * b[0] + p1 * b[1] + p2 * b[2];
    let position = transform_point(&inst.object_to_world, p);
    let error = surface_error(&inst.object_to_world, p0.abs().max(p1.abs()).max(p2.abs()), position);
    let face = (p1 - p0).cross(p2 - p0);
    let geometric_normal = normalize_or(transform_normal(&inst.world_to_object, face), Vec3::Y);

    let mut smooth_normal = geometric_normal;
    if mesh.normal_offset != NONE {
        let n = attribute3(scene, mesh.normal_offset, triangle[0]) * b[0]
            + attribute3(scene, mesh.normal_offset, triangle[1]) * b[1]
            + attribute3(scene, mesh.normal_offset, triangle[2]) * b[2];
        smooth_normal = normalize_or(transform_normal(&inst.world_to_object, n), geometric_normal);
    }
    let (mut tangent, mut bitangent_sign) = (Vec3::ZERO, 0.0);
    if mesh.tangent_offset != NONE {
        let t = attribute4(scene, mesh.tangent_offset, triangle, b);
        tangent = transform_vector(&inst.object_to_world, Vec3::new(t[0], t[1], t[2]));
        let mirrored = inst.flags & INSTANCE_MIRRORED != 0;
        bitangent_sign = if (t[3] < 0.0) != mirrored { -1.0 } else { 1.0 };
    }
    let color = if mesh.color_offset == NONE { [1.0; 4] } else { attribute4(scene, mesh.color_offset, triangle, b) };
    SurfacePoint {
        position,
        error,
        geometric_normal,
        smooth_normal,
        tangent,
        bitangent_sign,
        uv0: attribute2(scene, mesh.uv0_offset, triangle, b),
        uv1: attribute2(scene, mesh.uv1_offset, triangle, b),
        color,
        material: material_index(scene, inst, mesh, primitive),
    }
}

/// The point of a sphere in the object-space direction `n` (unit) from its centre. Texture coordinates are those of a
/// globe: `u` runs eastwards from `-Z`, `v` from the north pole (+Y) down.
pub fn sphere_point(scene: &PackedScene, instance: u32, primitive: u32, n: Vec3) -> SurfacePoint {
    let inst = &scene.instances[instance as usize];
    let mesh = &scene.meshes[inst.mesh as usize];
    let [x, y, z, radius] = scene.spheres[(mesh.sphere_offset + primitive - mesh.triangle_count) as usize];
    let center = Vec3::new(x, y, z);
    let position = transform_point(&inst.object_to_world, center + n * radius);
    let error = surface_error(&inst.object_to_world, center.abs() + Vec3::splat(radius), position);
    let normal = normalize_or(transform_normal(&inst.world_to_object, n), Vec3::Y);
    let uv = [0.5 + n.x.atan2(n.z) * (0.5 * super::math::INV_PI), n.y.clamp(-1.0, 1.0).acos() * super::math::INV_PI];
    let east = normalize_or(Vec3::new(n.z, 0.0, -n.x), Vec3::X);
    let mirrored = inst.flags & INSTANCE_MIRRORED != 0;
    SurfacePoint {
        position,
        error,
        geometric_normal: normal,
        smooth_normal: normal,
        tangent: transform_vector(&inst.object_to_world, east),
        bitangent_sign: if mirrored { -1.0 } else { 1.0 },
        uv0: uv,
        uv1: uv,
        color: [1.0; 4],
        material: material_index(scene, inst, mesh, primitive),
    }
}

/// Object-space unit direction from a sphere's centre to the ray's point at `t`. The instance's translation comes off
/// before the inverse is applied, as in traversal: so nothing is lost far from the world's origin.
pub fn sphere_direction(scene: &PackedScene, inst: &PackedInstance, primitive: u32, ray: &Ray, t: f32) -> Vec3 {
    let mesh = &scene.meshes[inst.mesh as usize];
    let [x, y, z, _] = scene.spheres[(mesh.sphere_offset + primitive - mesh.triangle_count) as usize];
    let m = &inst.object_to_world;
    let origin = transform_vector(&inst.world_to_object, ray.origin - Vec3::new(m[0][3], m[1][3], m[2][3]));
    let direction = transform_vector(&inst.world_to_object, ray.direction);
    normalize_or(origin + direction * t - Vec3::new(x, y, z), Vec3::Y)
}

/// The point that a ray hits.
pub fn hit_point(scene: &PackedScene, ray: &Ray, hit: &Hit) -> SurfacePoint {
    let inst = &scene.instances[hit.instance as usize];
    let mesh = &scene.meshes[inst.mesh as usize];
    if hit.primitive < mesh.triangle_count {
        triangle_point(scene, hit.instance, hit.primitive, hit.u, hit.v)
    } else {
        let n = sphere_direction(scene, inst, hit.primitive, ray, hit.t);
        sphere_point(scene, hit.instance, hit.primitive, n)
    }
}

/// Linear base colour and alpha at a point: factor, texture and vertex colour multiplied.
pub fn base_color(scene: &PackedScene, material: &PackedMaterial, point: &SurfacePoint) -> [f32; 4] {
    let mut color = [0, 1, 2, 3].map(|c| material.base_color[c] * point.color[c]);
    if material.base_color_texture != NONE {
        let t = sample_texture(scene, material.base_color_texture, point.uv0, point.uv1);
        color = [0, 1, 2, 3].map(|c| color[c] * t[c]);
    }
    color
}

/// Emitted radiance at a point.
pub fn emission(scene: &PackedScene, material: &PackedMaterial, point: &SurfacePoint) -> Vec3 {
    let mut e = Vec3::from_array(material.emissive);
    if material.emissive_texture != NONE && e != Vec3::ZERO {
        let t = sample_texture(scene, material.emissive_texture, point.uv0, point.uv1);
        e *= Vec3::new(t[0], t[1], t[2]);
    }
    e
}

/// The shading normal of the front side: the normal map in the tangent frame of the smooth normal.
fn mapped_normal(scene: &PackedScene, material: &PackedMaterial, point: &SurfacePoint) -> Vec3 {
    let n = point.smooth_normal;
    if material.normal_texture == NONE || point.bitangent_sign == 0.0 {
        return n;
    }
    let along = point.tangent - n * n.dot(point.tangent);
    let tangent = normalize_or(along, basis(n).0);
    let bitangent = n.cross(tangent) * point.bitangent_sign;
    let t = sample_texture(scene, material.normal_texture, point.uv0, point.uv1);
    let x = (2.0 * t[0] - 1.0) * material.normal_scale;
    let y = (2.0 * t[1] - 1.0) * material.normal_scale;
    let z = 2.0 * t[2] - 1.0;
    normalize_or(tangent * x + bitangent * y + n * z, n)
}

/// Interpolated and mapped normals do not fit the flat surface that they stand on: seen at a grazing angle they may face
/// away, or mirror the view into the surface, where all that light would be lost and silhouettes and engravings be dark.
/// Such a normal is bent until the mirrored view leaves the surface (Keller et al. 2017, "The Iray Light Transport
/// Simulation and Rendering System", appendix A.3).
fn valid_normal(normal: Vec3, geometric_normal: Vec3, to_viewer: Vec3) -> Vec3 {
    let mut n = normal;
    let cosine = n.dot(to_viewer);
    if cosine < MIN_VIEW_COSINE {
        n = normalize_or(n + to_viewer * (MIN_VIEW_COSINE - cosine), geometric_normal);
    }
    let mirrored = n * (2.0 * n.dot(to_viewer)) - to_viewer;
    let height = mirrored.dot(geometric_normal);
    let least = MIN_MIRROR_COSINE.min(MIN_MIRROR_SHARE * geometric_normal.dot(to_viewer));
    if height >= least {
        return n;
    }
    let lifted = normalize_or(mirrored + geometric_normal * (least - height), geometric_normal);
    normalize_or(lifted + to_viewer, geometric_normal)
}

/// Looks a hit point's material up and turns it towards a viewer in the unit direction `to_viewer`.
pub fn shade_point(scene: &PackedScene, point: &SurfacePoint, to_viewer: Vec3) -> Surface {
    let material = &scene.materials[point.material as usize];
    let color = base_color(scene, material, point);
    let (mut metallic, mut roughness) = (material.metallic, material.roughness);
    let mut dielectric_f0 = Vec3::from_array(material.dielectric_f0);
    if material.metallic_roughness_texture != NONE {
        let t = sample_texture(scene, material.metallic_roughness_texture, point.uv0, point.uv1);
        if material.flags & MATERIAL_SPECULAR_GLOSSINESS != 0 {
            dielectric_f0 *= Vec3::new(t[0], t[1], t[2]);
            roughness = 1.0 - (1.0 - roughness) * t[3];
        } else {
            roughness *= t[1];
            metallic *= t[2];
        }
    }
    let side = if point.geometric_normal.dot(to_viewer) < 0.0 { -1.0 } else { 1.0 };
    let geometric_normal = point.geometric_normal * side;
    let normal = valid_normal(mapped_normal(scene, material, point) * side, geometric_normal, to_viewer);
    Surface {
        position: point.position,
        error: point.error,
        geometric_normal,
        normal,
        base_color: Vec3::new(color[0].clamp(0.0, 1.0), color[1].clamp(0.0, 1.0), color[2].clamp(0.0, 1.0)),
        metallic: metallic.clamp(0.0, 1.0),
        roughness: roughness.clamp(0.0, 1.0),
        dielectric_f0,
        emission: emission(scene, material, point),
        material: point.material,
        flags: material.flags,
    }
}
