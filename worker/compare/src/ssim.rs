//! Structural similarity (Wang, Bovik, Sheikh and Simoncelli 2004, "Image quality assessment: from error visibility to
//! structural similarity").

use crate::image::{Error, Image, luminance, same_size};
use crate::plane::Plane;

/// Mean SSIM: 1 for identical images, near 0 for unrelated ones, below 0 for opposite ones.
///
/// On the luma of the sRGB-encoded images (`2^exposure`, clamped to 0..1), with the paper's 11 x 11 Gaussian window of
/// standard deviation 1.5, `K1 = 0.01`, `K2 = 0.03`; windows at the border repeat the nearest pixel.
///
/// # Errors
/// [`Error::Size`] when the sizes differ.
pub fn ssim(reference: &Image, test: &Image, exposure: f32) -> Result<f64, Error> {
    same_size(reference, test)?;
    const C1: f32 = 0.01 * 0.01;
    const C2: f32 = 0.03 * 0.03;
    let window = gaussian_window();
    let blur = |plane: &Plane| plane.filter(&window, &window);

    let (x, y) = (luma(reference, exposure), luma(test, exposure));
    let (mean_x, mean_y) = (blur(&x), blur(&y));
    let (xx, yy, xy) =
        (blur(&x.map2(&x, |a, b| a * b)), blur(&y.map2(&y, |a, b| a * b)), blur(&x.map2(&y, |a, b| a * b)));
    let pixels = reference.pixels().len();
    let sum: f64 = (0..pixels)
        .map(|i| {
            let (mx, my) = (mean_x.values()[i], mean_y.values()[i]);
            let (var_x, var_y) = (xx.values()[i] - mx * mx, yy.values()[i] - my * my);
            let covariance = xy.values()[i] - mx * my;
            let similarity = (2.0 * mx * my + C1) * (2.0 * covariance + C2)
                / ((mx * mx + my * my + C1) * (var_x.max(0.0) + var_y.max(0.0) + C2));
            f64::from(similarity)
        })
        .sum();
    Ok(sum / pixels as f64)
}

fn luma(image: &Image, exposure: f32) -> Plane {
    image.plane(image.encoded(exposure).into_iter().map(luminance).collect())
}

fn gaussian_window() -> [f32; 11] {
    const SIGMA: f32 = 1.5;
    let weights: [f32; 11] = std::array::from_fn(|i| (-(i as f32 - 5.0).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
    let sum: f32 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{flat, noise, shifted};

    #[test]
    fn identical_is_one_and_unrelated_noise_is_near_zero() {
        let a = noise(64, 48, 1);
        assert!((ssim(&a, &a, 0.0).unwrap() - 1.0).abs() < 1e-6);
        let unrelated = ssim(&a, &noise(64, 48, 2), 0.0).unwrap();
        assert!(unrelated.abs() < 0.2, "{unrelated}");
    }

    #[test]
    fn flat_images_follow_the_luminance_term() {
        let (a, b) = (flat(20, 20, [0.0; 3]), flat(20, 20, [1.0; 3]));
        let expected = 0.01_f64.powi(2) / (1.0 + 0.01_f64.powi(2));
        assert!((ssim(&a, &b, 0.0).unwrap() - expected).abs() < 1e-6);
    }

    #[test]
    fn a_shifted_image_is_no_longer_similar() {
        let a = noise(64, 64, 3);
        let near = ssim(&a, &shifted(&a, 1), 0.0).unwrap();
        assert!(near < 0.9, "{near}");
        assert!(ssim(&a, &flat(1, 1, [0.0; 3]), 0.0).is_err());
    }
}
