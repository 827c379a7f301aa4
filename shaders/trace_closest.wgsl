// TRACE: the nearest hit of every queued ray. No material code but the alpha filter of `accept`.

//!include traverse
//!include accept_all

@group(2) @binding(0) var<storage, read_write> rays: array<Ray>;
@group(2) @binding(1) var<storage, read_write> hits: array<Hit>;
// Word 0 counts the ray numbers that follow.
@group(2) @binding(2) var<storage, read_write> queue: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= queue[0] {
        return;
    }
    let slot = queue[id.x + 1u];
    begin_filter(slot);
    hits[slot] = trace(rays[slot]).hit;
}
