// ACCUMULATE: adds a wave's samples to its pixels' sums. Each sum is an unevaluated pair of floats (Knuth's two-sum),
// so that it keeps some 48 bits and does not depend on how samples were split into waves.

//!include rays
//!include scene
//!include math

@group(2) @binding(0) var<storage, read_write> paths: array<Path>;
@group(2) @binding(1) var<storage, read_write> sums: array<vec4<f32>>;

// The value as it is: keeps compilers from simplifying across it by the laws of real numbers.
fn opaque_value(v: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(v) ^ vec3<u32>(wave.zero));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= wave.pixels {
        return;
    }
    var high = vec3<f32>(0.0);
    var low = vec3<f32>(0.0);
    if wave.accumulated > 0u {
        high = sums[2u * id.x].xyz;
        low = sums[2u * id.x + 1u].xyz;
    }
    for (var s = 0u; s < wave.samples; s++) {
        var value = paths[id.x * wave.samples + s].radiance.xyz;
        if !is_finite(value) {
            value = vec3<f32>(0.0);
        }
        value /= f32(max(wave.ao_samples, 1u));
        let sum = opaque_value(high + value);
        let virtual_value = opaque_value(sum - high);
        low += (high - (sum - virtual_value)) + (value - virtual_value);
        high = sum;
    }
    sums[2u * id.x] = vec4<f32>(high, 0.0);
    sums[2u * id.x + 1u] = vec4<f32>(low, 0.0);
}
