//! Reading jobs with all that belongs to them.

use std::collections::BTreeMap;

use lightshaft_api::job::{Artifact, Attempt, Job, JobSummary, Task};
use lightshaft_api::lease::NewArtifact;
use lightshaft_api::status::StateCounts;
use sqlx::FromRow;

use super::jobs::counts;
use super::{SqliteStore, context, from_json, from_name, timestamp, to_json};
use crate::queue::Millis;
use crate::store::{JobQuery, ListedJob, PageRequest, Result, TaskProgress, Totals};

#[derive(FromRow)]
struct JobRow {
    id: String,
    kind: String,
    scene_id: String,
    scene_name: String,
    state: String,
    paused: bool,
    cancel_requested: bool,
    priority: i32,
    max_attempts: u32,
    settings: String,
    error: Option<String>,
    metrics: Option<String>,
    trace_id: String,
    created_at: i64,
    started_at: Option<i64>,
    finished_at: Option<i64>,
    labels: String,
    tasks_total: u32,
    tasks_done: u32,
    settled: f64,
    leased: Option<String>,
}

#[derive(FromRow)]
struct ProgressRow {
    tasks: u32,
    settled: f64,
    leased: Option<String>,
}

impl ProgressRow {
    fn into_progress(self) -> Result<TaskProgress> {
        let leased = self.leased.as_deref().map(from_json).transpose()?.unwrap_or_default();
        Ok(TaskProgress { tasks: self.tasks, settled: self.settled, leased })
    }
}

impl JobRow {
    fn into_listed(self) -> Result<ListedJob> {
        let row = ProgressRow { tasks: self.tasks_total, settled: self.settled, leased: self.leased };
        let progress = row.into_progress()?;
        let summary = JobSummary {
            id: self.id,
            kind: from_name(&self.kind)?,
            scene: self.scene_id,
            scene_name: self.scene_name,
            state: from_name(&self.state)?,
            paused: self.paused,
            cancel_requested: self.cancel_requested,
            priority: self.priority,
            labels: from_json::<BTreeMap<String, String>>(&self.labels)?,
            progress: progress.of_job(|_| None),
            tasks_total: self.tasks_total,
            tasks_done: self.tasks_done,
            error: self.error,
            created_at: timestamp(self.created_at)?,
            started_at: self.started_at.map(timestamp).transpose()?,
            finished_at: self.finished_at.map(timestamp).transpose()?,
            trace_id: self.trace_id,
        };
        Ok(ListedJob { summary, progress })
    }
}

#[derive(FromRow)]
struct TaskRow {
    id: String,
    position: u32,
    work: String,
    state: String,
    progress: f64,
    spent: u32,
    max_attempts: u32,
    run_at: i64,
    error: Option<String>,
}

#[derive(FromRow)]
struct AttemptRow {
    id: String,
    task_id: String,
    number: u32,
    worker_id: String,
    worker_name: String,
    outcome: String,
    error: Option<String>,
    phase: Option<String>,
    started_at: i64,
    finished_at: Option<i64>,
}

#[derive(FromRow)]
struct ArtifactRow {
    name: String,
    media_type: String,
    bytes: i64,
    blob: String,
}

impl SqliteStore {
    pub(super) async fn read_totals(&self) -> Result<Totals> {
        let jobs: Vec<(String, i64)> = sqlx::query_as("SELECT state, COUNT(*) FROM job GROUP BY state")
            .fetch_all(&self.readers)
            .await
            .map_err(context("counting jobs"))?;
        let mut by_state = StateCounts::default();
        for (state, count) in jobs {
            let count = count.unsigned_abs();
            match state.as_str() {
                "queued" => by_state.queued = count,
                "running" => by_state.running = count,
                "succeeded" => by_state.succeeded = count,
                "failed" => by_state.failed = count,
                _ => by_state.cancelled = count,
            }
        }
        let tasks: Vec<(String, u32)> = sqlx::query_as("SELECT state, COUNT(*) FROM task GROUP BY state")
            .fetch_all(&self.readers)
            .await
            .map_err(context("counting tasks"))?;
        let scenes: i64 = sqlx::query_scalar("SELECT COUNT(*) FROM scene WHERE deleted_at IS NULL")
            .fetch_one(&self.readers)
            .await
            .map_err(context("counting scenes"))?;
        Ok(Totals { jobs: by_state, tasks: counts(tasks), scenes: scenes.unsigned_abs() })
    }

    pub(super) async fn read_job(&self, id: &str) -> Result<Option<Job>> {
        let row: Option<JobRow> = sqlx::query_as(
            "SELECT j.*, s.name AS scene_name,
                    (SELECT json_group_object(l.key, l.value) FROM job_label l WHERE l.job_id = j.id) AS labels,
                    COUNT(t.id) AS tasks_total, COALESCE(SUM(t.state = 'succeeded'), 0) AS tasks_done,
                    COALESCE(SUM(t.progress) FILTER (WHERE t.state <> 'leased'), 0.0) AS settled,
                    json_group_object(t.id, t.progress) FILTER (WHERE t.state = 'leased') AS leased
             FROM job j JOIN scene s ON s.id = j.scene_id LEFT JOIN task t ON t.job_id = j.id
             WHERE j.id = $1 GROUP BY j.id",
        )
        .bind(id)
        .fetch_optional(&self.readers)
        .await
        .map_err(context("reading a job"))?;
        let Some(mut row) = row else { return Ok(None) };
        let metrics = row.metrics.take().map(|text| from_json(&text)).transpose()?;
        let settings = from_json(&row.settings)?;
        Ok(Some(Job {
            max_attempts: row.max_attempts,
            settings,
            metrics,
            tasks: self.read_tasks(id).await?,
            attempts: self.read_attempts(id).await?,
            artifacts: self.read_artifacts(id).await?,
            waiting: None,
            preview: None,
            summary: row.into_listed()?.summary,
        }))
    }

    pub(super) async fn read_jobs(&self, query: &JobQuery, page: &PageRequest) -> Result<Vec<ListedJob>> {
        let rows: Vec<JobRow> = sqlx::query_as(
            "SELECT j.*, s.name AS scene_name,
                    (SELECT json_group_object(l.key, l.value) FROM job_label l WHERE l.job_id = j.id) AS labels,
                    COUNT(t.id) AS tasks_total, COALESCE(SUM(t.state = 'succeeded'), 0) AS tasks_done,
                    COALESCE(SUM(t.progress) FILTER (WHERE t.state <> 'leased'), 0.0) AS settled,
                    json_group_object(t.id, t.progress) FILTER (WHERE t.state = 'leased') AS leased
             FROM (SELECT j.* FROM job j JOIN scene s ON s.id = j.scene_id
                   WHERE ($1 IS NULL OR j.id < $1)
                     AND ($3 IS NULL OR j.state = $3)
                     AND ($4 IS NULL OR j.scene_id = $4)
                     AND ($5 IS NULL OR j.automatic = $5)
                     AND NOT EXISTS (SELECT 1 FROM json_each($6) wanted WHERE NOT EXISTS
                             (SELECT 1 FROM job_label l
                              WHERE l.job_id = j.id AND l.key = wanted.key AND l.value = wanted.value))
                     AND ($7 IS NULL OR substr(j.id, 1, length($7)) = $7 OR instr(lower(s.name), $7) > 0
                          OR EXISTS (SELECT 1 FROM job_label l WHERE l.job_id = j.id AND instr(lower(l.value), $7) > 0))
                   ORDER BY j.id DESC LIMIT $2) j
             JOIN scene s ON s.id = j.scene_id LEFT JOIN task t ON t.job_id = j.id
             GROUP BY j.id ORDER BY j.id DESC",
        )
        .bind(&page.after)
        .bind(page.limit)
        .bind(query.state.map(|state| state.as_str()))
        .bind(&query.scene)
        .bind(query.automatic)
        .bind(to_json(&query.labels)?)
        .bind(query.text.as_ref().map(|text| text.to_lowercase()))
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading jobs"))?;
        rows.into_iter().map(JobRow::into_listed).collect()
    }

    pub(super) async fn read_task_progress(&self, job: &str) -> Result<TaskProgress> {
        let row: ProgressRow = sqlx::query_as(
            "SELECT COUNT(*) AS tasks, COALESCE(SUM(progress) FILTER (WHERE state <> 'leased'), 0.0) AS settled,
                    json_group_object(id, progress) FILTER (WHERE state = 'leased') AS leased
             FROM task WHERE job_id = $1",
        )
        .bind(job)
        .fetch_one(&self.readers)
        .await
        .map_err(context("reading how far a job is"))?;
        row.into_progress()
    }

    pub(super) async fn read_tasks(&self, job: &str) -> Result<Vec<Task>> {
        let rows: Vec<TaskRow> = sqlx::query_as(
            "SELECT t.id, t.position, t.work, t.state, t.progress, t.spent, j.max_attempts, t.run_at, t.error
             FROM task t JOIN job j ON j.id = t.job_id WHERE t.job_id = $1 ORDER BY t.position",
        )
        .bind(job)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading tasks"))?;
        rows.into_iter()
            .map(|row| {
                Ok(Task {
                    id: row.id,
                    index: row.position,
                    work: from_json(&row.work)?,
                    progress: row.progress,
                    state: from_name(&row.state)?,
                    attempt: row.spent,
                    max_attempts: row.max_attempts,
                    ready_at: if row.state == "ready" { Some(timestamp(row.run_at)?) } else { None },
                    error: row.error,
                })
            })
            .collect()
    }

    pub(super) async fn read_attempts(&self, job: &str) -> Result<Vec<Attempt>> {
        let rows: Vec<AttemptRow> = sqlx::query_as(
            "SELECT a.id, a.task_id, a.number, a.worker_id, w.name AS worker_name, a.outcome, a.error, a.phase,
                    a.started_at, a.finished_at
             FROM attempt a JOIN worker w ON w.id = a.worker_id WHERE a.job_id = $1 ORDER BY a.id",
        )
        .bind(job)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading attempts"))?;
        rows.into_iter()
            .map(|row| {
                Ok(Attempt {
                    id: row.id,
                    task: row.task_id,
                    number: row.number,
                    worker: row.worker_id,
                    worker_name: row.worker_name,
                    outcome: from_name(&row.outcome)?,
                    error: row.error,
                    phase: row.phase.map(|phase| from_name(&phase)).transpose()?,
                    started_at: timestamp(row.started_at)?,
                    finished_at: row.finished_at.map(timestamp).transpose()?,
                })
            })
            .collect()
    }

    /// Of frames and merges; the parts in between are nobody's business.
    pub(super) async fn read_artifacts(&self, job: &str) -> Result<Vec<Artifact>> {
        let rows: Vec<ArtifactRow> = sqlx::query_as(
            "SELECT name, media_type, bytes, blob FROM artifact WHERE job_id = $1 AND name <> $2 ORDER BY name",
        )
        .bind(job)
        .bind(NewArtifact::PART)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading artifacts"))?;
        Ok(rows
            .into_iter()
            .map(|row| Artifact {
                href: format!("/v1/jobs/{job}/artifacts/{}", row.name),
                name: row.name,
                media_type: row.media_type,
                bytes: row.bytes.unsigned_abs(),
                hash: row.blob,
            })
            .collect())
    }

    pub(super) async fn read_has_ready_task(&self, now: Millis) -> Result<bool> {
        sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM task WHERE state = 'ready' AND run_at <= $1)")
            .bind(now)
            .fetch_one(&self.readers)
            .await
            .map_err(context("looking for work"))
    }
}
