// SHADE: one vertex of path tracing; twin of integrate/path.rs.

//!include scattering
//!include paths

const ROULETTE_START = 3u;
const MAX_SURVIVAL = 0.95;

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
        path_miss(slot, path, ray.direction);
    } else {
        path_hit(slot, path, ray, hit);
    }
}

fn path_miss(slot: u32, path: PathState, direction: vec3<f32>) {
    if scene.environment.light == NONE {
        return;
    }
    var weight = 1.0;
    if path.pdf > 0.0 {
        weight = power_heuristic(path.pdf, path.environment_pdf);
    }
    add_radiance(slot, path.throughput * environment_radiance(direction) * weight);
}

fn path_hit(slot: u32, path: PathState, ray: Ray, hit: Hit) {
    let to_viewer = -ray.direction;
    let surface = shade_point(hit_point(ray, hit), to_viewer);
    if (surface.flags & MATERIAL_UNLIT) != 0u {
        add_radiance(slot, path.throughput * surface.base_color);
        return;
    }
    if any(surface.emission != vec3<f32>(0.0)) {
        var weight = 1.0;
        if path.pdf > 0.0 {
            let n = surface.geometric_normal;
            weight = power_heuristic(path.pdf, emitter_pdf(hit.instance, hit.primitive, ray.origin, surface.position, n));
        }
        add_radiance(slot, path.throughput * surface.emission * weight);
    }
    if wave.bounce > wave.max_bounces {
        return;
    }

    let frame = basis(surface.normal);
    let bsdf = make_bsdf(surface.base_color, surface.metallic, surface.roughness, surface.dielectric_f0,
        to_local(frame, surface.normal, to_viewer));
    let dimensions = SET_PATH + wave.bounce * SETS_PER_BOUNCE;
    let sample = path_sample(slot);
    let numbers = sample_4d_bits(sample.seed, sample.index, dimensions);
    connect(slot, surface, bsdf, frame, path.throughput, numbers);

    let directions = sample_4d(sample.seed, sample.index, dimensions + 1u);
    let sampled = sample_bsdf(bsdf, directions.x, directions.y, directions.z);
    let wi = to_world(frame, surface.normal, sampled.wi);
    var next: PathState;
    next.throughput = path.throughput * sampled.weight;
    let largest = max(max(next.throughput.x, next.throughput.y), next.throughput.z);
    if sampled.pdf <= 0.0 || dot(wi, surface.geometric_normal) <= 0.0 || largest <= 0.0 || !is_finite(next.throughput) {
        return;
    }
    if wave.bounce >= ROULETTE_START {
        let survival = min(largest, MAX_SURVIVAL);
        if unit_float(numbers.w) >= survival {
            return;
        }
        next.throughput *= 1.0 / survival;
    }
    next.pdf = sampled.pdf;
    if scene.environment.light != NONE {
        let selection = light_at(scene.environment.light).selection;
        next.environment_pdf = selection * environment_pdf(surface.normal, wi);
    }
    paths[slot].state = next;
    let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, wi);
    continue_path(slot, Ray(origin, 0.0, wi, infinity()));
}

// Next-event estimation: one light, one point on it, weighted against BSDF sampling.
fn connect(slot: u32, surface: Surface, bsdf: Bsdf, frame: Basis, throughput: vec3<f32>, numbers: vec4<u32>) {
    let light =
        sample_light(surface.position, surface.normal, numbers.x, unit_float(numbers.y), unit_float(numbers.z));
    if light.pdf <= 0.0 || dot(light.direction, surface.geometric_normal) <= 0.0 {
        return;
    }
    let wi = to_local(frame, surface.normal, light.direction);
    var weight = 1.0;
    if !light.is_delta {
        weight = power_heuristic(light.pdf, pdf_bsdf(bsdf, wi));
    }
    let contribution = throughput * eval_bsdf(bsdf, wi) * light.radiance * (weight / light.pdf);
    if all(contribution == vec3<f32>(0.0)) || !is_finite(contribution) {
        return;
    }
    cast_shadow_ray(slot, shadow_ray(surface, light), contribution);
}
