// GENERATE: camera rays of all slots of a wave.

//!include shading
//!include camera
//!include paths

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let slot = id.x;
    if slot >= wave.pixels * wave.samples {
        return;
    }
    let sample = path_sample(slot);
    let numbers = sample_4d(sample.seed, sample.index, SET_CAMERA);
    rays[slot] = camera_ray(sample.x, sample.y, numbers.x, numbers.y);
    paths[slot] = PathState(vec3<f32>(1.0), 0.0, 0.0, 0u, 0u, 0u);
    radiance[slot] = vec4<f32>(0.0);
    active_queue.slots[slot] = slot;
    if slot == 0u {
        atomicStore(&active_queue.count, wave.pixels * wave.samples);
    }
}
