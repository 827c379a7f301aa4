//! Deleting finished jobs.

use lightshaft_api::event::EventKind;
use serde_json::json;

use super::events::emit;
use super::jobs::read_state;
use super::{SqliteStore, Tx, commit, context};
use crate::queue::Millis;
use crate::store::{JobRemoval, Result};

/// In this order nothing is left that refers to what goes.
const BELONGINGS: [&str; 7] = [
    "DELETE FROM artifact WHERE job_id = $1",
    "DELETE FROM attempt WHERE job_id = $1",
    "DELETE FROM task WHERE job_id = $1",
    "DELETE FROM worker_block WHERE job_id = $1",
    "DELETE FROM idempotency WHERE job_id = $1",
    "DELETE FROM event WHERE job_id = $1",
    "DELETE FROM job WHERE id = $1",
];

impl SqliteStore {
    pub(super) async fn do_delete_job(&self, id: &str, now: Millis) -> Result<JobRemoval> {
        let mut tx = self.begin().await?;
        let Some(state) = read_state(&mut *tx, id).await? else { return Ok(JobRemoval::Unknown) };
        if !state.is_final() {
            return Ok(JobRemoval::Unfinished(state));
        }
        let blobs = read_blobs(&mut tx, id).await?;
        let attempts: Vec<String> = sqlx::query_scalar("SELECT id FROM attempt WHERE job_id = $1")
            .bind(id)
            .fetch_all(&mut *tx)
            .await
            .map_err(context("reading a job's attempts"))?;
        for statement in BELONGINGS {
            sqlx::query(statement).bind(id).execute(&mut *tx).await.map_err(context("deleting a job"))?;
        }
        emit(&mut tx, now, id, EventKind::JobDeleted, json!({})).await?;
        commit(tx).await?;
        Ok(JobRemoval::Done { blobs, attempts })
    }

    pub(super) async fn read_jobs_finished_before(&self, before: Millis, limit: u32) -> Result<Vec<String>> {
        sqlx::query_scalar(
            "SELECT j.id FROM job j WHERE j.finished_at < $1
                AND NOT EXISTS (SELECT 1 FROM scene s
                                WHERE j.automatic AND s.id = j.scene_id AND s.deleted_at IS NULL)
                AND NOT EXISTS (SELECT 1 FROM farm_job f JOIN farm_run r ON r.id = f.run_id
                                WHERE f.job_id = j.id AND r.state = 'running')
             ORDER BY j.finished_at LIMIT $2",
        )
        .bind(before)
        .bind(limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("looking for old jobs"))
    }
}

async fn read_blobs(tx: &mut Tx, job: &str) -> Result<Vec<String>> {
    sqlx::query_scalar(
        "SELECT blob FROM artifact WHERE job_id = $1
         UNION SELECT blob FROM job_blob WHERE job_id = $1",
    )
    .bind(job)
    .fetch_all(&mut **tx)
    .await
    .map_err(context("reading what a job left"))
}
