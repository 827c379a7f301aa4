//! Film: sample sums, AOVs, tone mapping, PNG and EXR.

mod environment;
mod exr;
mod layers;
mod part;
mod png;
mod tonemap;

pub use environment::{EnvironmentError, read_environment};
pub use exr::encode_exr;
pub use layers::{COLOR, ExrLayers, LayerInfo, LayerKind, LayerRange, LayersError, integer_value, is_exr};
pub use part::{Merger, PartError, encode_part};
pub use png::{encode_png, encode_png_srgb8};
pub use tonemap::{ToneMap, linear_to_srgb, to_srgb8};

use crate::device::Region;
use crate::integrate::aov::FirstHit;
use crate::integrate::usage::Usage;
use crate::settings::Aov;

/// A picture that could not be encoded.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct EncodeError(pub String);

fn check_size(width: u32, height: u32, values: usize) -> Result<(), EncodeError> {
    let expected = width as usize * height as usize;
    if values == expected && expected > 0 {
        return Ok(());
    }
    Err(EncodeError(format!("{width}x{height} pixels need {expected} values, there are {values}")))
}

/// Sums of linear radiance for a region. Sums are f64 so that splitting a job into passes does not change the picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PassFilm {
    pub region: Region,
    /// RGB sums, row-major.
    pub sum: Vec<[f64; 3]>,
    /// Samples in every sum.
    pub samples: u32,
}

impl PassFilm {
    pub fn new(region: Region) -> Self {
        Self { region, sum: vec![[0.0; 3]; region.pixels()], samples: 0 }
    }

    /// Mean linear radiance, row-major; black before the first sample.
    pub fn mean(&self) -> Vec<[f32; 3]> {
        let scale = if self.samples == 0 { 0.0 } else { 1.0 / f64::from(self.samples) };
        self.sum.iter().map(|s| s.map(|c| (c * scale) as f32)).collect()
    }
}

/// One layer of values for a region, row-major.
#[derive(Clone, Debug, PartialEq)]
pub enum AovLayer {
    Scalar(Vec<f32>),
    Vector(Vec<[f32; 3]>),
    /// Ids (`u32::MAX` on a miss) and counts.
    Integer(Vec<u32>),
}

#[derive(Clone, Debug, PartialEq)]
pub struct AovBuffers {
    pub region: Region,
    pub layers: Vec<(Aov, AovLayer)>,
}

impl AovBuffers {
    pub fn new(region: Region, aovs: &[Aov]) -> Self {
        let n = region.pixels();
        let layers = aovs
            .iter()
            .map(|&aov| {
                let layer = match aov {
                    Aov::Depth => AovLayer::Scalar(vec![f32::INFINITY; n]),
                    Aov::LineSpaceGamma => AovLayer::Scalar(vec![0.0; n]),
                    Aov::Position | Aov::GeometricNormal | Aov::ShadingNormal | Aov::Albedo | Aov::LineSpaceAnswer => {
                        AovLayer::Vector(vec![[0.0; 3]; n])
                    }
                    Aov::InstanceId | Aov::PrimitiveId | Aov::MaterialId => AovLayer::Integer(vec![u32::MAX; n]),
                    Aov::BoxTests | Aov::TriangleTests | Aov::LineSpaceLookUps | Aov::LineSpaceSkipped => {
                        AovLayer::Integer(vec![0; n])
                    }
                };
                (aov, layer)
            })
            .collect();
        Self { region, layers }
    }

    /// Writes what the pixels of `region`, which lies within this one, see first; row-major.
    pub(crate) fn store_hits(&mut self, region: Region, hits: &[FirstHit]) {
        for (aov, layer) in self.layers.iter_mut().filter(|(aov, _)| !aov.is_of_line_space()) {
            for (i, hit) in region.places_in(self.region).zip(hits) {
                hit.store(*aov, layer, i);
            }
        }
    }

    /// Writes what Line Spaces did for the pixels of `region`, likewise.
    pub(crate) fn store_usage(&mut self, region: Region, usage: &[Usage]) {
        for (aov, layer) in self.layers.iter_mut().filter(|(aov, _)| aov.is_of_line_space()) {
            for (i, usage) in region.places_in(self.region).zip(usage) {
                usage.store(*aov, layer, i);
            }
        }
    }
}
