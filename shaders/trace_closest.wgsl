// TRACE: the nearest hit of every queued ray. No material code but the alpha filter of `accept`.

//!include traverse
//!include accept_all
//!include gate_tell

@group(2) @binding(0) var<storage, read_write> rays: array<Ray>;
@group(2) @binding(1) var<storage, read_write> hits: array<Hit>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= queue_count() {
        return;
    }
    let slot = queue_slot(id.x);
    begin_filter(slot);
    hits[slot] = trace(rays[slot]).hit;
    if GATED {
        tell_gate_counts(id.x);
    }
}
