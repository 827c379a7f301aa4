//! How large lights are: what the usage heuristic of adaptive Line Spaces asks (Keul 2020, section 8.3.2).

use std::collections::HashMap;

use super::{LIGHT_ENVIRONMENT, LIGHT_SPHERE, LIGHT_TRIANGLE, PackedLight, PackedScene};
use crate::integrate::math::{PI, transform_vector};
use crate::integrate::surface::triangle_corners;

/// For each light the edge of a square as large as all that its instance emits from; 0 for punctual lights, infinite for the
/// environment.
pub(super) fn light_sizes(packed: &PackedScene) -> Vec<f32> {
    let areas: Vec<f32> = packed.lights.iter().map(|light| area(packed, light)).collect();
    let mut of_instances: HashMap<u32, f32> = HashMap::new();
    for (light, area) in packed.lights.iter().zip(&areas) {
        *of_instances.entry(light.instance).or_default() += area;
    }
    let size = |light: &PackedLight| match light.kind {
        LIGHT_ENVIRONMENT => f32::INFINITY,
        LIGHT_TRIANGLE | LIGHT_SPHERE => of_instances[&light.instance].sqrt(),
        _ => 0.0,
    };
    packed.lights.iter().map(size).collect()
}

/// World-space area of an emitter's primitive.
fn area(packed: &PackedScene, light: &PackedLight) -> f32 {
    let Some(instance) = packed.instances.get(light.instance as usize) else { return 0.0 };
    let mesh = &packed.meshes[instance.mesh as usize];
    match light.kind {
        LIGHT_TRIANGLE => {
            let triangle = packed.triangles[(mesh.triangle_offset + light.primitive) as usize];
            let [a, b, c] = triangle_corners(packed, mesh, triangle);
            let edges = [b - a, c - a].map(|edge| transform_vector(&instance.object_to_world, edge));
            0.5 * edges[0].cross(edges[1]).length()
        }
        LIGHT_SPHERE => {
            let sphere = packed.spheres[(mesh.sphere_offset + light.primitive - mesh.triangle_count) as usize];
            let radius = transform_vector(&instance.object_to_world, glam::Vec3::X * sphere[3]).length();
            4.0 * PI * radius * radius
        }
        _ => 0.0,
    }
}
