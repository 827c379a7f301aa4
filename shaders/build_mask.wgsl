// BUILD by masking: the shafts that meet a cell with surface (`accel/line_space/mask.rs`), a word of them each thread.

// Words of a cell's mask, and how many cells follow.
@group(2) @binding(0) var<storage, read_write> filled: array<u32>;
// The masks of all cells.
@group(2) @binding(1) var<storage, read_write> atlas: array<u32>;
@group(2) @binding(2) var<storage, read_write> marks: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let words = filled[0];
    if id.x >= words {
        return;
    }
    var marked = 0u;
    for (var i = 0u; i < filled[1]; i++) {
        marked |= atlas[filled[2u + i] * words + id.x];
    }
    marks[id.x] = marked;
}
