// PREPARE: dispatch arguments for a queue, and the sum of all queue lengths (64 bits).

@group(2) @binding(0) var<storage, read_write> queue: array<u32>;
@group(2) @binding(1) var<storage, read_write> arguments: array<u32>;
@group(2) @binding(2) var<storage, read_write> total: array<u32>;

@compute @workgroup_size(1)
fn main() {
    let count = queue[0];
    arguments[0] = (count + 63u) / 64u;
    arguments[1] = 1u;
    arguments[2] = 1u;
    let low = total[0] + count;
    total[1] += select(0u, 1u, low < count);
    total[0] = low;
}
