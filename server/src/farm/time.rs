//! Times: this run's samples against those of the runs that were accepted.

use lightshaft_api::farm::{
    Confirmation, ConfirmationState, Spread, TimeMetric, TimeRatio, TimeResult, TimeTolerance, TimeVerdict,
};
use lightshaft_compare::timing::{Interval, mann_whitney, median_ratio, paired_ratio, quartiles};

/// Pairs of the interleaved re-run, after the one that warms up.
pub const CONFIRMATION_PAIRS: u32 = 7;
/// A re-run's sides differ when chance gives so much in fewer than 2 of 100 cases, two-sided.
const SIGNIFICANCE: f64 = 0.02;

/// What was found of the times of a case.
#[derive(Clone, Debug)]
pub struct JudgedTime {
    pub result: TimeResult,
    /// It looks slower: to be confirmed before anybody is told.
    pub is_suspected: bool,
}

/// Where a ratio lies, and how sure that is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reading {
    Faster,
    Same,
    Slower,
    TooNoisy,
}

/// Reads a ratio against a limit: beyond the limit counts only what is beyond 1 with confidence, and an interval so wide
/// that a change as large as the limit could hide in it says nothing.
fn read(ratio: &Interval, limit: f64) -> Reading {
    if ratio.value > limit {
        return if ratio.low > 1.0 { Reading::Slower } else { Reading::TooNoisy };
    }
    if ratio.value < 1.0 / limit {
        return if ratio.high < 1.0 { Reading::Faster } else { Reading::TooNoisy };
    }
    if ratio.high / ratio.low > limit * limit { Reading::TooNoisy } else { Reading::Same }
}

pub fn spread(samples: &[f64]) -> Option<Spread> {
    let quarters = quartiles(samples)?;
    Some(Spread {
        samples: samples.len() as u32,
        lower_quartile_s: quarters.lower,
        median_s: quarters.median,
        upper_quartile_s: quarters.upper,
    })
}

/// Times that are kept, but not judged.
pub fn not_judged(metric: TimeMetric, samples: Vec<f64>, reason: &str) -> TimeResult {
    TimeResult {
        verdict: None,
        reason: reason.to_owned(),
        metric,
        spread: spread(&samples),
        samples_s: samples,
        baseline: None,
        ratio: None,
        limit: None,
        noise_floor: None,
        confirmation: Confirmation::default(),
    }
}

/// Judges samples by those of the baseline. `noise_floor` is the calibrated one of the metric.
pub fn judge_time(
    tolerance: &TimeTolerance,
    samples: Vec<f64>,
    baseline: &[f64],
    noise_floor: Option<f64>,
) -> JudgedTime {
    let metric = tolerance.metric();
    let calm = |reason: &str, samples| JudgedTime { result: not_judged(metric, samples, reason), is_suspected: false };
    let Some(tolerated) = tolerance.limit() else { return calm("times of this case are not judged", samples) };
    if baseline.is_empty() {
        return calm("the baseline has no times to compare with", samples);
    }
    let Some(ratio) = median_ratio(baseline, &samples) else {
        return calm("a time of 0 cannot be compared", samples);
    };
    let limit = tolerated.max_ratio.max(1.0 + noise_floor.unwrap_or(0.0));
    let reading = read(&ratio, limit);
    let (verdict, reason) = match reading {
        Reading::Faster => (TimeVerdict::Faster, format!("takes {} of the baseline's time", percent(ratio.value))),
        Reading::Same => (TimeVerdict::Same, format!("takes {} of the baseline's time", percent(ratio.value))),
        Reading::Slower => (
            TimeVerdict::Slower,
            format!("takes {} of the baseline's time, over the limit of {}", percent(ratio.value), percent(limit)),
        ),
        Reading::TooNoisy => (TimeVerdict::TooNoisyToSay, noisy(&ratio)),
    };
    let result = TimeResult {
        verdict: Some(verdict),
        reason,
        metric,
        spread: spread(&samples),
        baseline: spread(baseline),
        ratio: Some(to_ratio(&ratio, baseline, &samples)),
        limit: Some(limit),
        noise_floor,
        samples_s: samples,
        confirmation: Confirmation::default(),
    };
    JudgedTime { is_suspected: reading == Reading::Slower, result }
}

/// After the interleaved re-run: `a` is the baseline's side, `b` this run's, in turns.
pub fn confirm(suspected: TimeResult, a: Vec<f64>, b: Vec<f64>) -> TimeResult {
    let limit = suspected.limit.unwrap_or(f64::INFINITY);
    let Some(ratio) = paired_ratio(&a, &b) else {
        return unconfirmable(suspected, "the re-run took no time that could be compared");
    };
    let found = to_ratio(&ratio, &a, &b);
    let (state, verdict, reason) = match read(&ratio, limit) {
        Reading::Slower if found.p < SIGNIFICANCE => (
            ConfirmationState::Confirmed,
            TimeVerdict::Slower,
            format!("run in turns on one worker, it takes {} of the baseline's time", percent(ratio.value)),
        ),
        Reading::Slower | Reading::TooNoisy => (ConfirmationState::Refuted, TimeVerdict::TooNoisyToSay, noisy(&ratio)),
        Reading::Same | Reading::Faster => (
            ConfirmationState::Refuted,
            TimeVerdict::Same,
            format!("run in turns on one worker, it takes {} of the baseline's time", percent(ratio.value)),
        ),
    };
    let confirmation = Confirmation { state, reason: Some(reason.clone()), a_s: a, b_s: b, ratio: Some(found) };
    TimeResult { verdict: Some(verdict), reason, confirmation, ..suspected }
}

/// The baseline's side cannot run any more, for this reason. What is left of the suspicion is told only when the whole
/// interval is beyond the limit.
pub fn unconfirmable(suspected: TimeResult, why: &str) -> TimeResult {
    let beyond = suspected.ratio.zip(suspected.limit).is_some_and(|(ratio, limit)| ratio.low > limit);
    let confirmation =
        Confirmation { state: ConfirmationState::Impossible, reason: Some(why.to_owned()), ..Confirmation::default() };
    let (verdict, reason) = if beyond {
        (TimeVerdict::Slower, format!("{}; not confirmed: {why}", suspected.reason))
    } else {
        let reason = format!("looks slower, but that may be noise, and it cannot be confirmed: {why}");
        (TimeVerdict::TooNoisyToSay, reason)
    };
    TimeResult { verdict: Some(verdict), reason, confirmation, ..suspected }
}

fn to_ratio(ratio: &Interval, a: &[f64], b: &[f64]) -> TimeRatio {
    TimeRatio { value: ratio.value, low: ratio.low, high: ratio.high, p: mann_whitney(a, b).unwrap_or(1.0) }
}

fn noisy(ratio: &Interval) -> String {
    format!("between {} and {} of the baseline's time: too wide to say", percent(ratio.low), percent(ratio.high))
}

fn percent(ratio: f64) -> String {
    format!("{:.1} %", 100.0 * ratio)
}

#[cfg(test)]
mod tests {
    use lightshaft_api::farm::TimeLimit;

    use super::*;

    fn tolerance(max_ratio: f64) -> TimeTolerance {
        TimeTolerance::Limit(TimeLimit { max_ratio, ..TimeLimit::default() })
    }

    /// Times about `level` that scatter by a log-normal-like tail, the same for each seed.
    fn samples(level: f64, scatter: f64, count: usize, seed: u64) -> Vec<f64> {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut uniform = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..count).map(|_| level * (1.0 + scatter * uniform().powi(2))).collect()
    }

    fn verdict(baseline: &[f64], found: &[f64], floor: Option<f64>) -> (Option<TimeVerdict>, bool) {
        let judged = judge_time(&tolerance(1.1), found.to_vec(), baseline, floor);
        (judged.result.verdict, judged.is_suspected)
    }

    #[test]
    fn a_clear_change_has_a_verdict_and_only_slower_is_suspected() {
        let baseline = [1.0, 1.01, 1.02];
        assert_eq!(verdict(&baseline, &[1.01, 1.0, 1.03], None), (Some(TimeVerdict::Same), false));
        assert_eq!(verdict(&baseline, &[0.5, 0.51, 0.52], None), (Some(TimeVerdict::Faster), false));
        assert_eq!(verdict(&baseline, &[2.0, 2.1, 2.2], None), (Some(TimeVerdict::Slower), true));
        assert_eq!(verdict(&baseline, &[1.0, 2.1, 1.9], None).0, Some(TimeVerdict::TooNoisyToSay));
        assert_eq!(verdict(&baseline, &[0.7, 1.4, 1.0], None).0, Some(TimeVerdict::TooNoisyToSay));
        assert_eq!(verdict(&baseline, &[0.0, 0.0, 0.0], None).0, None);
        assert_eq!(verdict(&[], &[1.0], None).0, None);
        let off = judge_time(&TimeTolerance::OFF, vec![1.0], &[1.0], None).result;
        assert_eq!((off.verdict, off.samples_s), (None, vec![1.0]));
    }

    #[test]
    fn calibrated_noise_raises_the_limit() {
        let (baseline, slower) = ([1.0, 1.01, 1.02], [1.3, 1.31, 1.32]);
        assert_eq!(verdict(&baseline, &slower, Some(0.05)), (Some(TimeVerdict::Slower), true));
        assert_eq!(verdict(&baseline, &slower, Some(0.4)), (Some(TimeVerdict::Same), false));
    }

    #[test]
    fn only_a_slow_down_that_the_re_run_shows_is_confirmed() {
        let suspected = || judge_time(&tolerance(1.1), vec![2.0, 2.1, 2.2], &[1.0, 1.01, 1.02], None).result;
        let a = samples(1.0, 0.05, 7, 1);
        let shown = confirm(suspected(), a.clone(), samples(1.8, 0.05, 7, 2));
        assert_eq!(shown.verdict, Some(TimeVerdict::Slower));
        assert_eq!(shown.confirmation.state, ConfirmationState::Confirmed);
        assert!((shown.confirmation.ratio.unwrap().value - 1.8).abs() < 0.1);
        let not_shown = confirm(suspected(), a.clone(), samples(1.0, 0.05, 7, 3));
        assert_eq!(not_shown.verdict, Some(TimeVerdict::Same));
        assert_eq!(not_shown.confirmation.state, ConfirmationState::Refuted);
        let noisy = confirm(suspected(), a, vec![0.8, 3.0, 0.9, 2.0, 1.0, 4.0, 1.2]);
        assert_eq!(noisy.verdict, Some(TimeVerdict::TooNoisyToSay));
        assert_eq!(noisy.confirmation.state, ConfirmationState::Refuted);
    }

    #[test]
    fn what_cannot_be_confirmed_is_told_but_never_called_confirmed() {
        let clear = judge_time(&tolerance(1.1), vec![2.0, 2.1, 2.2], &[1.0, 1.01, 1.02], None).result;
        let told = unconfirmable(clear, "the build is gone");
        assert_eq!(told.verdict, Some(TimeVerdict::Slower));
        assert_eq!(told.confirmation.state, ConfirmationState::Impossible);
        assert!(told.reason.contains("not confirmed: the build is gone"), "{}", told.reason);
        let vague = judge_time(&tolerance(1.1), vec![1.1, 1.2, 1.3], &[1.0, 1.05, 1.02], None).result;
        assert_eq!(vague.verdict, Some(TimeVerdict::Slower));
        assert_eq!(unconfirmable(vague, "x").verdict, Some(TimeVerdict::TooNoisyToSay));
    }

    #[test]
    fn pure_noise_is_not_reported() {
        let mut alarms = 0;
        for seed in 0..1000 {
            let baseline = samples(1.0, 0.4, 3, 4 * seed);
            let judged = judge_time(&tolerance(1.1), samples(1.0, 0.4, 3, 4 * seed + 1), &baseline, None);
            if judged.is_suspected {
                let (a, b) = (samples(1.0, 0.4, 7, 4 * seed + 2), samples(1.0, 0.4, 7, 4 * seed + 3));
                let verdict = confirm(judged.result, a, b).verdict;
                alarms += u32::from(verdict == Some(TimeVerdict::Slower));
            }
        }
        assert!(alarms <= 2, "{alarms} of 1000 runs that scatter by 40 %");
    }
}
