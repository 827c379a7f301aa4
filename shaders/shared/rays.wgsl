// Rays and hits as they lie in buffers, and the control block of a wave.

struct Ray {
    origin: vec3<f32>,
    t_min: f32,
    direction: vec3<f32>,
    t_max: f32,
}

// `instance` is NONE on a miss.
struct Hit {
    t: f32,
    u: f32,
    v: f32,
    instance: u32,
    primitive: u32,
}

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

// A path in flight.
struct Path {
    state: PathState,
    // What it has gathered.
    radiance: vec4<f32>,
    // What its shadow ray adds unless something stands in the way.
    contribution: vec4<f32>,
}

const NONE = 0xffffffffu;
