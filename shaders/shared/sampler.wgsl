// Twin of integrate/sampler.rs, bit by bit.

const SET_CAMERA = 0u;
const SET_AO = 1u;
const SET_PATH = 2u;
const SETS_PER_BOUNCE = 2u;

fn hash(value: u32) -> u32 {
    var x = value;
    x ^= x >> 16u;
    x *= 0x7feb352du;
    x ^= x >> 15u;
    x *= 0x846ca68bu;
    x ^= x >> 16u;
    return x;
}

fn hash_combine(seed: u32, value: u32) -> u32 {
    return hash(seed ^ (value + 0x9e3779b9u + (seed << 6u) + (seed >> 2u)));
}

fn pixel_seed(x: u32, y: u32, seed: u32) -> u32 {
    return hash_combine(hash_combine(hash(seed), x), y);
}

fn unit_float(bits: u32) -> f32 {
    return f32(bits >> 8u) * (1.0 / 16777216.0);
}

fn nested_uniform_scramble(value: u32, seed: u32) -> u32 {
    var x = reverseBits(value);
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return reverseBits(x);
}

// Direction numbers are a constant of the scene's tables: four words a bit.
fn sobol_4d(index: u32) -> vec4<u32> {
    var x = vec4<u32>(0u);
    for (var bit = 0u; bit < 32u; bit++) {
        let at = scene.sobol + 4u * bit;
        let directions = vec4<u32>(words_at(at), words_at(at + 1u), words_at(at + 2u), words_at(at + 3u));
        x ^= directions & vec4<u32>(0u - ((index >> bit) & 1u));
    }
    return x;
}

fn sample_4d(pixel_seed: u32, sample: u32, dimensions: u32) -> vec4<f32> {
    let x = sample_4d_bits(pixel_seed, sample, dimensions);
    return vec4<f32>(unit_float(x.x), unit_float(x.y), unit_float(x.z), unit_float(x.w));
}

fn sample_4d_bits(pixel_seed: u32, sample: u32, dimensions: u32) -> vec4<u32> {
    let seed = hash_combine(pixel_seed, dimensions);
    let x = sobol_4d(nested_uniform_scramble(sample, seed));
    return vec4<u32>(
        nested_uniform_scramble(x.x, hash_combine(seed, 0u)),
        nested_uniform_scramble(x.y, hash_combine(seed, 1u)),
        nested_uniform_scramble(x.z, hash_combine(seed, 2u)),
        nested_uniform_scramble(x.w, hash_combine(seed, 3u)),
    );
}

fn alpha_seed(pixel_seed: u32, sample: u32, ray_number: u32) -> u32 {
    return hash_combine(hash_combine(pixel_seed ^ 0x5bd1e995u, sample), ray_number) & 0x7fffffffu;
}

struct PathSample {
    x: u32,
    y: u32,
    index: u32,
    seed: u32,
}

// Which sample of which pixel a slot is. Pixels take turns in runs from all over the region (`pace.rs`).
fn path_sample(slot: u32) -> PathSample {
    let turn = wave.first_pixel + slot / wave.samples;
    let run = turn / wave.run;
    var pixel = turn;
    if run < wave.runs {
        pixel = run * wave.run_step % wave.runs * wave.run + turn % wave.run;
    }
    let x = wave.region_x + pixel % wave.region_width;
    let y = wave.region_y + pixel / wave.region_width;
    return PathSample(x, y, wave.first_sample + slot % wave.samples, pixel_seed(x, y, wave.seed));
}
