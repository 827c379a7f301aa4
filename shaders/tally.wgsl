// TALLY: the counters of the gates that the threads of TRACE left behind their queue, into 64-bit sums.

//!include queue

@group(2) @binding(0) var<storage, read_write> totals: array<u32>;

@compute @workgroup_size(16)
fn main(@builtin(local_invocation_id) id: vec3<u32>) {
    if id.x >= GATE_COUNTERS {
        return;
    }
    var counted = 0u;
    for (var copy = 0u; copy < GATE_COPIES; copy++) {
        counted += atomicExchange(&queue[gate_counters_start() + copy * GATE_COUNTERS + id.x], 0u);
    }
    let low = totals[2u * id.x] + counted;
    totals[2u * id.x + 1u] += select(0u, 1u, low < counted);
    totals[2u * id.x] = low;
}
