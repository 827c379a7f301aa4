//! Claiming a task, keeping a lease.

use lightshaft_api::event::EventKind;
use lightshaft_api::job::{AttemptOutcome, Phase, TaskWork};
use lightshaft_api::lease::{LeaseScene, NewArtifact, Part, SceneFile};
use lightshaft_api::settings::JobSettings;
use serde_json::json;
use sqlx::FromRow;

use super::events::emit;
use super::jobs::refresh_job;
use super::offers::{read_worker, take_best};
use super::{SqliteStore, Tx, commit, context, from_json, from_name};
use crate::queue::Millis;
use crate::store::{Claim, Claimed, ClaimedTask, LeaseState, Result};

#[derive(FromRow)]
struct TaskRow {
    id: String,
    job_id: String,
    work: String,
    leases: u32,
    run_at: i64,
    settings: String,
    trace_id: String,
    scene_id: String,
    scene_name: String,
}

#[derive(FromRow)]
struct LeaseRow {
    attempt: String,
    task: String,
    job: String,
    worker: String,
    outcome: String,
    phase: Option<String>,
    expires_at: i64,
    cancel_requested: bool,
    draining: bool,
}

impl SqliteStore {
    pub(super) async fn do_claim(&self, claim: &Claim) -> Result<Claimed> {
        let mut tx = self.begin().await?;
        let Some(worker) = read_worker(&mut *tx, &claim.worker).await? else { return Ok(Claimed::UnknownWorker) };
        if worker.draining {
            return Ok(Claimed::Nothing);
        }
        let Some(task) = take_best(&mut tx, claim, &worker).await? else { return Ok(Claimed::Nothing) };
        let row: TaskRow = sqlx::query_as(
            "SELECT t.id, t.job_id, t.work, t.leases, t.run_at, j.settings, j.trace_id, j.scene_id,
                    s.name AS scene_name
             FROM task t JOIN job j ON j.id = t.job_id JOIN scene s ON s.id = j.scene_id WHERE t.id = $1",
        )
        .bind(&task)
        .fetch_one(&mut *tx)
        .await
        .map_err(context("reading a claimed task"))?;
        sqlx::query(
            "INSERT INTO attempt (id, task_id, job_id, number, worker_id, token, outcome, started_at)
             VALUES ($1, $2, $3, $4, $5, $6, 'running', $7)",
        )
        .bind(&claim.attempt)
        .bind(&row.id)
        .bind(&row.job_id)
        .bind(row.leases)
        .bind(&claim.worker)
        .bind(&claim.token)
        .bind(claim.now)
        .execute(&mut *tx)
        .await
        .map_err(context("beginning an attempt"))?;
        refresh_job(&mut tx, &row.job_id, claim.now).await?;
        let data = json!({ "task": row.id, "attempt": claim.attempt, "worker": claim.worker });
        emit(&mut tx, claim.now, &row.job_id, EventKind::TaskLeased, data).await?;
        let work: TaskWork = from_json(&row.work)?;
        let settings: JobSettings = from_json(&row.settings)?;
        let mut more_scenes = Vec::new();
        for scene in settings.further_scenes() {
            more_scenes.extend(read_further_scene(&mut tx, scene).await?);
        }
        let claimed = ClaimedTask {
            parts: if work == TaskWork::Merge { read_parts(&mut tx, &row.job_id).await? } else { Vec::new() },
            scene: read_lease_scene(&mut tx, &row.scene_id, &row.scene_name).await?,
            job: row.job_id,
            task: row.id,
            number: row.leases,
            work,
            settings,
            more_scenes,
            trace_id: row.trace_id,
            waited_ms: claim.now - row.run_at,
        };
        commit(tx).await?;
        Ok(Claimed::Task(Box::new(claimed)))
    }

    pub(super) async fn read_lease(&self, token: &str) -> Result<Option<LeaseState>> {
        let row: Option<LeaseRow> = sqlx::query_as(
            "SELECT a.id AS attempt, a.task_id AS task, a.job_id AS job, a.worker_id AS worker, a.outcome, a.phase,
                    CASE WHEN t.lease_token = a.token THEN t.lease_expires_at ELSE 0 END AS expires_at,
                    t.cancel_requested, w.draining
             FROM attempt a JOIN task t ON t.id = a.task_id JOIN worker w ON w.id = a.worker_id WHERE a.token = $1",
        )
        .bind(token)
        .fetch_optional(&self.readers)
        .await
        .map_err(context("reading a lease"))?;
        row.map(|row| {
            Ok(LeaseState {
                attempt: row.attempt,
                task: row.task,
                job: row.job,
                worker: row.worker,
                outcome: from_name::<AttemptOutcome>(&row.outcome)?,
                phase: row.phase.map(|phase| from_name::<Phase>(&phase)).transpose()?,
                expires_at: row.expires_at,
                cancel_requested: row.cancel_requested,
                draining: row.draining,
            })
        })
        .transpose()
    }

    pub(super) async fn do_renew(&self, token: &str, phase: Phase, progress: f64, expires_at: Millis) -> Result<bool> {
        let mut tx = self.begin().await?;
        let renewed = sqlx::query(
            "UPDATE task SET lease_expires_at = $2, progress = MAX(progress, $3)
             WHERE lease_token = $1 AND state = 'leased'",
        )
        .bind(token)
        .bind(expires_at)
        .bind(progress)
        .execute(&mut *tx)
        .await
        .map_err(context("renewing a lease"))?;
        if renewed.rows_affected() == 0 {
            return Ok(false);
        }
        sqlx::query("UPDATE attempt SET phase = $2 WHERE token = $1")
            .bind(token)
            .bind(phase.as_str())
            .execute(&mut *tx)
            .await
            .map_err(context("noting an attempt's phase"))?;
        commit(tx).await?;
        Ok(true)
    }

    pub(super) async fn do_note_progress(&self, token: &str, progress: f64) -> Result<()> {
        sqlx::query("UPDATE task SET progress = MAX(progress, $2) WHERE lease_token = $1 AND state = 'leased'")
            .bind(token)
            .bind(progress)
            .execute(&self.writer)
            .await
            .map_err(context("noting a task's progress"))?;
        Ok(())
    }
}

/// `None` when it was deleted since the job was made: the worker misses it.
async fn read_further_scene(tx: &mut Tx, id: &str) -> Result<Option<LeaseScene>> {
    let name: Option<String> = sqlx::query_scalar("SELECT name FROM scene WHERE id = $1 AND deleted_at IS NULL")
        .bind(id)
        .fetch_optional(&mut **tx)
        .await
        .map_err(context("reading a further scene"))?;
    match name {
        Some(name) => read_lease_scene(tx, id, &name).await.map(Some),
        None => Ok(None),
    }
}

async fn read_lease_scene(tx: &mut Tx, id: &str, name: &str) -> Result<LeaseScene> {
    let files: Vec<(String, String, i64)> =
        sqlx::query_as("SELECT path, blob, bytes FROM scene_file WHERE scene_id = $1 ORDER BY position")
            .bind(id)
            .fetch_all(&mut **tx)
            .await
            .map_err(context("reading a scene's files"))?;
    let meshes: Vec<String> =
        sqlx::query_scalar("SELECT mesh_hash FROM scene_mesh WHERE scene_id = $1 ORDER BY mesh_hash")
            .bind(id)
            .fetch_all(&mut **tx)
            .await
            .map_err(context("reading a scene's meshes"))?;
    let files =
        files.into_iter().map(|(path, blob, bytes)| SceneFile { path, blob, bytes: bytes.unsigned_abs() }).collect();
    Ok(LeaseScene { id: id.to_owned(), name: name.to_owned(), files, meshes })
}

async fn read_parts(tx: &mut Tx, job: &str) -> Result<Vec<Part>> {
    let rows: Vec<(String, String)> = sqlx::query_as(
        "SELECT t.work, a.blob FROM artifact a JOIN task t ON t.id = a.task_id
         WHERE a.job_id = $1 AND a.name = $2 AND t.state = 'succeeded' ORDER BY t.position",
    )
    .bind(job)
    .bind(NewArtifact::PART)
    .fetch_all(&mut **tx)
    .await
    .map_err(context("reading the parts of a picture"))?;
    rows.into_iter().map(|(work, blob)| Ok(Part { work: from_json(&work)?, blob })).collect()
}
