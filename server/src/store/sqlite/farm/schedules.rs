//! Schedules.

use async_trait::async_trait;
use lightshaft_api::farm::Schedule;
use sqlx::FromRow;

use crate::queue::Millis;
use crate::store::sqlite::{SqliteStore, context, from_json, timestamp, to_json};
use crate::store::{Result, ScheduleStore};

#[derive(FromRow)]
struct ScheduleRow {
    id: String,
    name: String,
    cron: String,
    run: String,
    paused: bool,
    next_at: Option<i64>,
    begun_at: Option<i64>,
    last_run: Option<String>,
    error: Option<String>,
    created_at: i64,
}

impl ScheduleRow {
    fn into_schedule(self) -> Result<Schedule> {
        Ok(Schedule {
            id: self.id,
            name: self.name,
            cron: self.cron,
            run: from_json(&self.run)?,
            paused: self.paused,
            next_at: self.next_at.map(timestamp).transpose()?,
            begun_at: self.begun_at.map(timestamp).transpose()?,
            last_run: self.last_run,
            error: self.error,
            created_at: timestamp(self.created_at)?,
        })
    }
}

#[async_trait]
impl ScheduleStore for SqliteStore {
    async fn add_schedule(&self, schedule: &Schedule) -> Result<bool> {
        let added = sqlx::query(
            "INSERT INTO farm_schedule (id, name, cron, run, next_at, created_at, paused)
             VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (name) DO NOTHING",
        )
        .bind(&schedule.id)
        .bind(&schedule.name)
        .bind(&schedule.cron)
        .bind(to_json(&schedule.run)?)
        .bind(schedule.next_at.map(jiff::Timestamp::as_millisecond))
        .bind(schedule.created_at.as_millisecond())
        .bind(schedule.paused)
        .execute(&self.writer)
        .await
        .map_err(context("adding a schedule"))?;
        Ok(added.rows_affected() > 0)
    }

    async fn schedules(&self, due_at: Option<Millis>) -> Result<Vec<Schedule>> {
        let rows: Vec<ScheduleRow> = sqlx::query_as(
            "SELECT id, name, cron, run, paused, next_at, begun_at, last_run, error, created_at FROM farm_schedule
             WHERE $1 IS NULL OR next_at <= $1 ORDER BY name",
        )
        .bind(due_at)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading schedules"))?;
        rows.into_iter().map(ScheduleRow::into_schedule).collect()
    }

    async fn delete_schedule(&self, id: &str) -> Result<bool> {
        let deleted = sqlx::query("DELETE FROM farm_schedule WHERE id = $1")
            .bind(id)
            .execute(&self.writer)
            .await
            .map_err(context("deleting a schedule"))?;
        Ok(deleted.rows_affected() > 0)
    }

    async fn change_schedule(&self, id: &str, paused: bool, next_at: Option<Millis>) -> Result<bool> {
        let changed = sqlx::query("UPDATE farm_schedule SET paused = $2, next_at = $3 WHERE id = $1")
            .bind(id)
            .bind(paused)
            .bind(next_at)
            .execute(&self.writer)
            .await
            .map_err(context("pausing a schedule"))?;
        Ok(changed.rows_affected() > 0)
    }

    async fn take_schedule(&self, due: &Schedule, next_at: Option<Millis>, now: Millis) -> Result<bool> {
        let taken = sqlx::query("UPDATE farm_schedule SET next_at = $3, begun_at = $4 WHERE id = $1 AND next_at = $2")
            .bind(&due.id)
            .bind(due.next_at.map(jiff::Timestamp::as_millisecond))
            .bind(next_at)
            .bind(now)
            .execute(&self.writer)
            .await
            .map_err(context("taking a schedule"))?;
        Ok(taken.rows_affected() > 0)
    }

    async fn note_begun(&self, id: &str, run: std::result::Result<&str, &str>) -> Result<()> {
        sqlx::query("UPDATE farm_schedule SET last_run = COALESCE($2, last_run), error = $3 WHERE id = $1")
            .bind(id)
            .bind(run.ok())
            .bind(run.err())
            .execute(&self.writer)
            .await
            .map_err(context("noting what a schedule began"))?;
        Ok(())
    }
}
