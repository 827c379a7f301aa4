//! Pictures: their layers, and how far two of them are apart.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::problem::FieldError;

/// Body of `POST /v1/compare`, and settings of a job of kind `compare`.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CompareRequest {
    /// The reference.
    pub a: PictureChoice,
    /// The picture to judge, of the same size.
    pub b: PictureChoice,
    /// Stops by which both are brightened before FLIP and SSIM, -32 to 32. Only for colour.
    pub exposure: f32,
    /// Difference of a channel up to which a pixel counts as equal, in the layer's units.
    pub tolerance: f32,
    /// Not passed when the root mean square error is above this.
    pub max_rmse: Option<f64>,
    /// Not passed when the mean FLIP error is above this.
    pub max_flip: Option<f64>,
    /// Whether HDR-FLIP is wanted too, and drawn by the heat map: of linear colour only (OpenEXR, Radiance). It takes several
    /// exposures, and so many times as long as FLIP.
    pub hdr: bool,
    /// Not passed when the mean HDR-FLIP error is above this; as if `hdr` were set.
    pub max_hdr_flip: Option<f64>,
}

impl CompareRequest {
    /// Every number that is out of range; the pictures are looked up by the service.
    pub fn validate(&self, prefix: &str) -> Vec<FieldError> {
        let not_negative = "must be a number of at least 0";
        let limit = |limit: Option<f64>| limit.is_none_or(|limit| limit.is_finite() && limit >= 0.0);
        let checks = [
            (is_exposure(self.exposure), "exposure", "must be -32 to 32 stops"),
            (self.tolerance.is_finite() && self.tolerance >= 0.0, "tolerance", not_negative),
            (limit(self.max_rmse), "max_rmse", not_negative),
            (limit(self.max_flip), "max_flip", not_negative),
            (limit(self.max_hdr_flip), "max_hdr_flip", not_negative),
        ];
        let wrong = checks.into_iter().filter(|check| !check.0);
        wrong.map(|(_, field, detail)| FieldError::new(format!("{prefix}/{field}"), detail)).collect()
    }

    /// Both pictures in words.
    pub fn describe(&self) -> String {
        format!("{} with {}", self.b.describe(), self.a.describe())
    }

    /// Whether HDR-FLIP is wanted, said so or limited.
    pub fn wants_hdr(&self) -> bool {
        self.hdr || self.max_hdr_flip.is_some()
    }
}

/// Whether an exposure is one that pictures are shown with.
pub fn is_exposure(stops: f32) -> bool {
    (-32.0..=32.0).contains(&stops)
}

/// A picture: the artifact of a job, a blob, or (neither) the uploaded part of this name.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PictureChoice {
    pub job: Option<String>,
    /// Name of the job's artifact; `image.exr` by default, or `image.png` when there is none.
    pub artifact: Option<String>,
    /// Hash of a blob, as answers name pictures; beside a job, that of its artifact.
    pub blob: Option<String>,
    /// `color` by default. `GET /v1/jobs/{id}/artifacts/{name}/layers` lists what there is.
    pub layer: Option<String>,
}

impl PictureChoice {
    /// In words: the job and its artifact, or the beginning of the blob's hash; and the layer where it is not the colour.
    pub fn describe(&self) -> String {
        let picture = match (&self.job, &self.artifact, &self.blob) {
            (Some(job), Some(artifact), _) => format!("{artifact} of job {job}"),
            (Some(job), None, _) => format!("job {job}"),
            (None, _, Some(blob)) => format!("blob {}", blob.chars().take(12).collect::<String>()),
            (None, _, None) => "a picture".to_owned(),
        };
        self.layer.as_ref().map_or_else(|| picture.clone(), |layer| format!("{layer} of {picture}"))
    }
}

/// How far two pictures are apart. The figures are also what `lightshaft compare --json` prints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Compared {
    pub a: ComparedPicture,
    pub b: ComparedPicture,
    #[serde(flatten)]
    pub report: CompareReport,
    /// Address of the FLIP error (HDR-FLIP where that was wanted) of every pixel as a picture (magma: 0 is black, 1 pale
    /// yellow) with a scale bar to the right; `&scale=false` leaves that out.
    pub heat_map: String,
    /// Address of the absolute difference as a picture.
    pub difference: String,
    /// Address of the page that shows both.
    pub page: String,
}

/// `comparison.json` of a job of kind `compare`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    pub a: ComparedPicture,
    pub b: ComparedPicture,
    #[serde(flatten)]
    pub report: CompareReport,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ComparedPicture {
    /// BLAKE3 of the file.
    pub hash: String,
    pub layer: String,
}

/// Figures of a comparison, `b` against the reference `a`. Colours are linear; other layers have their own units, and are
/// spread over their common range for SSIM and FLIP.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CompareReport {
    pub width: u32,
    pub height: u32,
    /// Root of the mean squared difference over all channels of all pixels.
    pub rmse: f64,
    /// Mean of `(b - a)² / (a² + 0.01)`.
    pub rel_mse: f64,
    /// Mean absolute difference.
    pub mae: f64,
    /// In dB, of the pictures as a display shows them; null where they are the same there.
    pub psnr: Option<f64>,
    /// Mean luminance of `b` over that of `a`; null when `a` is black.
    pub mean_ratio: Option<f64>,
    /// Largest difference of any channel.
    pub max_difference: f64,
    /// Column and row of the first pixel with the largest difference; null when none differs.
    pub max_at: Option<[u32; 2]>,
    /// Pixels that differ in any channel by more than the tolerance, or are NaN or infinite in one picture only.
    pub differing_pixels: u64,
    /// Pixels with a NaN or an infinity in either picture; left out of the means. An id that is "none" counts as one.
    pub non_finite_pixels: u64,
    pub pixels: u64,
    pub ssim: f64,
    pub flip_mean: f64,
    /// The error that 99 % of the pixels do not exceed.
    pub flip_p99: f64,
    /// Null where it was not wanted.
    pub hdr_flip: Option<HdrFlipFigures>,
    pub max_rmse: Option<f64>,
    pub max_flip: Option<f64>,
    pub max_hdr_flip: Option<f64>,
    /// Whether every limit is kept. A figure that is not a number keeps none.
    pub passed: bool,
    /// The limits that are not kept, in words.
    pub over_limits: Vec<String>,
}

/// HDR-FLIP: each pixel's largest error at any of several exposures, through the tone mapper of ACES.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HdrFlipFigures {
    pub mean: f64,
    /// The error that 99 % of the pixels do not exceed.
    pub p99: f64,
    /// Stops at which the brightest pixel of `a` is just not blown out.
    pub start_exposure: f64,
    /// Stops at which half of the pixels of `a` are.
    pub stop_exposure: f64,
    /// How many were tried, evenly from start to stop.
    pub exposures: u32,
}

/// What an OpenEXR, PNG, JPEG or Radiance file holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PictureLayers {
    /// BLAKE3 of the file.
    pub hash: String,
    pub width: u32,
    pub height: u32,
    /// Whether colours are as a display shows them (PNG, JPEG): tone mapped already. Values are decoded to linear.
    pub display_referred: bool,
    /// Colour first.
    pub layers: Vec<PictureLayer>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PictureLayer {
    pub name: String,
    pub kind: PictureLayerKind,
    /// Names of the file's channels, one or three.
    pub channels: Vec<String>,
    /// Least finite value; null when there is none.
    pub minimum: Option<f64>,
    pub maximum: Option<f64>,
    /// Values that are NaN, infinite or, of ids, "none" (4294967295).
    pub non_finite: u64,
    /// Address of the pixels.
    pub href: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PictureLayerKind {
    /// Linear colour: three floats.
    Color,
    /// Positions and normals: three floats.
    Vector,
    /// One float.
    Scalar,
    /// Ids and counts: one unsigned integer.
    Integer,
}

/// Form of the samples that `…/layers/{layer}` answers, little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SampleForm {
    /// Half floats, for floats only. What is greater than 65504 becomes that.
    F16,
    /// Floats as they are, for floats only.
    F32,
    /// For integers only.
    U32,
}

/// All values of one pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PixelValues {
    pub x: u32,
    pub y: u32,
    pub layers: Vec<LayerValue>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LayerValue {
    pub name: String,
    /// One or three; null where a value is NaN or infinite, or an id is "none".
    pub values: Vec<Option<f64>>,
}
