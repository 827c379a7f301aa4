//! Why jobs wait, and the end of waiting for a device that nobody has.

use std::sync::{Mutex, PoisonError};

use lightshaft_api::job::{Job, TaskState};
use lightshaft_api::worker::{Worker, WorkerState};

use super::App;
use super::leases::timestamp;
use crate::error::ApiResult;
use crate::queue::{Demand, Millis, Offer, Roll, gives_up};

/// Who is there, as last seen.
#[derive(Debug)]
pub(super) struct RollCall(Mutex<Roll>);

impl RollCall {
    pub(super) fn new(now: Millis) -> Self {
        Self(Mutex::new(Roll::new(now)))
    }

    /// Since when it has been just these.
    fn call(&self, offers: Vec<Offer>, now: Millis) -> Millis {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).call(offers, now)
    }
}

/// What a job waits with.
pub(super) struct Wait<'a> {
    pub(super) paused: bool,
    /// When the first of its tasks may run.
    pub(super) ready_at: Option<Millis>,
    pub(super) demand: &'a Demand,
}

impl App {
    /// Fails the jobs that no worker can do, once that has been so for the grace period.
    pub async fn give_up_unmet_jobs(&self) -> ApiResult<()> {
        let offers = offers(&self.workers().await?);
        let (now, grace) = (self.now(), self.device_grace_ms());
        let roll_since = self.roll.call(offers.clone(), now);
        for demanding in self.store.demanding_jobs().await? {
            let Some(why) = demanding.demand.unmet_by(&offers) else { continue };
            if gives_up(demanding.ready_since, roll_since, grace, now)
                && self.store.give_up_job(&demanding.job, &why, now).await?
            {
                tracing::warn!(job.id = %demanding.job, demand = %demanding.demand, "given up: no worker has the device");
                self.changed();
            }
        }
        Ok(())
    }

    /// Why none of a job's tasks runs; `None` when one does, or nothing is left to run.
    pub(super) async fn why_waiting(&self, job: &Job) -> ApiResult<Option<String>> {
        let is_in = |state| job.tasks.iter().any(|task| task.state == state);
        if !is_in(TaskState::Ready) || is_in(TaskState::Leased) {
            return Ok(None);
        }
        let wait = Wait {
            paused: job.summary.paused,
            ready_at: job.tasks.iter().filter_map(|task| Some(task.ready_at?.as_millisecond())).min(),
            demand: &Demand::of(&job.settings),
        };
        let workers = self.workers().await?;
        Ok(Some(self.why_waits(&wait, &workers, &offers(&workers))))
    }

    /// What keeps a job of which nothing runs from one of these workers, which make these offers.
    pub(super) fn why_waits(&self, wait: &Wait<'_>, workers: &[Worker], offers: &[Offer]) -> String {
        if wait.paused {
            return "the job is paused".to_owned();
        }
        if let Some(Ok(at)) = wait.ready_at.filter(|&at| at > self.now()).map(timestamp) {
            return format!("the next attempt is at {at:.0}");
        }
        if offers.is_empty() {
            return "there is no worker".to_owned();
        }
        if let Some(why) = wait.demand.unmet_by(offers) {
            let grace_s = self.config.device_grace.as_secs();
            return format!("{why}. It fails after {grace_s} s unless a worker with it joins.");
        }
        let is_able = |worker: &&Worker| wait.demand.is_met_by(&worker.devices);
        let able = |state| workers.iter().filter(is_able).any(|worker| worker.state == state);
        match (able(WorkerState::Idle), able(WorkerState::Busy)) {
            (true, _) => "a worker is about to take it".to_owned(),
            (false, true) => "every worker that could do it is busy".to_owned(),
            (false, false) => "every worker that could do it is draining".to_owned(),
        }
    }

    fn device_grace_ms(&self) -> Millis {
        Millis::try_from(self.config.device_grace.as_millis()).unwrap_or(Millis::MAX)
    }
}

/// Those that are there.
pub(super) fn offers(workers: &[Worker]) -> Vec<Offer> {
    let present = workers.iter().filter(|worker| worker.state != WorkerState::Gone);
    let offer = |worker: &Worker| Offer {
        id: worker.id.clone(),
        name: worker.name.clone(),
        devices: worker.devices.clone(),
        draining: worker.draining,
    };
    present.map(offer).collect()
}
