// The gate in front of a mesh: what its Line Space says of a ray. Twin of `accel/line_space/gate.rs`; the records are
// made in `device/gpu/gates.rs`.
//
// Constants from outside: GATED (some mesh has a Line Space), APPROXIMATE (occlusion rays take for true what is not
// proven).

//!include shaft

// A record in `prims`: the grid (two elements), kind, whether it is proven, a number, 0; where the parts of the payload
// begin, relative to the record; then these. The number is that of the levels below the coarsest, or of bits.
const GATE_CLASS_TREE = 0u;
const GATE_CLASS_TABLE = 1u;
const GATE_SYMMETRIC_BITS = 2u;
const GATE_DIRECTED_BITS = 3u;
const GATE_COVERAGE = 4u;

const CLASS_EMPTY = 0u;
const CLASS_OPAQUE = 1u;
const CLASS_MIXED = 2u;
// In a tree: undecided, and the next level knows more. Of a shaft: nothing is proven.
const CLASS_SPLIT = 3u;
const CLASS_NONE = 3u;

const VERDICT_UNKNOWN = 0u;
const VERDICT_MISS = 1u;
const VERDICT_HIT = 2u;

// What this thread's rays were told: `GateCounters`, without those of surface shafts.
struct GateCounts {
    full_chord: vec3<u32>,
    ends_inside: vec3<u32>,
    starts_inside: u32,
    approximated: u32,
    beside: u32,
    too_far: u32,
}

var<private> gate_counts: GateCounts;

fn lane(v: vec4<u32>, i: u32) -> u32 {
    return select(select(v.x, v.y, i == 1u), select(v.z, v.w, i == 3u), i >= 2u);
}

// Word `i` of an array that begins at an element of `prims`.
fn gate_word(start: u32, i: u32) -> u32 {
    return lane(prims_at(start + (i >> 2u)), i & 3u);
}

fn splits(word: u32) -> u32 {
    return word & (word >> 1u) & 0x55555555u;
}

fn coarser(patch_: Patch, levels: u32) -> Patch {
    return Patch(patch_.face, patch_.u >> levels, patch_.v >> levels);
}

// `ClassTree::class`.
fn class_in_tree(record: u32, parts: vec4<u32>, levels: u32, n: u32, entry: Patch, exit: Patch) -> u32 {
    var a = entry;
    var b = exit;
    if a.face > b.face {
        a = exit;
        b = entry;
    }
    var shift = levels;
    let index = symmetric_shaft(n >> levels, coarser(a, shift), coarser(b, shift));
    var block = index >> 4u;
    var slot = index & 15u;
    for (var level = 0u; level < levels; level++) {
        let group = prims_at(record + lane(parts, level) + block / 3u);
        let place = block % 3u;
        let word = lane(group, place + 1u);
        let code = (word >> (2u * slot)) & 3u;
        if code != CLASS_SPLIT {
            return code;
        }
        let before = select(0u, countOneBits(splits(group.y)), place > 0u)
            + select(0u, countOneBits(splits(group.z)), place > 1u);
        block = group.x + before + countOneBits(splits(word) & ((1u << (2u * slot)) - 1u));
        shift -= 1u;
        slot = ((a.v >> shift) & 1u) << 3u | ((a.u >> shift) & 1u) << 2u
            | ((b.v >> shift) & 1u) << 1u | ((b.u >> shift) & 1u);
    }
    return (gate_word(record + lane(parts, levels), block) >> (2u * slot)) & 3u;
}

// A number from 0 to 1, below 1, that follows from the ray alone.
fn chance(origin: vec3<f32>, direction: vec3<f32>) -> f32 {
    var values = array<u32, 6>(
        bitcast<u32>(origin.x), bitcast<u32>(origin.y), bitcast<u32>(origin.z),
        bitcast<u32>(direction.x), bitcast<u32>(direction.y), bitcast<u32>(direction.z),
    );
    var hash = 0u;
    for (var i = 0u; i < 6u; i++) {
        hash = (hash ^ values[i]) * 0x85ebca6bu;
        hash ^= hash >> 13u;
        hash *= 0xc2b2ae35u;
        hash ^= hash >> 16u;
    }
    return f32(hash >> 8u) / 16777216.0;
}

fn verdict_if(is_blocked: bool) -> u32 {
    return select(VERDICT_MISS, VERDICT_HIT, is_blocked);
}

// What is certain, or with `approximate` taken for true, of a ray in the mesh's space.
fn ask_gate(
    record: u32, approximate: bool, origin: vec3<f32>, direction: vec3<f32>, t_min: f32, t_max: f32,
) -> u32 {
    let box = bitcast<vec4<f32>>(prims_at(record));
    let more = bitcast<vec4<f32>>(prims_at(record + 1u));
    let kind = prims_at(record + 2u);
    let grid = ShaftGrid(box.xyz, box.w, more.xyz, more.w);
    if !(t_min < t_max) {
        return VERDICT_UNKNOWN;
    }
    let placed = (origin - grid.corner) * grid.scale;
    if all(placed >= vec3<f32>(0.0)) && all(placed <= vec3<f32>(grid.n)) {
        gate_counts.starts_inside += 1u;
        return VERDICT_UNKNOWN;
    }
    let chord = locate_shaft(grid, origin, direction, t_min, t_max);
    if chord.flags == 0u {
        gate_counts.beside += 1u;
        return VERDICT_MISS;
    }
    if (chord.flags & SHAFT_TOO_FAR) != 0u {
        gate_counts.too_far += 1u;
        return VERDICT_UNKNOWN;
    }
    const WHOLE = SHAFT_STARTS_OUTSIDE | SHAFT_REACHES_EXIT;
    let is_whole = (chord.flags & WHOLE) == WHOLE;
    if approximate && !is_whole {
        gate_counts.ends_inside.z += 1u;
        return VERDICT_UNKNOWN;
    }
    let is_proven = kind.y != 0u;
    if !is_proven && !approximate {
        return VERDICT_UNKNOWN;
    }

    let n = u32(grid.n);
    let parts = prims_at(record + 3u);
    var class_ = CLASS_NONE;
    var marked = true;
    var index = symmetric_shaft(n, chord.entry, chord.exit);
    switch kind.x {
        case GATE_CLASS_TREE: {
            class_ = class_in_tree(record, parts, kind.z, n, chord.entry, chord.exit);
        }
        case GATE_CLASS_TABLE: {
            class_ = (gate_word(record + parts.x, index >> 4u) >> (2u * (index & 15u))) & 3u;
        }
        case GATE_COVERAGE: {
            let per_word = 32u / kind.z;
            let most = (1u << kind.z) - 1u;
            let word = gate_word(record + parts.x, index / per_word);
            let level = (word >> (kind.z * (index % per_word))) & most;
            marked = f32(level) / f32(most) > chance(origin, direction);
        }
        default: {
            if kind.x == GATE_DIRECTED_BITS {
                index = directed_shaft(n, chord.entry, chord.exit);
            }
            marked = ((gate_word(record + parts.x, index >> 5u) >> (index & 31u)) & 1u) == 1u;
            if is_proven {
                class_ = select(CLASS_EMPTY, CLASS_MIXED, marked);
            }
        }
    }
    let counted = vec3<u32>(vec3<u32>(CLASS_EMPTY, CLASS_OPAQUE, CLASS_MIXED) == vec3<u32>(min(class_, CLASS_MIXED)));
    if is_whole {
        gate_counts.full_chord += counted;
    } else {
        gate_counts.ends_inside += counted;
    }
    if class_ == CLASS_EMPTY {
        return VERDICT_MISS;
    }
    if class_ == CLASS_OPAQUE && is_whole {
        return VERDICT_HIT;
    }
    if approximate {
        gate_counts.approximated += 1u;
        return verdict_if(marked);
    }
    return VERDICT_UNKNOWN;
}
