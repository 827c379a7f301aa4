//! Pictures: a case's against the ones that were accepted.

use lightshaft_api::farm::{
    ImageFigures, ImageLimits, ImageResult, ImageTolerance, ImageVerdict, PictureSource, ZTest, ZTestBlocks,
    ZTestFigures,
};
use lightshaft_compare::{
    Comparison, Image, LEAST_RENDERINGS, Options, PIXELS_PER_DEGREE, Plane, ZTestLevel, ZTestOptions, compare,
    hdr_flip, z_test,
};

/// A picture and its identity.
#[derive(Clone, Debug)]
pub struct Decoded {
    pub source: PictureSource,
    pub image: Image,
    pub pixels: String,
}

impl Decoded {
    /// Identity is BLAKE3 of size and pixels as they are decoded: another compression is the same picture.
    pub fn new(source: PictureSource, image: Image) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(source.as_str().as_bytes());
        for side in [image.width(), image.height()] {
            hasher.update(&(side as u64).to_le_bytes());
        }
        for row in image.pixels().chunks(image.width()) {
            let bytes: Vec<u8> = row.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
            hasher.update(&bytes);
        }
        Self { source, pixels: hasher.finalize().to_hex().to_string(), image }
    }
}

/// An accepted picture: its identity, and its renderings (several, of other seeds, where a Z-test judges).
#[derive(Clone, Debug)]
pub struct Known {
    pub pixels: String,
    pub renderings: Vec<Decoded>,
}

#[derive(Clone, Debug)]
pub struct JudgedPicture {
    pub result: ImageResult,
    /// Of a picture that was compared: which of the accepted ones it was, and the FLIP error of every pixel.
    pub compared: Option<(usize, Plane)>,
}

/// Judges the repetitions of a case; the first is its picture. `None` of no picture at all.
pub fn judge_picture(tolerance: &ImageTolerance, pictures: &[Decoded], accepted: &[Known]) -> Option<JudgedPicture> {
    let picture = pictures.first()?;
    let mut result = ImageResult {
        verdict: ImageVerdict::Missing,
        reason: None,
        pixels: Some(picture.pixels.clone()),
        source: Some(picture.source),
        accepted: None,
        figures: None,
        z_test: None,
        // Repetitions of a Z-test have seeds of their own.
        unsteady: tolerance.z_test().is_none() && pictures.iter().any(|other| other.pixels != picture.pixels),
    };
    if accepted.is_empty() {
        result.reason = Some("no picture was accepted for this case and device class yet".to_owned());
        return Some(JudgedPicture { result, compared: None });
    }
    if accepted.iter().any(|known| known.pixels == picture.pixels) {
        result.verdict = ImageVerdict::Identical;
        result.accepted = Some(picture.pixels.clone());
        return Some(JudgedPicture { result, compared: None });
    }
    result.verdict = ImageVerdict::Changed;
    let Some((index, comparison)) = closest(picture, accepted) else {
        let (width, height) = (picture.image.width(), picture.image.height());
        result.reason = Some(format!("no accepted picture has {width} x {height} pixels"));
        return Some(JudgedPicture { result, compared: None });
    };
    result.accepted = Some(accepted[index].pixels.clone());
    let mut figures = to_figures(&comparison);
    let mut over = Vec::new();
    match tolerance.limits() {
        None => over.push(format!("{} of {} pixels differ", figures.differing_pixels, figures.pixels)),
        Some(limits) => {
            if limits.max_hdr_flip.is_some() {
                figures.hdr_flip_mean = hdr_flip_mean(picture, &accepted[index]);
            }
            over.extend(over_limits(limits, &figures));
            if let Some(test) = &limits.z_test {
                let tested = run_z_test(test, &accepted[index], pictures);
                over.extend(tested.as_ref().map_or_else(|why| Some(why.clone()), |tested| over_z_test(test, tested)));
                result.z_test = tested.ok();
            }
        }
    }
    if over.is_empty() {
        result.verdict = ImageVerdict::WithinTolerance;
    } else {
        result.reason = Some(over.join("; "));
    }
    result.figures = Some(figures);
    Some(JudgedPicture { result, compared: Some((index, comparison.flip)) })
}

/// The accepted picture of the same size and source with the least mean FLIP error.
fn closest(picture: &Decoded, accepted: &[Known]) -> Option<(usize, Comparison)> {
    let mut best: Option<(usize, Comparison)> = None;
    for (i, known) in accepted.iter().enumerate() {
        let Some(reference) = known.renderings.first().filter(|first| first.source == picture.source) else { continue };
        let Ok(found) = compare(&reference.image, &picture.image, &Options::default()) else { continue };
        if best.as_ref().is_none_or(|(_, least)| found.report.flip_mean < least.report.flip_mean) {
            best = Some((i, found));
        }
    }
    best
}

fn to_figures(comparison: &Comparison) -> ImageFigures {
    let (report, differences) = (&comparison.report, &comparison.report.differences);
    ImageFigures {
        rmse: differences.rmse,
        rel_mse: differences.rel_mse,
        mae: differences.mae,
        psnr: report.psnr,
        ssim: report.ssim,
        flip_mean: report.flip_mean,
        flip_p99: report.flip_p99,
        hdr_flip_mean: None,
        max_difference: differences.max_difference,
        max_at: differences.max_at,
        differing_pixels: differences.differing_pixels,
        pixels: differences.pixels,
    }
}

/// Limits that are passed, in words. A figure that is not a number passes every limit.
fn over_limits(limits: &ImageLimits, figures: &ImageFigures) -> Vec<String> {
    let differing = figures.differing_pixels as f64 / figures.pixels.max(1) as f64;
    [
        ("RMSE", figures.rmse, limits.max_rmse),
        ("mean FLIP", figures.flip_mean, limits.max_flip),
        // What is no linear colour has none.
        ("mean HDR-FLIP", figures.hdr_flip_mean.unwrap_or(f64::NAN), limits.max_hdr_flip),
        ("the share of differing pixels", differing, limits.max_differing),
    ]
    .into_iter()
    .filter_map(|(name, found, limit)| Some((name, found, limit?)))
    .filter(|&(_, found, limit)| found.is_nan() || found > limit)
    .map(|(name, found, limit)| format!("{name} is {found:.6}, over the limit of {limit}"))
    .collect()
}

/// Of linear colour only.
fn hdr_flip_mean(picture: &Decoded, accepted: &Known) -> Option<f64> {
    let reference = accepted.renderings.first().filter(|first| first.source == PictureSource::Exr)?;
    Some(hdr_flip(&reference.image, &picture.image, PIXELS_PER_DEGREE).ok()?.error.mean())
}

fn run_z_test(test: &ZTest, known: &Known, pictures: &[Decoded]) -> Result<ZTestFigures, String> {
    let images = |renderings: &[Decoded]| renderings.iter().map(|one| one.image.clone()).collect::<Vec<_>>();
    for (whose, count) in [("the accepted picture", known.renderings.len()), ("the run", pictures.len())] {
        if count < LEAST_RENDERINGS {
            let detail = format!("{whose} has {count} repetitions with seeds of their own");
            return Err(format!(
                "too few samples for the Z-test: {detail}, and it takes {LEAST_RENDERINGS} on each side"
            ));
        }
    }
    let options = ZTestOptions { significance: test.significance };
    let tested = z_test(&images(&known.renderings), &images(pictures), &options);
    let levels = tested.map_err(|error| format!("the Z-test cannot be made: {error}"))?.levels;
    let [pixels, blocks @ ..] = levels.as_slice() else { return Err("the Z-test found no pixels".to_owned()) };
    let to_blocks = |&ZTestLevel { side, failing, blocks, max_z, critical_z }: &ZTestLevel| ZTestBlocks {
        side,
        failing,
        blocks,
        max_z,
        critical_z,
    };
    Ok(ZTestFigures {
        failing_pixels: pixels.failing,
        pixels: pixels.blocks,
        max_z: pixels.max_z,
        critical_z: pixels.critical_z,
        blocks: blocks.iter().map(to_blocks).collect(),
    })
}

fn over_z_test(test: &ZTest, found: &ZTestFigures) -> Option<String> {
    let share = found.failing_pixels as f64 / found.pixels.max(1) as f64;
    let pixels = (share > test.max_failing).then(|| {
        let (failing, pixels, max_z) = (found.failing_pixels, found.pixels, found.max_z);
        format!("{failing} of {pixels} pixels (up to {max_z:.1} standard deviations)")
    });
    let blocks = found.blocks.iter().filter(|level| level.failing > 0).map(|level| {
        let ZTestBlocks { side, failing, blocks, max_z, .. } = level;
        format!("{failing} of {blocks} blocks of {side} x {side} pixels (up to {max_z:.1})")
    });
    let over: Vec<String> = pixels.into_iter().chain(blocks).collect();
    (!over.is_empty()).then(|| format!("more than noise explains differ {}", over.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(width: usize, height: usize, values: &[f32]) -> Decoded {
        let pixels = (0..width * height).map(|i| [values[i % values.len()]; 3]).collect();
        Decoded::new(PictureSource::Exr, Image::new(width, height, pixels).unwrap())
    }

    fn known(renderings: &[Decoded]) -> Known {
        Known { pixels: renderings[0].pixels.clone(), renderings: renderings.to_vec() }
    }

    fn judge(tolerance: &ImageTolerance, picture: &Decoded, accepted: &[Known]) -> ImageResult {
        judge_picture(tolerance, std::slice::from_ref(picture), accepted).unwrap().result
    }

    fn limits(change: impl FnOnce(&mut ImageLimits)) -> ImageTolerance {
        let mut limits = ImageLimits::default();
        change(&mut limits);
        ImageTolerance::Limits(limits)
    }

    #[test]
    fn identity_is_that_of_the_pixels_and_their_form() {
        let picture = grey(4, 2, &[0.5]);
        assert_eq!(picture.pixels, grey(4, 2, &[0.5]).pixels);
        assert_ne!(picture.pixels, grey(2, 4, &[0.5]).pixels);
        assert_ne!(picture.pixels, grey(4, 2, &[0.5001]).pixels);
        assert_ne!(picture.pixels, Decoded::new(PictureSource::Png, picture.image.clone()).pixels);
    }

    #[test]
    fn any_accepted_picture_is_right() {
        let (one, two, other) = (grey(8, 8, &[0.2]), grey(8, 8, &[0.8]), grey(8, 8, &[0.79, 0.8]));
        let accepted = [known(std::slice::from_ref(&one)), known(std::slice::from_ref(&two))];
        let identical = judge(&ImageTolerance::IDENTICAL, &two, &accepted);
        assert_eq!((identical.verdict, identical.accepted), (ImageVerdict::Identical, Some(two.pixels.clone())));
        let changed = judge(&ImageTolerance::IDENTICAL, &other, &accepted);
        assert_eq!((changed.verdict, changed.accepted), (ImageVerdict::Changed, Some(two.pixels)), "the closest");
        assert_eq!(changed.reason.as_deref(), Some("32 of 64 pixels differ"));
        let figures = changed.figures.unwrap();
        assert_eq!((figures.differing_pixels, figures.max_at), (32, Some([0, 0])));
        assert_eq!(judge(&ImageTolerance::IDENTICAL, &one, &[]).verdict, ImageVerdict::Missing);
    }

    #[test]
    fn every_limit_that_is_given_must_be_kept() {
        let accepted = [known(&[grey(8, 8, &[0.5])])];
        let near = grey(8, 8, &[0.5, 0.51]);
        let of = |tolerance| judge(&tolerance, &near, &accepted);
        assert_eq!(of(limits(|l| l.max_rmse = Some(0.01))).verdict, ImageVerdict::WithinTolerance);
        assert_eq!(of(limits(|l| l.max_rmse = Some(0.001))).verdict, ImageVerdict::Changed);
        assert_eq!(of(limits(|l| l.max_flip = Some(0.0))).verdict, ImageVerdict::Changed);
        let both = of(limits(|l| (l.max_rmse, l.max_differing) = (Some(0.01), Some(0.4))));
        assert_eq!(both.verdict, ImageVerdict::Changed);
        let reason = both.reason.unwrap();
        assert!(reason.contains("differing pixels is 0.5") && !reason.contains("RMSE"), "{reason}");
    }

    #[test]
    fn highlights_that_a_display_clips_are_seen_by_hdr_flip() {
        let (lamp, brighter) = (grey(16, 16, &[0.2, 0.2, 0.2, 40.0]), grey(16, 16, &[0.2, 0.2, 0.2, 80.0]));
        let accepted = [known(&[lamp])];
        let clipped = judge(&limits(|l| l.max_flip = Some(0.0)), &brighter, &accepted);
        assert_eq!(clipped.verdict, ImageVerdict::WithinTolerance);
        assert_eq!(clipped.figures.unwrap().hdr_flip_mean, None, "nobody asked");
        let seen = judge(&limits(|l| l.max_hdr_flip = Some(0.01)), &brighter, &accepted);
        assert_eq!(seen.verdict, ImageVerdict::Changed);
        assert!(seen.figures.unwrap().hdr_flip_mean.unwrap() > 0.01);
        let loose = judge(&limits(|l| l.max_hdr_flip = Some(0.9)), &brighter, &accepted);
        assert_eq!(loose.verdict, ImageVerdict::WithinTolerance);

        let shown = |picture: &Decoded| Decoded::new(PictureSource::Png, picture.image.clone());
        let accepted = [known(&[shown(&grey(4, 4, &[0.5]))])];
        let unknowable = judge(&limits(|l| l.max_hdr_flip = Some(1.0)), &shown(&grey(4, 4, &[0.6])), &accepted);
        assert_eq!(unknowable.verdict, ImageVerdict::Changed, "no limit is kept by what cannot be found");
    }

    #[test]
    fn another_size_is_a_change_without_figures() {
        let result = judge(&limits(|l| l.max_rmse = Some(1e6)), &grey(4, 4, &[0.5]), &[known(&[grey(8, 2, &[0.5])])]);
        assert_eq!((result.verdict, result.figures), (ImageVerdict::Changed, None));
        assert!(result.reason.unwrap().contains("4 x 4"));
    }

    #[test]
    fn repetitions_that_differ_are_noticed() {
        let (one, two) = (grey(4, 4, &[0.5]), grey(4, 4, &[0.6]));
        let judged = judge_picture(
            &ImageTolerance::IDENTICAL,
            &[one.clone(), two.clone()],
            &[known(std::slice::from_ref(&one))],
        );
        let result = judged.unwrap().result;
        assert!(result.unsteady && result.verdict == ImageVerdict::Identical);
        assert!(!super::super::passes(&result, None));
        let sampled = limits(|l| l.z_test = Some(ZTest::default()));
        let judged = judge_picture(&sampled, &[one.clone(), two], &[known(&[one])]).unwrap();
        assert!(!judged.result.unsteady, "their seeds differ");
    }

    #[test]
    fn sampled_pictures_are_judged_by_their_variance() {
        let seeds = |level: f32, seeds: std::ops::Range<u32>| -> Vec<Decoded> {
            let noise = |i: usize, seed: u32| {
                let mut state =
                    (i as u32 + 1).wrapping_mul(2_654_435_761) ^ seed.wrapping_mul(40_503).wrapping_add(seed);
                for _ in 0..3 {
                    state ^= state << 13;
                    state ^= state >> 17;
                    state ^= state << 5;
                }
                f32::from((state >> 16) as u16) / 65536.0 - 0.5
            };
            let picture = |seed| {
                let pixels = (0..256).map(|i| [level + 0.2 * noise(i, seed); 3]).collect();
                Decoded::new(PictureSource::Exr, Image::new(16, 16, pixels).unwrap())
            };
            seeds.map(picture).collect()
        };
        let tolerance = limits(|l| l.z_test = Some(ZTest::default()));
        let accepted = [known(&seeds(0.5, 1..7))];
        let same = judge_picture(&tolerance, &seeds(0.5, 11..17), &accepted).unwrap().result;
        assert_eq!(same.verdict, ImageVerdict::WithinTolerance, "{same:?}");
        let darker = judge_picture(&tolerance, &seeds(0.02, 21..27), &accepted).unwrap().result;
        assert_eq!(darker.verdict, ImageVerdict::Changed);
        assert!(darker.z_test.unwrap().failing_pixels > 100);

        let hardly = judge_picture(&tolerance, &seeds(0.48, 21..27), &accepted).unwrap().result;
        let figures = hardly.z_test.unwrap();
        assert_eq!((hardly.verdict, figures.failing_pixels), (ImageVerdict::Changed, 0), "{figures:?}");
        assert!(figures.failing_blocks() > 0 && hardly.reason.unwrap().contains("blocks of 16 x 16 pixels"));
    }

    #[test]
    fn too_few_samples_are_told_as_such() {
        let tolerance = limits(|l| l.z_test = Some(ZTest::default()));
        let run: Vec<Decoded> = (0..4_u8).map(|i| grey(4, 4, &[0.5 + f32::from(i) / 100.0])).collect();
        let result = judge_picture(&tolerance, &run, &[known(&[grey(4, 4, &[0.4])])]).unwrap().result;
        assert_eq!((result.verdict, &result.z_test), (ImageVerdict::Changed, &None));
        let reason = result.reason.unwrap();
        assert!(reason.starts_with("too few samples") && reason.contains("the accepted picture has 1"), "{reason}");
    }
}
