//! What is said of a case's picture.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ImageVerdict {
    /// The decoded pixels are those of an accepted picture.
    Identical,
    /// They are not, but no limit is passed.
    WithinTolerance,
    Changed,
    /// The baseline has no accepted picture for this case and device class.
    Missing,
    /// There is no picture: a job failed.
    Failed,
}

impl ImageVerdict {
    pub const ALL: [Self; 5] = [Self::Identical, Self::WithinTolerance, Self::Changed, Self::Missing, Self::Failed];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Identical => "identical",
            Self::WithinTolerance => "within_tolerance",
            Self::Changed => "changed",
            Self::Missing => "missing",
            Self::Failed => "failed",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|verdict| verdict.as_str() == name)
    }

    pub fn passes(self) -> bool {
        matches!(self, Self::Identical | Self::WithinTolerance)
    }
}

/// Which file a case is judged by: the EXR (linear, as it was computed) where there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PictureSource {
    Exr,
    Png,
}

impl PictureSource {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Png => "png",
        }
    }
}

/// A case's picture against the accepted one that is closest to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ImageResult {
    pub verdict: ImageVerdict,
    /// Why it failed or changed, in words: the limits that it passes.
    pub reason: Option<String>,
    /// BLAKE3 of the decoded pixels: the picture's identity. Null without a picture.
    pub pixels: Option<String>,
    pub source: Option<PictureSource>,
    /// Identity of the accepted picture that it was compared with: the closest by mean FLIP. Null when there is none.
    pub accepted: Option<String>,
    /// Null when the pictures are identical, differ in size, or there is nothing to compare with.
    pub figures: Option<ImageFigures>,
    pub z_test: Option<ZTestFigures>,
    /// Whether repetitions gave different pixels although their seed was the same.
    pub unsteady: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ImageFigures {
    /// Of linear colour.
    pub rmse: f64,
    pub rel_mse: f64,
    /// Mean absolute error of linear colour.
    pub mae: f64,
    /// In dB, of the pictures as a display shows them; null where they are the same there.
    pub psnr: Option<f64>,
    pub ssim: f64,
    pub flip_mean: f64,
    /// The FLIP error that 99 % of the pixels do not exceed.
    pub flip_p99: f64,
    /// Mean HDR-FLIP error; null where the case has no limit on it.
    pub hdr_flip_mean: Option<f64>,
    /// Of any channel.
    pub max_difference: f64,
    /// Column and row of the pixel with the largest difference; null when nothing differs.
    pub max_at: Option<[u32; 2]>,
    pub differing_pixels: u64,
    pub pixels: u64,
}

/// A per-pixel Z-test with Sidak's correction, on every level of an image pyramid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ZTestFigures {
    /// Pixels that fail.
    pub failing_pixels: u64,
    pub pixels: u64,
    /// Largest statistic of any channel of any pixel, in standard deviations.
    pub max_z: f64,
    /// A statistic beyond this fails.
    pub critical_z: f64,
    /// Blocks of 2, 4, 8 and so on pixels on a side, up to one that is the whole picture. Empty of runs of older versions.
    #[serde(default)]
    pub blocks: Vec<ZTestBlocks>,
}

/// The test of the means of all blocks of one size.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ZTestBlocks {
    /// Pixels on a side of a block.
    pub side: u32,
    pub failing: u64,
    pub blocks: u64,
    pub max_z: f64,
    pub critical_z: f64,
}

impl ZTestFigures {
    pub fn failing_blocks(&self) -> u64 {
        self.blocks.iter().map(|level| level.failing).sum()
    }
}
