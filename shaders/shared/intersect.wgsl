// Ray against primitive.

//!include trace_ray

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
