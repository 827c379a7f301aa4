// BUILD: which cells of a box each triangle meets (`accel/overlap.rs`), by separating axes (Akenine-Möller 2001). Cells that are met for
// certain are marked; of those that rounding may decide, the pairs of cell and triangle are listed for the CPU.
//
// All is counted in cells. Corners are moved here by rounding, by less than `slack`: what holds for cells that are smaller or
// larger by as much holds for the triangle itself.

struct VoxelJob {
    origin: vec3<f32>,
    slack: f32,
    // Cells per unit of length.
    scale: vec3<f32>,
    resolution: u32,
    // By how much cells grow before they are tested.
    growth: vec3<f32>,
    count: u32,
    // Whether triangles are edges: flat, so that nothing can pass them by.
    edges: u32,
    _pad0: u32,
    _pad1: u32,
    _pad2: u32,
}

@group(2) @binding(0) var<storage, read_write> jobs: array<VoxelJob>;
// Three corners each.
@group(2) @binding(1) var<storage, read_write> corners: array<f32>;
@group(2) @binding(2) var<storage, read_write> cells: array<atomic<u32>>;
// How many pairs there are, also where there was no room for them; then cell and triangle of each.
@group(2) @binding(3) var<storage, read_write> unsure: array<atomic<u32>>;

const MET = 1u;
const MISSED = 0u;
const UNSURE = 2u;

struct Triangle {
    corners: array<vec3<f32>, 3>,
    low: vec3<f32>,
    high: vec3<f32>,
    normal: vec3<f32>,
    // What rounding may do to a distance along the normal, for a corner one cell away.
    flatness: f32,
}

fn corner_at(place: u32) -> vec3<f32> {
    return vec3<f32>(corners[place], corners[place + 1u], corners[place + 2u]);
}

// The extent of a triangle along an axis of a projection, against half a box's: x where it is left out, y where it is inside
// for certain.
fn along(axis: vec2<f32>, p: vec2<f32>, q: vec2<f32>, half_out: vec2<f32>, half_in: vec2<f32>) -> vec2<bool> {
    let at_p = dot(axis, p);
    let at_q = dot(axis, q);
    let low = min(at_p, at_q);
    let high = max(at_p, at_q);
    let out = dot(abs(axis), half_out);
    let inside = dot(abs(axis), half_in);
    return vec2<bool>(low > out || high < -out, low <= inside && high >= -inside);
}

// A box around `center`.
fn meets(triangle: Triangle, center: vec3<f32>, half_out: vec3<f32>, half_in: vec3<f32>, is_edge: bool) -> u32 {
    let low = triangle.low - center;
    let high = triangle.high - center;
    if any(low > half_out) || any(high < -half_out) {
        return MISSED;
    }
    var is_met = all(low <= half_in) && all(high >= -half_in);
    for (var i = 0u; i < 3u; i++) {
        let p = triangle.corners[i] - center;
        let side = triangle.corners[(i + 1u) % 3u] - triangle.corners[i];
        let q = triangle.corners[(i + 2u) % 3u] - center;
        let z = along(vec2<f32>(-side.y, side.x), p.xy, q.xy, half_out.xy, half_in.xy);
        let x = along(vec2<f32>(-side.z, side.y), p.yz, q.yz, half_out.yz, half_in.yz);
        let y = along(vec2<f32>(-side.x, side.z), p.zx, q.zx, half_out.zx, half_in.zx);
        if x.x || y.x || z.x {
            return MISSED;
        }
        is_met = is_met && x.y && y.y && z.y;
    }
    if !is_edge {
        let offset = triangle.corners[0] - center;
        let distance = abs(dot(triangle.normal, offset));
        let farthest = max(abs(offset.x), max(abs(offset.y), abs(offset.z)));
        let error = triangle.flatness * (1.0 + farthest);
        if distance > dot(abs(triangle.normal), half_out) + error {
            return MISSED;
        }
        is_met = is_met && distance <= dot(abs(triangle.normal), half_in) - error;
    }
    return select(UNSURE, MET, is_met);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let job = jobs[0];
    if id.x >= job.count {
        return;
    }
    let a = (corner_at(9u * id.x) - job.origin) * job.scale;
    let b = (corner_at(9u * id.x + 3u) - job.origin) * job.scale;
    let c = (corner_at(9u * id.x + 6u) - job.origin) * job.scale;
    // From a whole number of cells on, so that no digits are lost that are left.
    let base = floor(min(a, min(b, c)));
    var triangle: Triangle;
    triangle.corners = array<vec3<f32>, 3>(a - base, b - base, c - base);
    triangle.low = min(a, min(b, c)) - base;
    triangle.high = max(a, max(b, c)) - base;
    let first_side = triangle.corners[1] - triangle.corners[0];
    let second_side = triangle.corners[2] - triangle.corners[0];
    triangle.normal = cross(first_side, second_side);
    triangle.flatness = 3e-6 * max(dot(first_side, first_side), dot(second_side, second_side));
    let grown = job.growth + job.slack;
    let last = vec3<f32>(f32(job.resolution - 1u));
    let least = vec3<i32>(clamp(floor(base + triangle.low - grown), vec3<f32>(0.0), last));
    let to = vec3<i32>(clamp(floor(base + triangle.high + grown), vec3<f32>(-1.0), last));
    let half_out = 0.5 + grown;
    let half_in = 0.5 + job.growth - job.slack;
    let resolution = i32(job.resolution);
    for (var z = least.z; z <= to.z; z++) {
        for (var y = least.y; y <= to.y; y++) {
            for (var x = least.x; x <= to.x; x++) {
                let center = vec3<f32>(vec3<i32>(x, y, z)) - base + 0.5;
                let outcome = meets(triangle, center, half_out, half_in, job.edges != 0u);
                if outcome == MISSED {
                    continue;
                }
                let cell = u32((z * resolution + y) * resolution + x);
                let bit = 1u << (cell & 31u);
                if (atomicLoad(&cells[cell >> 5u]) & bit) != 0u {
                    continue;
                }
                if outcome == MET {
                    atomicOr(&cells[cell >> 5u], bit);
                    continue;
                }
                let place = 1u + 2u * atomicAdd(&unsure[0], 1u);
                if place + 1u < arrayLength(&unsure) {
                    atomicStore(&unsure[place], cell);
                    atomicStore(&unsure[place + 1u], id.x);
                }
            }
        }
    }
}
