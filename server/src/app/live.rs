//! What changes too often for the database: progress of running tasks, and what workers told of themselves. It is
//! lost at a restart, and told anew by the next heartbeat or poll.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use lightshaft_api::job::Phase;
use lightshaft_api::lease::Heartbeat;
use lightshaft_api::worker::CacheStatus;

use crate::queue::{GONE_AFTER_MS, Millis};
use crate::store::LeaseState;

/// How often a worker's sign of life is written down.
const SEEN_FLUSH_MS: Millis = 15_000;

#[derive(Debug, Default)]
pub(super) struct Live {
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    workers: HashMap<String, LiveWorker>,
    /// By attempt: a task's attempt before may still be speaking when the next one begins.
    attempts: HashMap<String, LiveTask>,
}

#[derive(Clone, Debug, Default)]
pub(super) struct LiveWorker {
    pub(super) seen_at: Millis,
    flushed_at: Millis,
    pub(super) cache: CacheStatus,
    pub(super) warm: Vec<String>,
    /// It said that it leaves, and has not registered again.
    pub(super) parted: bool,
}

#[derive(Clone, Debug)]
pub(super) struct LiveTask {
    pub(super) job: String,
    task: String,
    pub(super) phase: Phase,
    /// Never falls while the lease lasts.
    pub(super) progress: f64,
    pub(super) preview: Option<String>,
}

/// What a heartbeat changed.
pub(super) struct Beat {
    /// The attempt was not known here before.
    pub(super) is_first: bool,
    /// The picture that another one has taken the place of.
    pub(super) old_preview: Option<String>,
    pub(super) new_preview: bool,
}

impl Live {
    /// Notes a sign of life; true when it should be written down.
    pub(super) fn seen(&self, worker: &str, now: Millis) -> bool {
        let mut state = self.lock();
        let live = state.workers.entry(worker.to_owned()).or_default();
        live.seen_at = now;
        if now - live.flushed_at < SEEN_FLUSH_MS {
            return false;
        }
        live.flushed_at = now;
        true
    }

    pub(super) fn poll(&self, worker: &str, cache: CacheStatus, warm: Vec<String>) {
        let mut state = self.lock();
        let live = state.workers.entry(worker.to_owned()).or_default();
        live.cache = cache;
        live.warm = warm;
    }

    pub(super) fn set_parted(&self, worker: &str, parted: bool) {
        self.lock().workers.entry(worker.to_owned()).or_default().parted = parted;
    }

    pub(super) fn has_parted(&self, worker: &str) -> bool {
        self.lock().workers.get(worker).is_some_and(|live| live.parted)
    }

    pub(super) fn forget_worker(&self, worker: &str) {
        self.lock().workers.remove(worker);
    }

    pub(super) fn worker(&self, worker: &str) -> Option<LiveWorker> {
        self.lock().workers.get(worker).cloned()
    }

    /// Ids of workers that hold a mesh warm.
    pub(super) fn workers_with(&self, mesh: &str, now: Millis) -> Vec<String> {
        let state = self.lock();
        let mut ids: Vec<String> = state
            .workers
            .iter()
            .filter(|(_, live)| now - live.seen_at < GONE_AFTER_MS && live.warm.iter().any(|hash| hash == mesh))
            .map(|(id, _)| id.clone())
            .collect();
        ids.sort();
        ids
    }

    /// Forgets workers that have not been heard of for so long that they are gone; what they hold is of no use now.
    pub(super) fn forget_gone_workers(&self, now: Millis) {
        self.lock().workers.retain(|_, live| now - live.seen_at < GONE_AFTER_MS);
    }

    pub(super) fn beat(&self, lease: &LeaseState, heartbeat: &Heartbeat) -> Beat {
        let mut state = self.lock();
        let is_first = !state.attempts.contains_key(&lease.attempt);
        let live = state.attempts.entry(lease.attempt.clone()).or_insert_with(|| LiveTask {
            job: lease.job.clone(),
            task: lease.task.clone(),
            phase: heartbeat.phase,
            progress: 0.0,
            preview: None,
        });
        live.phase = heartbeat.phase;
        live.progress = heartbeat.progress.clamp(0.0, 1.0).max(live.progress);
        let new_preview = heartbeat.preview.is_some() && heartbeat.preview != live.preview;
        let old_preview = if new_preview { live.preview.take() } else { None };
        if new_preview {
            live.preview.clone_from(&heartbeat.preview);
        }
        Beat { is_first, old_preview, new_preview }
    }

    /// Everything that runs, by task. To be asked before the database is: a task that ends in between then counts as done.
    pub(super) fn tasks(&self) -> HashMap<String, LiveTask> {
        let state = self.lock();
        // Ids of attempts grow with time: the last attempt at a task is the one that counts.
        let mut attempts: Vec<_> = state.attempts.iter().collect();
        attempts.sort_by_key(|(attempt, _)| *attempt);
        attempts.into_iter().map(|(_, live)| (live.task.clone(), live.clone())).collect()
    }

    pub(super) fn progress_of(&self, attempt: &str) -> Option<f64> {
        self.lock().attempts.get(attempt).map(|live| live.progress)
    }

    /// Forgets an attempt that has ended; returns its last preview.
    pub(super) fn end_attempt(&self, attempt: &str) -> Option<String> {
        self.lock().attempts.remove(attempt)?.preview
    }

    /// Whether a running attempt shows this picture.
    pub(super) fn shows(&self, preview: &str) -> bool {
        self.lock().attempts.values().any(|live| live.preview.as_deref() == Some(preview))
    }

    pub(super) fn preview_of(&self, job: &str) -> Option<String> {
        let state = self.lock();
        let of_job = state.attempts.values().filter(|live| live.job == job && live.preview.is_some());
        of_job.max_by(|a, b| a.progress.total_cmp(&b.progress))?.preview.clone()
    }

    /// No code panics while it holds the lock; were one to, the maps would still be whole.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use lightshaft_api::job::AttemptOutcome;

    use super::*;

    #[test]
    fn workers_that_are_gone_are_forgotten() {
        let live = Live::default();
        live.seen("old", 0);
        live.poll("old", CacheStatus::default(), vec!["mesh".to_owned()]);
        live.seen("new", 1_000);
        live.forget_gone_workers(GONE_AFTER_MS);
        assert!(live.worker("old").is_none() && live.worker("new").is_some());
    }

    #[test]
    fn the_last_attempt_at_a_task_is_the_one_that_counts() {
        let live = Live::default();
        let lease = |attempt: &str| LeaseState {
            attempt: attempt.to_owned(),
            task: "task".to_owned(),
            job: "job".to_owned(),
            worker: "worker".to_owned(),
            outcome: AttemptOutcome::Running,
            phase: None,
            expires_at: 0,
            cancel_requested: false,
            draining: false,
        };
        let beat = |progress| Heartbeat { progress, ..Heartbeat::default() };
        assert!(live.beat(&lease("1"), &beat(0.9)).is_first);
        assert!(live.beat(&lease("2"), &beat(0.1)).is_first);
        assert!(!live.beat(&lease("1"), &beat(0.95)).is_first, "a superseded attempt that is still heard");
        assert_eq!(live.tasks()["task"].progress, 0.1);
        live.end_attempt("1");
        assert_eq!((live.tasks()["task"].progress, live.progress_of("2")), (0.1, Some(0.1)));
        live.end_attempt("2");
        assert!(live.tasks().is_empty());
    }
}
