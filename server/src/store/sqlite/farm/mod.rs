//! The regression farm's tables.

mod baselines;
mod cases;
mod decisions;
mod history;
mod runs;
mod schedules;
mod suites;
mod webhooks;
