//! HDR-FLIP: the difference that a person sees in two high-dynamic-range images at the exposure that shows it best
//! (Andersson, Nilsson, Shirley and Akenine-Moller 2021, "Visualizing Errors in Rendered High Dynamic Range Images",
//! Eurographics Short Papers).
//!
//! Both images are shown at several exposures through one tone mapper, and a pixel's error is its largest LDR-FLIP error.
//! The exposures reach from the one at which the reference's brightest pixel is just not blown out to the one at which
//! half of its pixels are, one or less apart. `tests/nvidia_flip.rs` compares the figures with NVIDIA's.

use crate::flip::flip_shown;
use crate::image::{Error, Image, is_finite, luminance, same_size};
use crate::plane::Plane;

/// Tone mapper: `(a x^2 + b x) / (c x^2 + d x + e)`, Narkowicz' fit of the filmic curve of ACES without its factor 0.6
/// of exposure.
const ACES: [f32; 5] = [0.36 * 2.51, 0.6 * 0.03, 0.36 * 2.43, 0.6 * 0.59, 0.14];
/// A tone-mapped luminance above this counts as blown out (section 3).
const BLOWN_OUT: f32 = 0.85;
/// The tone mapper is 1 from far below this on. Larger squares could overflow.
const LARGEST: f32 = 1e4;
/// Exposures at most; the paper has no limit. Reached only where the brightest pixel is 2^42 times the median.
const MOST_EXPOSURES: u32 = 42;

/// Stops at which images are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposures {
    pub start: f32,
    pub stop: f32,
    /// Evenly from `start` to `stop`, both included; at least 2.
    pub count: u32,
}

#[derive(Clone, Debug, PartialEq)]
pub struct HdrFlip {
    /// 0 to 1 per pixel: the largest error at any exposure.
    pub error: Plane,
    pub exposures: Exposures,
}

/// HDR-FLIP errors of two linear images. A pixel with a NaN or an infinity in one image only has the error 1. Exposures
/// are those of the reference, or of the test image when the reference is black.
///
/// # Errors
/// [`Error::Size`] when the sizes differ.
pub fn hdr_flip(reference: &Image, test: &Image, pixels_per_degree: f32) -> Result<HdrFlip, Error> {
    same_size(reference, test)?;
    let exposures = Exposures::of(reference).or_else(|| Exposures::of(test)).unwrap_or(Exposures::AS_IT_IS);
    let mut largest = reference.plane(vec![0.0; reference.pixels().len()]);
    for exposure in exposures.iter() {
        let scale = exposure.exp2();
        let error = flip_shown(reference, test, pixels_per_degree, |channel| aces(channel * scale))?;
        largest = largest.map2(&error, f32::max);
    }
    Ok(HdrFlip { error: largest, exposures })
}

impl Exposures {
    const AS_IT_IS: Self = Self { start: 0.0, stop: 0.0, count: 2 };

    /// Those that show all of an image (section 3); `None` of a black one.
    fn of(image: &Image) -> Option<Self> {
        let finite = image.pixels().iter().filter(|pixel| is_finite(pixel));
        let mut luminances: Vec<f32> = finite.map(|&pixel| luminance(pixel)).collect();
        let middle = luminances.len() / 2;
        let brightest = luminances.iter().copied().fold(0.0, f32::max);
        if brightest <= 0.0 {
            return None;
        }
        let (_, &mut median, _) = luminances.select_nth_unstable_by(middle, f32::total_cmp);
        let white = blown_out();
        let start = (white / brightest).log2();
        let stop = (white / median.max(f32::EPSILON)).log2().max(start);
        Some(Self { start, stop, count: ((stop - start).ceil() as u32).clamp(2, MOST_EXPOSURES) })
    }

    /// Every exposure, in stops.
    pub fn iter(self) -> impl Iterator<Item = f32> {
        let step = (self.stop - self.start) / (self.count - 1) as f32;
        (0..self.count).map(move |i| self.start + i as f32 * step)
    }
}

/// What a display shows of a linear channel; NaN of NaN.
fn aces(channel: f32) -> f32 {
    let [a, b, c, d, e] = ACES;
    let x = channel.clamp(0.0, LARGEST);
    (x * (a * x + b)) / (x * (c * x + d) + e)
}

/// The luminance that the tone mapper shows as [`BLOWN_OUT`]: the positive root of a quadratic equation.
fn blown_out() -> f32 {
    let [a, b, c, d, e] = ACES;
    let (a, b, c) = (a - BLOWN_OUT * c, b - BLOWN_OUT * d, -BLOWN_OUT * e);
    (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flip::{PIXELS_PER_DEGREE, flip};
    use crate::test_images::{flat, gradient, noise, shifted};

    fn with_pixel(image: &Image, at: usize, color: [f32; 3]) -> Image {
        let mut pixels = image.pixels().to_vec();
        pixels[at] = color;
        Image::new(image.width(), image.height(), pixels).unwrap()
    }

    fn of(reference: &Image, test: &Image) -> HdrFlip {
        hdr_flip(reference, test, PIXELS_PER_DEGREE).unwrap()
    }

    #[test]
    fn the_tone_mapper_shows_white_where_it_should() {
        assert!((aces(blown_out()) - BLOWN_OUT).abs() < 1e-6);
        assert_eq!((aces(0.0), aces(-1.0)), (0.0, 0.0));
        assert!(aces(LARGEST) > 1.0 && aces(f32::INFINITY) == aces(LARGEST) && aces(f32::NAN).is_nan());
    }

    #[test]
    fn exposures_reach_from_the_brightest_pixel_to_the_median() {
        let image = with_pixel(&flat(8, 8, [1.0; 3]), 5, [64.0; 3]);
        let found = Exposures::of(&image).unwrap();
        assert!((found.stop - found.start - 6.0).abs() < 1e-4, "{found:?}");
        assert!(found.count == 6 || found.count == 7, "{found:?}");
        let all: Vec<f32> = found.iter().collect();
        assert_eq!((all.len() as u32, all[0]), (found.count, found.start));
        assert!((all[all.len() - 1] - found.stop).abs() < 1e-5);
        assert_eq!(Exposures::of(&flat(3, 3, [0.5; 3])).unwrap().count, 2, "one brightness");
        assert_eq!(Exposures::of(&flat(3, 3, [0.0; 3])), None);
        assert_eq!(Exposures::of(&flat(3, 3, [f32::NAN; 3])), None);
        let firefly = with_pixel(&flat(8, 8, [0.0; 3]), 5, [1e38; 3]);
        assert_eq!(Exposures::of(&firefly).unwrap().count, MOST_EXPOSURES);
    }

    #[test]
    fn differences_count_that_one_exposure_would_clip() {
        let dim = gradient(40, 30);
        let (bright, brighter) = (with_pixel(&dim, 600, [400.0; 3]), with_pixel(&dim, 600, [900.0; 3]));
        assert_eq!(flip(&bright, &brighter, 0.0, PIXELS_PER_DEGREE).unwrap().mean(), 0.0, "both are white");
        assert!(of(&bright, &brighter).error.values()[600] > 0.05);
    }

    #[test]
    fn no_exposure_has_a_larger_error() {
        let (reference, test) = (gradient(40, 30), shifted(&gradient(40, 30), 2));
        let found = of(&reference, &test);
        for exposure in found.exposures.iter() {
            let scale = exposure.exp2();
            let one = flip_shown(&reference, &test, PIXELS_PER_DEGREE, |c| aces(c * scale)).unwrap();
            assert!(one.values().iter().zip(found.error.values()).all(|(one, largest)| one <= largest));
        }
        assert!(found.error.values().iter().all(|error| (0.0..=1.0).contains(error)));
    }

    #[test]
    fn identical_images_have_no_error_whatever_they_hold() {
        let broken = with_pixel(&noise(20, 10, 3), 7, [f32::NAN, 1e38, -2.0]);
        for image in [noise(20, 10, 1), flat(4, 4, [0.0; 3]), flat(1, 1, [1e38; 3]), broken] {
            assert_eq!(of(&image, &image).error.mean(), 0.0);
        }
    }

    #[test]
    fn what_is_finite_in_one_image_only_is_the_worst_error() {
        let clean = flat(32, 32, [0.5; 3]);
        for wrong in [f32::NAN, f32::INFINITY] {
            let error = of(&clean, &with_pixel(&clean, 100, [wrong; 3])).error;
            assert_eq!(error.values()[100], 1.0);
        }
        let huge = of(&clean, &with_pixel(&clean, 100, [f32::MAX; 3])).error;
        assert!(huge.values()[100] < 1.0, "white is no infinity");
        assert!(of(&flat(8, 8, [0.0; 3]), &flat(8, 8, [1.0; 3])).error.mean() > 0.5, "a black reference");
    }

    #[test]
    fn sizes_must_agree() {
        assert!(hdr_flip(&flat(2, 2, [0.0; 3]), &flat(2, 1, [0.0; 3]), PIXELS_PER_DEGREE).is_err());
    }
}
