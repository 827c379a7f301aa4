//! Jobs that demand a device, and giving up those that nobody can do.

use lightshaft_api::event::EventKind;
use serde_json::json;

use super::events::emit;
use super::jobs::{cancel_tasks, refresh_job};
use super::{SqliteStore, commit, context};
use crate::queue::{Demand, Millis};
use crate::store::{Demanding, Result};

impl SqliteStore {
    pub(super) async fn read_demanding_jobs(&self) -> Result<Vec<Demanding>> {
        let rows: Vec<(String, bool, bool, Option<String>, i64)> = sqlx::query_as(
            "SELECT t.job_id, t.needs_cpu, t.needs_gpu, t.needs_adapter, MIN(t.run_at)
             FROM task t WHERE t.demand > 0 AND t.state = 'ready' AND t.paused = 0
             GROUP BY t.job_id, t.needs_cpu, t.needs_gpu, t.needs_adapter ORDER BY t.job_id",
        )
        .fetch_all(&self.readers)
        .await
        .map_err(context("looking for jobs that demand a device"))?;
        let demanding = |(job, cpu, gpu, adapter, ready_since)| Demanding {
            job,
            demand: Demand { cpu, gpu, adapter },
            ready_since,
        };
        Ok(rows.into_iter().map(demanding).collect())
    }

    pub(super) async fn do_give_up_job(&self, id: &str, error: &str, now: Millis) -> Result<bool> {
        let mut tx = self.begin().await?;
        let failed: Option<String> = sqlx::query_scalar(
            "UPDATE task SET state = 'failed', error = $2
             WHERE id = (SELECT id FROM task WHERE job_id = $1 AND state = 'ready' AND (needs_cpu OR needs_gpu)
                         ORDER BY position LIMIT 1)
             RETURNING id",
        )
        .bind(id)
        .bind(error)
        .fetch_optional(&mut *tx)
        .await
        .map_err(context("giving up a task"))?;
        let Some(task) = failed else { return Ok(false) };
        emit(&mut tx, now, id, EventKind::TaskFailed, json!({ "task": task, "error": error })).await?;
        cancel_tasks(&mut tx, id).await?;
        refresh_job(&mut tx, id, now).await?;
        commit(tx).await?;
        Ok(true)
    }
}
