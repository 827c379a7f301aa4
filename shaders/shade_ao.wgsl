// SHADE: one ambient occlusion ray of every slot; twin of integrate/ao.rs. The wave repeats it `ao_samples` times over
// the same hits; a ray that gets through adds one, ACCUMULATE divides by their number.

//!include shading
//!include paths

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= active_count() {
        return;
    }
    let slot = active_slot(id.x);
    let hit = hits[slot];
    if hit.instance == NONE {
        add_radiance(slot, vec3<f32>(1.0));
        return;
    }
    let ray = rays[slot];
    let surface = shade_point(hit_point(ray, hit), -ray.direction);
    let sample = path_sample(slot);
    let numbers = sample_4d(sample.seed, sample.index * wave.ao_samples + wave.ao_index, SET_AO);
    var direction = to_world(basis(surface.normal), surface.normal, cosine_hemisphere(numbers.x, numbers.y));
    let below = dot(direction, surface.geometric_normal);
    if below < 0.0 {
        direction -= surface.geometric_normal * (2.0 * below);
    }
    let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, direction);
    cast_shadow_ray(slot, Ray(origin, 0.0, direction, wave.ao_distance), vec3<f32>(1.0));
}
