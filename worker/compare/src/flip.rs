//! LDR-FLIP: the difference that a person sees when two pictures alternate at one place (Andersson, Nilsson,
//! Akenine-Moller, Oskarsson, Astrom and Fairchild 2020, "FLIP: A Difference Evaluator for Alternating Images",
//! Proc. ACM Comput. Graph. Interact. Tech. 3(2)). Sections below are the paper's.
//!
//! Its Gaussians are separable, and so filtered here: the blue-yellow channel's sum of two Gaussians is filtered twice.
//! Tests compare every pixel with NVIDIA's own implementation.

use crate::image::{Error, Image, is_finite, same_size};
use crate::plane::Plane;

/// Pixels per degree of visual angle of the paper's viewer: 0.7 m away from a 0.7 m wide display of 3840 pixels.
pub const PIXELS_PER_DEGREE: f32 = 67.020_64;

/// Contrast sensitivity as Gaussians `a sqrt(pi/b) exp(-pi^2 x^2 / b)` (table 1): achromatic, red-green and the two of
/// blue-yellow.
const CSF: [(f32, f32); 4] = [(1.0, 0.0047), (1.0, 0.0053), (34.1, 0.04), (13.5, 0.025)];
/// Exponent of the colour distance (section 4.1.3).
const Q_C: f32 = 0.7;
/// Colour distances below this share of the largest one ...
const P_C: f32 = 0.4;
/// ... fill this share of the error range.
const P_T: f32 = 0.95;
/// Width of the feature detectors in degrees (section 4.2).
const FEATURE_WIDTH_DEG: f32 = 0.082;
/// Exponent of the feature difference.
const Q_F: f32 = 0.5;

/// FLIP errors, 0 to 1 per pixel, of two linear images shown with `2^exposure` and clamped to 0..1.
/// A pixel with a NaN or an infinity in one image only has the error 1.
///
/// # Errors
/// [`Error::Size`] when the sizes differ.
pub fn flip(reference: &Image, test: &Image, exposure: f32, pixels_per_degree: f32) -> Result<Plane, Error> {
    let scale = exposure.exp2();
    flip_shown(reference, test, pixels_per_degree, |channel| channel * scale)
}

/// FLIP errors of two images whose channels a display shows as `tone` of them, clamped to 0..1.
pub(crate) fn flip_shown(
    reference: &Image,
    test: &Image,
    pixels_per_degree: f32,
    tone: impl Fn(f32) -> f32,
) -> Result<Plane, Error> {
    same_size(reference, test)?;
    let (r, t) = (Opponent::new(reference, &tone), Opponent::new(test, &tone));
    let color = color_difference(&r, &t, pixels_per_degree);
    let feature = feature_difference(&r, &t, pixels_per_degree);
    let mut error: Vec<f32> = color.iter().zip(&feature).map(|(color, feature)| color.powf(1.0 - feature)).collect();
    for (error, (r, t)) in error.iter_mut().zip(reference.pixels().iter().zip(test.pixels())) {
        if is_finite(r) != is_finite(t) {
            *error = 1.0;
        }
    }
    Ok(reference.plane(error))
}

/// An image in the opponent space YCxCz (section 3): achromatic, red-green, blue-yellow.
struct Opponent {
    y: Plane,
    cx: Plane,
    cz: Plane,
}

impl Opponent {
    /// Channels that are NaN become 0.
    fn new(image: &Image, tone: impl Fn(f32) -> f32) -> Self {
        let pixels: Vec<[f32; 3]> = image
            .pixels()
            .iter()
            .map(|pixel| {
                let [x, y, z] = relative_xyz(pixel.map(|channel| tone(channel).clamp(0.0, 1.0).max(0.0)));
                [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
            })
            .collect();
        let plane = |channel: usize| image.plane(pixels.iter().map(|pixel| pixel[channel]).collect());
        Self { y: plane(0), cx: plane(1), cz: plane(2) }
    }

    /// Blurs by the contrast sensitivity of each channel, clamps to the RGB cube, and returns Hunt-adjusted L*a*b*
    /// (sections 4.1.1 and 4.1.2).
    fn as_seen(&self, kernels: &[Vec<f32>; 4]) -> Vec<[f32; 3]> {
        let [achromatic, red_green, blue_yellow_1, blue_yellow_2] = kernels;
        let y = self.y.filter(achromatic, achromatic);
        let cx = self.cx.filter(red_green, red_green);
        let cz_1 = self.cz.filter(blue_yellow_1, blue_yellow_1);
        let cz = cz_1.map2(&self.cz.filter(blue_yellow_2, blue_yellow_2), |a, b| a + b);
        let channels = y.values().iter().zip(cx.values()).zip(cz.values());
        channels
            .map(|((&y, &cx), &cz)| {
                let y = (y + 16.0) / 116.0;
                let rgb = linear_rgb([y + cx / 500.0, y, y - cz / 200.0]);
                hunt_lab(rgb.map(|c| c.clamp(0.0, 1.0)))
            })
            .collect()
    }
}

/// Section 4.1: filtered colours compared by HyAB, remapped to 0..1.
fn color_difference(reference: &Opponent, test: &Opponent, pixels_per_degree: f32) -> Vec<f32> {
    let kernels = contrast_sensitivity(pixels_per_degree);
    let largest = hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])).powf(Q_C);
    let knee = P_C * largest;
    let (reference, test) = (reference.as_seen(&kernels), test.as_seen(&kernels));
    let pairs = reference.into_iter().zip(test);
    pairs
        .map(|(r, t)| {
            let distance = hyab(r, t).powf(Q_C);
            if distance < knee {
                distance * P_T / knee
            } else {
                P_T + (distance - knee) / (largest - knee) * (1.0 - P_T)
            }
        })
        .collect()
}

/// Section 4.2: edges and points that one image has and the other lacks.
fn feature_difference(reference: &Opponent, test: &Opponent, pixels_per_degree: f32) -> Vec<f32> {
    let kernel = FeatureKernel::new(pixels_per_degree);
    let (reference, test) = (kernel.detect(&reference.y), kernel.detect(&test.y));
    let pairs = reference.into_iter().zip(test);
    pairs
        .map(|((edge_r, point_r), (edge_t, point_t))| {
            let difference = (edge_r - edge_t).abs().max((point_r - point_t).abs());
            (difference * std::f32::consts::FRAC_1_SQRT_2).powf(Q_F)
        })
        .collect()
}

/// A Gaussian and its first two derivatives; weights of each sign sum to 1 (the derivatives) or all to 1.
struct FeatureKernel {
    gaussian: Vec<f32>,
    edge: Vec<f32>,
    point: Vec<f32>,
}

impl FeatureKernel {
    fn new(pixels_per_degree: f32) -> Self {
        let sigma = 0.5 * FEATURE_WIDTH_DEG * pixels_per_degree;
        let radius = (3.0 * sigma).ceil() as i32;
        let weights = |f: &dyn Fn(f32, f32) -> f32| -> Vec<f32> {
            (-radius..=radius)
                .map(|x| {
                    let x = x as f32;
                    f(x, (-x * x / (2.0 * sigma * sigma)).exp())
                })
                .collect()
        };
        Self {
            gaussian: normalized_by_sign(weights(&|_, g| g)),
            edge: normalized_by_sign(weights(&|x, g| -x * g)),
            point: normalized_by_sign(weights(&|x, g| (x * x / (sigma * sigma) - 1.0) * g)),
        }
    }

    /// Edge and point strength of every pixel.
    fn detect(&self, y: &Plane) -> Vec<(f32, f32)> {
        let gray = y.map2(y, |y, _| (y + 16.0) / 116.0);
        let length = |a: Plane, b: Plane| a.map2(&b, f32::hypot);
        let edges = length(gray.filter(&self.edge, &self.gaussian), gray.filter(&self.gaussian, &self.edge));
        let points = length(gray.filter(&self.point, &self.gaussian), gray.filter(&self.gaussian, &self.point));
        edges.values().iter().copied().zip(points.values().iter().copied()).collect()
    }
}

fn normalized_by_sign(mut weights: Vec<f32>) -> Vec<f32> {
    let positive: f32 = weights.iter().filter(|w| **w > 0.0).sum();
    let negative: f32 = -weights.iter().filter(|w| **w < 0.0).sum::<f32>();
    for weight in &mut weights {
        *weight /= if *weight > 0.0 { positive } else { negative.max(f32::MIN_POSITIVE) };
    }
    weights
}

/// One-dimensional factors of the four Gaussians of [`CSF`]; each channel's two-dimensional weights sum to 1.
fn contrast_sensitivity(pixels_per_degree: f32) -> [Vec<f32>; 4] {
    use std::f32::consts::PI;
    let widest = CSF.iter().fold(0.0_f32, |widest, &(_, b)| widest.max(b));
    let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as i32;
    let mut kernels = CSF.map(|(a, b)| -> Vec<f32> {
        let height = (a * (PI / b).sqrt()).sqrt();
        (-radius..=radius)
            .map(|x| {
                let degrees = x as f32 / pixels_per_degree;
                height * (-PI * PI * degrees * degrees / b).exp()
            })
            .collect()
    });
    let sums = kernels.each_ref().map(|kernel| kernel.iter().sum::<f32>());
    let blue_yellow = sums[2].hypot(sums[3]);
    for (kernel, sum) in kernels.iter_mut().zip([sums[0], sums[1], blue_yellow, blue_yellow]) {
        kernel.iter_mut().for_each(|weight| *weight /= sum);
    }
    kernels
}

/// Distance of large colour differences (Abasi, Tehran and Fairchild 2019).
fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// CIE L*a*b* with its chroma scaled by lightness (the Hunt effect).
fn hunt_lab(linear: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| if t > DELTA * DELTA * DELTA { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let [x, y, z] = relative_xyz(linear).map(f);
    let lightness = 116.0 * y - 16.0;
    let hunt = 0.01 * lightness;
    [lightness, hunt * 500.0 * (x - y), hunt * 200.0 * (y - z)]
}

/// White of D65 as the sum of the sRGB primaries.
const WHITE: [f32; 3] = [0.950_428_5, 1.0, 1.088_900_4];

/// XYZ of linear sRGB, relative to white.
fn relative_xyz([r, g, b]: [f32; 3]) -> [f32; 3] {
    [
        (0.412_386_56 * r + 0.357_591_5 * g + 0.180_450_5 * b) / WHITE[0],
        (0.212_636_8 * r + 0.715_183 * g + 0.072_180_2 * b) / WHITE[1],
        (0.019_330_62 * r + 0.119_197_16 * g + 0.950_372_6 * b) / WHITE[2],
    ]
}

/// The inverse of [`relative_xyz`].
fn linear_rgb(relative: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = [relative[0] * WHITE[0], relative[1] * WHITE[1], relative[2] * WHITE[2]];
    [
        3.241_003_3 * x - 1.537_399 * y - 0.498_615_86 * z,
        -0.969_224_33 * x + 1.875_930_1 * y + 0.041_554_224 * z,
        0.055_639_423 * x - 0.204_011_2 * y + 1.057_148_9 * z,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{flat, gradient, noise, shifted};

    /// Largest per-pixel difference between our errors and NVIDIA's, and the difference of the means.
    fn against_nvidia(reference: &Image, test: &Image, pixels_per_degree: f32) -> (f32, f64) {
        let (width, height) = (reference.width(), reference.height());
        let (reference_bytes, test_bytes) = (reference.to_srgb8(0.0), test.to_srgb8(0.0));
        let nvidia = |bytes: &[u8]| nv_flip::FlipImageRgb8::with_data(width as u32, height as u32, bytes);
        let theirs = nv_flip::flip(nvidia(&reference_bytes), nvidia(&test_bytes), pixels_per_degree).to_vec();

        let ours = |bytes: &[u8]| Image::from_srgb8(width, height, bytes).unwrap();
        let ours = flip(&ours(&reference_bytes), &ours(&test_bytes), 0.0, pixels_per_degree).unwrap();
        let worst = ours.values().iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let mean = theirs.iter().map(|&v| f64::from(v)).sum::<f64>() / theirs.len() as f64;
        (worst, (ours.mean() - mean).abs())
    }

    #[test]
    fn every_pixel_agrees_with_nvidias_implementation() {
        let (gradient, noise_1, noise_2) = (gradient(96, 64), noise(96, 64, 1), noise(96, 64, 2));
        let pairs = [
            ("noise on noise", noise_1.clone(), noise_2),
            ("a shifted gradient", gradient.clone(), shifted(&gradient, 3)),
            ("a shifted noise", noise_1.clone(), shifted(&noise_1, 1)),
            ("noise on a gradient", gradient, noise_1),
            ("black and white", flat(40, 30, [0.0; 3]), flat(40, 30, [1.0; 3])),
            ("green and blue", flat(40, 30, [0.0, 1.0, 0.0]), flat(40, 30, [0.0, 0.0, 1.0])),
        ];
        for (name, reference, test) in pairs {
            for pixels_per_degree in [PIXELS_PER_DEGREE, 24.0] {
                let (worst, mean) = against_nvidia(&reference, &test, pixels_per_degree);
                assert!(worst < 1e-3, "{name} at {pixels_per_degree}: a pixel differs by {worst}");
                assert!(mean < 1e-4, "{name} at {pixels_per_degree}: the means differ by {mean}");
            }
        }
    }

    #[test]
    fn identical_images_have_no_error() {
        for image in [noise(50, 20, 5), gradient(33, 21), flat(1, 1, [0.3; 3])] {
            let error = flip(&image, &image, 0.0, PIXELS_PER_DEGREE).unwrap();
            assert!(error.values().iter().all(|&e| e == 0.0));
        }
    }

    #[test]
    fn errors_stay_in_range_and_grow_with_the_shift() {
        let image = gradient(96, 64);
        let means: Vec<f64> = [1, 4, 12]
            .iter()
            .map(|&by| {
                let error = flip(&image, &shifted(&image, by), 0.0, PIXELS_PER_DEGREE).unwrap();
                assert!(error.values().iter().all(|e| (0.0..=1.0).contains(e)));
                error.mean()
            })
            .collect();
        assert!(means[0] > 0.0 && means[0] < means[1] && means[1] < means[2], "{means:?}");
    }

    #[test]
    fn a_nan_in_one_image_is_the_worst_error_and_does_not_spread() {
        let clean = flat(64, 64, [0.0; 3]);
        let mut pixels = clean.pixels().to_vec();
        pixels[32 * 64 + 32] = [0.0, f32::NAN, 0.0];
        let broken = Image::new(64, 64, pixels).unwrap();
        let error = flip(&clean, &broken, 0.0, PIXELS_PER_DEGREE).unwrap();
        assert_eq!(error.values()[32 * 64 + 32], 1.0);
        assert_eq!(error.values().iter().filter(|&&e| e != 0.0).count(), 1);
        let both = flip(&broken, &broken, 0.0, PIXELS_PER_DEGREE).unwrap();
        assert!(both.values().iter().all(|&e| e == 0.0));
    }

    #[test]
    fn exposure_reveals_differences_in_highlights() {
        let (a, b) = (flat(16, 16, [2.0; 3]), flat(16, 16, [3.0; 3]));
        assert_eq!(flip(&a, &b, 0.0, PIXELS_PER_DEGREE).unwrap().mean(), 0.0, "both are clipped to white");
        assert!(flip(&a, &b, -2.0, PIXELS_PER_DEGREE).unwrap().mean() > 0.05);
    }

    #[test]
    fn sizes_must_agree() {
        assert!(flip(&flat(2, 2, [0.0; 3]), &flat(2, 1, [0.0; 3]), 0.0, PIXELS_PER_DEGREE).is_err());
    }
}
