// Adds what a thread's rays were told by gates to the counters behind the queue.

//!include queue
//!include gate

fn tell(place: u32, counted: u32) {
    if counted != 0u {
        atomicAdd(&queue[place], counted);
    }
}

fn tell_gate_counts(thread: u32) {
    let start = gate_counters_start() + GATE_COUNTERS * ((thread / 64u) % GATE_COPIES);
    tell(start, gate_counts.full_chord.x);
    tell(start + 1u, gate_counts.full_chord.y);
    tell(start + 2u, gate_counts.full_chord.z);
    tell(start + 3u, gate_counts.ends_inside.x);
    tell(start + 4u, gate_counts.ends_inside.y);
    tell(start + 5u, gate_counts.ends_inside.z);
    tell(start + 6u, gate_counts.starts_inside);
    tell(start + 7u, gate_counts.approximated);
    tell(start + 8u, gate_counts.beside);
    tell(start + 9u, gate_counts.too_far);
}
