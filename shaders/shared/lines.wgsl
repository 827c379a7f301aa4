// Lines between the patches of a box, as builds cast them.

//!include shaft

// Lines lead from 0 to here.
const LINE_END = 1.0;

// The faces of pair 0 to 14, the lower one first.
fn face_pair(number: u32) -> vec2<u32> {
    var left = number;
    var low = 0u;
    while left >= 5u - low {
        left -= 5u - low;
        low += 1u;
    }
    return vec2<u32>(low, low + 1u + left);
}

// The numbers, among 6 N^2 patches, of those of a shaft; inverse of `symmetric_shaft`.
fn symmetric_patches(n: u32, index: u32) -> vec2<u32> {
    let square = n * n;
    let faces = face_pair(index / (square * square));
    return vec2<u32>(faces.x * square + index / square % square, faces.y * square + index % square);
}

// Inverse of `directed_shaft`.
fn directed_patches(n: u32, index: u32) -> vec2<u32> {
    let square = n * n;
    let ends = 5u * square;
    let start = index / ends;
    let end = index % ends;
    let is_behind = end / square >= start / square;
    return vec2<u32>(start, end + select(0u, square, is_behind));
}
