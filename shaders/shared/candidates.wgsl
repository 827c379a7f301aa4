// Which of two hits counts.

//!include found
//!include intersect

// Whether a hit beats the best so far; of several at one distance the lowest ids count.
fn is_nearer(t: f32, t_min: f32, best: Hit, found: bool, instance: u32, primitive: u32) -> bool {
    let wins_tie = found && (instance < best.instance || (instance == best.instance && primitive < best.primitive));
    return t > t_min && (t < best.t || (t == best.t && wins_tie));
}

// The hit of a primitive of a flat structure if it beats the best so far; else its instance is NONE.
fn candidate(
    p0: vec4<u32>, p1: vec4<u32>, p2: vec4<u32>, world: Ray, ray: TraceRay, best: Hit, found: bool,
) -> Hit {
    let primitive = p0.w;
    let instance = p2.w;
    let filtered = FILTERED && (p1.w & PRIMITIVE_FILTERED) != 0u;
    let a = bitcast<vec3<f32>>(p0.xyz);
    let b = bitcast<vec3<f32>>(p1.xyz);
    var tuv: vec3<f32>;
    let is_sphere = SPHERES && (p1.w & PRIMITIVE_SPHERE) != 0u;
    if is_sphere {
        tuv = intersect_sphere(ray, a, b.x, world.t_min);
    } else {
        tuv = intersect_triangle(ray, a, b, bitcast<vec3<f32>>(p2.xyz));
    }
    var hit = Hit(tuv.x, tuv.y, tuv.z, instance, primitive);
    var taken = is_nearer(tuv.x, world.t_min, best, found, instance, primitive) && accept(filtered, world, hit);
    if SPHERES && FILTERED {
        // A ray that the sphere's near wall lets through may still meet the far one.
        if !taken && filtered && is_sphere {
            tuv = intersect_sphere(ray, a, b.x, max(tuv.x, world.t_min));
            hit = Hit(tuv.x, tuv.y, tuv.z, instance, primitive);
            taken = is_nearer(tuv.x, world.t_min, best, found, instance, primitive) && accept(filtered, world, hit);
        }
    }
    if !taken {
        hit.instance = NONE;
    }
    return hit;
}
