//! What changes too often for the database: progress of running tasks, and what workers told of themselves. It is
//! lost at a restart, and told anew by the next heartbeat or poll.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use lightshaft_api::job::Phase;
use lightshaft_api::lease::Heartbeat;
use lightshaft_api::worker::CacheStatus;

use crate::queue::{GONE_AFTER_MS, Millis};

/// How often a worker's sign of life is written down.
const SEEN_FLUSH_MS: Millis = 15_000;

#[derive(Debug, Default)]
pub(super) struct Live {
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    workers: HashMap<String, LiveWorker>,
    tasks: HashMap<String, LiveTask>,
}

#[derive(Clone, Debug, Default)]
pub(super) struct LiveWorker {
    pub(super) seen_at: Millis,
    flushed_at: Millis,
    pub(super) cache: CacheStatus,
    pub(super) warm: Vec<String>,
}

#[derive(Clone, Debug)]
pub(super) struct LiveTask {
    pub(super) job: String,
    pub(super) phase: Phase,
    /// Never falls while the lease lasts.
    pub(super) progress: f64,
    pub(super) preview: Option<String>,
}

/// What a heartbeat changed.
pub(super) struct Beat {
    /// A picture that nobody needs any more.
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

    pub(super) fn beat(&self, job: &str, task: &str, heartbeat: &Heartbeat) -> Beat {
        let mut state = self.lock();
        let live = state.tasks.entry(task.to_owned()).or_insert_with(|| LiveTask {
            job: job.to_owned(),
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
        Beat { old_preview, new_preview }
    }

    /// Everything that runs. To be asked before the database is: a task that ends in between then counts as done.
    pub(super) fn tasks(&self) -> HashMap<String, LiveTask> {
        self.lock().tasks.clone()
    }

    pub(super) fn progress_of(&self, task: &str) -> Option<f64> {
        self.lock().tasks.get(task).map(|task| task.progress)
    }

    /// Forgets a task whose lease has ended; returns its last preview.
    pub(super) fn end_task(&self, task: &str) -> Option<String> {
        self.lock().tasks.remove(task)?.preview
    }

    pub(super) fn preview_of(&self, job: &str) -> Option<String> {
        let state = self.lock();
        let of_job = state.tasks.values().filter(|task| task.job == job && task.preview.is_some());
        of_job.max_by(|a, b| a.progress.total_cmp(&b.progress))?.preview.clone()
    }

    /// No code panics while it holds the lock; were one to, the maps would still be whole.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
