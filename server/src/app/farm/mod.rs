//! The regression farm: suites, runs and their verdicts, baselines and decisions. Its rules are in [`crate::farm`].

mod decisions;
mod follow;
mod history;
mod pictures;
mod runs;
mod schedules;
mod suites;
mod webhooks;
