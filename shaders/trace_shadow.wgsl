// TRACE: adds each queued contribution to its path's radiance unless something stands in the way.

//!include traverse
//!include accept_all

@group(2) @binding(0) var<storage, read_write> rays: array<Ray>;
@group(2) @binding(1) var<storage, read_write> paths: array<Path>;
@group(2) @binding(2) var<storage, read_write> queue: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= queue[0] {
        return;
    }
    let slot = queue[id.x + 1u];
    begin_filter(slot);
    if trace(rays[slot]).hit.instance == NONE {
        paths[slot].radiance += paths[slot].contribution;
    }
}
