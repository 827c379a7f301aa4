// LOCATE: the shaft of each ray in one box.

//!include rays
//!include shaft

struct Located {
    flags: u32,
    symmetric: u32,
    directed: u32,
}

@group(2) @binding(0) var<storage, read_write> grid: array<ShaftGrid>;
@group(2) @binding(1) var<storage, read_write> rays: array<Ray>;
@group(2) @binding(2) var<storage, read_write> located: array<Located>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&rays) {
        return;
    }
    let ray = rays[id.x];
    let n = u32(grid[0].n);
    let chord = locate_shaft(grid[0], ray.origin, ray.direction, ray.t_min, ray.t_max);
    var found = Located(chord.flags, 0u, 0u);
    if (chord.flags & SHAFT_THROUGH) != 0u {
        found.symmetric = symmetric_shaft(n, chord.entry, chord.exit);
        found.directed = directed_shaft(n, chord.entry, chord.exit);
    }
    located[id.x] = found;
}
