//! What is said of a case's time.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::tolerance::TimeMetric;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeVerdict {
    Faster,
    Same,
    Slower,
    /// The samples scatter so much that a change as large as the tolerance could hide in them.
    TooNoisyToSay,
}

impl TimeVerdict {
    pub const ALL: [Self; 4] = [Self::Faster, Self::Same, Self::Slower, Self::TooNoisyToSay];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Faster => "faster",
            Self::Same => "same",
            Self::Slower => "slower",
            Self::TooNoisyToSay => "too_noisy_to_say",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|verdict| verdict.as_str() == name)
    }
}

/// A case's times against the baseline's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TimeResult {
    /// Null when it is not judged: the tolerance is `off`, or the baseline has no times of this metric.
    pub verdict: Option<TimeVerdict>,
    /// The verdict in words, or why there is none.
    pub reason: String,
    pub metric: TimeMetric,
    /// Seconds of each repetition, in the order in which they ran; without the warm-up.
    pub samples_s: Vec<f64>,
    pub spread: Option<Spread>,
    /// Of the baseline's samples.
    pub baseline: Option<Spread>,
    /// This run's median over the baseline's.
    pub ratio: Option<TimeRatio>,
    /// A ratio beyond this is suspected: the tolerance, or the noise where that is more.
    pub limit: Option<f64>,
    /// How far the medians of unchanged runs lie apart, as a ratio less 1, in 19 of 20 cases; null without a calibration.
    pub noise_floor: Option<f64>,
    pub confirmation: Confirmation,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Spread {
    pub samples: u32,
    pub lower_quartile_s: f64,
    pub median_s: f64,
    pub upper_quartile_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TimeRatio {
    pub value: f64,
    /// Between these it lies with a confidence of 95 % (percentile bootstrap).
    pub low: f64,
    pub high: f64,
    /// Of the Mann-Whitney test that both sides are alike, two-sided.
    pub p: f64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ConfirmationState {
    /// Nothing was suspected.
    #[default]
    NotNeeded,
    /// Both sides run again in turns.
    Running,
    /// The interleaved re-run shows the slow-down, too.
    Confirmed,
    /// It does not.
    Refuted,
    /// The baseline's side cannot be run any more.
    Impossible,
}

/// The interleaved re-run of a suspected slow-down: baseline and this run in turns, on one worker, structures warm.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Confirmation {
    pub state: ConfirmationState,
    /// In words; null when not needed.
    pub reason: Option<String>,
    /// Seconds of the baseline's side, without the warm-up.
    pub a_s: Vec<f64>,
    /// Seconds of this run's side.
    pub b_s: Vec<f64>,
    /// Of this run's to the baseline's.
    pub ratio: Option<TimeRatio>,
}
