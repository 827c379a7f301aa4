// Two-level walk of compressed wide BVHs (Ylitie, Karras, Laine 2017, section 4; layout in `compressed.rs`).
//
// The stack holds groups: all hit inner children of one node, or the untested entries of one leaf group, as
// (base, bits): bits 24..31 mark inner children by visiting order, bits 0..7 then say which slots are inner;
// without marks in 24..31 the lower bits mark leaf entries. A node adds at most one group, and the instances left of a
// top-level leaf, which lie above it, come off before it is opened: so STACK_SIZE, the depth of top level and deepest
// mesh plus two, cannot overflow.
//
// Constants from outside: STACK_SIZE, ANY_HIT (stop at the first hit), SPHERES (there are any), FILTERED
// (some placements' hits go through the alpha filter), COUNTING, FLAT (primitives name their instance), ALONE (the
// top level is one instance), and those of `gate.wgsl`.

//!include rays
//!include intersect
//!include candidates
//!include gate
//!pool nodes
//!pool prims

// `prims` begins with the leaf entries of the top level, four elements an instance: rows of the inverse 3x3 matrix, each
// with a component of the translation that comes off before it; then (root node, instance, flags, gate). From the next
// multiple of three on those of the meshes, three elements a primitive; then the records of gates, which placements name
// by their element, or by 0 when there is none.
const PLACEMENT_FILTERED = 1u;

// What a node's children answered: their inner group and their leaf group.
struct Groups {
    inner: vec2<u32>,
    leaf: vec2<u32>,
    children: u32,
}

fn byte_lanes(word: u32) -> vec4<u32> {
    return vec4<u32>(word & 0xffu, (word >> 8u) & 0xffu, (word >> 16u) & 0xffu, word >> 24u);
}

// Quantised planes of four children, each times the inverse of its lane of PLACES, which spares shifts. Signed, since that
// is the cheaper conversion on CPUs.
fn planes(word: u32) -> vec4<f32> {
    let bytes = vec4<u32>(word & 0xffu, word & 0xff00u, word & 0xff0000u, word >> 24u);
    return vec4<f32>(bitcast<vec4<i32>>(bytes));
}

const PLACES = vec4<f32>(1.0, 1.0 / 256.0, 1.0 / 65536.0, 1.0);

// Number of the highest bit of a number below 2^24: the exponent of the float. On CPUs far cheaper than firstLeadingBit.
fn highest_bit(bits: u32) -> u32 {
    return (bitcast<u32>(f32(bitcast<i32>(bits))) >> 23u) - 127u;
}

// Distances by their bits, which order floats as long as those that count are not negative: `first` is not below t_min,
// and a `last` below zero stays below. Spares the minima and maxima their care for values that are not numbers.
fn ordered(distances: vec4<f32>) -> vec4<i32> {
    return bitcast<vec4<i32>>(distances);
}

// Tests four children. `near` and `far` are their quantised planes on the side where the ray enters and leaves.
fn hit_bits(
    meta_word: u32, near_x: u32, near_y: u32, near_z: u32, far_x: u32, far_y: u32, far_z: u32,
    scale: vec3<f32>, enter: vec3<f32>, leave: vec3<f32>, t_min: f32, t_max: f32, octant4: u32,
) -> u32 {
    let scale_x = PLACES * scale.x;
    let scale_y = PLACES * scale.y;
    let scale_z = PLACES * scale.z;
    let enter_x = fma(planes(near_x), scale_x, vec4<f32>(enter.x));
    let enter_y = fma(planes(near_y), scale_y, vec4<f32>(enter.y));
    let enter_z = fma(planes(near_z), scale_z, vec4<f32>(enter.z));
    let leave_x = fma(planes(far_x), scale_x, vec4<f32>(leave.x));
    let leave_y = fma(planes(far_y), scale_y, vec4<f32>(leave.y));
    let leave_z = fma(planes(far_z), scale_z, vec4<f32>(leave.z));
    let first = max(max(ordered(enter_x), ordered(enter_y)), max(ordered(enter_z), vec4<i32>(bitcast<i32>(t_min))));
    let last = min(min(ordered(leave_x), ordered(leave_y)), min(ordered(leave_z), vec4<i32>(bitcast<i32>(t_max))));
    let is_inner = (meta_word & (meta_word << 1u)) & 0x10101010u;
    let inner_mask = (is_inner >> 4u) * 0xffu;
    let index = byte_lanes((meta_word ^ (octant4 & inner_mask)) & 0x1f1f1f1fu);
    let bits = byte_lanes((meta_word >> 5u) & 0x07070707u);
    let found = select(vec4<u32>(0u), bits << index, first <= last);
    return found.x | found.y | found.z | found.w;
}

fn visit(node: u32, ray: TraceRay, t_min: f32, t_max: f32, octant: u32) -> Groups {
    let n0 = nodes_at(node * 5u);
    let n1 = nodes_at(node * 5u + 1u);
    let n2 = nodes_at(node * 5u + 2u);
    let n3 = nodes_at(node * 5u + 3u);
    let n4 = nodes_at(node * 5u + 4u);
    let e = n0.w;
    let scale = bitcast<vec3<f32>>(vec3<u32>((e & 0xffu) << 23u, (e << 15u) & 0x7f800000u, (e << 7u) & 0x7f800000u))
        * ray.inverse;
    // Primitive tests round coordinates relative to the ray's origin a few times, these slabs as often: boxes grow by
    // twice that, in proportion to how far away they are (after Ize 2013, "Robust BVH Ray Traversal"). The part that
    // goes with the node's own extent is in the quantised planes.
    let offset = bitcast<vec3<f32>>(n0.xyz) - ray.origin;
    let reach = max(abs(offset.x), max(abs(offset.y), abs(offset.z)));
    let slack = (reach * 4.8e-7) * abs(ray.inverse);
    let origin = offset * ray.inverse;
    let enter = origin - slack;
    let leave = origin + slack;
    let negative = ray.inverse < vec3<f32>(0.0);
    let octant4 = octant * 0x01010101u;
    let lx = n2.xy;
    let ly = n2.zw;
    let lz = n3.xy;
    let hx = n3.zw;
    let hy = n4.xy;
    let hz = n4.zw;
    let near_x = select(lx, hx, negative.x);
    let near_y = select(ly, hy, negative.y);
    let near_z = select(lz, hz, negative.z);
    let far_x = select(hx, lx, negative.x);
    let far_y = select(hy, ly, negative.y);
    let far_z = select(hz, lz, negative.z);
    let bits = hit_bits(n1.z, near_x.x, near_y.x, near_z.x, far_x.x, far_y.x, far_z.x, scale, enter, leave, t_min, t_max, octant4)
        | hit_bits(n1.w, near_x.y, near_y.y, near_z.y, far_x.y, far_y.y, far_z.y, scale, enter, leave, t_min, t_max, octant4);
    var groups: Groups;
    groups.inner = vec2<u32>(n1.x, (bits & 0xff000000u) | (e >> 24u));
    groups.leaf = vec2<u32>(n1.y, bits & 0x00ffffffu);
    if COUNTING {
        let used = (n1.zw | (n1.zw >> vec2<u32>(1u)) | (n1.zw >> vec2<u32>(2u))) & vec2<u32>(0x20202020u);
        groups.children = countOneBits(used.x) + countOneBits(used.y);
    }
    return groups;
}

// Bits by which slots are visited: highest set bit first is front to back.
fn octant_of(ray: TraceRay) -> u32 {
    let positive = select(vec3<u32>(0u), vec3<u32>(1u, 2u, 4u), ray.inverse >= vec3<f32>(0.0));
    return positive.x | positive.y | positive.z;
}

// The nearest hit in (t_min, t_max), or with ANY_HIT some hit. `t_min` is not negative.
fn trace(world: Ray) -> Trace {
    var result: Trace;
    var best = Hit(world.t_max, 0.0, 0.0, 0u, 0u);
    var found = false;
    // The top entry stands apart, and is empty when its bits are 0: most are pushed and popped again while it holds them.
    var stack: array<vec2<u32>, STACK_SIZE>;
    var sp = 0u;
    var top = vec2<u32>(0u);
    // Stack height at which the current instance ends; NONE in the top level.
    var floor_sp = NONE;
    var instance = 0u;
    var filtered = false;
    var ray = prepare_ray(world.origin, world.direction);
    var octant = octant_of(ray);
    // Pretends a parent with the root as its only child; an empty scene has a root without children. An instance alone
    // is entered at once: its mesh's root tests the same box.
    var inner = vec2<u32>(0u, select(0x80000000u, 1u, ALONE));
    var leaf = vec2<u32>(0u);
    loop {
        if inner.y > 0x00ffffffu {
            let bit = highest_bit(inner.y >> 24u);
            inner.y &= ~(0x01000000u << bit);
            let slot = bit ^ octant;
            let node = inner.x + countOneBits(inner.y & 0xffu & ((1u << slot) - 1u));
            if inner.y > 0x00ffffffu {
                if top.y != 0u {
                    stack[sp] = top;
                    sp += 1u;
                }
                top = inner;
            }
            let groups = visit(node, ray, world.t_min, best.t, octant);
            inner = groups.inner;
            leaf = groups.leaf;
            if COUNTING {
                result.box_tests += groups.children;
            }
        } else {
            leaf = inner;
            inner = vec2<u32>(0u);
        }
        while leaf.y != 0u {
            let bit = leaf.y & (~leaf.y + 1u);
            leaf.y ^= bit;
            let entry = leaf.x + highest_bit(bit);
            if floor_sp == NONE {
                let r0 = bitcast<vec4<f32>>(prims_at(entry * 4u));
                let r1 = bitcast<vec4<f32>>(prims_at(entry * 4u + 1u));
                let r2 = bitcast<vec4<f32>>(prims_at(entry * 4u + 2u));
                let r3 = prims_at(entry * 4u + 3u);
                let o = world.origin - vec3<f32>(r0.w, r1.w, r2.w);
                let d = world.direction;
                let origin = vec3<f32>(dot(r0.xyz, o), dot(r1.xyz, o), dot(r2.xyz, o));
                let direction = vec3<f32>(dot(r0.xyz, d), dot(r1.xyz, d), dot(r2.xyz, d));
                let is_filtered = (r3.z & PLACEMENT_FILTERED) != 0u;
                if GATED {
                    if r3.w != 0u {
                        let approximate = APPROXIMATE && ANY_HIT && !is_filtered;
                        let verdict = ask_gate(r3.w, approximate, origin, direction, world.t_min, best.t);
                        if verdict == VERDICT_MISS {
                            continue;
                        }
                        // The filter may let the ray pass through what is there.
                        if ANY_HIT && verdict == VERDICT_HIT && !is_filtered {
                            best.instance = r3.y;
                            found = true;
                            leaf.y = 0u;
                            inner.y = 0u;
                            sp = 0u;
                            top.y = 0u;
                            continue;
                        }
                    }
                }
                // Remember what is left of the top level, and go on at the mesh's root.
                if inner.y > 0x00ffffffu {
                    if top.y != 0u {
                        stack[sp] = top;
                        sp += 1u;
                    }
                    top = inner;
                }
                if leaf.y != 0u {
                    if top.y != 0u {
                        stack[sp] = top;
                        sp += 1u;
                    }
                    top = leaf;
                }
                floor_sp = sp + select(0u, 1u, top.y != 0u);
                ray = prepare_ray(origin, direction);
                octant = octant_of(ray);
                instance = r3.y;
                filtered = is_filtered;
                inner = vec2<u32>(r3.x, 0x80000000u);
                leaf.y = 0u;
            } else {
                let p0 = prims_at(entry * 3u);
                let p1 = prims_at(entry * 3u + 1u);
                let p2 = prims_at(entry * 3u + 2u);
                let primitive = p0.w;
                if COUNTING {
                    result.primitive_tests += 1u;
                }
                if FLAT {
                    instance = p2.w;
                    filtered = FILTERED && (p1.w & PRIMITIVE_FILTERED) != 0u;
                }
                let a = bitcast<vec3<f32>>(p0.xyz);
                let b = bitcast<vec3<f32>>(p1.xyz);
                var tuv = intersect_triangle(ray, a, b, bitcast<vec3<f32>>(p2.xyz));
                if SPHERES {
                    if (p1.w & PRIMITIVE_SPHERE) != 0u {
                        tuv = intersect_sphere(ray, a, b.x, world.t_min);
                    }
                }
                var taken = is_nearer(tuv.x, world.t_min, best, found, instance, primitive)
                    && accept(filtered, world, Hit(tuv.x, tuv.y, tuv.z, instance, primitive));
                if SPHERES && FILTERED {
                    // A ray that the sphere's near wall lets through may still meet the far one.
                    if !taken && filtered && (p1.w & PRIMITIVE_SPHERE) != 0u {
                        tuv = intersect_sphere(ray, a, b.x, max(tuv.x, world.t_min));
                        taken = is_nearer(tuv.x, world.t_min, best, found, instance, primitive)
                            && accept(filtered, world, Hit(tuv.x, tuv.y, tuv.z, instance, primitive));
                    }
                }
                if taken {
                    best = Hit(tuv.x, tuv.y, tuv.z, instance, primitive);
                    found = true;
                    if ANY_HIT {
                        leaf.y = 0u;
                        inner.y = 0u;
                        sp = 0u;
                        top.y = 0u;
                        floor_sp = NONE;
                    }
                }
            }
        }
        if inner.y <= 0x00ffffffu {
            let height = sp + select(0u, 1u, top.y != 0u);
            if height == 0u {
                break;
            }
            if height == floor_sp {
                floor_sp = NONE;
                ray = prepare_ray(world.origin, world.direction);
                octant = octant_of(ray);
            }
            inner = top;
            if top.y == 0u {
                sp -= 1u;
                inner = stack[sp];
            }
            top.y = 0u;
        }
    }
    result.hit = best;
    if !found {
        result.hit.instance = NONE;
    }
    return result;
}
