// Walk through a tree of cells: grid, octree or N-tree over the whole scene. The same walk as `trace/cells.rs`, which says
// why; in place of its recursion, rays from far away keep a stack.
//
// Constants from outside: STACK_SIZE (levels of nodes, or more), ANY_HIT (stop at the first hit), SPHERES (there are any),
// FILTERED (some instances' hits go through the alpha filter), COUNTING.

//!include rays
//!include intersect
//!include candidates
//!pool nodes
//!pool prims

// `nodes` begins with a header:
//   0: where children begin and where lists begin, in words; words of the root and of every other node
//   1: cells of the root on each axis; cells of every other node on one
//   2: lowest corner of the root; by how much cells were grown
//   4 + level, 20 + level: edges of the level's cells, and their reciprocals
// Behind it, for each 32 cells of a node: which are not empty, and the number of the first such cell's child.
const HEADER = 36u;
// In children: the other bits are the start of a list, not a node's number.
const LEAF = 0x80000000u;
// In lists: the last one.
const LAST = 0x80000000u;
// `prims` has four records for each packet that lists name.
const RECORDS = 4u;

// No plane is crossed so late.
const NEVER = 3.0e38;
// Rounding of a walk and of primitive tests for each unit of distance (`ROUNDING` in `accel/cells`).
const ROUNDING = 9.536743e-7;

// The ray in coordinates from the root's lowest corner.
struct Lattice {
    origin: vec3<f32>,
    // Zero where it is too small to move the ray.
    direction: vec3<f32>,
    inverse: vec3<f32>,
    moves: vec3<bool>,
    // Where the planes through the root's lowest corner are crossed.
    t_origin: vec3<f32>,
    dims: vec3<u32>,
    n: u32,
    // Of `nodes`: words where children and lists begin; words of the root and of other nodes.
    places: vec4<u32>,
}

struct State {
    best: Hit,
    found: bool,
    box_tests: u32,
    primitive_tests: u32,
    // Packets that were just tested: large primitives stand in many cells one after the other.
    recent: vec4<u32>,
}

fn word_at(i: u32) -> u32 {
    return nodes_at(i >> 2u)[i & 3u];
}

fn edges(level: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(nodes_at(4u + level).xyz);
}

fn inverse_edges(level: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(nodes_at(20u + level).xyz);
}

fn first_word(lattice: Lattice, node: u32) -> u32 {
    return select(lattice.places.z + (node - 1u) * lattice.places.w, 0u, node == 0u);
}

fn dims_at(lattice: Lattice, level: u32) -> vec3<u32> {
    return select(vec3<u32>(lattice.n), lattice.dims, vec3<bool>(level == 0u));
}

// The child of a cell of a node, NONE where it is empty.
fn child_of(lattice: Lattice, node_word: u32, cell: vec3<u32>, dims: vec3<u32>) -> u32 {
    let index = (cell.z * dims.y + cell.y) * dims.x + cell.x;
    let word = node_word + (index >> 5u);
    let pairs = nodes_at(HEADER + (word >> 1u));
    let marks = select(pairs.xy, pairs.zw, (word & 1u) == 1u);
    let bit = 1u << (index & 31u);
    if (marks.x & bit) == 0u {
        return NONE;
    }
    return word_at(lattice.places.x + marks.y + countOneBits(marks.x & (bit - 1u)));
}

// Tests the packets of a list; true when the ray needs no more.
fn test_list(start: u32, lattice: Lattice, world: Ray, ray: TraceRay, state: ptr<function, State>) -> bool {
    var at = lattice.places.y + start;
    loop {
        let entry = word_at(at);
        let packet = entry & ~LAST;
        if all((*state).recent != vec4<u32>(packet)) {
            (*state).recent = vec4<u32>(packet, (*state).recent.xyz);
            for (var lane = 0u; lane < RECORDS; lane += 1u) {
                let record = 3u * (packet * RECORDS + lane);
                let p0 = prims_at(record);
                if p0.w == NONE {
                    break;
                }
                if COUNTING {
                    (*state).primitive_tests += 1u;
                }
                let taken = candidate(p0, prims_at(record + 1u), prims_at(record + 2u), world, ray, (*state).best, (*state).found);
                if taken.instance != NONE {
                    (*state).best = taken;
                    (*state).found = true;
                    if ANY_HIT {
                        return true;
                    }
                }
            }
        }
        if (entry & LAST) != 0u {
            return false;
        }
        at += 1u;
    }
    return false;
}

// A node that is left for one of its children.
struct Above {
    low: vec3<u32>,
    node_word: u32,
    cell: vec3<u32>,
}

fn t_at(lattice: Lattice, level: u32, planes: vec3<u32>) -> vec3<f32> {
    let t = vec3<f32>(planes) * (edges(level) * lattice.inverse) + lattice.t_origin;
    return select(vec3<f32>(NEVER), t, lattice.moves);
}

fn walk_near(lattice: Lattice, begin: f32, world: Ray, ray: TraceRay, state: ptr<function, State>) {
    let forward = lattice.direction > vec3<f32>(0.0);
    let ahead = select(vec3<u32>(0u), vec3<u32>(1u), forward);
    // Also backwards: numbers wrap around.
    let stride = select(vec3<u32>(0xffffffffu), vec3<u32>(1u), forward);
    var above: array<Above, STACK_SIZE>;
    var level = 0u;
    var node_word = 0u;
    var low = vec3<u32>(0u);
    var dims = lattice.dims;
    // Where the ray came into the current cell.
    var t = begin;
    var cell = vec3<u32>(0u);
    var t_next = vec3<f32>(0.0);
    var entering = true;
    loop {
        if entering {
            let at = (lattice.origin + t * lattice.direction) * inverse_edges(level);
            let inside = clamp(at, vec3<f32>(0.0), vec3<f32>(2.1e9));
            cell = clamp(vec3<u32>(inside), low, low + dims - 1u);
            t_next = t_at(lattice, level, cell + ahead);
            entering = false;
        }
        if COUNTING {
            (*state).box_tests += 1u;
        }
        let child = child_of(lattice, node_word, cell - low, dims);
        if child != NONE {
            if (child & LEAF) == 0u {
                above[level] = Above(low, node_word, cell);
                level += 1u;
                node_word = first_word(lattice, child);
                low = cell * lattice.n;
                dims = vec3<u32>(lattice.n);
                entering = true;
                continue;
            }
            if test_list(child & ~LEAF, lattice, world, ray, state) {
                return;
            }
        }
        // To the next cell, up as many levels as end here.
        loop {
            let t_leave = min(t_next.x, min(t_next.y, t_next.z));
            t = t_leave;
            if !(t <= (*state).best.t && t < NEVER) {
                return;
            }
            let axis = select(select(2u, 1u, t_next.y == t_leave), 0u, t_next.x == t_leave);
            let chosen = vec3<u32>(0u, 1u, 2u) == vec3<u32>(axis);
            let next = select(cell, cell + stride, chosen);
            if all(next - low < dims) {
                cell = next;
                t_next = t_at(lattice, level, cell + ahead);
                break;
            }
            if level == 0u {
                return;
            }
            level -= 1u;
            low = above[level].low;
            node_word = above[level].node_word;
            cell = above[level].cell;
            dims = dims_at(lattice, level);
            t_next = t_at(lattice, level, cell + ahead);
        }
    }
}

// A node that a ray from far away goes through slab by slab along the axis on which it crosses most cells.
struct Slabs {
    low: vec3<u32>,
    node_word: u32,
    // Cells that are left of the current slab: from `cell` on, within first..last. Counted from `low`.
    first: vec3<u32>,
    axis: u32,
    last: vec3<u32>,
    // Slabs begun.
    slabs: u32,
    cell: vec3<u32>,
    has_cells: bool,
    begin: f32,
    end: f32,
}

// Where the ray, thickened by `margin`, is among some cells, before `limit`; nowhere when the first is larger.
fn thick_interval(
    lattice: Lattice, margin: f32, level: u32, low: vec3<u32>, dims: vec3<u32>, t_min: f32, limit: f32,
) -> vec2<f32> {
    let near = vec3<f32>(low) * edges(level) - margin;
    let far = vec3<f32>(low + dims) * edges(level) + margin;
    if any(!lattice.moves & ((lattice.origin < near) | (lattice.origin > far))) {
        return vec2<f32>(1.0, 0.0);
    }
    let a = (near - lattice.origin) * lattice.inverse;
    let b = (far - lattice.origin) * lattice.inverse;
    let first = select(vec3<f32>(t_min), min(a, b), lattice.moves);
    let last = select(vec3<f32>(limit), max(a, b), lattice.moves);
    return vec2<f32>(
        max(t_min, max(first.x, max(first.y, first.z))),
        min(limit, min(last.x, min(last.y, last.z))),
    );
}

fn slabs_of(lattice: Lattice, margin: f32, level: u32, node: u32, low: vec3<u32>, t_min: f32, limit: f32) -> Slabs {
    var slabs: Slabs;
    slabs.low = low;
    slabs.node_word = first_word(lattice, node);
    let interval = thick_interval(lattice, margin, level, low, dims_at(lattice, level), t_min, limit);
    slabs.begin = interval.x;
    slabs.end = interval.y;
    let crossed = abs(lattice.direction) * inverse_edges(level);
    slabs.axis = select(select(0u, 1u, crossed.y > crossed.x), 2u, crossed.z > max(crossed.x, crossed.y));
    return slabs;
}

fn walk_far(lattice: Lattice, margin: f32, world: Ray, ray: TraceRay, state: ptr<function, State>) {
    var stack: array<Slabs, STACK_SIZE>;
    var level = 0u;
    var node = slabs_of(lattice, margin, 0u, 0u, vec3<u32>(0u), world.t_min, (*state).best.t);
    loop {
        let dims = dims_at(lattice, level);
        let main = vec3<u32>(0u, 1u, 2u) == vec3<u32>(node.axis);
        if !node.has_cells {
            if node.begin > node.end || node.slabs == dims[node.axis] {
                if level == 0u {
                    return;
                }
                level -= 1u;
                node = stack[level];
                continue;
            }
            let backward = lattice.direction[node.axis] < 0.0;
            let number = select(node.slabs, dims[node.axis] - 1u - node.slabs, backward);
            node.slabs += 1u;
            let lowest_cell = select(node.low, node.low + number, main);
            let size = select(dims, vec3<u32>(1u), main);
            let limit = min(node.end, (*state).best.t);
            let inside = thick_interval(lattice, margin, level, lowest_cell, size, world.t_min, limit);
            if inside.x > inside.y {
                continue;
            }
            let p = lattice.origin + max(inside.x, node.begin) * lattice.direction;
            let q = lattice.origin + min(inside.y, node.end) * lattice.direction;
            let top = vec3<f32>(dims - 1u);
            let base = vec3<f32>(node.low);
            let lowest = clamp(floor((min(p, q) - margin) * inverse_edges(level)) - base, vec3<f32>(0.0), top);
            let highest = clamp(floor((max(p, q) + margin) * inverse_edges(level)) - base, vec3<f32>(0.0), top);
            node.first = select(vec3<u32>(lowest), vec3<u32>(number), main);
            node.last = select(vec3<u32>(highest), vec3<u32>(number), main);
            node.cell = node.first;
            node.has_cells = true;
        }
        let cell = node.cell;
        if cell.x < node.last.x {
            node.cell.x += 1u;
        } else if cell.y < node.last.y {
            node.cell = vec3<u32>(node.first.x, cell.y + 1u, cell.z);
        } else if cell.z < node.last.z {
            node.cell = vec3<u32>(node.first.xy, cell.z + 1u);
        } else {
            node.has_cells = false;
        }
        if COUNTING {
            (*state).box_tests += 1u;
        }
        let child = child_of(lattice, node.node_word, cell, dims);
        if child == NONE {
            continue;
        }
        if (child & LEAF) == 0u {
            stack[level] = node;
            let below = (node.low + cell) * lattice.n;
            level += 1u;
            node = slabs_of(lattice, margin, level, child, below, world.t_min, (*state).best.t);
        } else if test_list(child & ~LEAF, lattice, world, ray, state) {
            return;
        }
    }
}

// The nearest hit in (t_min, t_max), or with ANY_HIT some hit. `t_min` is not negative.
fn trace(world: Ray) -> Trace {
    let ray = prepare_ray(world.origin, world.direction);
    let places = nodes_at(0u);
    let shape = nodes_at(1u);
    let corner = bitcast<vec4<f32>>(nodes_at(2u));
    var lattice: Lattice;
    lattice.origin = world.origin - corner.xyz;
    lattice.moves = abs(world.direction) >= vec3<f32>(1e-20);
    lattice.direction = select(vec3<f32>(0.0), world.direction, lattice.moves);
    lattice.inverse = select(vec3<f32>(0.0), ray.inverse, lattice.moves);
    lattice.t_origin = -lattice.origin * lattice.inverse;
    lattice.dims = shape.xyz;
    lattice.n = shape.w;
    lattice.places = places;
    var state: State;
    state.best = Hit(world.t_max, 0.0, 0.0, 0u, 0u);
    state.recent = vec4<u32>(NONE);
    let size = vec3<f32>(lattice.dims) * edges(0u);
    let distances = max(abs(lattice.origin), abs(size - lattice.origin));
    let margin = max(distances.x, max(distances.y, distances.z)) * ROUNDING;
    if margin > corner.w {
        walk_far(lattice, margin, world, ray, &state);
    } else {
        let inside = thick_interval(lattice, 0.0, 0u, vec3<u32>(0u), lattice.dims, world.t_min, world.t_max);
        if inside.x <= inside.y {
            walk_near(lattice, inside.x, world, ray, &state);
        }
    }
    var result: Trace;
    result.hit = state.best;
    if !state.found {
        result.hit.instance = NONE;
    }
    result.box_tests = state.box_tests;
    result.primitive_tests = state.primitive_tests;
    return result;
}
