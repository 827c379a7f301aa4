//! Events: written in the transaction that they tell of.

use lightshaft_api::event::{Event, EventKind};
use serde_json::Value;

use super::{SqliteStore, Tx, context, from_json, timestamp};
use crate::queue::Millis;
use crate::store::{Result, StoreError};

/// Events deleted in one transaction, so that upkeep never holds the writer for long.
const FORGET_BATCH: i64 = 10_000;

pub(super) async fn emit(tx: &mut Tx, now: Millis, job: &str, kind: EventKind, data: Value) -> Result<()> {
    sqlx::query("INSERT INTO event (at, job_id, kind, data) VALUES ($1, $2, $3, $4)")
        .bind(now)
        .bind(job)
        .bind(kind.as_str())
        .bind(data.to_string())
        .execute(&mut **tx)
        .await
        .map_err(context("writing an event"))?;
    Ok(())
}

impl SqliteStore {
    pub(super) async fn read_events_after(&self, id: i64, job: Option<&str>, limit: u32) -> Result<Vec<Event>> {
        let all = "SELECT id, at, job_id, kind, data FROM event WHERE id > $1 ORDER BY id LIMIT $2";
        let of_job = "SELECT id, at, job_id, kind, data FROM event WHERE id > $1 AND job_id = $3 ORDER BY id LIMIT $2";
        let query = sqlx::query_as(if job.is_some() { of_job } else { all }).bind(id).bind(limit);
        let query = if let Some(job) = job { query.bind(job) } else { query };
        let rows: Vec<(i64, i64, String, String, String)> =
            query.fetch_all(&self.readers).await.map_err(context("reading events"))?;
        rows.into_iter()
            .map(|(id, at, job, kind, data)| {
                let kind = EventKind::from_name(&kind)
                    .ok_or_else(|| StoreError::Corrupt(format!("event {id} is of no known kind")))?;
                Ok(Event { id: Some(id), at: timestamp(at)?, job, kind, data: from_json(&data)? })
            })
            .collect()
    }

    pub(super) async fn read_last_event(&self) -> Result<i64> {
        sqlx::query_scalar("SELECT COALESCE(MAX(id), 0) FROM event")
            .fetch_one(&self.readers)
            .await
            .map_err(context("reading the last event"))
    }

    pub(super) async fn do_forget_before(&self, keys: Millis, events: Millis) -> Result<u64> {
        let mut forgotten = 0;
        for statement in
            ["DELETE FROM idempotency WHERE created_at < $1", "DELETE FROM farm_idempotency WHERE created_at < $1"]
        {
            let keys = sqlx::query(statement).bind(keys).execute(&self.writer);
            forgotten += keys.await.map_err(context("forgetting idempotency keys"))?.rows_affected();
        }
        let old_events =
            sqlx::query("DELETE FROM event WHERE id IN (SELECT id FROM event WHERE at < $1 ORDER BY at LIMIT $2)")
                .bind(events)
                .bind(FORGET_BATCH)
                .execute(&self.writer)
                .await
                .map_err(context("forgetting events"))?;
        Ok(forgotten + old_events.rows_affected())
    }
}
