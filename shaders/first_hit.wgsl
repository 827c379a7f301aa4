// First-hit layers through pixel centres, traced and shaded in one go; twin of integrate/aov.rs.

//!include traverse
//!include accept_all
//!include shading
//!include camera

struct FirstHit {
    position: vec3<f32>,
    depth: f32,
    geometric_normal: vec3<f32>,
    instance: u32,
    shading_normal: vec3<f32>,
    primitive: u32,
    albedo: vec3<f32>,
    material: u32,
    box_tests: u32,
    primitive_tests: u32,
    _pad0: u32,
    _pad1: u32,
}

@group(2) @binding(0) var<storage, read_write> first_hits: array<FirstHit>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let slot = id.x;
    if slot >= wave.pixels {
        return;
    }
    let sample = path_sample(slot);
    let ray = camera_ray(sample.x, sample.y, 0.5, 0.5);
    begin_filter(slot);
    let traced = trace(ray);
    var out: FirstHit;
    out.depth = infinity();
    out.instance = traced.hit.instance;
    out.primitive = NONE;
    out.material = NONE;
    out.box_tests = traced.box_tests;
    out.primitive_tests = traced.primitive_tests;
    if traced.hit.instance != NONE {
        let surface = shade_point(hit_point(ray, traced.hit), -ray.direction);
        out.depth = traced.hit.t * dot(ray.direction, scene.camera.forward);
        out.position = surface.position;
        out.geometric_normal = surface.geometric_normal;
        out.shading_normal = surface.normal;
        out.albedo = surface.base_color;
        out.primitive = traced.hit.primitive;
        out.material = surface.material;
    }
    first_hits[slot] = out;
}
