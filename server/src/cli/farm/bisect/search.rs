//! Bisection among commits of which some cannot be judged.

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Good,
    Bad,
    Skipped,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// The last one is good.
    NoneIsBad,
    Found {
        first: usize,
        /// Those just before it that cannot be judged.
        suspects: Vec<usize>,
    },
}

/// The first bad one of `count` in a row, of which the first is known to be good. Asks of each at most once.
///
/// # Errors
/// Those of `ask`.
pub(super) fn first_bad<E>(count: usize, mut ask: impl FnMut(usize) -> Result<Verdict, E>) -> Result<Outcome, E> {
    let mut skipped = vec![false; count];
    let (mut good, mut bad) = (0, count.saturating_sub(1));
    if bad == 0 || ask(bad)? != Verdict::Bad {
        return Ok(Outcome::NoneIsBad);
    }
    while let Some(middle) = next(good, bad, &skipped) {
        match ask(middle)? {
            Verdict::Good => good = middle,
            Verdict::Bad => bad = middle,
            Verdict::Skipped => skipped[middle] = true,
        }
    }
    Ok(Outcome::Found { first: bad, suspects: (good + 1..bad).collect() })
}

/// The one nearest to the middle that has not been skipped.
fn next(good: usize, bad: usize, skipped: &[bool]) -> Option<usize> {
    let middle = good + (bad - good) / 2;
    (good + 1..bad).filter(|&i| !skipped[i]).min_by_key(|&i| i.abs_diff(middle))
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn search(count: usize, of: impl Fn(usize) -> Verdict) -> (Outcome, usize) {
        let mut asked = Vec::new();
        let outcome = first_bad::<Infallible>(count, |i| {
            assert!(!asked.contains(&i), "asked of {i} twice");
            asked.push(i);
            Ok(of(i))
        });
        (outcome.unwrap(), asked.len())
    }

    #[test]
    fn the_first_bad_one_is_found_wherever_it_is() {
        for count in 2..70 {
            for first in 1..count {
                let (outcome, asked) = search(count, |i| if i < first { Verdict::Good } else { Verdict::Bad });
                assert_eq!(outcome, Outcome::Found { first, suspects: vec![] }, "{first} of {count}");
                assert!(asked <= 1 + (count as f64).log2().ceil() as usize, "{asked} questions for {count}");
            }
        }
    }

    #[test]
    fn where_the_last_is_good_nothing_is_searched() {
        assert_eq!(search(9, |_| Verdict::Good), (Outcome::NoneIsBad, 1));
        assert_eq!(search(9, |_| Verdict::Skipped), (Outcome::NoneIsBad, 1));
        assert_eq!(search(1, |_| Verdict::Bad), (Outcome::NoneIsBad, 0));
    }

    #[test]
    fn what_cannot_be_judged_is_passed_by_and_named_where_it_matters() {
        let (outcome, _) = search(20, |i| match i {
            3..=8 => Verdict::Skipped,
            i if i < 13 => Verdict::Good,
            _ => Verdict::Bad,
        });
        assert_eq!(outcome, Outcome::Found { first: 13, suspects: vec![] });
        let (outcome, _) = search(20, |i| match i {
            10..=12 => Verdict::Skipped,
            i if i < 13 => Verdict::Good,
            _ => Verdict::Bad,
        });
        assert_eq!(outcome, Outcome::Found { first: 13, suspects: vec![10, 11, 12] });
    }
}
