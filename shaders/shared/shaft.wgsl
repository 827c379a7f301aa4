// The shaft of a ray in a box: `accel/line_space/shaft.rs`, operation by operation. What decides are comparisons of
// products of two operands, each rounded once: the division only guesses where to compare, and nothing is added to a
// product, so neither an inexact quotient nor a fused product can lead to another shaft than on the CPU.

// `ShaftGrid::to_words`.
struct ShaftGrid {
    // Lower corner of the padded box.
    corner: vec3<f32>,
    n: f32,
    // Patches per unit of length.
    scale: vec3<f32>,
    // Greatest distance of a ray's origin from the corner, on any axis.
    limit: f32,
}

struct Patch {
    face: u32,
    u: u32,
    v: u32,
}

// Bits of Chord.flags.
const SHAFT_THROUGH = 1u;
const SHAFT_TOO_FAR = 2u;
const SHAFT_STARTS_OUTSIDE = 4u;
const SHAFT_REACHES_EXIT = 8u;

// Without flags the ray meets nothing in the box.
struct Chord {
    flags: u32,
    entry: Patch,
    exit: Patch,
}

const SHAFT_TINY = 0x1p-40f;
const SHAFT_SLIGHT = 0x1p-30f;
const SHAFT_LATEST = 0x1p48f;
const SHAFT_LEAST_EXPONENT = 48u << 23u;
const SHAFT_GREATEST_EXPONENT = 206u << 23u;

fn component(v: vec3<f32>, axis: u32) -> f32 {
    return select(select(v.x, v.y, axis == 1u), v.z, axis == 2u);
}

// The patch along one axis at `position + moved`, where `moved` is about `product / speed`.
fn patch_at(n: f32, position: f32, moved: f32, product: f32, speed: f32) -> u32 {
    let last = n - 1.0;
    let guess = floor(clamp(position + moved, 0.0, last));
    let is_behind_guess = (guess - position) * speed <= product;
    let is_behind_next = ((guess + 1.0) - position) * speed <= product;
    var found = guess;
    if guess > 0.0 && !is_behind_guess {
        found = guess - 1.0;
    } else if guess < last && is_behind_next {
        found = guess + 1.0;
    }
    return u32(found);
}

// Where the line crosses the planes orthogonal to `axis` that lie `ahead` of it.
fn crossing(
    n: f32, axis: u32, upper: bool, ahead: f32, position: vec3<f32>, speed: vec3<f32>, negative: vec3<bool>,
) -> Patch {
    let along = component(speed, axis);
    let ratio = ahead / along;
    let velocity = select(speed, -speed, negative);
    let products = ahead * velocity;
    let u = select(0u, 1u, axis == 0u);
    let v = select(2u, 1u, axis == 2u);
    return Patch(
        2u * axis + select(0u, 1u, upper),
        patch_at(n, component(position, u), ratio * component(velocity, u), component(products, u), along),
        patch_at(n, component(position, v), ratio * component(velocity, v), component(products, v), along),
    );
}

fn locate_shaft(grid: ShaftGrid, origin: vec3<f32>, direction: vec3<f32>, ray_t_min: f32, ray_t_max: f32) -> Chord {
    var chord: Chord;
    let offset = origin - grid.corner;
    let scaled = direction * grid.scale;
    let distances = abs(offset);
    let lengths = abs(scaled);
    let distance = max(max(distances.x, distances.y), distances.z);
    let longest = max(max(lengths.x, lengths.y), lengths.z);
    let exponent = bitcast<u32>(longest) & 0x7f800000u;
    let is_near = distance <= grid.limit;
    if !is_near || exponent < SHAFT_LEAST_EXPONENT || exponent > SHAFT_GREATEST_EXPONENT {
        chord.flags = SHAFT_TOO_FAR;
        return chord;
    }
    let shrink = bitcast<f32>(0x7f000000u - exponent);
    let grow = bitcast<f32>(exponent);
    let n = grid.n;
    let negative = direction < vec3<f32>(0.0);
    let placed = offset * grid.scale;
    let position = select(placed, vec3<f32>(0.0), abs(placed) < vec3<f32>(SHAFT_TINY));
    let speed = max(lengths * shrink, vec3<f32>(SHAFT_SLIGHT));
    let near = select(vec3<f32>(0.0) - position, position - vec3<f32>(n), negative);
    let far = select(vec3<f32>(n) - position, position, negative);
    var enter = select(0u, 1u, near.y * speed.x > near.x * speed.y);
    enter = select(enter, 2u, near.z * component(speed, enter) > component(near, enter) * speed.z);
    var leave = select(0u, 1u, far.y * speed.x < far.x * speed.y);
    leave = select(leave, 2u, far.z * component(speed, leave) < component(far, leave) * speed.z);
    let latest = SHAFT_LATEST * shrink;
    let t_min = min(max(ray_t_min, 0.0), latest) * grow;
    let t_max = min(ray_t_max, latest) * grow;
    let near_enter = component(near, enter);
    let far_leave = component(far, leave);
    let speed_enter = component(speed, enter);
    let speed_leave = component(speed, leave);
    let misses = near_enter * speed_leave > far_leave * speed_enter;
    if misses || far_leave < t_min * speed_leave || near_enter > t_max * speed_enter {
        return chord;
    }
    let enter_negative = component(select(vec3<f32>(0.0), vec3<f32>(1.0), negative), enter) != 0.0;
    let leave_negative = component(select(vec3<f32>(0.0), vec3<f32>(1.0), negative), leave) != 0.0;
    chord.entry = crossing(n, enter, enter_negative, near_enter, position, speed, negative);
    chord.exit = crossing(n, leave, !leave_negative, far_leave, position, speed, negative);
    chord.flags = SHAFT_THROUGH
        | select(0u, SHAFT_STARTS_OUTSIDE, t_min * speed_enter <= near_enter)
        | select(0u, SHAFT_REACHES_EXIT, far_leave <= t_max * speed_leave);
    return chord;
}

// Number of the shaft between two patches on different faces when direction does not count: 15 N^4 in all.
fn symmetric_shaft(n: u32, first: Patch, second: Patch) -> u32 {
    var a = first;
    var b = second;
    if a.face > b.face {
        a = second;
        b = first;
    }
    let pair = a.face * (11u - a.face) / 2u + b.face - a.face - 1u;
    let square = n * n;
    return (pair * square + a.v * n + a.u) * square + b.v * n + b.u;
}

// The same when direction counts: 30 N^4 in all.
fn directed_shaft(n: u32, start: Patch, end: Patch) -> u32 {
    let other = end.face - select(0u, 1u, end.face > start.face);
    let first = (start.face * n + start.v) * n + start.u;
    return first * 5u * n * n + (other * n + end.v) * n + end.u;
}
