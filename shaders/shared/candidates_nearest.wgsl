// Stands in for `candidates.wgsl`: the nearest of the certain hits, and where the nearest of all others may be. A hit's t is its upper
// bound, so that no box is left out in which a hit may be nearer.

//!include found
//!include intersect

// Farther than any hit.
const NOWHERE = 3e38;

// Lower bounds of the nearest certain hit so far, and of everything else that may be a hit.
var<private> nearest_lower: f32;
var<private> others_lower: f32;

fn begin_nearest() {
    nearest_lower = NOWHERE;
    others_lower = NOWHERE;
}

// Takes part of the answer of the test before it.
fn is_nearer(t: f32, t_min: f32, best: Hit, found: bool, instance: u32, primitive: u32) -> bool {
    let is_between = tested.upper > t_min && tested.lower < LINE_END;
    if tested.outcome == TESTED_MISS || !is_between || (found && primitive == best.primitive) {
        return false;
    }
    let is_certain = tested.outcome == TESTED_HIT && tested.lower > t_min && tested.upper < LINE_END;
    if is_certain && t < best.t {
        others_lower = min(others_lower, nearest_lower);
        nearest_lower = tested.lower;
        return true;
    }
    others_lower = min(others_lower, tested.lower);
    return false;
}
