//! How far two layers are apart, as figures and as pictures.

use lightshaft_api::compare::{CompareReport, CompareRequest, HdrFlipFigures};
use lightshaft_compare::{
    Differences, Drawing, Error, HdrFlip, Image, Options, Plane, Report, compare, differences, flip, hdr_flip,
    heat_map, heat_map_with_scale, psnr, ssim,
};
use lightshaft_engine::film::{AovLayer, LayerKind, encode_png_srgb8, integer_value};

use super::{Picture, PictureError, range, unreadable};

/// A layer with its size, ready to be compared.
pub struct Pixels {
    pub width: u32,
    pub height: u32,
    pub layer: AovLayer,
    pub is_color: bool,
    /// Tone mapped already; decoded to linear.
    pub display_referred: bool,
}

/// Limits that a comparison must keep.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bounds {
    pub max_rmse: Option<f64>,
    pub max_flip: Option<f64>,
    pub max_hdr_flip: Option<f64>,
}

impl Bounds {
    pub fn of(request: &CompareRequest) -> Self {
        Self { max_rmse: request.max_rmse, max_flip: request.max_flip, max_hdr_flip: request.max_hdr_flip }
    }
}

/// Figures, and the FLIP error of every pixel.
pub struct Outcome {
    pub figures: Figures,
    /// Of HDR-FLIP where that was wanted.
    pub error_map: Plane,
}

#[derive(Clone, Copy, Debug)]
pub struct Figures {
    width: u32,
    height: u32,
    report: Report,
    /// Where it was wanted.
    hdr_flip: Option<HdrFlipFigures>,
}

impl Pixels {
    /// Reads one layer of a file.
    pub fn read(bytes: &[u8], layer: &str, max_pixels: u64) -> Result<Self, PictureError> {
        let picture = Picture::open(bytes, max_pixels)?;
        let index = picture.find(layer)?;
        let (width, height) = (picture.width, picture.height);
        let is_color = picture.layers[index].kind == LayerKind::Color;
        let display_referred = picture.display_referred;
        Ok(Self { width, height, layer: picture.read(index)?, is_color, display_referred })
    }

    /// A picture's linear colour.
    pub fn color(image: &Image) -> Self {
        let layer = AovLayer::Vector(image.pixels().to_vec());
        let (width, height) = (image.width() as u32, image.height() as u32);
        Self { width, height, layer, is_color: true, display_referred: false }
    }

    fn is_linear_color(&self) -> bool {
        self.is_color && !self.display_referred
    }

    /// As three channels each; integers as floats (which [`layers`] and [`difference_png`] tell apart exactly nevertheless),
    /// "none" as infinity.
    pub fn image(&self) -> Result<Image, Error> {
        let pixels: Vec<[f32; 3]> = match &self.layer {
            AovLayer::Vector(values) => values.clone(),
            AovLayer::Scalar(values) => values.iter().map(|&value| [value; 3]).collect(),
            AovLayer::Integer(values) => values.iter().map(|&value| [integer_value(value) as f32; 3]).collect(),
        };
        Image::new(self.width as usize, self.height as usize, pixels)
    }
}

/// Compares `b` with the reference `a`, by HDR-FLIP too where `hdr` says so.
///
/// FLIP and SSIM are made for colours between black and white. Other layers are spread over the range that both
/// have in common, so that the greatest difference there can be is that between black and white.
///
/// # Errors
/// When the sizes differ, or HDR-FLIP is wanted of what is no linear colour.
pub fn layers(a: &Pixels, b: &Pixels, options: &Options, hdr: bool) -> Result<Outcome, PictureError> {
    if hdr && !(a.is_linear_color() && b.is_linear_color()) {
        let detail = "HDR-FLIP is for linear colour: the layer `color` of OpenEXR or Radiance files";
        return Err(PictureError::NotLinear(detail.to_owned()));
    }
    let (first, second) = (a.image().map_err(unreadable)?, b.image().map_err(unreadable)?);
    if a.is_color && b.is_color {
        let comparison = compare(&first, &second, options).map_err(unreadable)?;
        let figures = Figures { width: a.width, height: a.height, report: comparison.report, hdr_flip: None };
        if !hdr {
            return Ok(Outcome { figures, error_map: comparison.flip });
        }
        let found = hdr_flip(&first, &second, options.pixels_per_degree).map_err(unreadable)?;
        let figures = Figures { hdr_flip: Some(hdr_figures(&found)), ..figures };
        return Ok(Outcome { figures, error_map: found.error });
    }
    spread_layers(a, b, [&first, &second], options).map_err(unreadable)
}

fn hdr_figures(found: &HdrFlip) -> HdrFlipFigures {
    HdrFlipFigures {
        mean: found.error.mean(),
        p99: f64::from(found.error.percentile(0.99)),
        start_exposure: f64::from(found.exposures.start),
        stop_exposure: f64::from(found.exposures.stop),
        exposures: found.exposures.count,
    }
}

fn spread_layers(a: &Pixels, b: &Pixels, images: [&Image; 2], options: &Options) -> Result<Outcome, Error> {
    let [first, second] = images;
    let (low, span) = common_range(a, b);
    let spread = |image: &Image| {
        let pixels = image.pixels().iter().map(|pixel| pixel.map(|value| (value - low) / span)).collect();
        Image::new(image.width(), image.height(), pixels)
    };
    let mut differences = differences(first, second, options.tolerance)?;
    if let (AovLayer::Integer(from), AovLayer::Integer(to)) = (&a.layer, &b.layer) {
        differences = of_integers(differences, [from, to], a.width, options.tolerance);
    }
    let (first, second) = (spread(first)?, spread(second)?);
    let flip = flip(&first, &second, 0.0, options.pixels_per_degree)?;
    let report = Report {
        differences,
        psnr: psnr(&first, &second, 0.0)?,
        ssim: ssim(&first, &second, 0.0)?,
        flip_mean: flip.mean(),
        flip_p99: f64::from(flip.percentile(0.99)),
    };
    Ok(Outcome { figures: Figures { width: a.width, height: a.height, report, hdr_flip: None }, error_map: flip })
}

/// Integers told apart exactly, which floats do below 2^24 only; means stay as they were found.
fn of_integers(found: Differences, [a, b]: [&[u32]; 2], width: u32, tolerance: f32) -> Differences {
    let is_none = |value: u32| !integer_value(value).is_finite();
    let (mut differing_pixels, mut largest, mut largest_at) = (0, 0, None);
    for (i, (&a, &b)) in (0_u32..).zip(a.iter().zip(b)) {
        if is_none(a) || is_none(b) {
            differing_pixels += u64::from(is_none(a) != is_none(b));
            continue;
        }
        let apart = a.abs_diff(b);
        differing_pixels += u64::from(f64::from(apart) > f64::from(tolerance));
        if apart > largest {
            (largest, largest_at) = (apart, Some([i % width, i / width]));
        }
    }
    Differences { max_difference: f64::from(largest), max_at: largest_at, differing_pixels, ..found }
}

/// Least value of both, and the distance to the greatest, which is not 0.
fn common_range(a: &Pixels, b: &Pixels) -> (f32, f32) {
    let (a, b) = (range(&a.layer).bounds(), range(&b.layer).bounds());
    let low = a.iter().chain(&b).map(|bounds| bounds.0).fold(f64::INFINITY, f64::min);
    let high = a.iter().chain(&b).map(|bounds| bounds.1).fold(f64::NEG_INFINITY, f64::max);
    if low < high { (low as f32, (high - low) as f32) } else { (if low.is_finite() { low as f32 } else { 0.0 }, 1.0) }
}

/// The figures with the limits, and whether they are kept.
pub fn report(figures: &Figures, bounds: Bounds) -> CompareReport {
    let Figures { width, height, report, hdr_flip } = *figures;
    let differences = &report.differences;
    // Without HDR-FLIP, a limit on it is not kept.
    let hdr_mean = hdr_flip.map_or(f64::NAN, |found| found.mean);
    let limits = [
        ("RMSE", differences.rmse, bounds.max_rmse),
        ("mean FLIP", report.flip_mean, bounds.max_flip),
        ("mean HDR-FLIP", hdr_mean, bounds.max_hdr_flip),
    ];
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
        psnr: report.psnr,
        mean_ratio: differences.mean_ratio,
        max_difference: differences.max_difference,
        max_at: differences.max_at,
        differing_pixels: differences.differing_pixels,
        non_finite_pixels: differences.non_finite_pixels,
        pixels: differences.pixels,
        ssim: report.ssim,
        flip_mean: report.flip_mean,
        flip_p99: report.flip_p99,
        hdr_flip,
        max_rmse: bounds.max_rmse,
        max_flip: bounds.max_flip,
        max_hdr_flip: bounds.max_hdr_flip,
        passed: over_limits.is_empty(),
        over_limits,
    }
}

/// The FLIP error of every pixel as a PNG, with a scale bar to its right; the map lies in the upper left corner.
pub fn heat_map_png(flip: &Plane) -> Result<Vec<u8>, PictureError> {
    let Drawing { width, height, rgb } = heat_map_with_scale(flip);
    png(width, height, &rgb)
}

/// The FLIP error of every pixel as a PNG of the pictures' size.
pub fn bare_heat_map_png(flip: &Plane) -> Result<Vec<u8>, PictureError> {
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
    let pixels = match (&a.layer, &b.layer) {
        (AovLayer::Integer(a), AovLayer::Integer(b)) => {
            let apart = |(&a, &b): (&u32, &u32)| match (a == u32::MAX, b == u32::MAX) {
                (false, false) => (f64::from(a.abs_diff(b)) / f64::from(span)) as f32 * gain,
                (true, true) => 0.0,
                _ => 1.0,
            };
            a.iter().zip(b).map(|pair| [apart(pair); 3]).collect()
        }
        _ => {
            let pairs = first.pixels().iter().zip(second.pixels());
            pairs.map(|(a, b)| std::array::from_fn(|i| apart((&a[i], &b[i])))).collect()
        }
    };
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
        Pixels {
            width: values.len() as u32,
            height: 1,
            layer: AovLayer::Scalar(values.to_vec()),
            is_color: false,
            display_referred: false,
        }
    }

    fn ids(values: &[u32]) -> Pixels {
        Pixels {
            width: values.len() as u32,
            height: 1,
            layer: AovLayer::Integer(values.to_vec()),
            is_color: false,
            display_referred: false,
        }
    }

    fn compared(a: &Pixels, b: &Pixels) -> Figures {
        layers(a, b, &Options::default(), false).unwrap().figures
    }

    #[test]
    fn depth_is_compared_in_its_own_units_and_infinity_is_no_difference() {
        let (a, b) = (scalar(&[1.0, 5.0, 100.0, f32::INFINITY]), scalar(&[1.0, 8.0, 100.0, f32::INFINITY]));
        let report = compared(&a, &b).report;
        let found = report.differences;
        assert_eq!((found.max_difference, found.differing_pixels, found.non_finite_pixels), (3.0, 1, 1));
        assert!((found.rmse - 3.0_f64.sqrt()).abs() < 1e-9);
        assert!(report.flip_mean > 0.0 && report.flip_mean < 0.5);
        let same = compared(&a, &a).report;
        assert_eq!((same.flip_mean, same.differences.differing_pixels), (0.0, 0));
    }

    #[test]
    fn an_id_in_one_picture_only_is_a_difference() {
        let (a, b) = (ids(&[7, u32::MAX, 3]), ids(&[7, 5, 4]));
        let found = compared(&a, &b).report.differences;
        assert_eq!((found.differing_pixels, found.non_finite_pixels), (2, 1));
        let nothing = ids(&[u32::MAX; 3]);
        assert_eq!(compared(&nothing, &nothing).report.differences.differing_pixels, 0);
    }

    #[test]
    fn integers_beyond_what_floats_hold_are_told_apart() {
        let large = 1 << 24;
        let (a, b) = (ids(&[large, large, 3]), ids(&[large + 1, large, 3]));
        let found = compared(&a, &b).report.differences;
        assert_eq!((found.differing_pixels, found.max_difference, found.max_at), (1, 1.0, Some([0, 0])));
        let tolerated = layers(&a, &b, &Options { tolerance: 1.0, ..Options::default() }, false).unwrap();
        assert_eq!(tolerated.figures.report.differences.differing_pixels, 0);
        let bytes = difference_png(&a, &b, 1e9).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!(picture.pixels().map(|pixel| pixel.0[0]).collect::<Vec<u8>>(), [255, 0, 0]);
    }

    #[test]
    fn limits_are_kept_up_to_their_value() {
        let (a, b) = (scalar(&[0.0, 1.0]), scalar(&[0.0, 1.5]));
        let figures = compared(&a, &b);
        let with = |max_rmse| report(&figures, Bounds { max_rmse, ..Bounds::default() });
        assert!(with(None).passed && with(Some(figures.report.differences.rmse)).passed);
        let over = with(Some(0.1));
        assert!(!over.passed);
        assert_eq!(over.over_limits, ["RMSE is 0.353553, over the limit of 0.1"]);
    }

    #[test]
    fn hdr_flip_is_for_linear_colour_and_has_a_limit_of_its_own() {
        let color = |values: &[f32]| {
            Pixels::color(&Image::new(values.len(), 1, values.iter().map(|&value| [value; 3]).collect()).unwrap())
        };
        let (a, b) = (color(&[0.5, 0.5, 0.5, 100.0]), color(&[0.5, 0.5, 0.5, 150.0]));
        let outcome = layers(&a, &b, &Options::default(), true).unwrap();
        let found = outcome.figures.hdr_flip.unwrap();
        assert!(outcome.figures.report.flip_mean == 0.0 && found.mean > 0.01, "a display clips both: {found:?}");
        assert!(found.exposures > 6 && found.start_exposure < found.stop_exposure);
        assert_eq!(outcome.error_map.mean(), found.mean, "the map is that of HDR-FLIP");
        let limited = |max_hdr_flip| report(&outcome.figures, Bounds { max_hdr_flip, ..Bounds::default() });
        assert!(limited(Some(1.0)).passed && !limited(Some(0.001)).passed);
        assert!(limited(Some(0.0)).over_limits[0].starts_with("mean HDR-FLIP is 0."));

        let shown = Pixels { display_referred: true, ..color(&[0.5]) };
        for wrong in [shown, scalar(&[0.5])] {
            let error = layers(&color(&[0.5]), &wrong, &Options::default(), true).err().unwrap();
            assert!(matches!(&error, PictureError::NotLinear(detail) if detail.contains("OpenEXR")), "{error:?}");
        }
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
