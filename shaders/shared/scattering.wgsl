// All that turns a material into light.

//!include shading
//!include bsdf
//!include environment
//!include lights

const SHADOW_ERROR = 4.0 * LOCAL_ERROR;

// The segment from a surface to a light: all of it to a punctual light, short of an area light by a bound on rounding
// errors.
fn shadow_ray(surface: Surface, light: LightSample) -> Ray {
    let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, light.direction);
    if bitcast<u32>(light.distance) == INFINITY_BITS {
        return Ray(origin, 0.0, light.direction, infinity());
    }
    let to_light = light.direction * light.distance - (origin - surface.position);
    var t_max = 1.0;
    if !light.is_delta {
        let error = (largest_component(origin) + largest_component(to_light)) * SHADOW_ERROR;
        t_max = max(1.0 - error / light.distance, 0.0);
    }
    return Ray(origin, 0.0, to_light, t_max);
}

fn largest_component(v: vec3<f32>) -> f32 {
    return max(max(abs(v.x), abs(v.y)), abs(v.z));
}
