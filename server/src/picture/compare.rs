//! How far two layers are apart, as figures and as pictures.

use lightshaft_api::compare::CompareReport;
use lightshaft_compare::{Error, Image, Options, Plane, Report, compare, differences, flip, heat_map, psnr, ssim};
use lightshaft_engine::film::{AovLayer, LayerKind, encode_png_srgb8, integer_value};

use super::{Picture, PictureError, range, unreadable};

/// A layer with its size, ready to be compared.
pub struct Pixels {
    pub width: u32,
    pub height: u32,
    pub layer: AovLayer,
    pub is_color: bool,
}

/// Limits that a comparison must keep.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bounds {
    pub max_rmse: Option<f64>,
    pub max_flip: Option<f64>,
}

/// Figures, and the FLIP error of every pixel.
pub struct Outcome {
    pub figures: Report,
    pub flip: Plane,
}

impl Pixels {
    /// Reads one layer of a file.
    pub fn read(bytes: &[u8], layer: &str, max_pixels: u64) -> Result<Self, PictureError> {
        let picture = Picture::open(bytes, max_pixels)?;
        let index = picture.find(layer)?;
        let (width, height) = (picture.width, picture.height);
        let is_color = picture.layers[index].kind == LayerKind::Color;
        Ok(Self { width, height, layer: picture.read(index)?, is_color })
    }

    /// A picture's colour.
    pub fn color(image: &Image) -> Self {
        let layer = AovLayer::Vector(image.pixels().to_vec());
        Self { width: image.width() as u32, height: image.height() as u32, layer, is_color: true }
    }

    /// As three channels each; ids as floats, exact below 2^24, "none" as infinity.
    pub fn image(&self) -> Result<Image, Error> {
        let pixels: Vec<[f32; 3]> = match &self.layer {
            AovLayer::Vector(values) => values.clone(),
            AovLayer::Scalar(values) => values.iter().map(|&value| [value; 3]).collect(),
            AovLayer::Integer(values) => values.iter().map(|&value| [integer_value(value) as f32; 3]).collect(),
        };
        Image::new(self.width as usize, self.height as usize, pixels)
    }
}

/// Compares `b` with the reference `a`.
///
/// FLIP and SSIM are made for colours between black and white. Other layers are spread over the range that both
/// have in common, so that the greatest difference there can be is that between black and white.
///
/// # Errors
/// When the sizes differ.
pub fn layers(a: &Pixels, b: &Pixels, options: &Options) -> Result<Outcome, Error> {
    let (first, second) = (a.image()?, b.image()?);
    if a.is_color && b.is_color {
        let comparison = compare(&first, &second, options)?;
        return Ok(Outcome { figures: comparison.report, flip: comparison.flip });
    }
    let (low, span) = common_range(a, b);
    let spread = |image: &Image| {
        let pixels = image.pixels().iter().map(|pixel| pixel.map(|value| (value - low) / span)).collect();
        Image::new(image.width(), image.height(), pixels)
    };
    let differences = differences(&first, &second, options.tolerance)?;
    let (first, second) = (spread(&first)?, spread(&second)?);
    let flip = flip(&first, &second, 0.0, options.pixels_per_degree)?;
    let figures = Report {
        differences,
        psnr: psnr(&first, &second, 0.0)?,
        ssim: ssim(&first, &second, 0.0)?,
        flip_mean: flip.mean(),
        flip_p99: f64::from(flip.percentile(0.99)),
    };
    Ok(Outcome { figures, flip })
}

/// Least value of both, and the distance to the greatest, which is not 0.
fn common_range(a: &Pixels, b: &Pixels) -> (f32, f32) {
    let (a, b) = (range(&a.layer).bounds(), range(&b.layer).bounds());
    let low = a.iter().chain(&b).map(|bounds| bounds.0).fold(f64::INFINITY, f64::min);
    let high = a.iter().chain(&b).map(|bounds| bounds.1).fold(f64::NEG_INFINITY, f64::max);
    if low < high { (low as f32, (high - low) as f32) } else { (if low.is_finite() { low as f32 } else { 0.0 }, 1.0) }
}

/// The figures with the limits, and whether they are kept.
pub fn report(width: u32, height: u32, figures: &Report, bounds: Bounds) -> CompareReport {
    let differences = &figures.differences;
    let limits = [("RMSE", differences.rmse, bounds.max_rmse), ("mean FLIP", figures.flip_mean, bounds.max_flip)];
    let over_limits: Vec<String> = limits
        .into_iter()
        .filter_map(|(name, found, limit)| Some((name, found, limit?)))
        .filter(|&(_, found, limit)| found.is_nan() || found > limit)
        .map(|(name, found, limit)| format!("{name} is {found:.6}, over the limit of {limit}"))
        .collect();
    CompareReport {
        width,
        height,
        rmse: differences.rmse,
        rel_mse: differences.rel_mse,
        mae: differences.mae,
        psnr: figures.psnr,
        mean_ratio: differences.mean_ratio,
        max_difference: differences.max_difference,
        max_at: differences.max_at,
        differing_pixels: differences.differing_pixels,
        non_finite_pixels: differences.non_finite_pixels,
        pixels: differences.pixels,
        ssim: figures.ssim,
        flip_mean: figures.flip_mean,
        flip_p99: figures.flip_p99,
        max_rmse: bounds.max_rmse,
        max_flip: bounds.max_flip,
        passed: over_limits.is_empty(),
        over_limits,
    }
}

/// The FLIP error of every pixel as a PNG.
pub fn heat_map_png(flip: &Plane) -> Result<Vec<u8>, PictureError> {
    png(flip.width(), flip.height(), &heat_map(flip))
}

/// The absolute difference of every channel times `gain`, as a display shows it, as a PNG. Layers that are no colour are
/// spread over their common range first. What is not finite in one picture only is white.
///
/// # Errors
/// When the sizes differ.
pub fn difference_png(a: &Pixels, b: &Pixels, gain: f32) -> Result<Vec<u8>, PictureError> {
    if let Some(problem) = size_problem(a, b) {
        return Err(unreadable(problem));
    }
    let (first, second) = (a.image().map_err(unreadable)?, b.image().map_err(unreadable)?);
    let span = if a.is_color && b.is_color { 1.0 } else { common_range(a, b).1 };
    let apart = |(&a, &b): (&f32, &f32)| match (a.is_finite(), b.is_finite()) {
        (true, true) => (b - a).abs() / span * gain,
        (false, false) => 0.0,
        _ => 1.0,
    };
    let pairs = first.pixels().iter().zip(second.pixels());
    let pixels = pairs.map(|(a, b)| std::array::from_fn(|i| apart((&a[i], &b[i])))).collect();
    let shown = Image::new(a.width as usize, a.height as usize, pixels).map_err(unreadable)?;
    png(shown.width(), shown.height(), &shown.to_srgb8(0.0))
}

/// What is wrong with the second picture's size, if anything.
pub fn size_problem(a: &Pixels, b: &Pixels) -> Option<String> {
    let differs = (a.width, a.height) != (b.width, b.height);
    let detail = || format!("has {} x {} pixels, but the reference has {} x {}", b.width, b.height, a.width, a.height);
    differs.then(detail)
}

fn png(width: usize, height: usize, rgb: &[u8]) -> Result<Vec<u8>, PictureError> {
    encode_png_srgb8(width as u32, height as u32, rgb, &[]).map_err(unreadable)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scalar(values: &[f32]) -> Pixels {
        Pixels { width: values.len() as u32, height: 1, layer: AovLayer::Scalar(values.to_vec()), is_color: false }
    }

    fn ids(values: &[u32]) -> Pixels {
        Pixels { width: values.len() as u32, height: 1, layer: AovLayer::Integer(values.to_vec()), is_color: false }
    }

    #[test]
    fn depth_is_compared_in_its_own_units_and_infinity_is_no_difference() {
        let (a, b) = (scalar(&[1.0, 5.0, 100.0, f32::INFINITY]), scalar(&[1.0, 8.0, 100.0, f32::INFINITY]));
        let outcome = layers(&a, &b, &Options::default()).unwrap();
        let found = outcome.figures.differences;
        assert_eq!((found.max_difference, found.differing_pixels, found.non_finite_pixels), (3.0, 1, 1));
        assert!((found.rmse - 3.0_f64.sqrt()).abs() < 1e-9);
        assert!(outcome.figures.flip_mean > 0.0 && outcome.figures.flip_mean < 0.5);
        let same = layers(&a, &a, &Options::default()).unwrap();
        assert_eq!((same.figures.flip_mean, same.figures.differences.differing_pixels), (0.0, 0));
    }

    #[test]
    fn an_id_in_one_picture_only_is_a_difference() {
        let (a, b) = (ids(&[7, u32::MAX, 3]), ids(&[7, 5, 4]));
        let found = layers(&a, &b, &Options::default()).unwrap().figures.differences;
        assert_eq!((found.differing_pixels, found.non_finite_pixels), (2, 1));
        let nothing = ids(&[u32::MAX; 3]);
        assert_eq!(layers(&nothing, &nothing, &Options::default()).unwrap().figures.differences.differing_pixels, 0);
    }

    #[test]
    fn limits_are_kept_up_to_their_value() {
        let (a, b) = (scalar(&[0.0, 1.0]), scalar(&[0.0, 1.5]));
        let figures = layers(&a, &b, &Options::default()).unwrap().figures;
        let with = |max_rmse| report(2, 1, &figures, Bounds { max_rmse, max_flip: None });
        assert!(with(None).passed && with(Some(figures.differences.rmse)).passed);
        let over = with(Some(0.1));
        assert!(!over.passed);
        assert_eq!(over.over_limits, ["RMSE is 0.353553, over the limit of 0.1"]);
    }

    #[test]
    fn the_difference_picture_is_black_where_nothing_differs() {
        let (a, b) = (scalar(&[0.0, 1.0, f32::INFINITY]), scalar(&[0.0, 0.0, 1.0]));
        let bytes = difference_png(&a, &b, 1.0).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap().into_rgb8();
        let greys: Vec<u8> = picture.pixels().map(|pixel| pixel.0[0]).collect();
        assert_eq!(greys, [0, 255, 255]);
        assert!(difference_png(&a, &scalar(&[0.0]), 1.0).is_err());
    }
}
