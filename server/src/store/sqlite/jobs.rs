//! Changes of whole jobs, and the derivation of a job's state from its tasks.

use lightshaft_api::event::EventKind;
use lightshaft_api::job::{JobState, TaskWork};
use serde_json::json;
use sqlx::{FromRow, SqliteExecutor};
use uuid::Uuid;

use super::events::emit;
use super::idempotency::OF_JOBS;
use super::{SqliteStore, Tx, commit, context, from_name, signed, to_json};
use crate::queue::{Demand, Millis, TaskCounts, job_state};
use crate::store::{Automatic, Change, Creation, Idempotency, JobRecord, Result};

#[derive(FromRow)]
struct StateRow {
    state: String,
    started_at: Option<i64>,
}

impl SqliteStore {
    pub(super) async fn do_create_job(
        &self,
        job: &JobRecord,
        idempotency: Option<&Idempotency>,
        now: Millis,
    ) -> Result<Creation> {
        let mut tx = self.begin().await?;
        if let Some(idempotency) = idempotency
            && let Some(creation) = OF_JOBS.repeated(&mut tx, idempotency).await?
        {
            return Ok(creation);
        }
        if !is_scene_there(&mut tx, &job.scene).await? {
            return Ok(Creation::UnknownScene);
        }
        add_job(&mut tx, job, now).await?;
        if job.automatic == Some(Automatic::Thumbnail) {
            sqlx::query("UPDATE scene SET thumbnail_job = $2 WHERE id = $1")
                .bind(&job.scene)
                .bind(&job.id)
                .execute(&mut *tx)
                .await
                .map_err(context("noting a scene's thumbnail"))?;
        }
        if let Some(idempotency) = idempotency {
            OF_JOBS.keep(&mut tx, idempotency, &job.id, now).await?;
        }
        commit(tx).await?;
        Ok(Creation::Created)
    }

    pub(super) async fn read_repeated_job(&self, idempotency: &Idempotency) -> Result<Option<Creation>> {
        let mut tx = self.readers.begin().await.map_err(context("beginning to read"))?;
        OF_JOBS.repeated(&mut tx, idempotency).await
    }

    pub(super) async fn do_cancel_job(&self, id: &str, now: Millis) -> Result<Change> {
        let mut tx = self.begin().await?;
        let Some(state) = read_state(&mut *tx, id).await? else { return Ok(Change::Unknown) };
        match state {
            JobState::Cancelled => return Ok(Change::Done),
            JobState::Succeeded | JobState::Failed => return Ok(Change::Refused(state)),
            JobState::Queued | JobState::Running => {}
        }
        cancel_open_job(&mut tx, id, now).await?;
        commit(tx).await?;
        Ok(Change::Done)
    }

    pub(super) async fn do_retry_job(&self, id: &str, now: Millis) -> Result<Change> {
        let mut tx = self.begin().await?;
        let Some(state) = read_state(&mut *tx, id).await? else { return Ok(Change::Unknown) };
        if !matches!(state, JobState::Failed | JobState::Cancelled) {
            return Ok(Change::Refused(state));
        }
        let scene_gone: bool = sqlx::query_scalar(
            "SELECT s.deleted_at IS NOT NULL FROM job j JOIN scene s ON s.id = j.scene_id WHERE j.id = $1",
        )
        .bind(id)
        .fetch_one(&mut *tx)
        .await
        .map_err(context("looking up a job's scene"))?;
        if scene_gone {
            return Ok(Change::SceneGone);
        }
        sqlx::query(
            "UPDATE task SET state = 'ready', spent = 0, progress = 0, cancel_requested = 0, paused = 0, error = NULL,
                             run_at = $2
             WHERE job_id = $1 AND state IN ('failed', 'dead', 'cancelled')",
        )
        .bind(id)
        .bind(now)
        .execute(&mut *tx)
        .await
        .map_err(context("retrying tasks"))?;
        sqlx::query(
            "UPDATE task SET state = 'blocked' WHERE job_id = $1 AND is_merge AND state = 'ready'
                AND EXISTS (SELECT 1 FROM task p WHERE p.job_id = $1 AND NOT p.is_merge AND p.state <> 'succeeded')",
        )
        .bind(id)
        .execute(&mut *tx)
        .await
        .map_err(context("blocking the merge"))?;
        sqlx::query("DELETE FROM worker_block WHERE job_id = $1")
            .bind(id)
            .execute(&mut *tx)
            .await
            .map_err(context("forgetting blocked workers"))?;
        sqlx::query(
            "UPDATE job SET cancel_requested = 0, paused = 0, error = NULL, finished_at = NULL
             WHERE id = $1",
        )
        .bind(id)
        .execute(&mut *tx)
        .await
        .map_err(context("retrying a job"))?;
        emit(&mut tx, now, id, EventKind::JobRetried, json!({})).await?;
        refresh_job(&mut tx, id, now).await?;
        commit(tx).await?;
        Ok(Change::Done)
    }

    pub(super) async fn do_patch_job(
        &self,
        id: &str,
        priority: Option<i32>,
        paused: Option<bool>,
        now: Millis,
    ) -> Result<Change> {
        let mut tx = self.begin().await?;
        let Some(state) = read_state(&mut *tx, id).await? else { return Ok(Change::Unknown) };
        if state.is_final() {
            return Ok(Change::Refused(state));
        }
        sqlx::query("UPDATE job SET priority = COALESCE($2, priority), paused = COALESCE($3, paused) WHERE id = $1")
            .bind(id)
            .bind(priority)
            .bind(paused)
            .execute(&mut *tx)
            .await
            .map_err(context("changing a job"))?;
        sqlx::query(
            "UPDATE task SET priority = COALESCE($2, priority), paused = COALESCE($3, paused) WHERE job_id = $1",
        )
        .bind(id)
        .bind(priority)
        .bind(paused)
        .execute(&mut *tx)
        .await
        .map_err(context("changing a job's tasks"))?;
        emit(&mut tx, now, id, EventKind::JobChanged, json!({ "priority": priority, "paused": paused })).await?;
        commit(tx).await?;
        Ok(Change::Done)
    }
}

/// A job with its tasks, and the event that tells of it.
pub(super) async fn add_job(tx: &mut Tx, job: &JobRecord, now: Millis) -> Result<()> {
    insert_job(tx, job, now).await?;
    insert_tasks(tx, job, now).await?;
    let data = json!({ "scene": job.scene, "tasks": job.tasks.len() });
    emit(tx, now, &job.id, EventKind::JobCreated, data).await
}

/// Whether jobs can be made of it.
pub(super) async fn is_scene_there(tx: &mut Tx, scene: &str) -> Result<bool> {
    sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM scene WHERE id = $1 AND deleted_at IS NULL)")
        .bind(scene)
        .fetch_one(&mut **tx)
        .await
        .map_err(context("looking up a job's scene"))
}

async fn insert_job(tx: &mut Tx, job: &JobRecord, now: Millis) -> Result<()> {
    sqlx::query(
        "INSERT INTO job (id, kind, scene_id, state, automatic, priority, max_attempts, settings, trace_id, created_at)
         VALUES ($1, $9, $2, 'queued', $3, $4, $5, $6, $7, $8)",
    )
    .bind(&job.id)
    .bind(&job.scene)
    .bind(job.automatic.is_some())
    .bind(job.priority)
    .bind(job.max_attempts)
    .bind(to_json(&job.settings)?)
    .bind(&job.trace_id)
    .bind(now)
    .bind(job.settings.kind().as_str())
    .execute(&mut **tx)
    .await
    .map_err(context("adding a job"))?;
    for blob in job.settings.blobs() {
        // The two pictures of a comparison may be one.
        sqlx::query("INSERT INTO job_blob (job_id, blob) VALUES ($1, $2) ON CONFLICT DO NOTHING")
            .bind(&job.id)
            .bind(blob)
            .execute(&mut **tx)
            .await
            .map_err(context("noting a job's blob"))?;
    }
    for (key, value) in &job.labels {
        sqlx::query("INSERT INTO job_label (job_id, key, value) VALUES ($1, $2, $3)")
            .bind(&job.id)
            .bind(key)
            .bind(value)
            .execute(&mut **tx)
            .await
            .map_err(context("adding a label"))?;
    }
    Ok(())
}

async fn insert_tasks(tx: &mut Tx, job: &JobRecord, now: Millis) -> Result<()> {
    for (position, work) in job.tasks.iter().enumerate() {
        let is_merge = *work == TaskWork::Merge;
        // Merging touches no ray: any worker can do it.
        let demand = if is_merge { Demand::default() } else { Demand::of(&job.settings) };
        sqlx::query(
            "INSERT INTO task (id, job_id, position, work, is_merge, state, priority, run_at, needs_cpu,
                               needs_gpu, needs_adapter, needs_worker)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12)",
        )
        .bind(Uuid::now_v7().to_string())
        .bind(&job.id)
        .bind(signed(position as u64))
        .bind(to_json(work)?)
        .bind(is_merge)
        .bind(if is_merge { "blocked" } else { "ready" })
        .bind(job.priority)
        .bind(now)
        .bind(demand.cpu)
        .bind(demand.gpu)
        .bind(demand.adapter)
        .bind(job.worker.as_ref().filter(|_| !is_merge))
        .execute(&mut **tx)
        .await
        .map_err(context("adding a task"))?;
    }
    Ok(())
}

pub(super) async fn read_state(db: impl SqliteExecutor<'_>, job: &str) -> Result<Option<JobState>> {
    let state: Option<String> = sqlx::query_scalar("SELECT state FROM job WHERE id = $1")
        .bind(job)
        .fetch_optional(db)
        .await
        .map_err(context("reading a job's state"))?;
    state.map(|name| from_name(&name)).transpose()
}

/// Of a job that is queued or running.
pub(super) async fn cancel_open_job(tx: &mut Tx, id: &str, now: Millis) -> Result<()> {
    sqlx::query("UPDATE job SET cancel_requested = 1 WHERE id = $1")
        .bind(id)
        .execute(&mut **tx)
        .await
        .map_err(context("cancelling a job"))?;
    cancel_tasks(tx, id).await?;
    emit(tx, now, id, EventKind::JobChanged, json!({ "cancel_requested": true })).await?;
    refresh_job(tx, id, now).await?;
    Ok(())
}

/// Waiting tasks end now; leased ones are asked to, by their next heartbeat.
pub(super) async fn cancel_tasks(tx: &mut Tx, job: &str) -> Result<()> {
    sqlx::query("UPDATE task SET state = 'cancelled' WHERE job_id = $1 AND state IN ('blocked', 'ready')")
        .bind(job)
        .execute(&mut **tx)
        .await
        .map_err(context("cancelling waiting tasks"))?;
    sqlx::query("UPDATE task SET cancel_requested = 1 WHERE job_id = $1 AND state = 'leased'")
        .bind(job)
        .execute(&mut **tx)
        .await
        .map_err(context("cancelling leased tasks"))?;
    Ok(())
}

/// Derives a job's state anew after its tasks have changed, and tells of a change.
pub(super) async fn refresh_job(tx: &mut Tx, job: &str, now: Millis) -> Result<JobState> {
    let old: StateRow = sqlx::query_as("SELECT state, started_at FROM job WHERE id = $1")
        .bind(job)
        .fetch_one(&mut **tx)
        .await
        .map_err(context("reading a job's state"))?;
    let state = job_state(&count_tasks(tx, job).await?);
    if old.state == state.as_str() {
        return Ok(state);
    }
    let error = if state == JobState::Failed { last_error(tx, job).await? } else { None };
    let starts = state == JobState::Running && old.started_at.is_none();
    sqlx::query(
        "UPDATE job SET state = $2, error = $3,
                        started_at = CASE WHEN $4 THEN $6 ELSE started_at END,
                        finished_at = CASE WHEN $5 THEN $6 END
         WHERE id = $1",
    )
    .bind(job)
    .bind(state.as_str())
    .bind(&error)
    .bind(starts)
    .bind(state.is_final())
    .bind(now)
    .execute(&mut **tx)
    .await
    .map_err(context("changing a job's state"))?;
    let (kind, data) = match state {
        JobState::Running if starts => (EventKind::JobStarted, json!({})),
        JobState::Queued | JobState::Running => (EventKind::JobChanged, json!({ "state": state })),
        JobState::Succeeded => (EventKind::JobSucceeded, json!({})),
        JobState::Failed => (EventKind::JobFailed, json!({ "error": error })),
        JobState::Cancelled => (EventKind::JobCancelled, json!({})),
    };
    emit(tx, now, job, kind, data).await?;
    Ok(state)
}

async fn count_tasks(tx: &mut Tx, job: &str) -> Result<TaskCounts> {
    let rows: Vec<(String, u32)> = sqlx::query_as("SELECT state, COUNT(*) FROM task WHERE job_id = $1 GROUP BY state")
        .bind(job)
        .fetch_all(&mut **tx)
        .await
        .map_err(context("counting a job's tasks"))?;
    Ok(counts(rows))
}

pub(super) fn counts(rows: Vec<(String, u32)>) -> TaskCounts {
    let mut counts = TaskCounts::default();
    for (state, count) in rows {
        match state.as_str() {
            "blocked" => counts.blocked = count,
            "ready" => counts.ready = count,
            "leased" => counts.leased = count,
            "succeeded" => counts.succeeded = count,
            "failed" => counts.failed = count,
            "cancelled" => counts.cancelled = count,
            "dead" => counts.dead = count,
            other => unreachable!("the table's check keeps out the state {other}"),
        }
    }
    counts
}

/// What the first task to fail for good failed of.
async fn last_error(tx: &mut Tx, job: &str) -> Result<Option<String>> {
    sqlx::query_scalar(
        "SELECT COALESCE(t.error, a.error) AS why FROM task t LEFT JOIN attempt a ON a.task_id = t.id
         WHERE t.job_id = $1 AND t.state IN ('failed', 'dead') AND why IS NOT NULL
         ORDER BY t.error IS NULL, a.finished_at DESC, a.id DESC LIMIT 1",
    )
    .bind(job)
    .fetch_optional(&mut **tx)
    .await
    .map(Option::flatten)
    .map_err(context("reading why a job failed"))
}
