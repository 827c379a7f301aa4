// SHADE: one vertex of path tracing; twin of integrate/path.rs.

//!include vertex

const ROULETTE_START = 3u;
const MAX_SURVIVAL = 0.95;

fn miss(slot: u32, path: PathState, direction: vec3<f32>) {
    if scene.environment.light == NONE {
        return;
    }
    var weight = 1.0;
    if path.pdf > 0.0 {
        weight = power_heuristic(path.pdf, path.environment_pdf);
    }
    add_radiance(slot, path.throughput * environment_radiance(direction) * weight);
}

fn scatter(slot: u32, path: PathState, ray: Ray, hit: Hit, surface: Surface) {
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
    let bsdf = surface_bsdf(surface, to_local(frame, surface.normal, -ray.direction));
    let dimensions = SET_PATH + wave.bounce * SETS_PER_BOUNCE;
    let sample = path_sample(slot);
    let numbers = sample_4d_bits(sample.seed, sample.index, dimensions);
    let light = light_in_front(surface, numbers);
    if light.pdf > 0.0 {
        // Next-event estimation, weighted against BSDF sampling.
        let wi = to_local(frame, surface.normal, light.direction);
        var weight = 1.0;
        if !light.is_delta {
            weight = power_heuristic(light.pdf, pdf_bsdf(bsdf, wi));
        }
        connect(slot, surface, light, path.throughput * eval_bsdf(bsdf, wi) * light.radiance * (weight / light.pdf));
    }

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
    go_on(slot, next, surface, wi);
}
