//! The rules of the queue, without IO: states, retry classes, back-off, poison, and how a job splits into tasks.
//!
//! ```text
//!                         all parts succeeded
//!               blocked ──────────────────────► ready ◄───────────────┐ retry class, attempts left
//!                  │                              │ claim              │
//!                  │ cancel                       ▼                    │
//!                  └──────────► cancelled ◄──── leased ────────────────┤
//!                                         cancel  │                    │ fatal        no attempts left, poison
//!                                                 ▼                    ├──► failed    ┌──► dead
//!                                             succeeded                └──────────────┘
//! ```
//!
//! A job's state is derived from its tasks' states alone ([`job_state`]). The store applies these rules inside its
//! transactions; the clock is whatever the caller says it is.

mod demand;
mod retry;
mod split;

pub use demand::{Demand, Offer, Roll, gives_up};
use lightshaft_api::job::JobState;
pub use retry::{
    BLOCK_AFTER_FAILURES, BLOCK_MS, Expiry, Failure, Next, WORKER_PATIENCE_MS, WORKER_PAUSE_MS, after_expiry,
    after_failure,
};
pub use split::plan;

/// Milliseconds since 1970 UTC.
pub type Millis = i64;

/// A worker that has not been heard of for this long is gone.
pub const GONE_AFTER_MS: Millis = 90_000;
/// A task that has waited this long goes before younger tasks whose structures are warm on the asking worker.
pub const WARM_PATIENCE_MS: Millis = 600_000;

/// How many tasks of a job are in each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskCounts {
    pub blocked: u32,
    pub ready: u32,
    pub leased: u32,
    pub succeeded: u32,
    pub failed: u32,
    pub cancelled: u32,
    pub dead: u32,
}

/// The state of a job whose tasks are in these states.
pub fn job_state(counts: &TaskCounts) -> JobState {
    let open = counts.blocked + counts.ready + counts.leased;
    if open > 0 {
        let begun = counts.leased + counts.succeeded > 0;
        return if begun { JobState::Running } else { JobState::Queued };
    }
    if counts.failed + counts.dead > 0 {
        JobState::Failed
    } else if counts.cancelled > 0 {
        JobState::Cancelled
    } else {
        JobState::Succeeded
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_is_what_its_tasks_are() {
        let state = |blocked, ready, leased, succeeded, failed, cancelled, dead| {
            job_state(&TaskCounts { blocked, ready, leased, succeeded, failed, cancelled, dead })
        };
        assert_eq!(state(0, 1, 0, 0, 0, 0, 0), JobState::Queued);
        assert_eq!(state(1, 4, 0, 0, 0, 0, 0), JobState::Queued);
        assert_eq!(state(1, 3, 1, 0, 0, 0, 0), JobState::Running);
        assert_eq!(state(1, 3, 0, 1, 0, 0, 0), JobState::Running);
        assert_eq!(state(0, 0, 1, 0, 1, 0, 0), JobState::Running, "a task still has to stop");
        assert_eq!(state(0, 0, 0, 5, 0, 0, 0), JobState::Succeeded);
        assert_eq!(state(0, 0, 0, 3, 1, 1, 0), JobState::Failed);
        assert_eq!(state(0, 0, 0, 3, 0, 1, 1), JobState::Failed);
        assert_eq!(state(0, 0, 0, 3, 0, 2, 0), JobState::Cancelled);
    }
}
