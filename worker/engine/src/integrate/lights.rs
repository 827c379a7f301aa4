//! Sampling of all lights: which one, where on it, with what density.

use glam::Vec3;

use super::environment::{environment_pdf, environment_radiance, sample_environment};
use super::math::{
    PI, TWO_PI, basis, normalize_or, offset_origin, to_world, transform_point, transform_vector, uniform_sphere,
    uniform_triangle,
};
use super::surface::{base_color, emission, sphere_point, triangle_corners, triangle_point};
use crate::pack::{
    INSTANCE_SIMILARITY, LIGHT_DIRECTIONAL, LIGHT_ENVIRONMENT, LIGHT_SPOT, LIGHT_TRIANGLE, MATERIAL_ALPHA_BLEND,
    MATERIAL_ALPHA_MASK, NONE, PackedInstance, PackedLight, PackedMaterial, PackedMesh, PackedScene,
};

/// Light that would reach a point from one light sample if nothing were in between.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit, towards the light.
    pub direction: Vec3,
    /// The shadow ray is `direction * t`, `0 < t < distance`; infinite for lights at infinity.
    pub distance: f32,
    /// Radiance (area lights and environment), or irradiance on a surface that faces the light (punctual lights).
    pub radiance: Vec3,
    /// Solid-angle density with the light's selection in it, or the bare selection probability of a punctual light; 0 for a
    /// sample that contributes nothing.
    pub pdf: f32,
    /// Punctual: no other technique can find it.
    pub is_delta: bool,
}

const NOTHING: LightSample =
    LightSample { direction: Vec3::Y, distance: 0.0, radiance: Vec3::ZERO, pdf: 0.0, is_delta: true };

/// Chooses a light with all bits of `select`, and a point on it with `(u, v)`, for a surface at `position` with shading
/// normal `normal`.
pub fn sample_light(scene: &PackedScene, position: Vec3, normal: Vec3, select: u32, u: f32, v: f32) -> LightSample {
    if scene.lights.is_empty() {
        return NOTHING;
    }
    let light = &scene.lights[select_light(scene, select) as usize];
    if light.kind == LIGHT_ENVIRONMENT {
        let direction = sample_environment(scene, normal, u, v);
        return LightSample {
            direction,
            distance: f32::INFINITY,
            radiance: environment_radiance(scene, direction),
            pdf: light.selection * environment_pdf(scene, normal, direction),
            is_delta: false,
        };
    }
    if light.instance == NONE {
        return sample_punctual(light, position);
    }
    if light.kind == LIGHT_TRIANGLE {
        sample_triangle(scene, light, position, u, v)
    } else {
        sample_sphere(scene, light, position, u, v)
    }
}

/// Size of the light that `select` chooses by its distance: 0 for punctual lights, 1 for the environment.
pub fn apparent_size(scene: &PackedScene, select: u32, distance: f32) -> f32 {
    let size = if scene.lights.is_empty() { 0.0 } else { scene.light_sizes[select_light(scene, select) as usize] };
    if size.is_finite() { size / distance } else { 1.0 }
}

/// The first light whose range of numbers does not end before `select`.
fn select_light(scene: &PackedScene, select: u32) -> u32 {
    let (mut low, mut high) = (0, scene.lights.len() as u32 - 1);
    while low < high {
        let middle = (low + high) / 2;
        if scene.light_cdf[middle as usize] >= select {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    low
}

/// KHR_lights_punctual: inverse square with a windowed range, and the recommended spot cone.
fn sample_punctual(light: &PackedLight, position: Vec3) -> LightSample {
    let intensity = Vec3::from_array(light.intensity);
    if light.kind == LIGHT_DIRECTIONAL {
        return LightSample {
            direction: -Vec3::from_array(light.direction),
            distance: f32::INFINITY,
            radiance: intensity,
            pdf: light.selection,
            is_delta: true,
        };
    }
    let to_light = Vec3::from_array(light.position) - position;
    let distance2 = to_light.dot(to_light);
    if distance2 <= 0.0 {
        return NOTHING;
    }
    let distance = distance2.sqrt();
    let direction = to_light * (1.0 / distance);
    let mut attenuation = 1.0 / distance2;
    if light.range < f32::INFINITY {
        let r = distance / light.range;
        let r2 = r * r;
        attenuation *= (1.0 - r2 * r2).clamp(0.0, 1.0);
    }
    if light.kind == LIGHT_SPOT {
        let cosine = -direction.dot(Vec3::from_array(light.direction));
        let cone = (cosine * light.spot_scale + light.spot_offset).clamp(0.0, 1.0);
        attenuation *= cone * cone;
    }
    LightSample { direction, distance, radiance: intensity * attenuation, pdf: light.selection, is_delta: true }
}

/// A world-space triangle: its first corner, and the cross product of its edges (twice its area long).
fn triangle_cross(scene: &PackedScene, inst: &PackedInstance, mesh: &PackedMesh, primitive: u32) -> Vec3 {
    let triangle = scene.triangles[(mesh.triangle_offset + primitive) as usize];
    let [a, b, c] = triangle_corners(scene, mesh, triangle);
    let e1 = transform_vector(&inst.object_to_world, b - a);
    let e2 = transform_vector(&inst.object_to_world, c - a);
    e1.cross(e2)
}

fn sample_triangle(scene: &PackedScene, light: &PackedLight, position: Vec3, u: f32, v: f32) -> LightSample {
    let inst = &scene.instances[light.instance as usize];
    let mesh = &scene.meshes[inst.mesh as usize];
    let (b1, b2) = uniform_triangle(u, v);
    let point = triangle_point(scene, light.instance, light.primitive, b1, b2);
    let cross = triangle_cross(scene, inst, mesh, light.primitive);
    let to_light = point.position - position;
    let distance2 = to_light.dot(to_light);
    let projected = 0.5 * cross.dot(to_light).abs();
    if distance2 <= 0.0 || projected <= 0.0 {
        return NOTHING;
    }
    // The shadow ray ends on the near side of the light.
    let target = offset_origin(point.position, point.error, point.geometric_normal, -to_light);
    let (direction, distance) = direction_to(position, target);
    let material = &scene.materials[point.material as usize];
    LightSample {
        direction,
        distance,
        radiance: emission(scene, material, &point) * opacity(scene, material, &point),
        pdf: light.selection * distance2 * distance2.sqrt() / projected,
        is_delta: false,
    }
}

fn direction_to(position: Vec3, target: Vec3) -> (Vec3, f32) {
    let v = target - position;
    let length = v.dot(v).sqrt();
    (normalize_or(v, Vec3::Y), length)
}

/// Expected share of an emitter's surface that is there: what [`super::alpha`] decides by chance.
fn opacity(scene: &PackedScene, material: &PackedMaterial, point: &super::surface::SurfacePoint) -> f32 {
    if material.flags & (MATERIAL_ALPHA_MASK | MATERIAL_ALPHA_BLEND) == 0 {
        return 1.0;
    }
    let alpha = base_color(scene, material, point)[3];
    if material.flags & MATERIAL_ALPHA_MASK == 0 {
        return alpha.clamp(0.0, 1.0);
    }
    if alpha >= material.alpha_cutoff { 1.0 } else { 0.0 }
}

/// World-space centre and radius of a sphere that its instance keeps round.
fn world_sphere(scene: &PackedScene, inst: &PackedInstance, primitive: u32) -> (Vec3, f32) {
    let mesh = &scene.meshes[inst.mesh as usize];
    let [x, y, z, r] = scene.spheres[(mesh.sphere_offset + primitive - mesh.triangle_count) as usize];
    let axis = transform_vector(&inst.object_to_world, Vec3::new(r, 0.0, 0.0));
    (transform_point(&inst.object_to_world, Vec3::new(x, y, z)), axis.dot(axis).sqrt())
}

/// Spheres seen from outside: uniform over the cone that they subtend (Pharr, Jakob and Humphreys 2023, section 6.2.4).
/// From inside, and for ellipsoids: uniform over the object-space sphere.
fn sample_sphere(scene: &PackedScene, light: &PackedLight, position: Vec3, u: f32, v: f32) -> LightSample {
    let inst = &scene.instances[light.instance as usize];
    let mut n = uniform_sphere(u, v);
    let cone = sphere_cone(scene, inst, light.primitive, position);
    if cone > 0.0 {
        let (center, radius) = world_sphere(scene, inst, light.primitive);
        let to_center = center - position;
        let distance = to_center.dot(to_center).sqrt();
        let axis = to_center * (1.0 / distance);
        // 1 - cos of the angle off the axis; then the angle at the sphere's centre.
        let lost = u * cone;
        let sine2 = lost * (2.0 - lost);
        let along = distance * (1.0 - lost) - (radius * radius - distance * distance * sine2).max(0.0).sqrt();
        let phi = TWO_PI * v;
        let sine = sine2.max(0.0).sqrt();
        let (t, b) = basis(axis);
        let direction = to_world(t, b, axis, Vec3::new(sine * phi.cos(), sine * phi.sin(), 1.0 - lost));
        let outward = position + direction * along - center;
        n = normalize_or(transform_vector(&inst.world_to_object, outward), n);
    }
    let point = sphere_point(scene, light.instance, light.primitive, n);
    let to_light = point.position - position;
    let target = offset_origin(point.position, point.error, point.geometric_normal, -to_light);
    let (direction, distance) = direction_to(position, target);
    let material = &scene.materials[point.material as usize];
    let density = sphere_pdf(scene, inst, light.primitive, position, point.position, n);
    LightSample {
        direction,
        distance,
        radiance: emission(scene, material, &point) * opacity(scene, material, &point),
        pdf: light.selection * density,
        is_delta: false,
    }
}

/// `1 - cos` of the half angle of a sphere's cone; 0 where it is not sampled by its cone.
fn sphere_cone(scene: &PackedScene, inst: &PackedInstance, primitive: u32, position: Vec3) -> f32 {
    if inst.flags & INSTANCE_SIMILARITY == 0 {
        return 0.0;
    }
    let (center, radius) = world_sphere(scene, inst, primitive);
    let to_center = center - position;
    let distance2 = to_center.dot(to_center);
    let sine2 = radius * radius / distance2;
    if sine2.is_nan() || sine2 >= 0.9999 {
        return 0.0;
    }
    // 1 - cos without cancellation for small spheres.
    sine2 / (1.0 + (1.0 - sine2).sqrt())
}

/// Solid-angle density at `position` of the sphere's point `target`, whose object-space normal is `n`.
fn sphere_pdf(
    scene: &PackedScene,
    inst: &PackedInstance,
    primitive: u32,
    position: Vec3,
    target: Vec3,
    n: Vec3,
) -> f32 {
    let cone = sphere_cone(scene, inst, primitive, position);
    if cone > 0.0 {
        return 1.0 / (TWO_PI * cone);
    }
    let mesh = &scene.meshes[inst.mesh as usize];
    let radius = scene.spheres[(mesh.sphere_offset + primitive - mesh.triangle_count) as usize][3];
    // Area element of the image of the unit sphere: cofactor(M) n, whose direction is the normal.
    let m = &inst.object_to_world;
    let (x, y, z) = (
        Vec3::new(m[0][0], m[1][0], m[2][0]),
        Vec3::new(m[0][1], m[1][1], m[2][1]),
        Vec3::new(m[0][2], m[1][2], m[2][2]),
    );
    let element = y.cross(z) * n.x + z.cross(x) * n.y + x.cross(y) * n.z;
    let to_light = target - position;
    let distance2 = to_light.dot(to_light);
    let projected = element.dot(to_light).abs() * radius * radius * 4.0 * PI;
    if projected <= 0.0 { 0.0 } else { distance2 * distance2.sqrt() / projected }
}

/// Density with which [`sample_light`] would have found the emitter that a ray from `position` hit at `target`; 0 where
/// the primitive is no light.
pub fn emitter_pdf(
    scene: &PackedScene,
    instance: u32,
    primitive: u32,
    position: Vec3,
    target: Vec3,
    geometric_normal: Vec3,
) -> f32 {
    let inst = &scene.instances[instance as usize];
    if inst.emitter_base == NONE {
        return 0.0;
    }
    let number = scene.emitter_lights[(inst.emitter_base + primitive) as usize];
    if number == NONE {
        return 0.0;
    }
    let selection = scene.lights[number as usize].selection;
    let mesh = &scene.meshes[inst.mesh as usize];
    if primitive < mesh.triangle_count {
        let cross = triangle_cross(scene, inst, mesh, primitive);
        let to_light = target - position;
        let distance2 = to_light.dot(to_light);
        let projected = 0.5 * cross.dot(to_light).abs();
        return if projected <= 0.0 { 0.0 } else { selection * distance2 * distance2.sqrt() / projected };
    }
    // The object-space normal back from the world's: transpose(M) N, the inverse of the inverse transpose.
    let m = &inst.object_to_world;
    let n = Vec3::new(
        m[0][0] * geometric_normal.x + m[1][0] * geometric_normal.y + m[2][0] * geometric_normal.z,
        m[0][1] * geometric_normal.x + m[1][1] * geometric_normal.y + m[2][1] * geometric_normal.z,
        m[0][2] * geometric_normal.x + m[1][2] * geometric_normal.y + m[2][2] * geometric_normal.z,
    );
    selection * sphere_pdf(scene, inst, primitive, position, target, normalize_or(n, Vec3::Y))
}
