// All paths in flight, one slot each, and the queues between the stages.

// Those of the paths, then `wave.capacity` further on those of the shadow rays.
@group(2) @binding(0) var<storage, read_write> rays: array<Ray>;
@group(2) @binding(1) var<storage, read_write> hits: array<Hit>;
@group(2) @binding(2) var<storage, read_write> paths: array<Path>;
// Two queues of paths, the active ones and those that go on, which swap roles after each bounce; then one of shadow
// rays. Each is a count and as many slots.
@group(2) @binding(3) var<storage, read_write> queues: array<atomic<u32>>;

const SHADOW_QUEUE = 2u;
// A queue takes this many words more than it has slots, so that each can be bound for itself (QUEUE_HEADER in stages.rs).
const QUEUE_HEADER = 384u;

fn queue_start(queue: u32) -> u32 {
    return queue * (wave.capacity + QUEUE_HEADER);
}

fn active_count() -> u32 {
    return atomicLoad(&queues[queue_start(wave.active_queue)]);
}

fn active_slot(i: u32) -> u32 {
    return atomicLoad(&queues[queue_start(wave.active_queue) + 1u + i]);
}

fn enqueue(queue: u32, slot: u32) {
    let start = queue_start(queue);
    let place = atomicAdd(&queues[start], 1u);
    atomicStore(&queues[start + 1u + place], slot);
}

fn add_radiance(slot: u32, value: vec3<f32>) {
    paths[slot].radiance += vec4<f32>(value, 0.0);
}

fn cast_shadow_ray(slot: u32, ray: Ray, contribution: vec3<f32>) {
    rays[wave.capacity + slot] = ray;
    paths[slot].contribution = vec4<f32>(contribution, 0.0);
    enqueue(SHADOW_QUEUE, slot);
}

fn continue_path(slot: u32, ray: Ray) {
    rays[slot] = ray;
    enqueue(1u - wave.active_queue, slot);
}
