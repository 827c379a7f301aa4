//! Where a series of measurements changes to another level: E-divisive (Matteson and James 2014, "A nonparametric approach
//! for multiple change point analysis of multivariate data"), with the significance of each point from permutations, as
//! used for benchmarks by Daly et al. 2020, "The use of change point detection to identify software performance
//! regressions in a continuous integration system".

use super::{SEED, SplitMix};

/// Least measurements of a segment.
const SHORTEST: usize = 3;
/// The chance that a point is found where nothing changes: one of so many orders of the same values is as divided.
const PERMUTATIONS: usize = 199;
const SIGNIFICANCE: f64 = 0.01;

/// Indices at which another level begins, ascending. Random numbers come from a fixed seed: the same series gives the same
/// points.
pub fn change_points(series: &[f64]) -> Vec<usize> {
    let mut points = Vec::new();
    if series.iter().all(|value| value.is_finite()) {
        divide(series, 0, &mut SplitMix(SEED), &mut points);
    }
    points.sort_unstable();
    points
}

fn divide(series: &[f64], offset: usize, random: &mut SplitMix, points: &mut Vec<usize>) {
    let Some((at, divergence)) = best_split(series) else { return };
    if !is_significant(series, divergence, random) {
        return;
    }
    points.push(offset + at);
    divide(&series[..at], offset, random, points);
    divide(&series[at..], offset + at, random, points);
}

fn is_significant(series: &[f64], divergence: f64, random: &mut SplitMix) -> bool {
    let mut shuffled = series.to_vec();
    let allowed = (SIGNIFICANCE * (PERMUTATIONS + 1) as f64) as usize;
    let mut as_divided = 1;
    for _ in 0..PERMUTATIONS {
        // Fisher and Yates.
        for i in (1..shuffled.len()).rev() {
            shuffled.swap(i, random.below(i + 1));
        }
        if best_split(&shuffled).is_some_and(|(_, found)| found >= divergence) {
            as_divided += 1;
            if as_divided > allowed {
                return false;
            }
        }
    }
    true
}

/// The split with the largest energy distance between its sides, weighed by their lengths (equation 5 with alpha 1), and
/// that distance. `None` for series too short to have one, and for those of one value.
fn best_split(series: &[f64]) -> Option<(usize, f64)> {
    let n = series.len();
    if n < 2 * SHORTEST {
        return None;
    }
    // Sums of distances within the left side, across, and within the right side; moved one by one.
    let distance_to = |x: f64, others: &[f64]| others.iter().map(|y| (x - y).abs()).sum::<f64>();
    let (mut left, mut across, mut right) = (0.0, 0.0, 0.0);
    for (i, &x) in series.iter().enumerate() {
        right += distance_to(x, &series[i + 1..]);
    }
    let mut best: Option<(usize, f64)> = None;
    for at in 1..=n - SHORTEST {
        let moved = series[at - 1];
        let (to_left, to_right) = (distance_to(moved, &series[..at - 1]), distance_to(moved, &series[at..]));
        left += to_left;
        right -= to_right;
        across += to_right - to_left;
        if at < SHORTEST {
            continue;
        }
        let (l, r) = (at as f64, (n - at) as f64);
        let energy = 2.0 * across / (l * r) - left / (l * (l - 1.0) / 2.0) - right / (r * (r - 1.0) / 2.0);
        let divergence = energy * l * r / (l + r);
        if divergence > best.map_or(0.0, |(_, most)| most) {
            best = Some((at, divergence));
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scatters by up to 2 % about each level.
    fn series(levels: &[(usize, f64)], seed: u64) -> Vec<f64> {
        let mut random = SplitMix(seed);
        let mut noisy = |level: f64| level * (1.0 + 0.04 * (random.below(1000) as f64 / 999.0 - 0.5));
        levels.iter().flat_map(|&(count, level)| vec![level; count]).map(&mut noisy).collect()
    }

    #[test]
    fn steps_are_found_where_they_are() {
        assert_eq!(change_points(&series(&[(12, 1.0), (10, 1.2)], 1)), [12]);
        assert_eq!(change_points(&series(&[(15, 1.0), (15, 1.3), (12, 0.9)], 2)), [15, 30]);
        let step_of_one_percent_of_noise = series(&[(10, 1.0), (10, 1.05)], 3);
        assert_eq!(change_points(&step_of_one_percent_of_noise), [10]);
    }

    #[test]
    fn noise_has_hardly_any() {
        let false_alarms = (0..100).filter(|&seed| !change_points(&series(&[(30, 1.0)], seed)).is_empty()).count();
        assert!(false_alarms <= 4, "{false_alarms} of 100 at a significance of 1 %");
    }

    #[test]
    fn short_and_constant_series_have_none() {
        assert!(change_points(&[]).is_empty());
        assert!(change_points(&[1.0, 1.0, 5.0, 5.0]).is_empty());
        assert!(change_points(&[2.0; 50]).is_empty());
        assert!(change_points(&[1.0, f64::NAN, 1.0, 1.0, 2.0, 2.0, 2.0]).is_empty());
    }
}
