// The state of all paths in flight, one slot each, and the queues between the stages.

struct PathState {
    throughput: vec3<f32>,
    // Density with which the BSDF sampled the ray; 0 for the camera's.
    pdf: f32,
    // Density with which the previous vertex's light sampling would find the environment in the ray's direction.
    environment_pdf: f32,
    _pad0: u32,
    _pad1: u32,
    _pad2: u32,
}

struct Queue {
    count: atomic<u32>,
    slots: array<u32>,
}

@group(2) @binding(0) var<storage, read_write> rays: array<Ray>;
@group(2) @binding(1) var<storage, read_write> hits: array<Hit>;
@group(2) @binding(2) var<storage, read_write> paths: array<PathState>;
@group(2) @binding(3) var<storage, read_write> radiance: array<vec4<f32>>;
@group(2) @binding(4) var<storage, read_write> shadow_rays: array<Ray>;
@group(2) @binding(5) var<storage, read_write> contributions: array<vec4<f32>>;
@group(2) @binding(6) var<storage, read_write> active_queue: Queue;
@group(2) @binding(7) var<storage, read_write> next_queue: Queue;
@group(2) @binding(8) var<storage, read_write> shadow_queue: Queue;

fn add_radiance(slot: u32, value: vec3<f32>) {
    radiance[slot] += vec4<f32>(value, 0.0);
}

fn cast_shadow_ray(slot: u32, ray: Ray, contribution: vec3<f32>) {
    shadow_rays[slot] = ray;
    contributions[slot] = vec4<f32>(contribution, 0.0);
    shadow_queue.slots[atomicAdd(&shadow_queue.count, 1u)] = slot;
}

fn continue_path(slot: u32, ray: Ray) {
    rays[slot] = ray;
    next_queue.slots[atomicAdd(&next_queue.count, 1u)] = slot;
}
