//! The queue as people see it: unfinished jobs in the order of their turn, with what holds each up.

use std::collections::HashMap;

use lightshaft_api::queue::{BlockedWorker, HeldTask};
use sqlx::FromRow;

use super::{SqliteStore, context, from_json, from_name, timestamp, to_json};
use crate::queue::{Demand, Millis};
use crate::store::{ListedJob, QueuedRecord, Result};

#[derive(FromRow)]
struct QueuedRow {
    id: String,
    needs_cpu: bool,
    needs_gpu: bool,
    needs_adapter: Option<String>,
    worker_id: Option<String>,
    worker_name: Option<String>,
    ready: u32,
    blocked: u32,
    ready_at: Option<i64>,
}

#[derive(FromRow)]
struct LeaseRow {
    job_id: String,
    task_id: String,
    work: String,
    worker_id: String,
    worker_name: String,
    number: u32,
    phase: Option<String>,
    expires_at: i64,
}

#[derive(FromRow)]
struct BlockRow {
    job_id: String,
    worker_id: String,
    worker_name: String,
    failures: u32,
    blocked_until: i64,
}

impl SqliteStore {
    pub(super) async fn read_queue(&self, limit: u32, now: Millis) -> Result<Vec<QueuedRecord>> {
        let rows = self.read_turns(limit).await?;
        let ids: Vec<String> = rows.iter().map(|row| row.id.clone()).collect();
        let jobs = self.read_jobs_by_id(&ids).await?;
        let mut jobs: HashMap<String, ListedJob> = jobs.into_iter().map(|job| (job.summary.id.clone(), job)).collect();
        let ids = to_json(&ids)?;
        let mut failures = self.read_failures(&ids).await?;
        let mut leases = self.read_held_tasks(&ids).await?;
        let mut blocks = self.read_blocks(&ids, now).await?;
        // A job that ended between two of these statements has left the queue.
        let queued = rows.into_iter().filter_map(|row| Some((jobs.remove(&row.id)?, row)));
        let record = |(job, row): (ListedJob, QueuedRow)| {
            let (count, last_error) = failures.remove(&row.id).unwrap_or_default();
            QueuedRecord {
                job,
                demand: Demand { cpu: row.needs_cpu, gpu: row.needs_gpu, adapter: row.needs_adapter },
                worker: row.worker_id.zip(row.worker_name),
                tasks_ready: row.ready,
                tasks_blocked: row.blocked,
                ready_at: row.ready_at,
                failures: count,
                last_error,
                leases: leases.remove(&row.id).unwrap_or_default(),
                blocked_workers: blocks.remove(&row.id).unwrap_or_default(),
            }
        };
        Ok(queued.map(record).collect())
    }

    /// Who comes when: as tasks are offered to a worker that can do all of them.
    async fn read_turns(&self, limit: u32) -> Result<Vec<QueuedRow>> {
        sqlx::query_as(
            "SELECT j.id, MAX(t.needs_cpu) AS needs_cpu, MAX(t.needs_gpu) AS needs_gpu,
                    MAX(t.needs_adapter) AS needs_adapter, w.id AS worker_id, w.name AS worker_name,
                    SUM(t.state = 'ready') AS ready, SUM(t.state = 'blocked') AS blocked,
                    MIN(t.run_at) FILTER (WHERE t.state = 'ready') AS ready_at
             FROM job j JOIN task t ON t.job_id = j.id LEFT JOIN worker w ON w.id = t.needs_worker
             WHERE j.state IN ('queued', 'running')
             GROUP BY j.id
             ORDER BY MAX(t.state = 'leased') DESC, j.paused, j.priority DESC, ready_at, j.id LIMIT $1",
        )
        .bind(limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading the queue"))
    }

    /// How many attempts failed, and what the last one failed of. Beside MAX, SQLite takes other columns from its row.
    async fn read_failures(&self, ids: &str) -> Result<HashMap<String, (u32, Option<String>)>> {
        let rows: Vec<(String, u32, Option<String>, String)> = sqlx::query_as(
            "SELECT job_id, COUNT(*), error, MAX(id) FROM attempt
             WHERE job_id IN (SELECT value FROM json_each($1))
               AND outcome IN ('worker', 'task', 'transient', 'expired')
             GROUP BY job_id",
        )
        .bind(ids)
        .fetch_all(&self.readers)
        .await
        .map_err(context("counting failed attempts"))?;
        Ok(rows.into_iter().map(|(job, count, error, _)| (job, (count, error))).collect())
    }

    async fn read_held_tasks(&self, ids: &str) -> Result<HashMap<String, Vec<HeldTask>>> {
        let rows: Vec<LeaseRow> = sqlx::query_as(
            "SELECT t.job_id, t.id AS task_id, t.work, w.id AS worker_id, w.name AS worker_name, a.number, a.phase,
                    t.lease_expires_at AS expires_at
             FROM task t JOIN attempt a ON a.token = t.lease_token JOIN worker w ON w.id = t.worker_id
             WHERE t.job_id IN (SELECT value FROM json_each($1)) AND t.state = 'leased'
             ORDER BY t.job_id, t.position",
        )
        .bind(ids)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading leases"))?;
        let mut by_job: HashMap<String, Vec<HeldTask>> = HashMap::new();
        for row in rows {
            by_job.entry(row.job_id).or_default().push(HeldTask {
                task: row.task_id,
                work: from_json(&row.work)?,
                worker: row.worker_id,
                worker_name: row.worker_name,
                attempt: row.number,
                phase: row.phase.map(|phase| from_name(&phase)).transpose()?,
                expires_at: timestamp(row.expires_at)?,
            });
        }
        Ok(by_job)
    }

    async fn read_blocks(&self, ids: &str, now: Millis) -> Result<HashMap<String, Vec<BlockedWorker>>> {
        let rows: Vec<BlockRow> = sqlx::query_as(
            "SELECT b.job_id, w.id AS worker_id, w.name AS worker_name, b.failures, b.blocked_until
             FROM worker_block b JOIN worker w ON w.id = b.worker_id
             WHERE b.job_id IN (SELECT value FROM json_each($1)) AND b.blocked_until > $2
             ORDER BY b.job_id, w.name, w.id",
        )
        .bind(ids)
        .bind(now)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading which workers are kept from jobs"))?;
        let mut by_job: HashMap<String, Vec<BlockedWorker>> = HashMap::new();
        for row in rows {
            by_job.entry(row.job_id).or_default().push(BlockedWorker {
                worker: row.worker_id,
                worker_name: row.worker_name,
                failures: row.failures,
                until: timestamp(row.blocked_until)?,
            });
        }
        Ok(by_job)
    }
}
