// Stands in for `intersect.wgsl` where the outcome must be that of another device too: it answers only what no rounding
// can change, and says so where it cannot. `device/gpu/build` asks the CPU about the rest.
//
// With u = 2^-24, half an ulp of 1, `reach` the greatest coordinate of a vertex relative to the ray's origin, and `width` the greatest
// after shearing: WGSL divides to 5 u, so the sheared coordinates of two devices differ by at most 12 u reach, and an edge
// function, four of them in two products, by 64 u reach width. The constants below are half as much again.

//!include trace_ray

const TESTED_MISS = 0u;
const TESTED_HIT = 1u;
const TESTED_UNSURE = 2u;

const EDGE_SLACK = 6e-6;
const DEPTH_SLACK = 2e-6;
// Hits nearer to an edge, as a part of the triangle's area, are not certain: barycentric coordinates are compared with 1e-6.
const EDGE_MARGIN = 4e-6;

// The last test of this thread: of a hit, and of what may be one, the parameters between which it lies; and the triangle.
struct Tested {
    outcome: u32,
    lower: f32,
    upper: f32,
    a: vec3<f32>,
    b: vec3<f32>,
    c: vec3<f32>,
}

var<private> tested: Tested;

fn greatest(v: vec3<f32>) -> f32 {
    let magnitude = abs(v);
    return max(magnitude.x, max(magnitude.y, magnitude.z));
}

// Answers (the upper bound of t, 0, 0) for a certain hit, else a negative t.
fn intersect_triangle(ray: TraceRay, v0: vec3<f32>, v1: vec3<f32>, v2: vec3<f32>) -> vec3<f32> {
    let a = permute(v0 - ray.origin, ray.major);
    let b = permute(v1 - ray.origin, ray.major);
    let c = permute(v2 - ray.origin, ray.major);
    // A coordinate of the three vertices each.
    let z = vec3<f32>(a.z, b.z, c.z);
    let x = vec3<f32>(a.x, b.x, c.x) - ray.shear.x * z;
    let y = vec3<f32>(a.y, b.y, c.y) - ray.shear.y * z;
    let edges = vec3<f32>(
        difference_of_products(x.z, y.y, y.z, x.y),
        difference_of_products(x.x, y.z, y.x, x.z),
        difference_of_products(x.y, y.x, y.y, x.x),
    );
    let reach = max(greatest(a), max(greatest(b), greatest(c)));
    let slack = EDGE_SLACK * reach * max(greatest(x), greatest(y));
    let low = min(edges.x, min(edges.y, edges.z));
    let high = max(edges.x, max(edges.y, edges.z));
    tested.outcome = TESTED_MISS;
    if low < -slack && high > slack {
        return vec3<f32>(-1.0, 0.0, 0.0);
    }
    tested.a = v0;
    tested.b = v1;
    tested.c = v2;
    let depth_slack = DEPTH_SLACK * greatest(z) * abs(ray.shear.z);
    let determinant = edges.x + edges.y + edges.z;
    let margin = 2.0 * slack + EDGE_MARGIN * abs(determinant);
    if low > margin || high < -margin {
        let t = ray.shear.z * (dot(edges, z) / determinant);
        let spread = max(z.x, max(z.y, z.z)) - min(z.x, min(z.y, z.z));
        let error = depth_slack + abs(ray.shear.z) * (6.0 * slack * spread / abs(determinant));
        tested.outcome = TESTED_HIT;
        tested.lower = t - error;
        tested.upper = t + error;
        return vec3<f32>(tested.upper, 0.0, 0.0);
    }
    let depths = ray.shear.z * z;
    tested.outcome = TESTED_UNSURE;
    tested.lower = min(depths.x, min(depths.y, depths.z)) - depth_slack;
    tested.upper = max(depths.x, max(depths.y, depths.z)) + depth_slack;
    return vec3<f32>(-1.0, 0.0, 0.0);
}

// Of spheres nothing is certain.
fn intersect_sphere(ray: TraceRay, center: vec3<f32>, radius: f32, t_min: f32) -> vec3<f32> {
    tested.outcome = TESTED_UNSURE;
    tested.lower = t_min;
    tested.upper = 3e38;
    return vec3<f32>(-1.0, 0.0, 0.0);
}
