// Stands in for `candidates.wgsl`: all hits of a line are kept, none shortens it. The walk ends early when one is not certain.

//!include found
//!include intersect

// More than these are left to the CPU.
const MOST_CROSSINGS = 32u;

// Where a line of a shaft crosses the surface, from 0 at the first patch to 1 at the second.
struct Crossing {
    lower: f32,
    upper: f32,
    primitive: u32,
}

var<private> crossings: array<Crossing, MOST_CROSSINGS>;
var<private> crossing_count: u32;
var<private> is_uncertain: bool;

fn begin_crossings() {
    crossing_count = 0u;
    is_uncertain = false;
}

// Takes part of the answer of the test before it. True: the line's crossings cannot be counted for certain.
fn is_nearer(t: f32, t_min: f32, best: Hit, found: bool, instance: u32, primitive: u32) -> bool {
    if tested.outcome == TESTED_MISS || tested.upper <= t_min || tested.lower >= LINE_END {
        return false;
    }
    let is_certain = tested.outcome == TESTED_HIT && tested.lower > t_min && tested.upper < LINE_END;
    if !is_certain || crossing_count == MOST_CROSSINGS {
        is_uncertain = true;
        return true;
    }
    // With spatial splits, one hit may be found in several leaves.
    for (var i = 0u; i < crossing_count; i++) {
        if crossings[i].primitive == primitive {
            return false;
        }
    }
    crossings[crossing_count] = Crossing(tested.lower, tested.upper, primitive);
    crossing_count += 1u;
    cover(tested.a, tested.b, tested.c);
    return false;
}
