//! The Mann-Whitney U test (Mann and Whitney 1947, "On a test of whether one of two random variables is stochastically
//! larger than the other"): exact for small samples, by the normal approximation with ties corrected otherwise.

use crate::normal::two_sided_p;

/// Up to so many samples together, without ties, the distribution is counted out.
const MOST_EXACT: usize = 40;

/// Two-sided p-value that both samples come from one distribution. `None` when a side is empty.
pub fn mann_whitney(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let mut all: Vec<(f64, bool)> = a.iter().map(|&x| (x, true)).chain(b.iter().map(|&x| (x, false))).collect();
    all.sort_by(|x, y| x.0.total_cmp(&y.0));
    let (mut rank_sum, mut ties) = (0.0, 0.0);
    let mut start = 0;
    while start < all.len() {
        let tied = all[start..].iter().take_while(|x| x.0 == all[start].0).count().max(1);
        let rank = start as f64 + (tied as f64 + 1.0) / 2.0;
        rank_sum += rank * all[start..start + tied].iter().filter(|x| x.1).count() as f64;
        ties += (tied as f64).powi(3) - tied as f64;
        start += tied;
    }
    let (m, n) = (a.len() as f64, b.len() as f64);
    let u = rank_sum - m * (m + 1.0) / 2.0;
    let smaller = u.min(m * n - u);
    if ties == 0.0 && all.len() <= MOST_EXACT {
        return Some(exact(a.len(), b.len(), smaller));
    }
    let total = m + n;
    let variance = m * n / 12.0 * (total + 1.0 - ties / (total * (total - 1.0)));
    if variance <= 0.0 {
        return Some(1.0);
    }
    // Half a step towards the middle: U is a whole number where there are no ties.
    let distance = (m * n / 2.0 - smaller - 0.5).max(0.0);
    Some(two_sided_p(distance / variance.sqrt()))
}

/// Twice the share of all orders of the samples with a statistic of at most `u`.
fn exact(m: usize, n: usize, u: f64) -> f64 {
    // ways[i][j]: orders of i and j samples by their statistic. The largest sample is of the first side, and then above all
    // of the second, or of the second.
    let mut ways = vec![vec![Vec::new(); n + 1]; m + 1];
    for i in 0..=m {
        for j in 0..=n {
            let mut counts = vec![0.0_f64; i * j + 1];
            if i == 0 || j == 0 {
                counts[0] = 1.0;
            } else {
                ways[i - 1][j].iter().enumerate().for_each(|(k, count)| counts[k + j] += count);
                ways[i][j - 1].iter().enumerate().for_each(|(k, count)| counts[k] += count);
            }
            ways[i][j] = counts;
        }
    }
    let counts = &ways[m][n];
    let at_most: f64 = counts.iter().take(u as usize + 1).sum();
    (2.0 * at_most / counts.iter().sum::<f64>()).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_samples_are_counted_out() {
        // wilcox.test(c(1, 2, 3), c(4, 5, 6))$p.value in R is 0.1; of five against five, 2 / 252.
        assert!((mann_whitney(&[1.0, 2.0, 3.0], &[4.0, 5.0, 6.0]).unwrap() - 0.1).abs() < 1e-12);
        let (a, b) = ([1.0, 2.0, 3.0, 4.0, 5.0], [6.0, 7.0, 8.0, 9.0, 10.0]);
        assert!((mann_whitney(&a, &b).unwrap() - 2.0 / 252.0).abs() < 1e-12);
        assert_eq!(mann_whitney(&a, &b), mann_whitney(&b, &a));
        // wilcox.test(c(1.1, 2.2, 3.3, 4.4), c(2.0, 3.0, 4.0, 5.0, 6.0)): W = 6, p = 0.4127.
        let p = mann_whitney(&[1.1, 2.2, 3.3, 4.4], &[2.0, 3.0, 4.0, 5.0, 6.0]).unwrap();
        assert!((p - 0.412_698_412_698).abs() < 1e-9, "{p}");
    }

    #[test]
    fn ties_are_corrected_for() {
        // U = 2.5 of 16; a variance of 16 / 12 * (9 - (24 + 6) / 56) = 11.286; 5 / sqrt(11.286) = 1.4884 deviations.
        let p = mann_whitney(&[1.0, 2.0, 2.0, 3.0], &[2.0, 3.0, 4.0, 5.0]).unwrap();
        assert!((p - 0.136_658).abs() < 1e-6, "{p}");
        assert_eq!(mann_whitney(&[1.0; 5], &[1.0; 4]), Some(1.0));
        assert_eq!(mann_whitney(&[], &[1.0]), None);
    }

    #[test]
    fn many_samples_take_the_normal_approximation() {
        let a: Vec<f64> = (0..40).map(f64::from).collect();
        let b: Vec<f64> = a.iter().map(|x| x + 20.5).collect();
        let p = mann_whitney(&a, &b).unwrap();
        assert!(p < 1e-6 && p > 1e-12, "{p}");
        let same: Vec<f64> = a.iter().map(|x| x + 0.5).collect();
        assert!(mann_whitney(&a, &same).unwrap() > 0.7);
    }
}
