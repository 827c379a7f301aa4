// The queue of rays that a tracing stage works on. Word 0 counts the ray numbers that follow; behind them, in the words
// that a queue has beyond its slots (QUEUE_HEADER in `paths.wgsl`), are the counters of the gates.

@group(2) @binding(2) var<storage, read_write> queue: array<atomic<u32>>;

// Threads add to one of several copies, so that they seldom wait for each other. TALLY adds these up.
const GATE_COUNTERS = 10u;
const GATE_COPIES = 32u;

fn queue_count() -> u32 {
    return atomicLoad(&queue[0]);
}

fn queue_slot(i: u32) -> u32 {
    return atomicLoad(&queue[i + 1u]);
}

fn gate_counters_start() -> u32 {
    return arrayLength(&queue) - GATE_COUNTERS * GATE_COPIES;
}
