//! Differences as a display shows them: PSNR, and a picture of where the images differ.

use crate::image::{Error, Image, same_size, srgb_encode};

/// Peak signal-to-noise ratio in dB of both images as a display shows them (see [`Image::to_srgb8`], but not quantised),
/// whose peak is 1. `None` where they are the same there: the ratio is infinite.
///
/// # Errors
/// [`Error::Size`] when the sizes differ.
pub fn psnr(reference: &Image, test: &Image, exposure: f32) -> Result<Option<f64>, Error> {
    same_size(reference, test)?;
    let (r, t) = (reference.encoded(exposure), test.encoded(exposure));
    let squared: f64 = r.iter().flatten().zip(t.iter().flatten()).map(|(&r, &t)| f64::from(t - r).powi(2)).sum();
    let mean = squared / (3 * r.len()) as f64;
    Ok((mean > 0.0).then(|| -10.0 * mean.log10()))
}

/// The absolute difference of each channel, multiplied by `gain`, clamped and sRGB-encoded: black where the images are the
/// same, three bytes per pixel. What is not finite in one of them only is white.
///
/// # Errors
/// [`Error::Size`] when the sizes differ.
pub fn difference_picture(reference: &Image, test: &Image, gain: f32) -> Result<Vec<u8>, Error> {
    same_size(reference, test)?;
    let channel = |r: f32, t: f32| {
        if r == t || (!r.is_finite() && !t.is_finite()) {
            return 0;
        }
        let difference = (t - r).abs() * gain;
        let shown = if difference.is_finite() { difference.min(1.0) } else { 1.0 };
        (srgb_encode(shown) * 255.0).round() as u8
    };
    let pairs = reference.pixels().iter().flatten().zip(test.pixels().iter().flatten());
    Ok(pairs.map(|(&r, &t)| channel(r, t)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{flat, noise};

    #[test]
    fn psnr_of_a_known_error_in_display_values() {
        let of = |a: u8, b: u8| {
            let image = |value: u8| Image::from_srgb8(4, 2, &[value; 24]).unwrap();
            psnr(&image(a), &image(b), 0.0).unwrap()
        };
        // 51 of 255 is a fifth: 10 log10 of 25.
        assert!((of(0, 51).unwrap() - 13.979_400_086_720_377).abs() < 1e-4);
        assert!((of(100, 101).unwrap() - 48.130_803_608_679_1).abs() < 1e-2, "one step of 255");
        assert_eq!(of(7, 7), None);
        assert_eq!(psnr(&flat(2, 2, [5.0; 3]), &flat(2, 2, [9.0; 3]), 0.0).unwrap(), None, "both are white");
    }

    #[test]
    fn the_picture_is_black_where_nothing_differs() {
        let image = noise(6, 5, 3);
        assert!(difference_picture(&image, &image, 10.0).unwrap().iter().all(|&byte| byte == 0));
        let bytes = difference_picture(&flat(1, 1, [0.5, 0.5, f32::NAN]), &flat(1, 1, [0.5, 1.0, 1.0]), 2.0).unwrap();
        assert_eq!(bytes, [0, 255, 255]);
        let halved = difference_picture(&flat(1, 1, [0.5; 3]), &flat(1, 1, [0.25; 3]), 2.0).unwrap();
        assert_eq!(halved, [188; 3], "linear 0.5");
        assert!(difference_picture(&flat(1, 1, [0.0; 3]), &flat(1, 2, [0.0; 3]), 1.0).is_err());
    }
}
