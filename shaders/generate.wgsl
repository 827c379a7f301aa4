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
    let start = PathState(vec3<f32>(1.0), 0.0, 0.0, 0u, 0u, 0u);
    paths[slot] = Path(start, vec4<f32>(0.0), vec4<f32>(0.0));
    let queue = queue_start(wave.active_queue);
    atomicStore(&queues[queue + 1u + slot], slot);
    if slot == 0u {
        atomicStore(&queues[queue], wave.pixels * wave.samples);
    }
}
