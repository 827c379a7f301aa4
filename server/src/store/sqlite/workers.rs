//! Workers.

use lightshaft_api::worker::{CacheStatus, CurrentWork, Device, DeviceKind, NewWorker, Worker, WorkerState};
use sqlx::FromRow;

use super::close::expire_worker;
use super::{SqliteStore, commit, context, from_json, timestamp, to_json};
use crate::queue::Millis;
use crate::store::{Expired, Removal, Result};

#[derive(FromRow)]
struct WorkerRow {
    id: String,
    name: String,
    version: String,
    devices: String,
    tags: String,
    draining: bool,
    tasks_done: i64,
    registered_at: i64,
    last_seen_at: i64,
    job_id: Option<String>,
    task_id: Option<String>,
}

impl WorkerRow {
    /// Whether it is gone, and what its cache holds, is known only to who hears its polls.
    fn into_worker(self) -> Result<Worker> {
        let current = self.job_id.zip(self.task_id).map(|(job, task)| CurrentWork { job, task });
        let state = match (&current, self.draining) {
            (_, true) => WorkerState::Draining,
            (Some(_), false) => WorkerState::Busy,
            (None, false) => WorkerState::Idle,
        };
        Ok(Worker {
            id: self.id,
            name: self.name,
            version: self.version,
            devices: from_json(&self.devices)?,
            tags: from_json(&self.tags)?,
            state,
            draining: self.draining,
            registered_at: timestamp(self.registered_at)?,
            last_seen_at: timestamp(self.last_seen_at)?,
            current,
            tasks_done: self.tasks_done.unsigned_abs(),
            cache: CacheStatus::default(),
        })
    }
}

impl SqliteStore {
    pub(super) async fn do_register_worker(&self, id: &str, worker: &NewWorker, now: Millis) -> Result<Vec<Expired>> {
        let gpus: Vec<&Device> = worker.devices.iter().filter(|device| device.kind == DeviceKind::Gpu).collect();
        let gpu_names: Vec<String> = gpus.iter().map(|gpu| gpu.name.to_lowercase()).collect();
        let mut tx = self.begin().await?;
        sqlx::query(
            "INSERT INTO worker (id, name, version, devices, tags, has_cpu, has_gpu, gpu_names, registered_at,
                                 last_seen_at)
             VALUES ($1, $2, $3, $4, $5, $9, $6, $7, $8, $8)
             ON CONFLICT (id) DO UPDATE SET name = $2, version = $3, devices = $4, tags = $5, has_cpu = $9, has_gpu = $6,
                 gpu_names = $7, registered_at = $8, last_seen_at = $8, removed_at = NULL",
        )
        .bind(id)
        .bind(&worker.name)
        .bind(&worker.version)
        .bind(to_json(&worker.devices)?)
        .bind(to_json(&worker.tags)?)
        .bind(!gpus.is_empty())
        .bind(gpu_names.join("\n"))
        .bind(now)
        .bind(worker.devices.iter().any(|device| device.kind == DeviceKind::Cpu))
        .execute(&mut *tx)
        .await
        .map_err(context("registering a worker"))?;
        let lost = expire_worker(&mut tx, id, now).await?;
        commit(tx).await?;
        Ok(lost)
    }

    pub(super) async fn read_worker(&self, id: &str) -> Result<Option<Worker>> {
        let row: Option<WorkerRow> = sqlx::query_as(
            "SELECT w.*, a.job_id, a.task_id
             FROM worker w LEFT JOIN attempt a ON a.worker_id = w.id AND a.outcome = 'running'
             WHERE w.id = $1 AND w.removed_at IS NULL ORDER BY a.id DESC LIMIT 1",
        )
        .bind(id)
        .fetch_optional(&self.readers)
        .await
        .map_err(context("reading a worker"))?;
        row.map(WorkerRow::into_worker).transpose()
    }

    pub(super) async fn read_workers(&self) -> Result<Vec<Worker>> {
        let rows: Vec<WorkerRow> = sqlx::query_as(
            "SELECT w.*, a.job_id, a.task_id
             FROM worker w LEFT JOIN attempt a ON a.id =
                 (SELECT MAX(r.id) FROM attempt r WHERE r.worker_id = w.id AND r.outcome = 'running')
             WHERE w.removed_at IS NULL ORDER BY w.name, w.id",
        )
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading workers"))?;
        rows.into_iter().map(WorkerRow::into_worker).collect()
    }

    pub(super) async fn do_touch_worker(&self, id: &str, now: Millis) -> Result<()> {
        sqlx::query("UPDATE worker SET last_seen_at = $2 WHERE id = $1")
            .bind(id)
            .bind(now)
            .execute(&self.writer)
            .await
            .map_err(context("noting that a worker is there"))?;
        Ok(())
    }

    pub(super) async fn do_set_draining(&self, id: &str, draining: bool) -> Result<bool> {
        let changed = sqlx::query("UPDATE worker SET draining = $2 WHERE id = $1 AND removed_at IS NULL")
            .bind(id)
            .bind(draining)
            .execute(&self.writer)
            .await
            .map_err(context("draining a worker"))?;
        Ok(changed.rows_affected() > 0)
    }

    pub(super) async fn do_remove_worker(&self, id: &str, now: Millis) -> Result<Removal> {
        let mut tx = self.begin().await?;
        let busy: bool =
            sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM attempt WHERE worker_id = $1 AND outcome = 'running')")
                .bind(id)
                .fetch_one(&mut *tx)
                .await
                .map_err(context("looking for a worker's leases"))?;
        if busy {
            return Ok(Removal::InUse);
        }
        let removed = sqlx::query("UPDATE worker SET removed_at = $2 WHERE id = $1 AND removed_at IS NULL")
            .bind(id)
            .bind(now)
            .execute(&mut *tx)
            .await
            .map_err(context("removing a worker"))?;
        if removed.rows_affected() == 0 {
            return Ok(Removal::Unknown);
        }
        commit(tx).await?;
        Ok(Removal::Done)
    }
}
