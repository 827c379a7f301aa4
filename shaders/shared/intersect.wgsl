// Ray against primitive.

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

// Watertight ray-triangle intersection (Woop, Benthin, Wald 2013). Answers (t, u, v), t negative on a miss.
fn intersect_triangle(ray: TraceRay, v0: vec3<f32>, v1: vec3<f32>, v2: vec3<f32>) -> vec3<f32> {
    let a = permute(v0 - ray.origin, ray.major);
    let b = permute(v1 - ray.origin, ray.major);
    let c = permute(v2 - ray.origin, ray.major);
    let ax = a.x - ray.shear.x * a.z;
    let ay = a.y - ray.shear.y * a.z;
    let bx = b.x - ray.shear.x * b.z;
    let by = b.y - ray.shear.y * b.z;
    let cx = c.x - ray.shear.x * c.z;
    let cy = c.y - ray.shear.y * c.z;
    let e0 = difference_of_products(cx, by, cy, bx);
    let e1 = difference_of_products(ax, cy, ay, cx);
    let e2 = difference_of_products(bx, ay, by, ax);
    let det = e0 + e1 + e2;
    let negative = min(e0, min(e1, e2)) < 0.0;
    let positive = max(e0, max(e1, e2)) > 0.0;
    let distance = ray.shear.z * (e0 * a.z + e1 * b.z + e2 * c.z);
    let reciprocal = 1.0 / det;
    if (negative && positive) || det == 0.0 {
        return vec3<f32>(-1.0, 0.0, 0.0);
    }
    return vec3<f32>(distance * reciprocal, e1 * reciprocal, e2 * reciprocal);
}

// Ray-sphere intersection that keeps its precision for small and distant spheres (Haines, Günther, Akenine-Möller,
// "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems 2019). Answers (t, 0, 0) with the first t
// beyond t_min, negative on a miss.
fn intersect_sphere(ray: TraceRay, center: vec3<f32>, radius: f32, t_min: f32) -> vec3<f32> {
    let f = ray.origin - center;
    let a = dot(ray.direction, ray.direction);
    let b = -dot(f, ray.direction);
    let closest = f + (b / a) * ray.direction;
    let discriminant = radius * radius - dot(closest, closest);
    let root = sqrt(max(a * discriminant, 0.0));
    let q = b + select(root, -root, b < 0.0);
    let c = dot(f, f) - radius * radius;
    let t0 = c / q;
    let t1 = q / a;
    let near = min(t0, t1);
    let t = select(max(t0, t1), near, near > t_min);
    return vec3<f32>(select(t, -1.0, discriminant < 0.0), 0.0, 0.0);
}
