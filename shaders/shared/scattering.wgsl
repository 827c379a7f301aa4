// All that turns a material into light.

//!include shading
//!include bsdf
//!include environment
//!include lights

// Shadow rays stop short of their light by this factor: the light itself is no occluder.
const SHADOW_REACH = 0.9999;

// The segment from a surface towards a light at `distance` in the unit direction `direction`.
fn shadow_ray(surface: Surface, direction: vec3<f32>, distance: f32) -> Ray {
    let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, direction);
    if bitcast<u32>(distance) == INFINITY_BITS {
        return Ray(origin, 0.0, direction, infinity());
    }
    return Ray(origin, 0.0, direction * distance - (origin - surface.position), SHADOW_REACH);
}
