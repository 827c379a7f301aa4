// SHADE of a path's vertex: what path tracing and Whitted's ray tracer share. A stage adds what they differ in, `miss`
// and `scatter`.

//!include scattering
//!include paths

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= active_count() {
        return;
    }
    let slot = active_slot(id.x);
    let ray = rays[slot];
    let hit = hits[slot];
    let path = paths[slot].state;
    if hit.instance == NONE {
        miss(slot, path, ray.direction);
        return;
    }
    let surface = shade_point(hit_point(ray, hit), -ray.direction);
    if (surface.flags & MATERIAL_UNLIT) != 0u {
        add_radiance(slot, path.throughput * surface.base_color);
        return;
    }
    scatter(slot, path, ray, hit, surface);
}

fn surface_bsdf(surface: Surface, wo: vec3<f32>) -> Bsdf {
    return make_bsdf(surface.base_color, surface.metallic, surface.roughness, surface.dielectric_f0, wo);
}

// One point on one light; its density is 0 where it does not shine on the surface's front.
fn light_in_front(surface: Surface, numbers: vec4<u32>) -> LightSample {
    var light =
        sample_light(surface.position, surface.normal, numbers.x, unit_float(numbers.y), unit_float(numbers.z));
    if dot(light.direction, surface.geometric_normal) <= 0.0 {
        light.pdf = 0.0;
    }
    return light;
}

fn connect(slot: u32, surface: Surface, light: LightSample, contribution: vec3<f32>) {
    if any(contribution != vec3<f32>(0.0)) && is_finite(contribution) {
        cast_shadow_ray(slot, shadow_ray(surface, light), contribution);
    }
}

fn go_on(slot: u32, next: PathState, surface: Surface, direction: vec3<f32>) {
    paths[slot].state = next;
    let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, direction);
    continue_path(slot, Ray(origin, 0.0, direction, infinity()));
}
