//! Everything about one pair of images at once.

use serde::Serialize;

use crate::error::{Differences, differences};
use crate::flip::{PIXELS_PER_DEGREE, flip};
use crate::image::{Error, Image};
use crate::plane::Plane;
use crate::psnr::psnr;
use crate::ssim::ssim;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Stops applied before encoding for FLIP and SSIM.
    pub exposure: f32,
    /// See [`PIXELS_PER_DEGREE`].
    pub pixels_per_degree: f32,
    /// Linear difference of a channel up to which a pixel counts as equal.
    pub tolerance: f32,
}

impl Default for Options {
    fn default() -> Self {
        Self { exposure: 0.0, pixels_per_degree: PIXELS_PER_DEGREE, tolerance: 0.0 }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Report {
    #[serde(flatten)]
    pub differences: Differences,
    /// See [`psnr`]; null where a display shows the same.
    pub psnr: Option<f64>,
    pub ssim: f64,
    pub flip_mean: f64,
    /// The error that 99 % of the pixels do not exceed.
    pub flip_p99: f64,
}

#[derive(Clone, Debug)]
pub struct Comparison {
    pub report: Report,
    /// FLIP error per pixel; [`crate::heat_map`] makes a picture of it.
    pub flip: Plane,
}

/// # Errors
/// [`Error::Size`] when the sizes differ.
pub fn compare(reference: &Image, test: &Image, options: &Options) -> Result<Comparison, Error> {
    let flip = flip(reference, test, options.exposure, options.pixels_per_degree)?;
    let report = Report {
        differences: differences(reference, test, options.tolerance)?,
        psnr: psnr(reference, test, options.exposure)?,
        ssim: ssim(reference, test, options.exposure)?,
        flip_mean: flip.mean(),
        flip_p99: f64::from(flip.percentile(0.99)),
    };
    Ok(Comparison { report, flip })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heat_map;
    use crate::test_images::{flat, noise};

    #[test]
    fn one_call_gives_every_figure_and_the_map() {
        let (a, b) = (noise(24, 16, 1), noise(24, 16, 2));
        let comparison = compare(&a, &b, &Options::default()).unwrap();
        let report = comparison.report;
        assert!(report.flip_mean > 0.05 && report.flip_mean < report.flip_p99 && report.flip_p99 <= 1.0);
        assert!(report.ssim < 0.5 && report.differences.rmse > 0.1);
        assert_eq!(heat_map(&comparison.flip).len(), 24 * 16 * 3);
    }

    #[test]
    fn sizes_must_agree() {
        assert!(compare(&flat(3, 1, [0.0; 3]), &flat(1, 3, [0.0; 3]), &Options::default()).is_err());
    }
}
