// SHADE: one vertex of Whitted's ray tracer; twin of integrate/whitted.rs.

//!include vertex

const MIRROR_ROUGHNESS = 0.25;

fn miss(slot: u32, path: PathState, direction: vec3<f32>) {
    if scene.environment.light != NONE {
        add_radiance(slot, path.throughput * environment_radiance(direction));
    }
}

fn scatter(slot: u32, path: PathState, ray: Ray, hit: Hit, surface: Surface) {
    add_radiance(slot, path.throughput * surface.emission);

    let to_viewer = -ray.direction;
    let frame = basis(surface.normal);
    let wo = to_local(frame, surface.normal, to_viewer);
    let bsdf = surface_bsdf(surface, wo);
    let is_mirror = surface.roughness < MIRROR_ROUGHNESS;
    let sample = path_sample(slot);
    let numbers = sample_4d_bits(sample.seed, sample.index, SET_PATH + wave.bounce * SETS_PER_BOUNCE);
    let light = light_in_front(surface, numbers);
    if light.pdf > 0.0 {
        let wi = to_local(frame, surface.normal, light.direction);
        var reflected: vec3<f32>;
        if is_mirror {
            reflected = eval_cosine_lobes(bsdf, wi);
        } else {
            reflected = eval_bsdf(bsdf, wi);
        }
        connect(slot, surface, light, path.throughput * reflected * light.radiance * (1.0 / light.pdf));
    }

    if !is_mirror || wave.bounce >= wave.max_bounces {
        return;
    }
    let wi = surface.normal * (2.0 * dot(surface.normal, to_viewer)) - to_viewer;
    var next = path;
    next.throughput *= bsdf.f0 + (vec3<f32>(1.0) - bsdf.f0) * schlick(wo.z);
    if dot(wi, surface.geometric_normal) <= 0.0 || all(next.throughput == vec3<f32>(0.0)) {
        return;
    }
    go_on(slot, next, surface, wi);
}
