//! The queue as people see it.

use lightshaft_api::job::JobSummary;
use lightshaft_api::queue::{Queue, QueuedJob};

use super::App;
use super::demand::{Wait, offers};
use super::leases::timestamp;
use crate::error::ApiResult;
use crate::store::QueuedRecord;

impl App {
    /// The first `limit` unfinished jobs in the order of their turn, and why each of them waits.
    pub async fn queue(&self, limit: u32) -> ApiResult<Queue> {
        let totals = self.store.totals().await?.jobs;
        let workers = self.workers().await?;
        let running = self.live.tasks();
        let mut jobs = Vec::new();
        for record in self.store.queue(limit, self.now()).await? {
            let QueuedRecord { job, demand, worker, leases, ready_at, .. } = record;
            // Those that must run on one worker wait for it alone.
            let only = worker.as_ref().map(|(id, _)| id.as_str());
            let able: Vec<_> = workers.iter().filter(|w| only.is_none_or(|id| w.id == id)).cloned().collect();
            let wait = Wait { paused: job.summary.paused, ready_at, demand: &demand };
            let is_waiting = leases.is_empty() && record.tasks_ready > 0;
            let on = worker.map(|(_, name)| format!("the worker `{name}`"));
            let device = (!demand.is_any()).then(|| demand.to_string());
            jobs.push(QueuedJob {
                waiting: is_waiting.then(|| self.why_waits(&wait, &able, &offers(&able))),
                needs: [device, on].into_iter().flatten().reduce(|device, worker| format!("{device} on {worker}")),
                tasks_ready: record.tasks_ready,
                tasks_blocked: record.tasks_blocked,
                ready_at: ready_at.map(timestamp).transpose()?,
                failures: record.failures,
                last_error: record.last_error,
                leases,
                blocked_workers: record.blocked_workers,
                summary: JobSummary {
                    progress: job.progress.of_job(|task| Some(running.get(task)?.progress)),
                    ..job.summary
                },
            });
        }
        Ok(Queue { jobs, total: totals.queued + totals.running })
    }
}
