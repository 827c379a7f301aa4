//! The state of the whole service.

use lightshaft_api::status::{ServiceState, Status, WorkerCounts};
use lightshaft_api::worker::WorkerState;
use metrics::gauge;

use super::App;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;

impl App {
    pub async fn status(&self) -> ApiResult<Status> {
        let totals = self.store.totals().await?;
        let mut workers = WorkerCounts::default();
        for worker in self.workers().await? {
            match worker.state {
                WorkerState::Idle => workers.idle += 1,
                WorkerState::Busy => workers.busy += 1,
                WorkerState::Draining => workers.draining += 1,
                WorkerState::Gone => workers.gone += 1,
            }
        }
        let present = workers.idle + workers.busy;
        let state = if totals.tasks.leased > 0 {
            ServiceState::Active
        } else if totals.tasks.ready == 0 {
            ServiceState::Idle
        } else if present > 0 {
            ServiceState::Waiting
        } else {
            ServiceState::Inoperable
        };
        Ok(Status {
            state,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            uptime_s: self.started.elapsed().as_secs_f64(),
            jobs: totals.jobs,
            tasks_ready: totals.tasks.ready.into(),
            tasks_leased: totals.tasks.leased.into(),
            workers,
            scenes: totals.scenes,
            blob_bytes: self.blobs.total_bytes(),
        })
    }

    /// Fails while the database or the blob store cannot be written, and during a shutdown.
    pub async fn check_ready(&self) -> ApiResult<()> {
        self.check_running()?;
        let not_ready = |what: &str, error: &dyn std::error::Error| {
            tracing::error!(error = %error, "{what} cannot be written");
            ApiError::new(Code::NotReady, format!("{what} cannot be written"))
        };
        self.store.check_writable(self.now()).await.map_err(|error| not_ready("the database", &error))?;
        self.blobs.check_writable().await.map_err(|error| not_ready("the blob store", &error))
    }

    /// Sets the gauges that are read rather than counted.
    pub async fn refresh_gauges(&self) -> ApiResult<()> {
        let totals = self.store.totals().await?;
        let (jobs, tasks) = (totals.jobs, totals.tasks);
        let job_states = [
            ("queued", jobs.queued),
            ("running", jobs.running),
            ("succeeded", jobs.succeeded),
            ("failed", jobs.failed),
            ("cancelled", jobs.cancelled),
        ];
        for (state, count) in job_states {
            gauge!("lightshaft_jobs", "state" => state).set(count as f64);
        }
        let task_states = [
            ("blocked", tasks.blocked),
            ("ready", tasks.ready),
            ("leased", tasks.leased),
            ("succeeded", tasks.succeeded),
            ("failed", tasks.failed),
            ("cancelled", tasks.cancelled),
            ("dead", tasks.dead),
        ];
        for (state, count) in task_states {
            gauge!("lightshaft_tasks", "state" => state).set(f64::from(count));
        }
        let workers = self.workers().await?;
        for state in [WorkerState::Idle, WorkerState::Busy, WorkerState::Draining, WorkerState::Gone] {
            let count = workers.iter().filter(|worker| worker.state == state).count();
            gauge!("lightshaft_workers", "state" => state.as_str()).set(count as f64);
        }
        gauge!("lightshaft_scenes").set(totals.scenes as f64);
        gauge!("lightshaft_blob_bytes").set(self.blobs.total_bytes() as f64);
        gauge!("lightshaft_uptime_seconds").set(self.started.elapsed().as_secs_f64());
        Ok(())
    }
}
