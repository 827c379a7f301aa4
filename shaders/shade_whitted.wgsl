// SHADE: one vertex of Whitted's ray tracer; twin of integrate/whitted.rs.

//!include scattering
//!include paths

const MIRROR_ROUGHNESS = 0.25;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= active_count() {
        return;
    }
    let slot = active_slot(id.x);
    let ray = rays[slot];
    let hit = hits[slot];
    var path = paths[slot].state;
    if hit.instance == NONE {
        if scene.environment.light != NONE {
            add_radiance(slot, path.throughput * environment_radiance(ray.direction));
        }
        return;
    }
    let to_viewer = -ray.direction;
    let surface = shade_point(hit_point(ray, hit), to_viewer);
    if (surface.flags & MATERIAL_UNLIT) != 0u {
        add_radiance(slot, path.throughput * surface.base_color);
        return;
    }
    add_radiance(slot, path.throughput * surface.emission);

    let frame = basis(surface.normal);
    let wo = to_local(frame, surface.normal, to_viewer);
    let bsdf = make_bsdf(surface.base_color, surface.metallic, surface.roughness, surface.dielectric_f0, wo);
    let is_mirror = surface.roughness < MIRROR_ROUGHNESS;
    let sample = path_sample(slot);
    let numbers = sample_4d_bits(sample.seed, sample.index, SET_PATH + wave.bounce * SETS_PER_BOUNCE);
    let light =
        sample_light(surface.position, surface.normal, numbers.x, unit_float(numbers.y), unit_float(numbers.z));
    if light.pdf > 0.0 && dot(light.direction, surface.geometric_normal) > 0.0 {
        let wi = to_local(frame, surface.normal, light.direction);
        var reflected: vec3<f32>;
        if is_mirror {
            reflected = eval_cosine_lobes(bsdf, wi);
        } else {
            reflected = eval_bsdf(bsdf, wi);
        }
        let contribution = path.throughput * reflected * light.radiance * (1.0 / light.pdf);
        if any(contribution != vec3<f32>(0.0)) && is_finite(contribution) {
            cast_shadow_ray(slot, shadow_ray(surface, light), contribution);
        }
    }

    if !is_mirror || wave.bounce >= wave.max_bounces {
        return;
    }
    let wi = surface.normal * (2.0 * dot(surface.normal, to_viewer)) - to_viewer;
    path.throughput *= bsdf.f0 + (vec3<f32>(1.0) - bsdf.f0) * schlick(wo.z);
    if dot(wi, surface.geometric_normal) <= 0.0 || all(path.throughput == vec3<f32>(0.0)) {
        return;
    }
    paths[slot].state = path;
    let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, wi);
    continue_path(slot, Ray(origin, 0.0, wi, infinity()));
}
