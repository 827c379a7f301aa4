//! Peak signal-to-noise ratio.

use crate::image::{Error, Image, same_size};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::flat;

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
}
