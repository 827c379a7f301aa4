//! Errors per channel, on linear values.
//!
//! A pixel with a NaN or an infinity in either image cannot be part of a mean: it is left out here, and counted as
//! [`Differences::non_finite_pixels`].

use serde::Serialize;

use crate::image::{Error, Image, is_finite, luminance, same_size};

/// Added to the squared reference value in [`Differences::rel_mse`], so that black references do not divide by zero
/// (Rousselle et al. 2011, "Adaptive sampling and reconstruction using greedy error minimization", section 3).
pub const REL_MSE_EPSILON: f64 = 0.01;

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Differences {
    /// Root of the mean squared difference over all channels of all pixels.
    pub rmse: f64,
    /// Mean over all channels of all pixels of `(test - reference)^2 / (reference^2 + 0.01)`.
    pub rel_mse: f64,
    /// Mean absolute difference over all channels of all pixels.
    pub mae: f64,
    /// Mean luminance of the test image over that of the reference; null when the reference is black.
    pub mean_ratio: Option<f64>,
    /// Largest difference of any channel.
    pub max_difference: f64,
    /// Column and row of the first pixel with the largest difference; null when none differs.
    pub max_at: Option<[u32; 2]>,
    /// Pixels that differ in any channel by more than the tolerance, or are NaN or infinite in one image only.
    pub differing_pixels: u64,
    /// Pixels with a NaN or an infinity in either image; left out of the figures above but `differing_pixels`.
    pub non_finite_pixels: u64,
    pub pixels: u64,
}

/// Compares `test` with `reference`. Channels that differ by at most `tolerance` (linear units) count as equal in
/// [`Differences::differing_pixels`].
///
/// # Errors
/// [`Error::Size`] when the sizes differ.
pub fn differences(reference: &Image, test: &Image, tolerance: f32) -> Result<Differences, Error> {
    same_size(reference, test)?;
    let (mut squared, mut absolute, mut relative) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut largest, mut largest_at) = (0.0_f64, None);
    let (mut reference_luminance, mut test_luminance) = (0.0_f64, 0.0_f64);
    let (mut differing, mut finite) = (0_u64, 0_u64);
    for (i, (r, t)) in reference.pixels().iter().zip(test.pixels()).enumerate() {
        if !is_finite(r) || !is_finite(t) {
            differing += u64::from(is_finite(r) != is_finite(t));
            continue;
        }
        finite += 1;
        let mut differs = false;
        for (&r, &t) in r.iter().zip(t) {
            let (reference, difference) = (f64::from(r), f64::from(t) - f64::from(r));
            squared += difference * difference;
            absolute += difference.abs();
            relative += difference * difference / (reference * reference + REL_MSE_EPSILON);
            if difference.abs() > largest {
                (largest, largest_at) = (difference.abs(), Some(i));
            }
            differs |= difference.abs() > f64::from(tolerance);
        }
        differing += u64::from(differs);
        reference_luminance += f64::from(luminance(*r));
        test_luminance += f64::from(luminance(*t));
    }
    let pixels = reference.pixels().len() as u64;
    let channels = (3 * finite).max(1) as f64;
    Ok(Differences {
        rmse: (squared / channels).sqrt(),
        mae: absolute / channels,
        rel_mse: relative / channels,
        mean_ratio: (reference_luminance > 0.0).then(|| test_luminance / reference_luminance),
        max_difference: largest,
        max_at: largest_at.map(|i| [(i % reference.width()) as u32, (i / reference.width()) as u32]),
        differing_pixels: differing,
        non_finite_pixels: pixels - finite,
        pixels,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{flat, noise};

    #[test]
    fn identical_images_differ_in_nothing() {
        let image = noise(31, 17, 1);
        let d = differences(&image, &image, 0.0).unwrap();
        assert_eq!((d.rmse, d.rel_mse, d.max_difference, d.differing_pixels), (0.0, 0.0, 0.0, 0));
        assert_eq!(d.mean_ratio, Some(1.0));
        assert_eq!((d.pixels, d.non_finite_pixels), (31 * 17, 0));
        assert_eq!((d.mae, d.max_at), (0.0, None));
    }

    #[test]
    fn known_differences_by_hand() {
        let d = differences(&flat(4, 4, [0.5; 3]), &flat(4, 4, [0.75; 3]), 0.0).unwrap();
        assert!((d.rmse - 0.25).abs() < 1e-12);
        assert!((d.rel_mse - 0.0625 / 0.26).abs() < 1e-12);
        assert!((d.mean_ratio.unwrap() - 1.5).abs() < 1e-6);
        assert_eq!(d.max_difference, 0.25);
        assert_eq!(d.differing_pixels, 16);
        assert_eq!(differences(&flat(1, 1, [0.5; 3]), &flat(1, 1, [0.75; 3]), 0.25).unwrap().differing_pixels, 0);
    }

    #[test]
    fn one_wrong_channel_of_one_pixel() {
        let mut pixels = vec![[1.0; 3]; 10];
        pixels[7][1] = 3.0;
        let test = Image::new(5, 2, pixels).unwrap();
        let d = differences(&flat(5, 2, [1.0; 3]), &test, 1e-3).unwrap();
        assert!((d.rmse - (4.0_f64 / 30.0).sqrt()).abs() < 1e-12);
        assert_eq!((d.max_difference, d.max_at, d.differing_pixels), (2.0, Some([2, 1]), 1));
        assert!((d.mae - 2.0 / 30.0).abs() < 1e-12);
    }

    #[test]
    fn black_reference_has_no_ratio() {
        let d = differences(&flat(2, 2, [0.0; 3]), &flat(2, 2, [1.0; 3]), 0.0).unwrap();
        assert_eq!(d.mean_ratio, None);
        assert!((d.rel_mse - 100.0).abs() < 1e-9);
    }

    #[test]
    fn nan_and_infinity_are_counted_and_left_out() {
        let mut pixels = vec![[0.5; 3]; 4];
        pixels[0][2] = f32::NAN;
        pixels[1] = [f32::INFINITY; 3];
        let broken = Image::new(2, 2, pixels).unwrap();
        let d = differences(&flat(2, 2, [0.5; 3]), &broken, 0.0).unwrap();
        assert_eq!((d.non_finite_pixels, d.differing_pixels), (2, 2));
        assert_eq!((d.rmse, d.mean_ratio), (0.0, Some(1.0)));

        let both = differences(&broken, &broken, 0.0).unwrap();
        assert_eq!((both.non_finite_pixels, both.differing_pixels), (2, 0));
        let nothing_left = flat(1, 1, [f32::NAN; 3]);
        let d = differences(&nothing_left, &nothing_left, 0.0).unwrap();
        assert_eq!((d.rmse, d.mean_ratio, d.non_finite_pixels), (0.0, None, 1));
    }

    #[test]
    fn sizes_must_agree() {
        let error = differences(&flat(2, 3, [0.0; 3]), &flat(3, 2, [0.0; 3]), 0.0).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the images differ in size: the reference has 2 x 3 pixels, the test image 3 x 2"
        );
    }
}
