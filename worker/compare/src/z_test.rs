//! A per-pixel Z-test for pictures with sampling noise: is each pixel's mean that of the reference, given how far
//! renderings scatter?
//!
//! After Subr and Arvo 2007, "Statistical hypothesis testing for assessing Monte Carlo estimators": two-sample t-tests,
//! whose significance is corrected for their number (Sidak 1967, "Rectangular confidence regions for the means of
//! multivariate normal distributions"), as Mitsuba tests its renderers. Few renderings and path tracing's fireflies ask for
//! care:
//!
//! - The variance is pooled over both sides, which have one distribution when nothing has changed. A firefly raises the
//!   variance that judges it, which keeps the statistic small however long the tail is (Efron 1969, "Student's t-test under
//!   symmetry conditions").
//! - What is unsure of a variance from few renderings is in the distribution: Student's, not the normal one.
//! - A variance is at least the mean of its neighbourhood's, which shares its noise: renderings that are alike by chance
//!   claim nothing. And it is at least what rounding leaves.
//! - Such a test alone sees only what is plain at a single pixel. So it is made on every level of an image pyramid (each
//!   rendering halved again and again, down to one value), at an equal share of the significance each: what is faint and
//!   wide is plain where it is averaged.
//!
//! With as many renderings on both sides the difference of their means is symmetric, and the test keeps its significance for
//! skewed noise too; tests in this file count false alarms.

use serde::Serialize;

use crate::image::{Error, Image, is_finite, same_size};
use crate::normal::{critical_z, from_student};

/// The fewest renderings of a side: with fewer, Student's tails are so long that hardly anything could fail.
pub const LEAST_RENDERINGS: usize = 4;
/// Variances are at least the mean over a square of this radius.
const RADIUS: usize = 2;
/// Least standard deviation of a pixel, in linear units, and as a share of its mean: what 8-bit sRGB and 16-bit floats
/// round away.
const LEAST_DEVIATION: f64 = 1e-3;
const LEAST_RELATIVE_DEVIATION: f64 = 1.0 / 256.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZTestOptions {
    /// The chance that anything of an unchanged picture fails.
    pub significance: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ZTest {
    /// The pixels, and then blocks of twice the side each, up to one block that is the whole picture.
    pub levels: Vec<ZTestLevel>,
}

/// The test of all pixels, or of all blocks of one size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ZTestLevel {
    /// Pixels on a side of a block: 1 where single pixels are tested.
    pub side: u32,
    /// Blocks of which a channel is beyond the critical value; of single pixels also those that are finite on one side only.
    pub failing: u64,
    pub blocks: u64,
    /// Largest statistic of all channels, as likely as so many standard deviations of a normal distribution.
    pub max_z: f64,
    pub critical_z: f64,
}

/// Tests whether `test` has the mean of `reference`: independent renderings of one scene on either side.
///
/// # Errors
/// [`Error::Size`] when sizes differ, [`Error::Renderings`] for fewer than [`LEAST_RENDERINGS`] on a side.
pub fn z_test(reference: &[Image], test: &[Image], options: &ZTestOptions) -> Result<ZTest, Error> {
    for side in [reference, test] {
        if side.len() < LEAST_RENDERINGS {
            return Err(Error::Renderings { found: side.len() });
        }
        side.iter().try_for_each(|image| same_size(&reference[0], image))?;
    }
    let (mut width, mut height) = (reference[0].width(), reference[0].height());
    let levels = 1 + width.max(height).next_power_of_two().ilog2();
    let significance = sidak(options.significance, f64::from(levels));
    let mut sides = [pixels_of(reference), pixels_of(test)];
    let is_valid = |i: usize| sides.iter().flatten().all(|rendering| is_finite(&rendering[i]));
    let mut weights: Vec<f32> = (0..width * height).map(|i| f32::from(u8::from(is_valid(i)))).collect();
    let mut found = Vec::with_capacity(levels as usize);
    for level in 0..levels {
        if level > 0 {
            let halved = |rendering: &Vec<[f32; 3]>| halved(width, height, rendering, &weights);
            sides = sides.map(|side| side.iter().map(halved).collect());
            weights = halved_weights(width, height, &weights);
            (width, height) = (width.div_ceil(2), height.div_ceil(2));
        }
        found.push(test_level(width, &sides, &weights, 1 << level, significance));
    }
    found[0].failing += finite_on_one_side(&sides_of_pixels(reference, test));
    Ok(ZTest { levels: found })
}

/// The significance of each of so many tests of which none may fail by chance.
fn sidak(significance: f64, tests: f64) -> f64 {
    -f64::exp_m1(f64::ln_1p(-significance) / tests)
}

fn pixels_of(renderings: &[Image]) -> Vec<Vec<[f32; 3]>> {
    renderings.iter().map(|image| image.pixels().to_vec()).collect()
}

fn sides_of_pixels<'a>(reference: &'a [Image], test: &'a [Image]) -> [Vec<&'a [[f32; 3]]>; 2] {
    [reference, test].map(|side| side.iter().map(Image::pixels).collect())
}

fn finite_on_one_side(sides: &[Vec<&[[f32; 3]]>; 2]) -> u64 {
    let is_whole = |side: usize, i: usize| sides[side].iter().all(|pixels| is_finite(&pixels[i]));
    (0..sides[0][0].len()).filter(|&i| is_whole(0, i) != is_whole(1, i)).count() as u64
}

/// Means over two by two values (fewer at a border of an odd size), each with its weight.
fn halved(width: usize, height: usize, values: &[[f32; 3]], weights: &[f32]) -> Vec<[f32; 3]> {
    blocks(width, height)
        .map(|block| {
            let (mut sum, mut weight) = ([0.0_f32; 3], 0.0_f32);
            for i in block.filter(|&i| weights[i] > 0.0) {
                weight += weights[i];
                sum.iter_mut().zip(values[i]).for_each(|(sum, value)| *sum += weights[i] * value);
            }
            sum.map(|sum| if weight > 0.0 { sum / weight } else { 0.0 })
        })
        .collect()
}

fn halved_weights(width: usize, height: usize, weights: &[f32]) -> Vec<f32> {
    blocks(width, height).map(|block| block.map(|i| weights[i]).sum()).collect()
}

/// The indices of the values of each block of two by two, row by row.
fn blocks(width: usize, height: usize) -> impl Iterator<Item = impl Iterator<Item = usize>> {
    (0..height.div_ceil(2)).flat_map(move |y| {
        (0..width.div_ceil(2)).map(move |x| {
            let columns = move || 2 * x..(2 * x + 2).min(width);
            (2 * y..(2 * y + 2).min(height)).flat_map(move |row| columns().map(move |column| row * width + column))
        })
    })
}

fn test_level(
    width: usize,
    sides: &[Vec<Vec<[f32; 3]>>; 2],
    weights: &[f32],
    side: u32,
    significance: f64,
) -> ZTestLevel {
    // Each channel of each block is one test.
    let critical = critical_z(sidak(significance, (3 * weights.len()) as f64));
    let [n, m] = [sides[0].len() as f64, sides[1].len() as f64];
    let moments = pooled(sides, weights);
    let share = (1.0 / n + 1.0 / m).sqrt();
    let (mut failing, mut largest) = (0, 0.0_f64);
    for (moments, least) in moments.iter().zip(neighbourhood_variances(width, &moments)) {
        let Some(moments) = moments else { continue };
        let z = |c: usize| {
            let rounding = LEAST_DEVIATION.max(LEAST_RELATIVE_DEVIATION * moments.largest_mean[c]) / f64::from(side);
            let deviation = moments.variance[c].max(least[c]).sqrt().max(rounding);
            from_student(moments.difference[c].abs() / (deviation * share), n + m - 2.0)
        };
        let worst = z(0).max(z(1)).max(z(2));
        largest = largest.max(worst);
        failing += u64::from(worst > critical);
    }
    ZTestLevel { side, failing, blocks: weights.len() as u64, max_z: largest, critical_z: critical }
}

/// Of one block, per channel.
struct Pooled {
    difference: [f64; 3],
    /// The larger of both sides' means, without its sign.
    largest_mean: [f64; 3],
    /// Of one rendering.
    variance: [f64; 3],
}

/// `None` where no pixel is finite in all renderings.
fn pooled(sides: &[Vec<Vec<[f32; 3]>>; 2], weights: &[f32]) -> Vec<Option<Pooled>> {
    let freedom = (sides[0].len() + sides[1].len() - 2) as f64;
    let of_block = |i: usize| {
        let [a, b] = [moments(&sides[0], i), moments(&sides[1], i)];
        Pooled {
            difference: std::array::from_fn(|c| b.0[c] - a.0[c]),
            largest_mean: std::array::from_fn(|c| a.0[c].abs().max(b.0[c].abs())),
            variance: std::array::from_fn(|c| (a.1[c] + b.1[c]) / freedom),
        }
    };
    weights.iter().enumerate().map(|(i, &weight)| (weight > 0.0).then(|| of_block(i))).collect()
}

/// Mean and sum of squared deviations (Welford 1962, "Note on a method for calculating corrected sums of squares and
/// products").
fn moments(renderings: &[Vec<[f32; 3]>], i: usize) -> ([f64; 3], [f64; 3]) {
    let (mut mean, mut squares) = ([0.0; 3], [0.0; 3]);
    for (count, rendering) in (1..).zip(renderings) {
        for c in 0..3 {
            let delta = f64::from(rendering[i][c]) - mean[c];
            mean[c] += delta / f64::from(count);
            squares[c] += delta * (f64::from(rendering[i][c]) - mean[c]);
        }
    }
    (mean, squares)
}

/// The mean variance of each block's neighbourhood, borders cut off.
fn neighbourhood_variances(width: usize, moments: &[Option<Pooled>]) -> Vec<[f64; 3]> {
    let height = moments.len() / width;
    let around = |at: usize, end: usize| at.saturating_sub(RADIUS)..(at + RADIUS + 1).min(end);
    let mut means = Vec::with_capacity(moments.len());
    for y in 0..height {
        for x in 0..width {
            let (mut sum, mut count) = ([0.0; 3], 0.0_f64);
            let rows = around(y, height).flat_map(|row| &moments[row * width..][around(x, width)]);
            for neighbour in rows.flatten() {
                sum.iter_mut().zip(neighbour.variance).for_each(|(sum, variance)| *sum += variance);
                count += 1.0;
            }
            means.push(sum.map(|sum| sum / count.max(1.0)));
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{flat, noise};

    const WIDTH: usize = 32;
    const HEIGHT: usize = 24;
    const OPTIONS: ZTestOptions = ZTestOptions { significance: 0.01 };

    /// What one sample of a pixel gives, of a uniform random number.
    type Sampled = fn(f32) -> f32;

    /// Means of this many samples per pixel: a mean of 1 before `scale`, on a ramp from dark to bright.
    fn renderings(sampled: Sampled, count: u64, seed: u64, samples: u64, scale: f32) -> Vec<Image> {
        let one = |i: u64| {
            let mut pixels = vec![[0.0_f32; 3]; WIDTH * HEIGHT];
            for draw in 0..samples {
                // Far apart: the streams of near seeds overlap.
                let key = ((seed * 1009 + i) * 101 + draw).wrapping_mul(0xd134_2543_de82_ef95);
                let drawn = noise(WIDTH, HEIGHT, key);
                for (x, (pixel, drawn)) in pixels.iter_mut().zip(drawn.pixels()).enumerate() {
                    let albedo = scale * (0.1 + 0.9 * (x % WIDTH) as f32 / WIDTH as f32) / samples as f32;
                    // The channels of a sample are of one path.
                    pixel.iter_mut().for_each(|sum| *sum += albedo * sampled(drawn[0]));
                }
            }
            Image::new(WIDTH, HEIGHT, pixels).unwrap()
        };
        (0..count).map(one).collect()
    }

    fn uniform(u: f32) -> f32 {
        2.0 * u
    }

    /// Paths that find a small lamp once in 500 samples.
    fn fireflies(u: f32) -> f32 {
        if u < 0.002 { 300.0 } else { 0.4 }
    }

    /// Pareto's distribution with a shape of 1.5: its variance is infinite.
    fn pareto(u: f32) -> f32 {
        (1.0 - u).max(1e-7).powf(-1.0 / 1.5) / 3.0
    }

    fn coverage(u: f32) -> f32 {
        if u < 0.3 { 3.3 } else { 0.0 }
    }

    fn failing(found: &ZTest) -> u64 {
        found.levels.iter().map(|level| level.failing).sum()
    }

    #[test]
    fn noise_with_any_tail_hardly_ever_fails() {
        let noises: [(&str, Sampled); 4] =
            [("uniform", uniform), ("fireflies", fireflies), ("Pareto", pareto), ("coverage", coverage)];
        for (name, sampled) in noises {
            // Renderings on either side, and samples per pixel.
            for (n, m, samples) in [(4, 4, 8), (6, 6, 8), (6, 6, 2), (4, 12, 8)] {
                let alarms = (0..50)
                    .filter(|&i| {
                        let reference = renderings(sampled, n, 2 * i, samples, 1.0);
                        let test = renderings(sampled, m, 2 * i + 1, samples, 1.0);
                        failing(&z_test(&reference, &test, &OPTIONS).unwrap()) > 0
                    })
                    .count();
                assert!(alarms <= 3, "{name}, {n} against {m} of {samples} samples: {alarms} of 50 at 1 %");
            }
        }
    }

    #[test]
    fn a_faint_change_of_everything_fails_though_no_pixel_shows_it() {
        for (name, sampled, scale) in [("uniform", uniform as Sampled, 1.05), ("coverage", coverage, 1.1)] {
            for i in 0..10 {
                let reference = renderings(sampled, 6, 2 * i, 8, 1.0);
                let found = z_test(&reference, &renderings(sampled, 6, 2 * i + 1, 8, scale), &OPTIONS).unwrap();
                assert!(failing(&found) > 0, "{name} times {scale}: {found:?}");
                assert_eq!(found.levels[0].failing, 0, "{name} times {scale}: {found:?}");
            }
        }
    }

    #[test]
    fn one_pixel_that_differs_fails_alone() {
        let reference = renderings(uniform, 6, 1, 8, 1.0);
        let mut images = renderings(uniform, 6, 3, 8, 1.0);
        for image in &mut images {
            let mut pixels = image.pixels().to_vec();
            pixels[100][1] += 5.0;
            *image = Image::new(WIDTH, HEIGHT, pixels).unwrap();
        }
        let found = z_test(&reference, &images, &OPTIONS).unwrap();
        assert_eq!(found.levels[0].failing, 1, "{found:?}");
    }

    #[test]
    fn levels_halve_down_to_the_whole_picture_at_sidaks_significance() {
        let found = z_test(&renderings(uniform, 4, 1, 1, 1.0), &renderings(uniform, 4, 2, 1, 1.0), &OPTIONS).unwrap();
        let sizes: Vec<(u32, u64)> = found.levels.iter().map(|level| (level.side, level.blocks)).collect();
        assert_eq!(sizes, [(1, 768), (2, 192), (4, 48), (8, 12), (16, 4), (32, 1)]);
        // Each level has 1 - 0.99^(1/6) = 1.67365e-3; of 2304 tests each 7.27015e-7, whose two-sided quantile is 4.95376.
        assert!((found.levels[0].critical_z - 4.9538).abs() < 1e-3, "{found:?}");
        // Of the whole picture's three: 5.58e-4, 3.4516.
        assert!((found.levels[5].critical_z - 3.4516).abs() < 1e-3, "{found:?}");
    }

    #[test]
    fn steady_pixels_may_differ_by_rounding_only() {
        let side = |value: f32| vec![flat(3, 5, [value; 3]); 4];
        assert_eq!(failing(&z_test(&side(0.5), &side(0.5), &OPTIONS).unwrap()), 0);
        assert_eq!(failing(&z_test(&side(0.5), &side(0.5005), &OPTIONS).unwrap()), 0);
        let found = z_test(&side(0.5), &side(0.53), &OPTIONS).unwrap();
        assert_eq!(found.levels[0].failing, 15, "{found:?}");
    }

    #[test]
    fn what_is_not_finite_on_one_side_fails_and_spoils_nothing_else() {
        let broken = || {
            let mut pixels = vec![[0.5; 3]; 16];
            pixels[5] = [f32::NAN; 3];
            vec![Image::new(4, 4, pixels).unwrap(); 4]
        };
        let whole = vec![flat(4, 4, [0.5; 3]); 4];
        let failing = |a: &[Image], b: &[Image]| {
            z_test(a, b, &OPTIONS).unwrap().levels.iter().map(|level| level.failing).collect::<Vec<_>>()
        };
        assert_eq!(failing(&whole, &broken()), [1, 0, 0]);
        assert_eq!(failing(&broken(), &whole), [1, 0, 0]);
        assert_eq!(failing(&broken(), &broken()), [0, 0, 0]);
        let nothing = vec![flat(2, 1, [f32::INFINITY; 3]); 4];
        assert_eq!(failing(&nothing, &nothing), [0, 0]);
    }

    #[test]
    fn few_renderings_and_other_sizes_are_refused() {
        let side = |count: usize| vec![flat(2, 2, [0.5; 3]); count];
        let error = z_test(&side(4), &side(3), &OPTIONS).unwrap_err();
        assert_eq!(error, Error::Renderings { found: 3 });
        assert_eq!(error.to_string(), "3 renderings are too few to know how far they scatter: it takes at least 4");
        assert_eq!(z_test(&[], &side(4), &OPTIONS), Err(Error::Renderings { found: 0 }));
        assert!(z_test(&side(4), &vec![flat(1, 4, [0.5; 3]); 4], &OPTIONS).is_err());
    }
}
