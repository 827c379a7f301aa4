// BUILD by layers: the class of each shaft (`accel/line_space/layered.rs`), where it is certain. Sections are held against voxels in whole
// numbers, so EMPTY is the CPU's to the last shaft; crossings are told apart by bounds.
//
// Constants from outside: those of `traverse.wgsl`.

//!include lines
//!include traverse
//!include accept_all

const CLASS_UNSURE = 4u;
// In a shaft grown by one part of so many of the box's edges (DILATION) everything is proven.
const DILATION_PARTS = 2048;
// Six times the volume between a line and a triangle's edge, and between an end of the line and the triangle, in a unit box: beyond
// this its sign is certain.
const COVER_SLACK = 1e-5;

struct ClassJob {
    count: u32,
    // Patches along an edge in this level, and in the grid's.
    n: u32,
    finest_n: u32,
    // Voxels along an axis, and slabs of a shaft: a power of two.
    resolution: u32,
    // Whether some triangle may be as wide as a patch.
    wide: u32,
}

@group(2) @binding(0) var<storage, read_write> jobs: array<ClassJob>;
@group(2) @binding(1) var<storage, read_write> grids: array<ShaftGrid>;
// The middle of each patch.
@group(2) @binding(2) var<storage, read_write> points: array<vec4<f32>>;
// The numbers of a shaft's patches, 16 bits each; then its class.
@group(2) @binding(3) var<storage, read_write> shafts: array<u32>;
// Sums over the voxels before each lattice point: of those with surface, and of those with rim. Two arrays, for 256 voxels along an
// axis fill half of what a binding may hold (WebGPU's 128 MiB).
@group(2) @binding(4) var<storage, read_write> surface: array<u32>;
@group(2) @binding(5) var<storage, read_write> rim: array<u32>;

// A shaft, by the corners of its patches in patches from the box's corner.
struct Beam {
    low_start: vec3<i32>,
    high_start: vec3<i32>,
    low_end: vec3<i32>,
    high_end: vec3<i32>,
}

var<private> job: ClassJob;
var<private> beam: Beam;
// A class: whether one triangle covers the shaft.
var<private> covered: u32;

fn patch_corner(index: u32, upper: u32) -> vec3<i32> {
    let n = job.n;
    let face = index / (n * n);
    let u = i32(index % n + upper);
    let v = i32(index / n % n + upper);
    let plane = i32(select(0u, n, (face & 1u) == 1u));
    let axis = face >> 1u;
    return select(select(vec3<i32>(u, v, plane), vec3<i32>(u, plane, v), axis == 1u), vec3<i32>(plane, u, v), axis == 0u);
}

fn beam_between(start: u32, end: u32) -> Beam {
    return Beam(patch_corner(start, 0u), patch_corner(start, 1u), patch_corner(end, 0u), patch_corner(end, 1u));
}

// A corner of the section after `slab` slabs, in voxels times DILATION_PARTS times N.
fn section(start: vec3<i32>, end: vec3<i32>, slab: u32) -> vec3<i32> {
    return (start * i32(job.resolution) + (end - start) * i32(slab)) * DILATION_PARTS;
}

// The voxel of such a place; the first one for all before it.
fn voxel(place: vec3<i32>) -> vec3<u32> {
    let parts = vec3<i32>(DILATION_PARTS * i32(job.n));
    let inside = max(place, vec3<i32>(0));
    // A quotient of floats may be one off.
    var guess = vec3<i32>(vec3<f32>(inside) * (1.0 / f32(parts.x)));
    guess -= select(vec3<i32>(0), vec3<i32>(1), guess * parts > inside);
    guess += select(vec3<i32>(0), vec3<i32>(1), (guess + 1) * parts <= inside);
    return vec3<u32>(guess);
}

// First voxels of the slabs from `first` to `end`, and those behind the last.
struct Voxels {
    least: vec3<u32>,
    to: vec3<u32>,
    is_any: bool,
}

fn voxels_of(first: u32, end: u32) -> Voxels {
    let growth = vec3<i32>(i32(job.n * job.resolution));
    let low = min(section(beam.low_start, beam.low_end, first), section(beam.low_start, beam.low_end, end)) - growth;
    let high = max(section(beam.high_start, beam.high_end, first), section(beam.high_start, beam.high_end, end)) + growth;
    let least = voxel(low);
    let to = min(voxel(high) + 1u, vec3<u32>(job.resolution));
    return Voxels(least, to, all(least < to));
}

fn place_of(x: u32, y: u32, z: u32) -> u32 {
    let row = job.resolution + 1u;
    return (z * row + y) * row + x;
}

fn sum_at(of_rim: bool, place: u32) -> u32 {
    if of_rim {
        return rim[place];
    }
    return surface[place];
}

// Whether the slabs from `first` to `end` hold surface, or rim.
fn holds(of_rim: bool, first: u32, end: u32) -> bool {
    let cells = voxels_of(first, end);
    if !cells.is_any {
        return false;
    }
    let least = cells.least;
    let to = cells.to;
    let behind = sum_at(of_rim, place_of(to.x, to.y, to.z)) - sum_at(of_rim, place_of(least.x, to.y, to.z))
        - sum_at(of_rim, place_of(to.x, least.y, to.z)) + sum_at(of_rim, place_of(least.x, least.y, to.z));
    let before = sum_at(of_rim, place_of(to.x, to.y, least.z)) - sum_at(of_rim, place_of(least.x, to.y, least.z))
        - sum_at(of_rim, place_of(to.x, least.y, least.z)) + sum_at(of_rim, place_of(least.x, least.y, least.z));
    return behind != before;
}

fn holds_surface(first: u32, end: u32) -> bool {
    return holds(false, first, end);
}

fn holds_rim(first: u32, end: u32) -> bool {
    return holds(true, first, end);
}

// Whether a slab holds surface. What many slabs together do not hold, none does: free runs are left out at once.
fn any_slab_with_surface() -> bool {
    var first = 0u;
    var size = job.resolution;
    while first < job.resolution {
        if holds_surface(first, first + size) {
            if size == 1u {
                return true;
            }
            size = size >> 1u;
        } else {
            first += size;
            size = first & (~first + 1u);
        }
    }
    return false;
}

fn any_slab_with_rim(first: u32, end: u32) -> bool {
    if !holds_rim(first, end) {
        return false;
    }
    for (var slab = first; slab < end; slab++) {
        if holds_rim(slab, slab + 1u) {
            return true;
        }
    }
    return false;
}

fn grown_corner(low: vec3<i32>, high: vec3<i32>, corner: u32) -> vec3<f32> {
    let is_high = vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
    let growth = 1.0 / f32(DILATION_PARTS);
    let place = vec3<f32>(select(low, high, is_high)) / f32(job.n);
    return place + select(vec3<f32>(-growth), vec3<f32>(growth), is_high);
}

// Whether the lines between all corners of the grown patches cross the triangle.
fn cover(v0: vec3<f32>, v1: vec3<f32>, v2: vec3<f32>) {
    if job.wide == 0u || covered == CLASS_OPAQUE {
        return;
    }
    let corner = grids[0].corner;
    let scale = grids[0].scale / f32(job.finest_n);
    let a = (v0 - corner) * scale;
    let b = (v1 - corner) * scale;
    let c = (v2 - corner) * scale;
    let normal = cross(b - a, c - a);
    var is_certain = true;
    for (var line = 0u; line < 64u; line++) {
        let p = grown_corner(beam.low_start, beam.high_start, line & 7u);
        let q = grown_corner(beam.low_end, beam.high_end, line >> 3u);
        let along = q - p;
        let volumes = vec3<f32>(
            dot(along, cross(a - p, b - p)),
            dot(along, cross(b - p, c - p)),
            dot(along, cross(c - p, a - p)),
        );
        let low = min(volumes.x, min(volumes.y, volumes.z));
        let high = max(volumes.x, max(volumes.y, volumes.z));
        let sides = vec2<f32>(dot(normal, p - a), dot(normal, q - a));
        let is_one_side = min(sides.x, sides.y) > COVER_SLACK || max(sides.x, sides.y) < -COVER_SLACK;
        if (low < -COVER_SLACK && high > COVER_SLACK) || is_one_side {
            return;
        }
        let is_inside = low > COVER_SLACK || high < -COVER_SLACK;
        let is_through = min(sides.x, sides.y) < -COVER_SLACK && max(sides.x, sides.y) > COVER_SLACK;
        is_certain = is_certain && is_inside && is_through;
    }
    covered = select(CLASS_UNSURE, CLASS_OPAQUE, is_certain);
}

fn sort_crossings() {
    for (var i = 1u; i < crossing_count; i++) {
        let moved = crossings[i];
        var at = i;
        while at > 0u && crossings[at - 1u].lower > moved.lower {
            crossings[at] = crossings[at - 1u];
            at -= 1u;
        }
        crossings[at] = moved;
    }
}

// Whether the middle line crosses the surface an odd number of times between two sections without surface, with no rim between
// them: OPAQUE, MIXED or unsure.
fn class_by_parity() -> u32 {
    let slabs = f32(job.resolution);
    let last = job.resolution - 1u;
    var at = 0u;
    while at < crossing_count {
        // The slab with surface in which the crossing lies; rounding may have put it into the next one.
        var slab = min(u32(crossings[at].lower * slabs), last);
        if slab != min(u32(crossings[at].upper * slabs), last) {
            return CLASS_UNSURE;
        }
        if !holds_surface(slab, slab + 1u) {
            let before = max(slab, 1u) - 1u;
            let behind = min(slab + 1u, last);
            if holds_surface(before, before + 1u) {
                slab = before;
            } else if holds_surface(behind, behind + 1u) {
                slab = behind;
            } else {
                return CLASS_MIXED;
            }
        }
        var first = slab;
        var end = slab + 1u;
        while first > 0u && holds_surface(first - 1u, first) {
            first -= 1u;
        }
        while end < job.resolution && holds_surface(end, end + 1u) {
            end += 1u;
        }
        let behind = (f32(end) + 0.5) / slabs;
        var inside = 0u;
        while at + inside < crossing_count && crossings[at + inside].upper < behind {
            inside += 1u;
        }
        if at + inside < crossing_count && crossings[at + inside].lower < behind {
            return CLASS_UNSURE;
        }
        inside = max(inside, 1u);
        if (inside & 1u) == 1u && !any_slab_with_rim(first, end) {
            return CLASS_OPAQUE;
        }
        at += inside;
    }
    return CLASS_MIXED;
}

fn classify(start: u32, end: u32) -> u32 {
    beam = beam_between(start, end);
    if !any_slab_with_surface() {
        return CLASS_EMPTY;
    }
    covered = CLASS_MIXED;
    begin_crossings();
    let origin = points[start].xyz;
    let hit = trace(Ray(origin, 0.0, points[end].xyz - origin, LINE_END)).hit;
    if is_uncertain || hit.instance != NONE {
        return CLASS_UNSURE;
    }
    sort_crossings();
    let class_ = class_by_parity();
    if class_ != CLASS_MIXED {
        return class_;
    }
    return covered;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    job = jobs[0];
    if id.x >= job.count {
        return;
    }
    let patches = shafts[id.x];
    shafts[id.x] = classify(patches & 0xffffu, patches >> 16u);
}
