//! Statistics of timings: what a few repeated measurements say, and how sure of it they are.
//!
//! Times of a computer have a floor and a long tail, so nothing here assumes a normal distribution: medians and
//! quartiles describe, and the bootstrap (Efron 1979, "Bootstrap methods: another look at the jackknife") gives
//! intervals. Random numbers come from a fixed seed: the same samples give the same interval.

mod change_points;
mod mann_whitney;
mod ratio;

pub use change_points::change_points;
pub use mann_whitney::mann_whitney;
pub use ratio::{median_ratio, noise_floor, paired_ratio};

/// The quarters of some samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quartiles {
    pub lower: f64,
    pub median: f64,
    pub upper: f64,
}

/// A figure, and between what it lies with a confidence of 95 %.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    pub value: f64,
    pub low: f64,
    pub high: f64,
}

/// Resamples of a bootstrap: the 2.5 % quantile then rests on fifty of them.
const RESAMPLES: usize = 2000;
const SEED: u64 = 0x4c53;

/// The value below which a share `p` (0 to 1) of the samples lies, interpolated linearly between the two nearest
/// (Hyndman and Fan 1996, type 7). `None` without samples.
pub fn quantile(samples: &[f64], p: f64) -> Option<f64> {
    let mut sorted = samples.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    quantile_of_sorted(&sorted, p)
}

pub fn median(samples: &[f64]) -> Option<f64> {
    quantile(samples, 0.5)
}

/// `None` without samples.
pub fn quartiles(samples: &[f64]) -> Option<Quartiles> {
    let mut sorted = samples.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    Some(Quartiles {
        lower: quantile_of_sorted(&sorted, 0.25)?,
        median: quantile_of_sorted(&sorted, 0.5)?,
        upper: quantile_of_sorted(&sorted, 0.75)?,
    })
}

/// Quartiles of several groups (views of a scene): of each figure, the median over the groups. So a group that is
/// faster than the others as a whole does not count as noise. `None` without samples.
pub fn grouped_quartiles(groups: &[Vec<f64>]) -> Option<Quartiles> {
    let all: Vec<Quartiles> = groups.iter().filter_map(|group| quartiles(group)).collect();
    let over = |figure: fn(&Quartiles) -> f64| median(&all.iter().map(figure).collect::<Vec<_>>());
    Some(Quartiles { lower: over(|q| q.lower)?, median: over(|q| q.median)?, upper: over(|q| q.upper)? })
}

/// The median over groups of each group's median, with a 95 % interval: the percentile bootstrap, which draws anew
/// within each group. The interval tells of the noise of measuring, not of how much the groups differ. `None` when a
/// group is empty, or there is none.
pub fn grouped_median(groups: &[Vec<f64>]) -> Option<Interval> {
    let of = |groups: &[Vec<f64>]| {
        let medians: Option<Vec<f64>> = groups.iter().map(|group| median(group)).collect();
        median(&medians?)
    };
    let value = of(groups)?;
    let mut random = SplitMix(SEED);
    let mut drawn = groups.to_vec();
    let mut values = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        for (drawn, group) in drawn.iter_mut().zip(groups) {
            drawn.iter_mut().for_each(|sample| *sample = group[random.below(group.len())]);
        }
        values.push(of(&drawn)?);
    }
    values.sort_unstable_by(f64::total_cmp);
    let (low, high) = (quantile_of_sorted(&values, 0.025)?, quantile_of_sorted(&values, 0.975)?);
    Some(Interval { value, low, high })
}

fn quantile_of_sorted(sorted: &[f64], p: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let at = p.clamp(0.0, 1.0) * last as f64;
    let (below, share) = (at.floor() as usize, at.fract());
    let above = (below + 1).min(last);
    Some(sorted[below] + (sorted[above] - sorted[below]) * share)
}

/// Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators".
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform below `bound` (Lemire 2019), but for a bias of `bound` in 2^64.
    fn below(&mut self, bound: usize) -> usize {
        ((u128::from(self.next()) * bound as u128) >> 64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_are_those_of_r() {
        // quantile(c(6, 7, 15, 36, 39, 40, 41, 42, 43, 47, 49)) and quantile(c(7, 15, 36, 39, 40, 41)) in R.
        let odd = [49.0, 6.0, 7.0, 15.0, 36.0, 39.0, 40.0, 41.0, 42.0, 43.0, 47.0];
        assert_eq!(quartiles(&odd), Some(Quartiles { lower: 25.5, median: 40.0, upper: 42.5 }));
        let even = [7.0, 15.0, 36.0, 39.0, 40.0, 41.0];
        assert_eq!(quartiles(&even), Some(Quartiles { lower: 20.25, median: 37.5, upper: 39.75 }));
        assert_eq!(quartiles(&[5.0]), Some(Quartiles { lower: 5.0, median: 5.0, upper: 5.0 }));
        assert_eq!(quartiles(&[]), None);
        assert_eq!(quantile(&odd, 1.0), Some(49.0));
    }

    #[test]
    fn samples_that_agree_have_no_interval() {
        let interval = grouped_median(&[vec![1.5; 7], vec![1.5; 3]]).unwrap();
        assert_eq!((interval.value, interval.low, interval.high), (1.5, 1.5, 1.5));
        assert_eq!(grouped_median(&[vec![1.0], vec![]]), None);
        assert_eq!(grouped_median(&[]), None);
    }

    #[test]
    fn the_interval_is_that_of_the_medians_distribution() {
        // The bootstrap median of three different values is the least where two or three of the three draws are it:
        // 7 of 27. So the ends of the interval are the ends of the samples.
        let interval = grouped_median(&[vec![1.0, 2.0, 4.0]]).unwrap();
        assert_eq!((interval.value, interval.low, interval.high), (2.0, 1.0, 4.0));
        // Of 1..=101 it is asymptotically normal: 51 +- 1.96 * 101 / (2 * sqrt(101)), which is 51 +- 9.8.
        let many: Vec<f64> = (1..=101).map(f64::from).collect();
        let interval = grouped_median(&[many]).unwrap();
        assert_eq!(interval.value, 51.0);
        assert!((38.0..45.0).contains(&interval.low) && (57.0..64.0).contains(&interval.high), "{interval:?}");
    }

    #[test]
    fn a_group_that_is_faster_as_a_whole_is_no_noise() {
        let groups = [vec![1.0, 1.1, 0.9], vec![10.0, 10.1, 9.9], vec![2.0, 2.1, 1.9]];
        let interval = grouped_median(&groups).unwrap();
        assert_eq!(interval.value, 2.0);
        assert!(interval.low >= 1.9 && interval.high <= 2.1, "{interval:?}");
        let quartiles = grouped_quartiles(&groups).unwrap();
        assert_eq!(quartiles.median, 2.0);
        assert!((quartiles.lower - 1.95).abs() < 1e-12 && (quartiles.upper - 2.05).abs() < 1e-12);
        assert_eq!(grouped_quartiles(&[]), None);
    }

    #[test]
    fn most_intervals_hold_the_truth() {
        // 200 experiments of 15 samples with the median 0: about 95 % must hold it.
        let mut random = SplitMix(7);
        let mut uniform = || random.next() as f64 / u64::MAX as f64 - 0.5;
        let held = (0..200)
            .filter(|_| {
                let samples: Vec<f64> = (0..15).map(|_| uniform()).collect();
                grouped_median(&[samples]).is_some_and(|interval| interval.low <= 0.0 && interval.high >= 0.0)
            })
            .count();
        assert!((180..=199).contains(&held), "{held} of 200");
    }
}
