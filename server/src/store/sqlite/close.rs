//! The ends of a lease: complete, fail, release, expiry. Each is guarded by the lease's token, so that a report of a
//! superseded attempt changes nothing.

use futures::TryStreamExt;
use lightshaft_api::event::EventKind;
use lightshaft_api::job::{AttemptOutcome, Metrics, Phase};
use lightshaft_api::lease::{Complete, Fail, NewArtifact, RetryClass};
use serde_json::json;
use sqlx::FromRow;

use super::events::emit;
use super::jobs::{cancel_tasks, refresh_job};
use super::{SqliteStore, Tx, commit, context, from_json, from_name, signed, to_json};
use crate::queue::{BLOCK_AFTER_FAILURES, BLOCK_MS, Expiry, Failure, Millis, Next, after_expiry, after_failure};
use crate::store::{Close, Completed, Expired, Result};

/// Leases ended in one transaction, so that the reaper never holds the writer for long.
const EXPIRE_BATCH: i64 = 100;

/// The leases for which a condition holds.
macro_rules! held {
    ($which:literal) => {
        concat!(
            "SELECT a.id AS attempt, a.number, a.phase, t.id AS task, t.job_id AS job, a.worker_id AS worker, t.spent,
                    j.max_attempts, t.cancel_requested, t.is_merge, json_extract(t.work, '$.kind') IN ('frame', 'benchmark', 'build') AS is_whole
             FROM attempt a JOIN task t ON t.lease_token = a.token JOIN job j ON j.id = t.job_id WHERE ",
            $which
        )
    };
}

#[derive(FromRow)]
struct Held {
    attempt: String,
    number: u32,
    phase: Option<String>,
    task: String,
    job: String,
    worker: String,
    spent: u32,
    max_attempts: u32,
    cancel_requested: bool,
    is_merge: bool,
    is_whole: bool,
}

enum Lookup {
    Held(Held),
    Ended(Close),
}

impl SqliteStore {
    pub(super) async fn do_complete(&self, token: &str, report: &Complete, now: Millis) -> Result<Completed> {
        // Summing up many parts takes a while. They do not change any more, so it need not keep others from writing.
        let parts = self.sum_of_parts(token).await?;
        let mut tx = self.begin().await?;
        let held = match look_up(&mut tx, token).await? {
            Lookup::Held(held) => held,
            Lookup::Ended(close) => return Ok(Completed { close, freed: Vec::new() }),
        };
        for artifact in &report.artifacts {
            sqlx::query(
                "INSERT INTO artifact (attempt_id, task_id, job_id, name, media_type, bytes, blob)
                 VALUES ($1, $2, $3, $4, $5, $6, $7)",
            )
            .bind(&held.attempt)
            .bind(&held.task)
            .bind(&held.job)
            .bind(&artifact.name)
            .bind(&artifact.media_type)
            .bind(signed(artifact.bytes))
            .bind(&artifact.blob)
            .execute(&mut *tx)
            .await
            .map_err(context("adding an artifact"))?;
        }
        keep_metrics(&mut tx, &held, parts, &report.metrics).await?;
        let freed = if held.is_merge { drop_parts(&mut tx, &held.job).await? } else { Vec::new() };
        end_attempt(&mut tx, &held.attempt, AttemptOutcome::Succeeded, None, now).await?;
        sqlx::query(
            "UPDATE task SET state = 'succeeded', progress = 1, spent = spent + 1, lease_token = NULL,
                             lease_expires_at = NULL WHERE id = $1",
        )
        .bind(&held.task)
        .execute(&mut *tx)
        .await
        .map_err(context("completing a task"))?;
        sqlx::query(
            "UPDATE task SET state = 'ready', run_at = $2 WHERE job_id = $1 AND state = 'blocked'
                AND NOT EXISTS (SELECT 1 FROM task p WHERE p.job_id = $1 AND NOT p.is_merge AND p.state <> 'succeeded')",
        )
        .bind(&held.job)
        .bind(now)
        .execute(&mut *tx)
        .await
        .map_err(context("unblocking the merge"))?;
        sqlx::query("UPDATE worker SET tasks_done = tasks_done + 1 WHERE id = $1")
            .bind(&held.worker)
            .execute(&mut *tx)
            .await
            .map_err(context("counting a worker's tasks"))?;
        let data = json!({ "task": held.task, "attempt": held.attempt, "worker": held.worker });
        emit(&mut tx, now, &held.job, EventKind::TaskSucceeded, data).await?;
        refresh_job(&mut tx, &held.job, now).await?;
        commit(tx).await?;
        Ok(Completed { close: Close::Closed(AttemptOutcome::Succeeded), freed })
    }

    /// What the parts measured that this lease's task merges; nothing when it is no merge.
    async fn sum_of_parts(&self, token: &str) -> Result<Metrics> {
        let mut rows = sqlx::query_scalar::<_, String>(
            "SELECT p.metrics FROM attempt a JOIN task m ON m.id = a.task_id AND m.is_merge
             JOIN task t ON t.job_id = m.job_id JOIN attempt p ON p.task_id = t.id
             WHERE a.token = $1 AND NOT t.is_merge AND p.outcome = 'succeeded' AND p.metrics IS NOT NULL
             ORDER BY t.position",
        )
        .bind(token)
        .fetch(&self.readers);
        let mut sum = Metrics::default();
        while let Some(row) = rows.try_next().await.map_err(context("reading metrics"))? {
            sum.add(&from_json(&row)?);
        }
        Ok(sum)
    }

    pub(super) async fn do_fail(&self, token: &str, report: &Fail, jitter: f64, now: Millis) -> Result<Close> {
        let mut tx = self.begin().await?;
        let held = match look_up(&mut tx, token).await? {
            Lookup::Held(held) => held,
            Lookup::Ended(close) => return Ok(close),
        };
        let next = after_failure(Failure {
            class: report.class,
            fatal: report.fatal,
            cancel_requested: held.cancel_requested,
            spent: held.spent,
            max_attempts: held.max_attempts,
            now,
            jitter,
        });
        let outcome = if next == Next::Cancelled { AttemptOutcome::Cancelled } else { report.class.outcome() };
        if report.class == RetryClass::Worker {
            count_towards_block(&mut tx, &held, now).await?;
        }
        settle(&mut tx, &held, outcome, next, Some(&report.error), now).await?;
        commit(tx).await?;
        Ok(Close::Closed(outcome))
    }

    pub(super) async fn do_release(&self, token: &str, cancelled: bool, now: Millis) -> Result<Close> {
        let mut tx = self.begin().await?;
        let held = match look_up(&mut tx, token).await? {
            Lookup::Held(held) => held,
            Lookup::Ended(close) => return Ok(close),
        };
        // A worker cannot cancel what nobody asked it to.
        let (outcome, next) = if held.cancel_requested {
            (AttemptOutcome::Cancelled, Next::Cancelled)
        } else {
            let next = Next::Ready { run_at: now, spends: false };
            (AttemptOutcome::Interrupted, next)
        };
        let error = (cancelled && !held.cancel_requested).then_some("released as cancelled, which was not asked for");
        settle(&mut tx, &held, outcome, next, error, now).await?;
        commit(tx).await?;
        Ok(Close::Closed(outcome))
    }

    pub(super) async fn do_expire_leases(&self, now: Millis) -> Result<Vec<Expired>> {
        let mut tx = self.begin().await?;
        let held: Vec<Held> = sqlx::query_as(held!(
            "t.state = 'leased' AND t.lease_expires_at <= $1 ORDER BY t.lease_expires_at LIMIT $2"
        ))
        .bind(now)
        .bind(EXPIRE_BATCH)
        .fetch_all(&mut *tx)
        .await
        .map_err(context("looking for expired leases"))?;
        let expired = expire(&mut tx, held, "no heartbeat within the lease's time to live", now).await?;
        commit(tx).await?;
        Ok(expired)
    }
}

/// Ends everything that a worker still holds: it has registered anew, and knows nothing of it.
pub(super) async fn expire_worker(tx: &mut Tx, worker: &str, now: Millis) -> Result<Vec<Expired>> {
    let held: Vec<Held> = sqlx::query_as(held!("a.worker_id = $1 AND a.outcome = 'running'"))
        .bind(worker)
        .fetch_all(&mut **tx)
        .await
        .map_err(context("looking for a worker's leases"))?;
    expire(tx, held, "it has started anew", now).await
}

async fn expire(tx: &mut Tx, all: Vec<Held>, why: &str, now: Millis) -> Result<Vec<Expired>> {
    let mut expired = Vec::with_capacity(all.len());
    for held in all {
        let phase_before: Option<String> = sqlx::query_scalar(
            "SELECT phase FROM attempt WHERE task_id = $1 AND number = $2 - 1 AND outcome = 'expired'",
        )
        .bind(&held.task)
        .bind(held.number)
        .fetch_optional(&mut **tx)
        .await
        .map(Option::flatten)
        .map_err(context("reading the attempt before"))?;
        let read = |phase: &Option<String>| phase.as_deref().map(from_name::<Phase>).transpose();
        let next = after_expiry(Expiry {
            cancel_requested: held.cancel_requested,
            spent: held.spent,
            max_attempts: held.max_attempts,
            phase: read(&held.phase)?,
            phase_before: read(&phase_before)?,
            now,
        });
        let phase = held.phase.as_deref().unwrap_or("the beginning");
        let error = format!("the worker was lost at {phase}: {why}");
        settle(tx, &held, AttemptOutcome::Expired, next, Some(&error), now).await?;
        let again = matches!(next, Next::Ready { .. });
        expired.push(Expired { job: held.job, task: held.task, attempt: held.attempt, worker: held.worker, again });
    }
    Ok(expired)
}

/// A part's are kept until they are summed up; those of a whole job are the job's.
async fn keep_metrics(tx: &mut Tx, held: &Held, mut parts: Metrics, own: &Metrics) -> Result<()> {
    if !held.is_merge && !held.is_whole {
        sqlx::query("UPDATE attempt SET metrics = $2 WHERE id = $1")
            .bind(&held.attempt)
            .bind(to_json(own)?)
            .execute(&mut **tx)
            .await
            .map_err(context("keeping metrics"))?;
        return Ok(());
    }
    let of_job = if held.is_merge {
        parts.add(own);
        &parts
    } else {
        own
    };
    sqlx::query("UPDATE job SET metrics = $2 WHERE id = $1")
        .bind(&held.job)
        .bind(to_json(of_job)?)
        .execute(&mut **tx)
        .await
        .map_err(context("keeping a job's metrics"))?;
    Ok(())
}

/// Once they are merged, nobody needs the parts of a picture nor what each measured; returns their blobs.
async fn drop_parts(tx: &mut Tx, job: &str) -> Result<Vec<String>> {
    sqlx::query("UPDATE attempt SET metrics = NULL WHERE job_id = $1")
        .bind(job)
        .execute(&mut **tx)
        .await
        .map_err(context("dropping the parts' metrics"))?;
    sqlx::query_scalar("DELETE FROM artifact WHERE job_id = $1 AND name = $2 RETURNING blob")
        .bind(job)
        .bind(NewArtifact::PART)
        .fetch_all(&mut **tx)
        .await
        .map_err(context("dropping the parts"))
}

async fn look_up(tx: &mut Tx, token: &str) -> Result<Lookup> {
    let outcome: Option<String> = sqlx::query_scalar("SELECT outcome FROM attempt WHERE token = $1")
        .bind(token)
        .fetch_optional(&mut **tx)
        .await
        .map_err(context("looking up a lease"))?;
    let Some(outcome) = outcome else { return Ok(Lookup::Ended(Close::Unknown)) };
    let outcome: AttemptOutcome = from_name(&outcome)?;
    if outcome != AttemptOutcome::Running {
        return Ok(Lookup::Ended(Close::Already(outcome)));
    }
    let held: Held = sqlx::query_as(held!("a.token = $1"))
        .bind(token)
        .fetch_one(&mut **tx)
        .await
        .map_err(context("reading a lease"))?;
    Ok(Lookup::Held(held))
}

async fn end_attempt(
    tx: &mut Tx,
    attempt: &str,
    outcome: AttemptOutcome,
    error: Option<&str>,
    now: Millis,
) -> Result<()> {
    sqlx::query("UPDATE attempt SET outcome = $2, error = $3, finished_at = $4 WHERE id = $1")
        .bind(attempt)
        .bind(outcome.as_str())
        .bind(error)
        .bind(now)
        .execute(&mut **tx)
        .await
        .map_err(context("ending an attempt"))?;
    Ok(())
}

/// Ends an attempt that did not succeed, and sends its task where the rules say.
async fn settle(
    tx: &mut Tx,
    held: &Held,
    outcome: AttemptOutcome,
    next: Next,
    error: Option<&str>,
    now: Millis,
) -> Result<()> {
    end_attempt(tx, &held.attempt, outcome, error, now).await?;
    let (state, run_at, spends, kind) = match next {
        Next::Ready { run_at, spends, .. } => ("ready", Some(run_at), spends, EventKind::TaskRetried),
        Next::Failed => ("failed", None, true, EventKind::TaskFailed),
        Next::Dead => ("dead", None, true, EventKind::TaskFailed),
        Next::Cancelled => ("cancelled", None, false, EventKind::TaskCancelled),
    };
    sqlx::query(
        "UPDATE task SET state = $2, run_at = COALESCE($3, run_at), spent = spent + $4,
                         progress = CASE $2 WHEN 'ready' THEN 0 ELSE progress END, cancel_requested = 0, lease_token = NULL, lease_expires_at = NULL
         WHERE id = $1",
    )
    .bind(&held.task)
    .bind(state)
    .bind(run_at)
    .bind(spends)
    .execute(&mut **tx)
    .await
    .map_err(context("moving a task on"))?;
    let data = json!({
        "task": held.task, "attempt": held.attempt, "worker": held.worker, "class": outcome, "error": error,
    });
    if outcome == AttemptOutcome::Expired {
        emit(tx, now, &held.job, EventKind::TaskExpired, data.clone()).await?;
    }
    emit(tx, now, &held.job, kind, data).await?;
    match next {
        // Its siblings cannot make the job succeed any more.
        Next::Failed | Next::Dead => cancel_tasks(tx, &held.job).await?,
        Next::Ready { .. } | Next::Cancelled => {}
    }
    refresh_job(tx, &held.job, now).await?;
    Ok(())
}

async fn count_towards_block(tx: &mut Tx, held: &Held, now: Millis) -> Result<()> {
    sqlx::query(
        "INSERT INTO worker_block (job_id, worker_id, failures, blocked_until) VALUES ($1, $2, 1, 0)
         ON CONFLICT (job_id, worker_id) DO UPDATE SET failures = failures + 1,
             blocked_until = CASE WHEN failures + 1 >= $3 THEN $4 ELSE blocked_until END",
    )
    .bind(&held.job)
    .bind(&held.worker)
    .bind(BLOCK_AFTER_FAILURES)
    .bind(now + BLOCK_MS)
    .execute(&mut **tx)
    .await
    .map_err(context("counting a worker's failures"))?;
    Ok(())
}
