// TRACE: adds each queued contribution to its path's radiance unless something stands in the way.

//!include traverse
//!include accept_all
//!include gate_tell

@group(2) @binding(0) var<storage, read_write> rays: array<Ray>;
@group(2) @binding(1) var<storage, read_write> paths: array<Path>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= queue_count() {
        return;
    }
    let slot = queue_slot(id.x);
    begin_filter(slot);
    if trace(rays[slot]).hit.instance == NONE {
        paths[slot].radiance += paths[slot].contribution;
    }
    if GATED {
        tell_gate_counts(id.x);
    }
}
