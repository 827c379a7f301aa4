//! Ratios of times: how much slower is this than that, and how much do unchanged runs differ?

use super::{Interval, RESAMPLES, SEED, SplitMix, median, quantile, quantile_of_sorted};

/// The median of `test` over that of `reference`, with a 95 % interval (percentile bootstrap: both sides are drawn anew).
/// `None` without samples on a side, or for samples that are no positive times.
pub fn median_ratio(reference: &[f64], test: &[f64]) -> Option<Interval> {
    if !all_positive(reference) || !all_positive(test) {
        return None;
    }
    let value = median(test)? / median(reference)?;
    let mut random = SplitMix(SEED);
    let (mut r, mut t) = (reference.to_vec(), test.to_vec());
    let mut values = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        r.iter_mut().for_each(|sample| *sample = reference[random.below(reference.len())]);
        t.iter_mut().for_each(|sample| *sample = test[random.below(test.len())]);
        values.push(median(&t)? / median(&r)?);
    }
    interval(value, values)
}

/// The median of `test[i] / reference[i]`, with a 95 % interval: for measurements in turns, so that what changes slowly
/// (clocks, heat, other load) changes both of a pair. `None` without pairs, or for samples that are no positive times.
pub fn paired_ratio(reference: &[f64], test: &[f64]) -> Option<Interval> {
    if !all_positive(reference) || !all_positive(test) {
        return None;
    }
    let ratios: Vec<f64> = reference.iter().zip(test).map(|(r, t)| t / r).collect();
    let value = median(&ratios)?;
    let mut random = SplitMix(SEED);
    let mut drawn = ratios.clone();
    let mut values = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        drawn.iter_mut().for_each(|ratio| *ratio = ratios[random.below(ratios.len())]);
        values.push(median(&drawn)?);
    }
    interval(value, values)
}

/// How far two medians of unchanged runs lie apart, as a ratio less 1, in 19 of 20 pairs. `None` for fewer than three runs.
pub fn noise_floor(medians: &[f64]) -> Option<f64> {
    if medians.len() < 3 || !all_positive(medians) {
        return None;
    }
    let pairs = medians.iter().enumerate().flat_map(|(i, &a)| medians[i + 1..].iter().map(move |&b| (a, b)));
    let apart: Vec<f64> = pairs.map(|(a, b)| a.max(b) / a.min(b) - 1.0).collect();
    quantile(&apart, 0.95)
}

fn all_positive(samples: &[f64]) -> bool {
    !samples.is_empty() && samples.iter().all(|sample| sample.is_finite() && *sample > 0.0)
}

fn interval(value: f64, mut values: Vec<f64>) -> Option<Interval> {
    values.sort_unstable_by(f64::total_cmp);
    Some(Interval { value, low: quantile_of_sorted(&values, 0.025)?, high: quantile_of_sorted(&values, 0.975)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_is_that_of_the_medians() {
        let ratio = median_ratio(&[1.0, 1.1, 0.9], &[2.0, 2.2, 1.8]).unwrap();
        assert!((ratio.value - 2.0).abs() < 1e-12);
        assert!((ratio.low - 1.8 / 1.1).abs() < 1e-9 && (ratio.high - 2.2 / 0.9).abs() < 1e-9, "{ratio:?}");
        let exact = median_ratio(&[2.0; 4], &[3.0; 5]).unwrap();
        assert_eq!((exact.value, exact.low, exact.high), (1.5, 1.5, 1.5));
    }

    #[test]
    fn what_drifts_on_both_sides_is_no_difference_of_pairs() {
        let drift: Vec<f64> = (0..9).map(|i| 1.0 + 0.3 * f64::from(i)).collect();
        let slower: Vec<f64> = drift.iter().map(|t| t * 1.2).collect();
        let paired = paired_ratio(&drift, &slower).unwrap();
        assert!((paired.low - 1.2).abs() < 1e-9 && (paired.high - 1.2).abs() < 1e-9, "{paired:?}");
        let unpaired = median_ratio(&drift, &slower).unwrap();
        assert!(unpaired.low < 1.0, "the drift hides it: {unpaired:?}");
    }

    #[test]
    fn what_is_no_time_has_no_ratio() {
        for bad in [&[][..], &[0.0], &[1.0, f64::NAN], &[-1.0], &[f64::INFINITY]] {
            assert_eq!(median_ratio(&[1.0], bad), None);
            assert_eq!(paired_ratio(bad, &[1.0]), None);
        }
    }

    #[test]
    fn the_noise_floor_is_what_unchanged_runs_differ_by() {
        assert_eq!(noise_floor(&[1.0, 1.0, 1.0, 1.0]), Some(0.0));
        // Three pairs: 1.1, 1.2 and 1.2 / 1.1; 95 % between the two largest.
        let floor = noise_floor(&[1.0, 1.1, 1.2]).unwrap();
        assert!((floor - 0.19).abs() < 1e-9, "{floor}");
        assert_eq!(noise_floor(&[1.0, 1.1]), None);
    }
}
