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

const NONE = 0xffffffffu;
