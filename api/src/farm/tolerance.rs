//! How far a picture and a time may be from the baseline's.

use std::fmt;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

use crate::problem::FieldError;

/// `"identical"`, or the limits of what still passes. A picture whose decoded pixels are those of an accepted one always
/// passes.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum ImageTolerance {
    Word(Identical),
    Limits(ImageLimits),
}

/// No pixel may differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub enum Identical {
    #[serde(rename = "identical")]
    Identical,
}

/// What still passes; a picture must keep to every limit that is given.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ImageLimits {
    /// Root mean square error of linear colour.
    pub max_rmse: Option<f64>,
    /// Mean FLIP error, 0 to 1.
    pub max_flip: Option<f64>,
    /// Mean HDR-FLIP error, 0 to 1: what is seen at the exposure that shows it best. Of cases whose outputs have `exr`.
    pub max_hdr_flip: Option<f64>,
    /// Share of the pixels that differ at all, 0 to 1.
    pub max_differing: Option<f64>,
    /// For sampled effects: repetitions are rendered with other seeds, and their mean is tested pixel by pixel.
    pub z_test: Option<ZTest>,
}

/// The per-pixel test of the mean of a run's repetitions against that of the baseline's, by how far repetitions scatter; of
/// blocks of 2, 4, 8 and so on pixels on a side too, where what is faint and wide shows. Takes at least 4 repetitions; 6 or
/// more tell small changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ZTest {
    /// The chance that an unchanged picture fails anywhere, over all pixels and blocks together (corrected after Sidak); 1e-6
    /// to 0.5.
    pub significance: f64,
    /// Share of the single pixels that may fail nevertheless, 0 to 0.1. No block may: what changes a region changes blocks.
    pub max_failing: f64,
}

impl Default for ZTest {
    fn default() -> Self {
        Self { significance: 0.01, max_failing: 0.0025 }
    }
}

/// `"off"`, or how much longer a case may take.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum TimeTolerance {
    Word(Off),
    Limit(TimeLimit),
}

/// Times are kept, but not judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub enum Off {
    #[serde(rename = "off")]
    Off,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TimeLimit {
    pub metric: TimeMetric,
    /// The median may be this many times the baseline's before it is suspected; more than 1, at most 100. Where calibration
    /// found more noise than that, the noise counts.
    pub max_ratio: f64,
}

impl Default for TimeLimit {
    fn default() -> Self {
        Self { metric: TimeMetric::RenderS, max_ratio: 1.1 }
    }
}

/// Which of a job's metrics is the time of a case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeMetric {
    #[default]
    RenderS,
    BuildS,
    PrepareS,
    TotalS,
}

impl TimeMetric {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::RenderS => "render_s",
            Self::BuildS => "build_s",
            Self::PrepareS => "prepare_s",
            Self::TotalS => "total_s",
        }
    }
}

impl ImageTolerance {
    pub const IDENTICAL: Self = Self::Word(Identical::Identical);

    pub fn limits(&self) -> Option<&ImageLimits> {
        match self {
            Self::Word(Identical::Identical) => None,
            Self::Limits(limits) => Some(limits),
        }
    }

    pub fn z_test(&self) -> Option<&ZTest> {
        self.limits()?.z_test.as_ref()
    }

    pub(super) fn validate(&self, prefix: &str, errors: &mut Vec<FieldError>) {
        let Some(limits) = self.limits() else { return };
        let none = ImageLimits::default();
        if *limits == none {
            let detail =
                "must be \"identical\", or name a limit: max_rmse, max_flip, max_hdr_flip, max_differing or z_test";
            errors.push(FieldError::new(prefix, detail));
        }
        let mut check = |value: Option<f64>, field: &str, most: f64, detail: &str| {
            if value.is_some_and(|value| !(0.0..=most).contains(&value)) {
                errors.push(FieldError::new(format!("{prefix}/{field}"), detail));
            }
        };
        check(limits.max_rmse, "max_rmse", 1e6, "must be 0 to 1000000");
        check(limits.max_flip, "max_flip", 1.0, "must be 0 to 1");
        check(limits.max_hdr_flip, "max_hdr_flip", 1.0, "must be 0 to 1");
        check(limits.max_differing, "max_differing", 1.0, "must be a share of the pixels, 0 to 1");
        if let Some(test) = &limits.z_test {
            check(Some(test.max_failing), "z_test/max_failing", 0.1, "must be 0 to 0.1");
            if !(1e-6..=0.5).contains(&test.significance) {
                errors.push(FieldError::new(format!("{prefix}/z_test/significance"), "must be 0.000001 to 0.5"));
            }
        }
    }
}

impl TimeTolerance {
    pub const OFF: Self = Self::Word(Off::Off);

    pub fn limit(&self) -> Option<&TimeLimit> {
        match self {
            Self::Word(Off::Off) => None,
            Self::Limit(limit) => Some(limit),
        }
    }

    /// The metric that is kept, judged or not.
    pub fn metric(&self) -> TimeMetric {
        self.limit().map(|limit| limit.metric).unwrap_or_default()
    }

    pub(super) fn validate(&self, prefix: &str, errors: &mut Vec<FieldError>) {
        if let Some(limit) = self.limit()
            && !(limit.max_ratio > 1.0 && limit.max_ratio <= 100.0)
        {
            errors.push(FieldError::new(format!("{prefix}/max_ratio"), "must be more than 1 and at most 100"));
        }
    }
}

impl Default for TimeTolerance {
    fn default() -> Self {
        Self::Limit(TimeLimit::default())
    }
}

impl<'de> Deserialize<'de> for ImageTolerance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ToleranceVisitor;

        impl<'de> Visitor<'de> for ToleranceVisitor {
            type Value = ImageTolerance;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(
                    "\"identical\", or an object with max_rmse, max_flip, max_hdr_flip, max_differing or z_test",
                )
            }

            fn visit_str<E: Error>(self, value: &str) -> Result<ImageTolerance, E> {
                match value {
                    "identical" => Ok(ImageTolerance::IDENTICAL),
                    _ => Err(E::invalid_value(Unexpected::Str(value), &self)),
                }
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<ImageTolerance, A::Error> {
                ImageLimits::deserialize(MapAccessDeserializer::new(map)).map(ImageTolerance::Limits)
            }
        }

        deserializer.deserialize_any(ToleranceVisitor)
    }
}

impl<'de> Deserialize<'de> for TimeTolerance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ToleranceVisitor;

        impl<'de> Visitor<'de> for ToleranceVisitor {
            type Value = TimeTolerance;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("\"off\", or an object with max_ratio and metric")
            }

            fn visit_str<E: Error>(self, value: &str) -> Result<TimeTolerance, E> {
                match value {
                    "off" => Ok(TimeTolerance::OFF),
                    _ => Err(E::invalid_value(Unexpected::Str(value), &self)),
                }
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<TimeTolerance, A::Error> {
                TimeLimit::deserialize(MapAccessDeserializer::new(map)).map(TimeTolerance::Limit)
            }
        }

        deserializer.deserialize_any(ToleranceVisitor)
    }
}
