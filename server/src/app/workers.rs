//! Workers as people see them.

use lightshaft_api::problem::FieldError;
use lightshaft_api::worker::{NewWorker, Registered, Worker, WorkerState};
use uuid::Uuid;

use super::{App, live::LiveWorker};
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::queue::GONE_AFTER_MS;
use crate::store::Removal;

impl App {
    pub async fn register_worker(&self, worker: &NewWorker) -> ApiResult<Registered> {
        self.check_running()?;
        let errors = validate(worker);
        if !errors.is_empty() {
            return Err(ApiError::fields(errors));
        }
        let id = worker.id.clone().unwrap_or_else(|| Uuid::now_v7().to_string());
        let lost = self.store.register_worker(&id, worker, self.now()).await?;
        self.live.seen(&id, self.now());
        self.live.set_parted(&id, false);
        for expired in lost {
            tracing::warn!(
                worker.id = %id, job.id = %expired.job, task.id = %expired.task,
                "worker registered anew; its task is lost"
            );
            self.end_attempt(&expired.attempt).await;
        }
        tracing::info!(worker.id = %id, worker.name = %worker.name, "worker registered");
        self.changed();
        Ok(Registered { id })
    }

    pub async fn workers(&self) -> ApiResult<Vec<Worker>> {
        let workers = self.store.workers().await?;
        Ok(workers.into_iter().map(|worker| self.add_live(worker)).collect())
    }

    pub async fn worker(&self, id: &str) -> ApiResult<Worker> {
        let worker = self.store.worker(id).await?.ok_or_else(|| ApiError::not_found("worker", id))?;
        Ok(self.add_live(worker))
    }

    /// Forgets what gone workers told of themselves.
    pub fn forget_gone_workers(&self) {
        self.live.forget_gone_workers(self.now());
    }

    fn add_live(&self, mut worker: Worker) -> Worker {
        let LiveWorker { seen_at, cache, parted, .. } = self.live.worker(&worker.id).unwrap_or_default();
        if let Ok(seen_at) = jiff::Timestamp::from_millisecond(seen_at) {
            worker.last_seen_at = worker.last_seen_at.max(seen_at);
        }
        worker.cache = cache;
        if parted || self.now() - worker.last_seen_at.as_millisecond() > GONE_AFTER_MS {
            worker.state = WorkerState::Gone;
        }
        worker
    }

    pub async fn set_draining(&self, id: &str, draining: bool) -> ApiResult<Worker> {
        if !self.store.set_draining(id, draining).await? {
            return Err(ApiError::not_found("worker", id));
        }
        self.changed();
        self.worker(id).await
    }

    /// The worker leaves. A poll of its that is waiting ends without a task; one that has just got a task brings it, and
    /// the worker gives it back.
    pub async fn part_worker(&self, id: &str) -> ApiResult<()> {
        if self.store.worker(id).await?.is_none() {
            return Err(ApiError::not_found("worker", id));
        }
        tracing::info!(worker.id = %id, "worker leaves");
        self.live.set_parted(id, true);
        self.changed();
        Ok(())
    }

    pub async fn remove_worker(&self, id: &str) -> ApiResult<()> {
        match self.store.remove_worker(id, self.now()).await? {
            Removal::Done => {
                self.live.forget_worker(id);
                Ok(())
            }
            Removal::Unknown => Err(ApiError::not_found("worker", id)),
            Removal::InUse => Err(ApiError::new(Code::InUse, "the worker holds a lease: drain it first")),
        }
    }
}

fn validate(worker: &NewWorker) -> Vec<FieldError> {
    let mut errors = Vec::new();
    let mut check = |ok: bool, pointer: String, detail: &str| {
        if !ok {
            errors.push(FieldError::new(pointer, detail));
        }
    };
    let is_id = |id: &String| Uuid::parse_str(id).is_ok_and(|uuid| uuid.to_string() == *id);
    check(worker.id.as_ref().is_none_or(is_id), "/id".into(), "must be an id that an earlier registration gave");
    check((1..=256).contains(&worker.name.chars().count()), "/name".into(), "must have 1 to 256 characters");
    check((1..=64).contains(&worker.version.chars().count()), "/version".into(), "must have 1 to 64 characters");
    check((1..=64).contains(&worker.devices.len()), "/devices".into(), "must be 1 to 64 devices");
    check(worker.tags.len() <= 64, "/tags".into(), "must be at most 64 tags");
    for (i, device) in worker.devices.iter().enumerate().take(64) {
        let fields = [&device.name, &device.driver, &device.backend, &device.device_type];
        let fits = fields.iter().all(|text| text.chars().count() <= 256);
        check(fits, format!("/devices/{i}"), "texts must have at most 256 characters");
    }
    for (i, tag) in worker.tags.iter().enumerate().take(64) {
        check((1..=64).contains(&tag.chars().count()), format!("/tags/{i}"), "must have 1 to 64 characters");
    }
    errors
}
