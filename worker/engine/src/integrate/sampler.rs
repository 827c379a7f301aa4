//! Random numbers: hash-based Owen-scrambled Sobol points in padded sets of four dimensions.
//!
//! Burley 2020, "Practical Hash-based Owen Scrambling", JCGT 9(4), sections 2 and 4, with Vegdahl's constants for the
//! Laine-Karras permutation. A number depends on (pixel, sample, set, seed) only, through `u32` arithmetic that WGSL
//! repeats bit by bit; so pictures do not depend on tile order, threads or device. Any aligned block of `2^k` samples
//! of a pixel is well stratified in each set, and sets are independent of each other.

/// Dimension sets. Each gives four numbers.
pub const SET_CAMERA: u32 = 0;
/// Directions of ambient occlusion (its sample index counts all directions of the pixel).
pub const SET_AO: u32 = 1;
/// First set of path vertex `b`: `SET_PATH + b * SETS_PER_BOUNCE` chooses the light (select, u, v) and the Russian
/// roulette, the next one the scattering (lobe, u, v).
pub const SET_PATH: u32 = 2;
pub const SETS_PER_BOUNCE: u32 = 2;

/// Avalanching 32-bit hash (Wellons' `lowbias32`).
pub fn hash(value: u32) -> u32 {
    let mut x = value;
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^= x >> 16;
    x
}

/// Mixes `value` into `seed`; not symmetric.
pub fn hash_combine(seed: u32, value: u32) -> u32 {
    hash(seed ^ value.wrapping_add(0x9e37_79b9).wrapping_add(seed << 6).wrapping_add(seed >> 2))
}

/// The seed of a pixel: all of its samples and sets start from it.
pub fn pixel_seed(x: u32, y: u32, seed: u32) -> u32 {
    hash_combine(hash_combine(hash(seed), x), y)
}

/// A number in `[0, 1)` from the upper 24 bits.
pub fn unit_float(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Each bit is flipped by a hash of the bits above it: Owen's nested uniform scramble.
pub fn nested_uniform_scramble(value: u32, seed: u32) -> u32 {
    let mut x = value.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// Bit `b` of an index toggles `SOBOL[b]` in each of the four dimensions.
pub const SOBOL: [[u32; 4]; 32] = sobol_directions();

/// Direction numbers of dimensions 1 to 4 after Joe and Kuo 2008 (new-joe-kuo-6).
const fn sobol_directions() -> [[u32; 4]; 32] {
    // Degree s, coefficients a, initial m of each primitive polynomial; dimension 1 is van der Corput's.
    const DEGREE: [usize; 4] = [0, 1, 2, 3];
    const COEFFICIENTS: [u32; 4] = [0, 0, 1, 1];
    const INITIAL: [[u32; 3]; 4] = [[0, 0, 0], [1, 0, 0], [1, 3, 0], [1, 3, 1]];
    let mut table = [[0u32; 4]; 32];
    let mut bit = 0;
    while bit < 32 {
        table[bit][0] = 1 << (31 - bit);
        let mut d = 1;
        while d < 4 {
            let s = DEGREE[d];
            table[bit][d] = if bit < s {
                INITIAL[d][bit] << (31 - bit)
            } else {
                let mut v = table[bit - s][d] ^ (table[bit - s][d] >> s);
                let mut k = 1;
                while k < s {
                    if (COEFFICIENTS[d] >> (s - 1 - k)) & 1 == 1 {
                        v ^= table[bit - k][d];
                    }
                    k += 1;
                }
                v
            };
            d += 1;
        }
        bit += 1;
    }
    table
}

/// What the `n`-th four bits of an index toggle together: `SOBOL_NIBBLES[n][bits]`.
pub static SOBOL_NIBBLES: [[[u32; 4]; 16]; 8] = {
    let mut table = [[[0; 4]; 16]; 8];
    let mut entry = 0;
    while entry < 8 * 16 * 16 {
        let (nibble, bits, d, bit) = (entry / 256, entry / 16 % 16, entry / 4 % 4, entry % 4);
        if bits >> bit & 1 == 1 {
            table[nibble][bits][d] ^= SOBOL[4 * nibble + bit][d];
        }
        entry += 1;
    }
    table
};

/// The four Sobol coordinates of `index`, as 32-bit fractions.
pub fn sobol_4d(index: u32) -> [u32; 4] {
    let mut x = [0u32; 4];
    for (n, toggles) in SOBOL_NIBBLES.iter().enumerate() {
        let toggles = &toggles[(index >> (4 * n) & 15) as usize];
        for d in 0..4 {
            x[d] ^= toggles[d];
        }
    }
    x
}

/// Four numbers in `[0, 1)` for sample `sample` of a pixel in dimension set `set`.
pub fn sample_4d(pixel_seed: u32, sample: u32, set: u32) -> [f32; 4] {
    sample_4d_bits(pixel_seed, sample, set).map(unit_float)
}

/// [`sample_4d`] as 32-bit fractions: floats have 24 bits only.
pub fn sample_4d_bits(pixel_seed: u32, sample: u32, set: u32) -> [u32; 4] {
    let seed = hash_combine(pixel_seed, set);
    let x = sobol_4d(nested_uniform_scramble(sample, seed));
    [
        nested_uniform_scramble(x[0], hash_combine(seed, 0)),
        nested_uniform_scramble(x[1], hash_combine(seed, 1)),
        nested_uniform_scramble(x[2], hash_combine(seed, 2)),
        nested_uniform_scramble(x[3], hash_combine(seed, 3)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn direction_numbers_follow_joe_and_kuo() {
        assert_eq!(SOBOL[0], [0x8000_0000; 4]);
        assert_eq!(SOBOL[1], [0x4000_0000, 0xc000_0000, 0xc000_0000, 0xc000_0000]);
        assert_eq!(SOBOL[2], [0x2000_0000, 0xa000_0000, 0x6000_0000, 0x2000_0000]);
        assert_eq!(SOBOL[3], [0x1000_0000, 0xf000_0000, 0x9000_0000, 0x5000_0000]);
        assert_eq!(sobol_4d(0), [0; 4]);
        assert_eq!(sobol_4d(3), [0xc000_0000, 0x4000_0000, 0x4000_0000, 0x4000_0000]);
    }

    /// Computed by an independent program from the papers' formulas; the shaders are held to the same numbers.
    #[test]
    fn golden_values() {
        assert_eq!((hash(1), hash_combine(1, 2), pixel_seed(3, 5, 7)), (0x6889_90c0, 0xa7bd_535e, 0xb1b7_c361));
        assert_eq!(nested_uniform_scramble(0x1234_5678, 0x9abc_def0), 0x1f8b_4945);
        assert_eq!(sobol_4d(0xdead_beef), [0xf77d_b57b, 0x0c66_ae4d, 0xa928_2de3, 0x2027_a979]);
        let bits = [0x74cc_d71e, 0x4352_2ed9, 0x0221_e9be, 0x5520_b632];
        assert_eq!(sample_4d(pixel_seed(3, 5, 7), 11, 2), bits.map(unit_float));
    }

    #[test]
    fn each_dimension_and_each_pair_of_the_first_two_is_stratified() {
        for set in 0..8 {
            let seed = pixel_seed(17, 4 + set, 3);
            let points: Vec<_> = (0..256).map(|i| sample_4d(seed, i, set)).collect();
            for d in 0..4 {
                let mut strata = [0u32; 256];
                points.iter().for_each(|p| strata[(p[d] * 256.0) as usize] += 1);
                assert_eq!(strata, [1; 256], "set {set}, dimension {d}");
            }
            // Elementary intervals of the (0, 8, 2)-net of dimensions 0 and 1.
            for k in 0..=8 {
                let (w, h) = (1u32 << k, 1u32 << (8 - k));
                let mut cells = vec![0u32; 256];
                for p in &points {
                    cells[((p[0] * w as f32) as u32 * h + (p[1] * h as f32) as u32) as usize] += 1;
                }
                assert!(cells.iter().all(|&n| n == 1), "set {set}, {w} x {h} cells");
            }
        }
    }

    #[test]
    fn later_aligned_blocks_are_stratified_too() {
        let seed = pixel_seed(1, 2, 3);
        let mut strata = [0u32; 64];
        (192..256).for_each(|i| strata[(sample_4d(seed, i, 1)[2] * 64.0) as usize] += 1);
        assert_eq!(strata, [1; 64]);
    }

    #[test]
    fn pixels_sets_and_seeds_are_uncorrelated() {
        let n = 4096;
        let correlation = |a: &dyn Fn(u32) -> f32, b: &dyn Fn(u32) -> f32| {
            (0..n).map(|i| (a(i) - 0.5) * (b(i) - 0.5)).sum::<f32>() / n as f32 * 12.0
        };
        let base = |i: u32| sample_4d(pixel_seed(i % 64, i / 64, 1), 5, 1)[0];
        let other_set = |i: u32| sample_4d(pixel_seed(i % 64, i / 64, 1), 5, 2)[0];
        let other_seed = |i: u32| sample_4d(pixel_seed(i % 64, i / 64, 2), 5, 1)[0];
        let next_pixel = |i: u32| sample_4d(pixel_seed(i % 64 + 1, i / 64, 1), 5, 1)[0];
        let mean = (0..n).map(base).sum::<f32>() / n as f32;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
        for other in [&other_set as &dyn Fn(u32) -> f32, &other_seed, &next_pixel] {
            let r = correlation(&base, other);
            assert!(r.abs() < 0.06, "{r}");
        }
    }
}
