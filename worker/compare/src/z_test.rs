//! A per-pixel Z-test for pictures with sampling noise: is each pixel's mean that of the reference, given how far samples
//! scatter?
//!
//! After Subr and Arvo 2007, "Statistical hypothesis testing for assessing Monte Carlo estimators", as Mitsuba tests its
//! renderers: the reference's variance is taken for that of both sides, and the significance is corrected for the number of
//! tests (Sidak 1967, "Rectangular confidence regions for the means of multivariate normal distributions"). Variances come
//! from a few renderings only, so each is averaged over the pixel's neighbourhood, which shares its noise; where the pixel's
//! own is larger (an edge, a highlight), that counts. What is still unsure of them is corrected for: with that many degrees of
//! freedom the statistic has Student's distribution.

use serde::Serialize;

use crate::image::{Error, Image, is_finite, same_size};
use crate::normal::{critical_z, from_student};

/// Variances are averaged over a square of this radius.
const RADIUS: usize = 2;
/// Least standard deviation of a pixel, in linear units: what rounding to 16-bit floats may add to radiance around 1.
const LEAST_DEVIATION: f64 = 1e-3;

/// Mean and variance of each channel over independent renderings of one scene.
#[derive(Clone, Debug)]
pub struct Moments {
    mean: Image,
    /// Of one rendering, not of the mean.
    variance: Vec<[f64; 3]>,
    renderings: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZTestOptions {
    /// The chance that any pixel of an unchanged picture fails.
    pub significance: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ZTest {
    /// Pixels of which a channel is beyond the critical value, or finite on one side only.
    pub failing_pixels: u64,
    pub pixels: u64,
    /// Largest statistic of all channels.
    pub max_z: f64,
    pub critical_z: f64,
}

impl Moments {
    /// Of at least two renderings (Welford 1962, "Note on a method for calculating corrected sums of squares and products").
    ///
    /// # Errors
    /// [`Error::Size`] when sizes differ, [`Error::Renderings`] for fewer than two.
    pub fn of(images: &[Image]) -> Result<Self, Error> {
        let [first, rest @ ..] = images else { return Err(Error::Renderings { found: 0 }) };
        if rest.is_empty() {
            return Err(Error::Renderings { found: 1 });
        }
        let mut means: Vec<[f64; 3]> = first.pixels().iter().map(|pixel| pixel.map(f64::from)).collect();
        let mut squares = vec![[0.0; 3]; means.len()];
        for (i, image) in rest.iter().enumerate() {
            same_size(first, image)?;
            let count = (i + 2) as f64;
            for ((mean, squares), pixel) in means.iter_mut().zip(&mut squares).zip(image.pixels()) {
                for c in 0..3 {
                    let delta = f64::from(pixel[c]) - mean[c];
                    mean[c] += delta / count;
                    squares[c] += delta * (f64::from(pixel[c]) - mean[c]);
                }
            }
        }
        let freedom = (images.len() - 1) as f64;
        let variance = squares.into_iter().map(|channels| channels.map(|sum| sum / freedom)).collect();
        let mean = means.into_iter().map(|channels| channels.map(|value| value as f32)).collect();
        Ok(Self { mean: Image::new(first.width(), first.height(), mean)?, variance, renderings: images.len() })
    }

    pub fn mean(&self) -> &Image {
        &self.mean
    }

    pub fn renderings(&self) -> usize {
        self.renderings
    }
}

/// Tests whether `test` has the mean of `reference`, pixel by pixel.
///
/// # Errors
/// [`Error::Size`] when the sizes differ.
pub fn z_test(reference: &Moments, test: &Moments, options: &ZTestOptions) -> Result<ZTest, Error> {
    same_size(&reference.mean, &test.mean)?;
    let pixels = reference.mean.pixels().len();
    // Each channel of each pixel is one test.
    let alpha = -f64::exp_m1(f64::ln_1p(-options.significance) / (3 * pixels) as f64);
    let critical = critical_z(alpha);
    let variance = smoothed(reference);
    let share = 1.0 / reference.renderings as f64 + 1.0 / test.renderings as f64;
    let (mut failing, mut largest) = (0, 0.0_f64);
    for ((r, t), &(variance, neighbours)) in reference.mean.pixels().iter().zip(test.mean.pixels()).zip(&variance) {
        if !is_finite(r) || !is_finite(t) {
            failing += u64::from(is_finite(r) != is_finite(t));
            continue;
        }
        let freedom = neighbours * (reference.renderings - 1) as f64;
        let z = |c: usize| {
            let deviation = variance[c].sqrt().max(LEAST_DEVIATION) * share.sqrt();
            from_student((f64::from(t[c]) - f64::from(r[c])).abs() / deviation, freedom)
        };
        let worst = z(0).max(z(1)).max(z(2));
        largest = largest.max(worst);
        failing += u64::from(worst > critical);
    }
    Ok(ZTest { failing_pixels: failing, pixels: pixels as u64, max_z: largest, critical_z: critical })
}

/// Each channel's variance, or its average over the neighbourhood (borders cut off, what is not finite left out) where that
/// is larger; and the pixels of the neighbourhood.
fn smoothed(moments: &Moments) -> Vec<([f64; 3], f64)> {
    let (width, height) = (moments.mean.width(), moments.mean.height());
    let mut smoothed = Vec::with_capacity(moments.variance.len());
    for y in 0..height {
        let rows = y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height);
        for x in 0..width {
            let columns = x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(width);
            let (mut sum, mut count) = ([0.0; 3], 0.0_f64);
            for row in rows.clone() {
                for variance in &moments.variance[row * width..][columns.clone()] {
                    if variance.iter().all(|value| value.is_finite()) {
                        sum.iter_mut().zip(variance).for_each(|(sum, value)| *sum += value);
                        count += 1.0;
                    }
                }
            }
            let own = moments.variance[y * width + x];
            let count = count.max(1.0);
            smoothed.push((std::array::from_fn(|c| (sum[c] / count).max(own[c])), count));
        }
    }
    smoothed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{flat, noise};

    /// Renderings of a grey field whose pixels scatter as means of twelve uniform samples do: almost normally, with a
    /// standard deviation of `spread`.
    fn renderings(count: u64, seed: u64, grey: f32, spread: f32) -> Vec<Image> {
        let one = |i: u64| {
            let mut pixels = vec![[0.0_f32; 3]; 32 * 24];
            for draw in 0..12 {
                // Far apart: the streams of near seeds overlap.
                let sample = noise(32, 24, (seed * 1009 + i * 101 + draw).wrapping_mul(0xd134_2543_de82_ef95));
                for (sum, drawn) in pixels.iter_mut().flatten().zip(sample.pixels().iter().flatten()) {
                    *sum += drawn;
                }
            }
            let scaled = pixels.into_iter().map(|pixel| pixel.map(|sum| grey + spread * (sum - 6.0)));
            Image::new(32, 24, scaled.collect()).unwrap()
        };
        (0..count).map(one).collect()
    }

    fn moments(seed: u64, grey: f32) -> Moments {
        Moments::of(&renderings(6, seed, grey, 0.1)).unwrap()
    }

    const OPTIONS: ZTestOptions = ZTestOptions { significance: 0.01 };

    #[test]
    fn moments_are_those_of_the_renderings() {
        let images = [flat(2, 2, [1.0, 2.0, 0.0]), flat(2, 2, [3.0, 2.0, 0.0]), flat(2, 2, [5.0, 2.0, 3.0])];
        let moments = Moments::of(&images).unwrap();
        assert_eq!(moments.mean().pixels()[3], [3.0, 2.0, 1.0]);
        assert_eq!(moments.variance[0], [4.0, 0.0, 3.0]);
        assert!(matches!(Moments::of(&images[..1]), Err(Error::Renderings { found: 1 })));
        assert!(Moments::of(&[flat(1, 2, [0.0; 3]), flat(2, 1, [0.0; 3])]).is_err());
    }

    #[test]
    fn pure_noise_fails_as_often_as_it_may() {
        let failing: Vec<u64> = (0..100)
            .map(|i| z_test(&moments(2 * i, 0.5), &moments(2 * i + 1, 0.5), &OPTIONS).unwrap().failing_pixels)
            .filter(|&pixels| pixels > 0)
            .collect();
        assert!(failing.len() <= 4, "of 100 at a significance of 1 %: {failing:?}");
    }

    #[test]
    fn a_shift_that_the_noise_cannot_explain_fails() {
        let reference = moments(1, 0.5);
        let result = z_test(&reference, &moments(2, 1.2), &OPTIONS).unwrap();
        assert_eq!(result.failing_pixels, result.pixels, "12 standard errors: {result:?}");
        let mut images = renderings(6, 3, 0.5, 0.1);
        for image in &mut images {
            let mut pixels = image.pixels().to_vec();
            pixels[100][1] += 1.0;
            *image = Image::new(32, 24, pixels).unwrap();
        }
        let result = z_test(&reference, &Moments::of(&images).unwrap(), &OPTIONS).unwrap();
        assert_eq!(result.failing_pixels, 1, "one pixel: {result:?}");
    }

    #[test]
    fn the_significance_is_sidaks() {
        // 1 - 0.99^(1/2304) = 4.36207e-6, whose quantile is 4.594 (R: qnorm(1 - alpha / 2)).
        let result = z_test(&moments(1, 0.5), &moments(2, 0.5), &OPTIONS).unwrap();
        assert!((result.critical_z - 4.594).abs() < 2e-3, "{result:?}");
    }

    #[test]
    fn what_is_not_finite_on_one_side_fails() {
        let broken = Moments::of(&[flat(2, 1, [f32::NAN; 3]), flat(2, 1, [f32::NAN; 3])]).unwrap();
        let whole = Moments::of(&[flat(2, 1, [0.0; 3]), flat(2, 1, [0.0; 3])]).unwrap();
        assert_eq!(z_test(&whole, &broken, &OPTIONS).unwrap().failing_pixels, 2);
        assert_eq!(z_test(&broken, &broken, &OPTIONS).unwrap().failing_pixels, 0);
        assert_eq!(z_test(&whole, &whole, &OPTIONS).unwrap().max_z, 0.0);
    }
}
