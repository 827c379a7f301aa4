//! Which tasks a worker may have.
//!
//! Ready tasks of jobs that are not paused stand in one index per demand (any worker, a CPU, a GPU) by priority and age.
//! A worker is offered the first 64 of each kind that it can do. One that has failed at a task or a job is kept from it
//! only while another one is there that could do it.

use sqlx::{FromRow, SqliteExecutor};

use super::{SqliteStore, Tx, context, to_json};
use crate::queue::{GONE_AFTER_MS, Millis, WARM_PATIENCE_MS, WORKER_PATIENCE_MS, WORKER_PAUSE_MS};
use crate::store::{Claim, Result};

#[derive(Debug, FromRow)]
pub(super) struct WorkerRow {
    has_cpu: bool,
    has_gpu: bool,
    gpu_names: String,
    pub(super) draining: bool,
}

/// Offers of one demand: $1 the worker, $2 now, $3 has_cpu, $4 has_gpu, $5 gpu_names, and the pauses of the queue.
macro_rules! offers_of {
    ($demand:literal, $can:literal) => {
        concat!(
            "SELECT * FROM (
                 SELECT t.id, t.priority, t.run_at, j.scene_id
                 FROM task t INDEXED BY task_offer CROSS JOIN job j ON j.id = t.job_id
                 WHERE t.demand = ",
            $demand,
            " AND t.state = 'ready' AND t.paused = 0 AND t.run_at <= $2 AND ",
            $can,
            "
                   AND (t.needs_worker IS NULL OR t.needs_worker = $1)
                   AND NOT (t.leases > 0 AND EXISTS (
                       SELECT 1 FROM attempt a
                       WHERE a.task_id = t.id AND a.worker_id = $1 AND a.outcome = 'worker' AND a.finished_at > $2 - $6))
                   AND NOT (
                       (t.job_id IN (SELECT b.job_id FROM worker_block b WHERE b.worker_id = $1 AND b.blocked_until > $2)
                        OR (t.leases > 0 AND EXISTS (
                            SELECT 1 FROM attempt a
                            WHERE a.task_id = t.id AND a.worker_id = $1 AND a.outcome = 'worker'
                              AND a.finished_at > $2 - $7)))
                       AND EXISTS (
                           SELECT 1 FROM worker o
                           WHERE o.id <> $1 AND o.removed_at IS NULL AND NOT o.draining AND o.last_seen_at > $2 - $8
                             AND (NOT t.needs_cpu OR o.has_cpu) AND (NOT t.needs_gpu OR o.has_gpu)
                             AND (t.needs_adapter IS NULL OR instr(o.gpu_names, t.needs_adapter) > 0)
                             AND (t.needs_worker IS NULL OR t.needs_worker = o.id)
                             AND NOT EXISTS (SELECT 1 FROM worker_block b
                                             WHERE b.job_id = t.job_id AND b.worker_id = o.id
                                               AND b.blocked_until > $2)))
                 ORDER BY t.priority DESC, t.run_at, t.id LIMIT 64)"
        )
    };
}

macro_rules! offers {
    () => {
        concat!(
            offers_of!("0", "$1 IS NOT NULL"),
            " UNION ALL ",
            offers_of!("1", "$3"),
            " UNION ALL ",
            offers_of!("2", "$4 AND (t.needs_adapter IS NULL OR instr($5, t.needs_adapter) > 0)")
        )
    };
}

const HAS_OFFER: &str = concat!("SELECT EXISTS (", offers!(), ")");

/// Takes the best offer: by priority, then what has waited for long, then what the worker holds warm (weighed by
/// primitives), then by age.
const TAKE_BEST: &str = concat!(
    "UPDATE task SET state = 'leased', leases = leases + 1, progress = 0, worker_id = $1, lease_token = $9,
                     lease_expires_at = $10
     WHERE id = (
         SELECT c.id FROM (",
    offers!(),
    ") c
         ORDER BY c.priority DESC, c.run_at < $2 - $12 DESC,
                  (SELECT COALESCE(SUM(m.triangles + m.spheres), 0)
                   FROM scene_mesh s JOIN mesh m ON m.hash = s.mesh_hash
                   WHERE s.scene_id = c.scene_id AND m.hash IN (SELECT value FROM json_each($11))) DESC,
                  c.run_at, c.id
         LIMIT 1)
     RETURNING id"
);

pub(super) async fn read_worker(db: impl SqliteExecutor<'_>, id: &str) -> Result<Option<WorkerRow>> {
    sqlx::query_as("SELECT has_cpu, has_gpu, gpu_names, draining FROM worker WHERE id = $1 AND removed_at IS NULL")
        .bind(id)
        .fetch_optional(db)
        .await
        .map_err(context("looking up a worker"))
}

/// Leases the task to the worker; returns its id.
pub(super) async fn take_best(tx: &mut Tx, claim: &Claim, worker: &WorkerRow) -> Result<Option<String>> {
    sqlx::query_scalar(TAKE_BEST)
        .bind(&claim.worker)
        .bind(claim.now)
        .bind(worker.has_cpu)
        .bind(worker.has_gpu)
        .bind(&worker.gpu_names)
        .bind(WORKER_PAUSE_MS)
        .bind(WORKER_PATIENCE_MS)
        .bind(GONE_AFTER_MS)
        .bind(&claim.token)
        .bind(claim.expires_at)
        .bind(to_json(&claim.warm)?)
        .bind(WARM_PATIENCE_MS)
        .fetch_optional(&mut **tx)
        .await
        .map_err(context("claiming a task"))
}

impl SqliteStore {
    pub(super) async fn read_has_task_for(&self, id: &str, now: Millis) -> Result<Option<bool>> {
        let Some(worker) = read_worker(&self.readers, id).await? else { return Ok(None) };
        if worker.draining {
            return Ok(Some(false));
        }
        sqlx::query_scalar(HAS_OFFER)
            .bind(id)
            .bind(now)
            .bind(worker.has_cpu)
            .bind(worker.has_gpu)
            .bind(&worker.gpu_names)
            .bind(WORKER_PAUSE_MS)
            .bind(WORKER_PATIENCE_MS)
            .bind(GONE_AFTER_MS)
            .fetch_one(&self.readers)
            .await
            .map(Some)
            .map_err(context("looking for work"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn offers_come_from_their_index_in_its_order() {
        let dir = tempfile::tempdir().unwrap();
        let store = SqliteStore::open(&dir.path().join("test.db")).await.unwrap();
        for (statement, params) in [(HAS_OFFER, 8), (TAKE_BEST, 12)] {
            let mut query = sqlx::query_as(sqlx::AssertSqlSafe(format!("EXPLAIN QUERY PLAN {statement}")));
            for _ in 0..params {
                query = query.bind(0);
            }
            let plan: Vec<(i64, i64, i64, String)> = query.fetch_all(&store.writer).await.unwrap();
            let lines: Vec<&str> = plan.iter().map(|row| row.3.as_str()).collect();
            assert_eq!(
                lines.iter().filter(|line| line.contains("INDEX task_offer (demand=?)")).count(),
                3,
                "{lines:#?}"
            );
            let scans = lines.iter().filter(|line| line.starts_with("SCAN t") || line.starts_with("SCAN j"));
            assert_eq!(scans.filter(|line| !line.contains("json_each")).count(), 0, "{lines:#?}");
        }
    }
}
