//! How long a call that fails is tried again.
//!
//! What the service refuses for the moment (429, 5xx), and what does not get through, is tried again after a growing
//! pause. The time for that is limited while the service answers heartbeats: it then has trouble with this very call,
//! and another attempt may fare better. While it answers nothing, nobody is served by giving up: the lease may still
//! hold when it is back, and the protocol says when it does not.

use std::time::{Duration, Instant};

use lightshaft_api::client::ClientError;

use super::live::Live;
use super::stop::Stop;
use crate::executor::TaskError;

const FIRST_PAUSE: Duration = Duration::from_millis(250);
const LONGEST_PAUSE: Duration = Duration::from_secs(10);
/// Longest pause that the service may ask for.
const LONGEST_ASKED: Duration = Duration::from_secs(60);
/// For one call, all tries together, without the time in which the service does not answer.
const LIMIT: Duration = Duration::from_secs(120);

/// The tries of one call.
pub(super) struct Tries<'a> {
    live: &'a Live,
    stop: &'a Stop,
    budget: Budget,
    /// When the last try began.
    began: Instant,
}

impl<'a> Tries<'a> {
    pub(super) fn new(live: &'a Live, stop: &'a Stop) -> Self {
        Self { live, stop, budget: Budget::default(), began: Instant::now() }
    }

    /// Waits for the moment of the next try; false when there should be none.
    ///
    /// # Errors
    /// [`TaskError::Stopped`] when the task is to stop meanwhile.
    pub(super) async fn again(&mut self, error: &ClientError) -> Result<bool, TaskError> {
        if !error.is_transient() {
            return Ok(false);
        }
        let asked = error.retry_after().unwrap_or_default();
        let pause = self.budget.next(self.began.elapsed(), asked, self.live.service_answers());
        let Some(pause) = pause else { return Ok(false) };
        tokio::select! {
            () = self.stop.asked() => return Err(TaskError::Stopped),
            () = tokio::time::sleep(pause) => {}
        }
        self.began = Instant::now();
        Ok(true)
    }
}

#[derive(Debug)]
struct Budget {
    pause: Duration,
    left: Duration,
}

impl Default for Budget {
    fn default() -> Self {
        Self { pause: FIRST_PAUSE, left: LIMIT }
    }
}

impl Budget {
    /// The pause after a try that took so long, or `None` when the time is up.
    fn next(&mut self, took: Duration, asked: Duration, service_answers: bool) -> Option<Duration> {
        let pause = self.pause.max(asked.min(LONGEST_ASKED));
        if service_answers {
            self.left = self.left.checked_sub(took + pause)?;
        }
        self.pause = (2 * self.pause).min(LONGEST_PAUSE);
        Some(pause)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOTHING: Duration = Duration::ZERO;

    #[test]
    fn pauses_double_and_end_after_two_minutes_of_a_service_that_answers() {
        let mut budget = Budget::default();
        let pauses: Vec<Duration> = std::iter::from_fn(|| budget.next(NOTHING, NOTHING, true)).collect();
        assert_eq!(pauses[..3], [250, 500, 1000].map(Duration::from_millis));
        assert_eq!(pauses.iter().max(), Some(&LONGEST_PAUSE));
        let total: Duration = pauses.iter().sum();
        assert!(total <= LIMIT && total + LONGEST_PAUSE >= LIMIT, "{total:?}");
    }

    #[test]
    fn tries_that_take_long_count_and_those_without_a_service_do_not() {
        let mut budget = Budget::default();
        assert!((0..100).all(|_| budget.next(Duration::from_secs(60), NOTHING, false).is_some()));
        assert!(budget.next(Duration::from_secs(60), NOTHING, true).is_some());
        assert_eq!(budget.next(Duration::from_secs(60), NOTHING, true), None);
    }

    #[test]
    fn the_service_may_ask_for_a_longer_pause_within_reason() {
        let mut budget = Budget::default();
        assert_eq!(budget.next(NOTHING, Duration::from_secs(5), true), Some(Duration::from_secs(5)));
        assert_eq!(budget.next(NOTHING, Duration::from_secs(86_400), true), Some(LONGEST_ASKED));
    }
}
