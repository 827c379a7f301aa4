//! What becomes of a task whose attempt did not succeed.

use lightshaft_api::job::Phase;
use lightshaft_api::lease::RetryClass;

use super::Millis;

/// First pause after a transient failure.
const BACKOFF_BASE_MS: Millis = 10_000;
/// Longest pause after a transient failure.
const BACKOFF_MAX_MS: Millis = 600_000;

/// After a failure of class `worker`, the same worker gets the task again after this pause at the earliest: a driver
/// that has lost its device may need a moment.
pub const WORKER_PAUSE_MS: Millis = 2_000;
/// For this long a task waits for another worker rather than go to the one that failed at it. As the block below, this
/// holds only while another worker is there that could do it: the last one left gets every attempt that there is.
pub const WORKER_PATIENCE_MS: Millis = 30_000;
/// A worker with this many failures of class `worker` at one job is kept from it …
pub const BLOCK_AFTER_FAILURES: i64 = 2;
/// … for this long.
pub const BLOCK_MS: Millis = 600_000;

/// Where a task goes after an attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Again, not before `run_at`. `spends` says whether the attempt counts.
    Ready {
        run_at: Millis,
        spends: bool,
    },
    /// Failed for good, by its own word.
    Failed,
    /// Out of attempts, or it kills workers.
    Dead,
    Cancelled,
}

/// A report of failure, and the task it is about.
#[derive(Clone, Copy, Debug)]
pub struct Failure {
    pub class: RetryClass,
    /// A further attempt cannot help.
    pub fatal: bool,
    pub cancel_requested: bool,
    /// Attempts that counted before this one.
    pub spent: u32,
    pub max_attempts: u32,
    pub now: Millis,
    /// Uniform in -1 to 1.
    pub jitter: f64,
}

pub fn after_failure(failure: Failure) -> Next {
    let Failure { class, fatal, cancel_requested, spent, max_attempts, now, jitter } = failure;
    if cancel_requested {
        return Next::Cancelled;
    }
    let again = |run_at| {
        if spent + 1 >= max_attempts { Next::Dead } else { Next::Ready { run_at, spends: true } }
    };
    match class {
        RetryClass::Task if fatal => Next::Failed,
        RetryClass::Worker | RetryClass::Task => again(now),
        RetryClass::Transient => again(now + backoff_ms(spent + 1, jitter)),
    }
}

/// A lease that ran out, and the task it was for.
#[derive(Clone, Copy, Debug)]
pub struct Expiry {
    pub cancel_requested: bool,
    pub spent: u32,
    pub max_attempts: u32,
    /// Last phase that this attempt's heartbeats told of.
    pub phase: Option<Phase>,
    /// The same of the attempt before, where that one expired too.
    pub phase_before: Option<Phase>,
    pub now: Millis,
}

/// Workers that vanish twice at the same place were most likely killed by the task itself (memory, driver): it must
/// not take down one worker after another until its attempts are used up.
pub fn after_expiry(expiry: Expiry) -> Next {
    let Expiry { cancel_requested, spent, max_attempts, phase, phase_before, now } = expiry;
    if cancel_requested {
        return Next::Cancelled;
    }
    let poison = spent >= 1 && phase.is_some() && phase == phase_before;
    if poison || spent + 1 >= max_attempts {
        return Next::Dead;
    }
    Next::Ready { run_at: now, spends: true }
}

/// `min(10 s * 4^(n-1), 10 min)`, 20 % more or less by `jitter`, so that failures do not come back in step.
fn backoff_ms(n: u32, jitter: f64) -> Millis {
    let doublings = 2 * n.saturating_sub(1).min(10);
    let pause = (BACKOFF_BASE_MS << doublings).min(BACKOFF_MAX_MS);
    pause + (pause as f64 * 0.2 * jitter.clamp(-1.0, 1.0)) as Millis
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Millis = 1_000_000;

    fn fail(class: RetryClass, spent: u32) -> Next {
        let cancel_requested = false;
        after_failure(Failure { class, fatal: false, cancel_requested, spent, max_attempts: 3, now: NOW, jitter: 0.0 })
    }

    #[test]
    fn pauses_grow_fourfold_up_to_ten_minutes() {
        let pauses = [1, 2, 3, 4, 5, 100].map(|n| backoff_ms(n, 0.0));
        assert_eq!(pauses, [10_000, 40_000, 160_000, 600_000, 600_000, 600_000]);
        assert_eq!(backoff_ms(1, 1.0), 12_000);
        assert_eq!(backoff_ms(1, -1.0), 8_000);
    }

    #[test]
    fn worker_and_task_failures_go_again_at_once_until_attempts_are_used_up() {
        for class in [RetryClass::Worker, RetryClass::Task] {
            assert_eq!(fail(class, 0), Next::Ready { run_at: NOW, spends: true });
            assert_eq!(fail(class, 2), Next::Dead);
        }
    }

    #[test]
    fn transient_failures_wait() {
        assert_eq!(fail(RetryClass::Transient, 1), Next::Ready { run_at: NOW + 40_000, spends: true });
        assert_eq!(fail(RetryClass::Transient, 2), Next::Dead);
    }

    #[test]
    fn a_fatal_failure_is_the_last() {
        let fatal = Failure {
            class: RetryClass::Task,
            fatal: true,
            cancel_requested: false,
            spent: 0,
            max_attempts: 3,
            now: NOW,
            jitter: 0.0,
        };
        assert_eq!(after_failure(fatal), Next::Failed);
        let cancelled = Failure { cancel_requested: true, ..fatal };
        assert_eq!(after_failure(cancelled), Next::Cancelled, "nobody wants it any more");
    }

    #[test]
    fn a_task_that_loses_two_workers_at_the_same_phase_is_dead() {
        let expiry = |spent, phase, phase_before| {
            after_expiry(Expiry { cancel_requested: false, spent, max_attempts: 10, phase, phase_before, now: NOW })
        };
        let ready = Next::Ready { run_at: NOW, spends: true };
        assert_eq!(expiry(0, Some(Phase::Render), None), ready);
        assert_eq!(expiry(1, Some(Phase::Render), Some(Phase::Render)), Next::Dead);
        assert_eq!(expiry(1, Some(Phase::Render), Some(Phase::Import)), ready);
        assert_eq!(expiry(1, None, None), ready, "an answer may have been lost before the first heartbeat");
        assert_eq!(expiry(9, None, None), Next::Dead);
        assert_eq!(expiry(0, Some(Phase::Render), Some(Phase::Render)), ready, "retried by a person: a fresh start");
    }
}
