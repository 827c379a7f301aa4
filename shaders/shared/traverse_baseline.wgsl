// The benchmark's base: a plain binary BVH, one 32-byte node per box, a private stack of node numbers, near child
// first. Two levels and the same primitive tests as `traverse.wgsl`, which it stands in for; no gates.

//!include rays
//!include intersect
//!pool nodes
//!pool prims

struct Trace {
    hit: Hit,
    box_tests: u32,
    primitive_tests: u32,
}

// Distance at which the ray enters the node's box, infinite on a miss.
fn enter_box(lower: vec3<f32>, upper: vec3<f32>, ray: TraceRay, t_min: f32, t_max: f32) -> f32 {
    let a = (lower - ray.origin) * ray.inverse;
    let b = (upper - ray.origin) * ray.inverse;
    let near = min(a, b);
    let far = max(a, b);
    let enter = max(max(near.x, near.y), max(near.z, t_min));
    let leave = min(min(far.x, far.y), min(far.z, t_max)) * 1.0000005;
    return select(3.4e38, enter, enter <= leave);
}

fn trace(world: Ray) -> Trace {
    var result: Trace;
    var best = Hit(world.t_max, 0.0, 0.0, 0u, 0u);
    var found = false;
    var stack: array<u32, STACK_SIZE>;
    var sp = 0u;
    var floor_sp = NONE;
    var instance = 0u;
    var ray = prepare_ray(world.origin, world.direction);
    var node = 0u;
    loop {
        let lower = nodes_at(node * 2u);
        let upper = nodes_at(node * 2u + 1u);
        var next = NONE;
        if upper.w == 0u {
            let left = node + 1u;
            let right = lower.w;
            let l0 = bitcast<vec3<f32>>(nodes_at(left * 2u).xyz);
            let l1 = bitcast<vec3<f32>>(nodes_at(left * 2u + 1u).xyz);
            let r0 = bitcast<vec3<f32>>(nodes_at(right * 2u).xyz);
            let r1 = bitcast<vec3<f32>>(nodes_at(right * 2u + 1u).xyz);
            let t_left = enter_box(l0, l1, ray, world.t_min, best.t);
            let t_right = enter_box(r0, r1, ray, world.t_min, best.t);
            let swap = t_right < t_left;
            let near = select(left, right, swap);
            let far = select(right, left, swap);
            if min(t_left, t_right) < 3.4e38 {
                next = near;
            }
            if max(t_left, t_right) < 3.4e38 {
                stack[sp] = far;
                sp += 1u;
            }
        } else {
            for (var i = 0u; i < upper.w; i++) {
                let entry = lower.w + i;
                if floor_sp == NONE {
                    // Leaves of this top level hold one instance each.
                    floor_sp = sp;
                    let r0 = bitcast<vec4<f32>>(prims_at(entry * 4u));
                    let r1 = bitcast<vec4<f32>>(prims_at(entry * 4u + 1u));
                    let r2 = bitcast<vec4<f32>>(prims_at(entry * 4u + 2u));
                    let r3 = prims_at(entry * 4u + 3u);
                    let o = world.origin - vec3<f32>(r0.w, r1.w, r2.w);
                    let d = world.direction;
                    ray = prepare_ray(
                        vec3<f32>(dot(r0.xyz, o), dot(r1.xyz, o), dot(r2.xyz, o)),
                        vec3<f32>(dot(r0.xyz, d), dot(r1.xyz, d), dot(r2.xyz, d)),
                    );
                    instance = r3.y;
                    next = r3.x;
                } else {
                    let p0 = prims_at(entry * 3u);
                    let p1 = prims_at(entry * 3u + 1u);
                    let p2 = prims_at(entry * 3u + 2u);
                    let primitive = p0.w;
                    let tuv = intersect_triangle(ray, bitcast<vec3<f32>>(p0.xyz), bitcast<vec3<f32>>(p1.xyz), bitcast<vec3<f32>>(p2.xyz));
                    let nearer = tuv.x < best.t || (tuv.x == best.t && found
                        && (instance < best.instance || (instance == best.instance && primitive < best.primitive)));
                    if tuv.x > world.t_min && nearer {
                        best = Hit(tuv.x, tuv.y, tuv.z, instance, primitive);
                        found = true;
                    }
                }
            }
        }
        if ANY_HIT && found {
            break;
        }
        if next != NONE {
            node = next;
        } else {
            if sp == floor_sp {
                floor_sp = NONE;
                ray = prepare_ray(world.origin, world.direction);
            }
            if sp == 0u {
                break;
            }
            sp -= 1u;
            node = stack[sp];
        }
    }
    result.hit = best;
    if !found {
        result.hit.instance = NONE;
    }
    return result;
}
