// A ray as primitive tests see it.

// A ray in the space of what it is tested against, with what the tests need of it.
struct TraceRay {
    origin: vec3<f32>,
    direction: vec3<f32>,
    // 1 / direction, finite.
    inverse: vec3<f32>,
    // Woop's shear: x and y shear, z scale, in the order that `permute` gives.
    shear: vec3<f32>,
    // Axis along which the direction is longest.
    major: u32,
}

fn prepare_ray(origin: vec3<f32>, direction: vec3<f32>) -> TraceRay {
    var ray: TraceRay;
    ray.origin = origin;
    ray.direction = direction;
    let magnitude = abs(direction);
    // Slabs tolerate a tiny component in place of zero: it moves the ray by less than a millionth of a millionth.
    let tiny = vec3<f32>(1e-20);
    let signed_tiny = select(tiny, -tiny, direction < vec3<f32>(0.0));
    ray.inverse = 1.0 / select(direction, signed_tiny, magnitude < tiny);
    ray.major = select(select(0u, 1u, magnitude.y > magnitude.x), 2u, magnitude.z > max(magnitude.x, magnitude.y));
    let d = permute(direction, ray.major);
    ray.shear = vec3<f32>(d.x, d.y, 1.0) / d.z;
    return ray;
}

// Cyclic rotation that puts the major axis last.
fn permute(v: vec3<f32>, major: u32) -> vec3<f32> {
    return select(select(v.yzx, v.zxy, major == 1u), v, major == 2u);
}

// a * b - c * d without cancellation where fma is fused (Kahan), so that the two triangles at an edge see the same
// sign whatever the compiler contracts.
fn difference_of_products(a: f32, b: f32, c: f32, d: f32) -> f32 {
    let cd = c * d;
    let error = fma(-c, d, cd);
    return fma(a, b, -cd) + error;
}
