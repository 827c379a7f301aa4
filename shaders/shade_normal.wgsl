// SHADE: the shading normal mapped to 0..1, black on a miss: the picture of the `aov` integrator.

//!include shading
//!include paths

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= active_count() {
        return;
    }
    let slot = active_slot(id.x);
    let hit = hits[slot];
    if hit.instance != NONE {
        let ray = rays[slot];
        let surface = shade_point(hit_point(ray, hit), -ray.direction);
        add_radiance(slot, surface.normal * 0.5 + vec3<f32>(0.5));
    }
}
