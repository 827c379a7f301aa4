//! The normal distribution.

/// Two-sided p-value: how likely a standard normal variable is at least this far from 0. Relative error below 1e-12 up to
/// where it underflows, which a correction for millions of pixels needs.
pub(crate) fn two_sided_p(z: f64) -> f64 {
    erfc(z.abs() / std::f64::consts::SQRT_2)
}

/// The distance from 0 that a standard normal variable passes with this probability: the inverse of [`two_sided_p`], by
/// bisection.
pub(crate) fn critical_z(p: f64) -> f64 {
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        if two_sided_p(middle) > p { low = middle } else { high = middle }
    }
    f64::midpoint(low, high)
}

/// The standard normal statistic as likely as Student's `t` with `freedom` degrees (Wallace 1959, "Bounds on normal
/// approximations to Student's and the chi-square distributions"). Exact to some percent of
/// the tail's probability up to t = 5; farther out it is a little too near (4.83 for 4.89 at t = 20 of 6 degrees), which errs
/// towards "no change".
pub(crate) fn from_student(t: f64, freedom: f64) -> f64 {
    (freedom * (t * t / freedom).ln_1p()).sqrt() * (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)
}

/// 1 - erf(x) for x >= 0: the power series of erf near 0, the continued fraction of erfc beyond (Abramowitz and Stegun
/// 1964, 7.1.5 and 7.1.14).
fn erfc(x: f64) -> f64 {
    if x.is_nan() {
        return f64::NAN;
    }
    if x < 2.5 {
        let mut term = x;
        let mut sum = x;
        let mut n = 0.0;
        while term.abs() > 1e-17 * sum.abs() {
            n += 1.0;
            term *= -x * x / n;
            sum += term / (2.0 * n + 1.0);
        }
        return 1.0 - sum * std::f64::consts::FRAC_2_SQRT_PI;
    }
    // From the innermost of enough levels outwards.
    let fraction = (1..=60).rev().fold(x, |inner, k| x + 0.5 * f64::from(k) / inner);
    (-x * x).exp() / (fraction * std::f64::consts::PI.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_are_those_of_python() {
        // math.erfc(z / math.sqrt(2)) in Python.
        for (z, p) in [
            (0.0, 1.0),
            (0.5, 0.617_075_077_451_973_8),
            (1.959_963_984_540_054, 0.05),
            (3.0, 0.002_699_796_063_260_19),
            (3.6, 3.182_171_803_150_68e-4),
            (5.0, 5.733_031_437_583_89e-7),
            (8.0, 1.244_192_114_854_36e-15),
            (20.0, 5.507_248_237_212_47e-89),
        ] {
            let found = two_sided_p(z);
            assert!((found / p - 1.0).abs() < 1e-9, "{z}: {found} instead of {p}");
            assert_eq!(two_sided_p(-z), found);
        }
    }

    #[test]
    fn students_tails_are_met() {
        // Two-sided quantiles of t: 2.228 at 5 % for 10 degrees, 3.496 at 0.1 % for 50, 2.776 at 5 % for 4.
        for (t, freedom, p, within) in [(2.228, 10.0, 0.05, 0.01), (3.496, 50.0, 0.001, 0.01), (2.776, 4.0, 0.05, 0.02)]
        {
            let found = two_sided_p(from_student(t, freedom));
            assert!((found / p - 1.0).abs() < within, "{t} of {freedom}: {found}");
        }
        // By numerical integration: 1.01425e-6 at t = 20 of 6 degrees, 1.58955e-6 at t = 10 of 10.
        for (t, freedom, p) in [(20.0, 6.0, 1.014_25e-6), (10.0, 10.0, 1.589_55e-6)] {
            let (found, exact) = (from_student(t, freedom), critical_z(p));
            assert!(found < exact && found > 0.985 * exact, "{t} of {freedom}: {found} for {exact}");
        }
        assert_eq!(from_student(0.0, 3.0), 0.0);
    }

    #[test]
    fn the_critical_value_is_the_inverse() {
        assert!((critical_z(0.05) - 1.959_963_984_540_054).abs() < 1e-10);
        assert!((critical_z(5.733_031_437_583_89e-7) - 5.0).abs() < 1e-9);
        assert!(critical_z(1.0) < 1e-20);
    }
}
