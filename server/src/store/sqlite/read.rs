//! Reading jobs with all that belongs to them.

use std::collections::BTreeMap;

use lightshaft_api::job::{Artifact, Attempt, Job, JobState, JobSummary, Task};
use lightshaft_api::lease::NewArtifact;
use lightshaft_api::status::StateCounts;
use sqlx::{FromRow, QueryBuilder, Sqlite};

use super::jobs::{counts, read_state};
use super::{SqliteStore, context, from_json, from_name, timestamp, to_json};
use crate::store::{JobQuery, ListedJob, PageRequest, Result, TaskProgress, Totals};

/// A line of the list of jobs for every row of `page`, which names ids.
const LISTED: &str = "
    SELECT j.id, j.kind, j.scene_id, s.name AS scene_name, j.state, j.paused, j.cancel_requested, j.priority, j.error,
           j.trace_id, j.created_at, j.started_at, j.finished_at,
           (SELECT json_group_object(l.key, l.value) FROM job_label l WHERE l.job_id = j.id) AS labels,
           COUNT(t.id) AS tasks_total, COALESCE(SUM(t.state = 'succeeded'), 0) AS tasks_done,
           COALESCE(SUM(t.progress) FILTER (WHERE t.state <> 'leased'), 0.0) AS settled,
           json_group_object(t.id, t.progress) FILTER (WHERE t.state = 'leased') AS leased
    FROM page JOIN job j ON j.id = page.id JOIN scene s ON s.id = j.scene_id LEFT JOIN task t ON t.job_id = j.id
    GROUP BY j.id ORDER BY j.id DESC";

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
    error: Option<String>,
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

/// What only a whole job has.
#[derive(FromRow)]
struct WholeRow {
    max_attempts: u32,
    settings: String,
    metrics: Option<String>,
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
        let mut page = QueryBuilder::new("WITH page AS (SELECT id FROM job WHERE id = ");
        page.push_bind(id).push(")").push(LISTED);
        let listed: Option<JobRow> =
            page.build_query_as().fetch_optional(&self.readers).await.map_err(context("reading a job"))?;
        let whole: Option<WholeRow> = sqlx::query_as("SELECT max_attempts, settings, metrics FROM job WHERE id = $1")
            .bind(id)
            .fetch_optional(&self.readers)
            .await
            .map_err(context("reading a job"))?;
        let Some((listed, whole)) = listed.zip(whole) else { return Ok(None) };
        Ok(Some(Job {
            max_attempts: whole.max_attempts,
            settings: from_json(&whole.settings)?,
            metrics: whole.metrics.map(|text| from_json(&text)).transpose()?,
            tasks: self.read_tasks(id).await?,
            attempts: self.read_attempts(id).await?,
            artifacts: self.read_artifacts(id).await?,
            waiting: None,
            preview: None,
            summary: listed.into_listed()?.summary,
        }))
    }

    pub(super) async fn read_job_state(&self, id: &str) -> Result<Option<JobState>> {
        read_state(&self.readers, id).await
    }

    pub(super) async fn read_jobs(&self, query: &JobQuery, page: &PageRequest) -> Result<Vec<ListedJob>> {
        let mut statement = QueryBuilder::new("WITH page AS (");
        push_page(&mut statement, query, page);
        statement.push(")").push(LISTED);
        let rows: Vec<JobRow> =
            statement.build_query_as().fetch_all(&self.readers).await.map_err(context("reading jobs"))?;
        rows.into_iter().map(JobRow::into_listed).collect()
    }

    /// Lines of the list of jobs for these ids, in no particular order.
    pub(super) async fn read_jobs_by_id(&self, ids: &[String]) -> Result<Vec<ListedJob>> {
        let mut statement = QueryBuilder::new("WITH page AS (SELECT value AS id FROM json_each(");
        statement.push_bind(to_json(&ids)?).push("))").push(LISTED);
        let rows: Vec<JobRow> =
            statement.build_query_as().fetch_all(&self.readers).await.map_err(context("reading jobs"))?;
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
}

/// The ids of a page of jobs. Only conditions that are asked for are written down, so that each finds its index.
fn push_page(statement: &mut QueryBuilder<Sqlite>, query: &JobQuery, page: &PageRequest) {
    statement.push("SELECT j.id FROM job j WHERE TRUE");
    if let Some(kind) = query.kind {
        statement.push(" AND j.kind = ").push_bind(kind.as_str());
    }
    if let Some(after) = &page.after {
        statement.push(" AND j.id < ").push_bind(after.clone());
    }
    if let Some(state) = query.state {
        statement.push(" AND j.state = ").push_bind(state.as_str());
    }
    if let Some(scene) = &query.scene {
        statement.push(" AND j.scene_id = ").push_bind(scene.clone());
    }
    if let Some(automatic) = query.automatic {
        statement.push(" AND j.automatic = ").push_bind(automatic);
    }
    for (key, value) in &query.labels {
        statement.push(" AND j.id IN (SELECT job_id FROM job_label WHERE key = ").push_bind(key.clone());
        statement.push(" AND value = ").push_bind(value.clone()).push(")");
    }
    if let Some(text) = query.text.as_ref().map(|text| text.to_lowercase()) {
        // From the newest job on, until the page is full. Scenes are few, and looked through once; a job's own labels are
        // looked up only when neither its id nor its scene will do.
        statement.push(" AND (substr(j.id, 1, length(").push_bind(text.clone()).push(")) = ").push_bind(text.clone());
        statement.push(" OR j.scene_id IN (SELECT s.id FROM scene s WHERE instr(lower(s.name), ");
        statement.push_bind(text.clone()).push(") > 0)");
        statement.push(" OR EXISTS (SELECT 1 FROM job_label l WHERE l.job_id = j.id AND instr(lower(l.value), ");
        statement.push_bind(text).push(") > 0))");
    }
    statement.push(" ORDER BY j.id DESC LIMIT ").push_bind(page.limit);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn filtered_lists_of_jobs_find_their_index() {
        let dir = tempfile::tempdir().unwrap();
        let store = SqliteStore::open(&dir.path().join("test.db")).await.unwrap();
        let plan = async |query: JobQuery, after: Option<&str>| {
            let mut statement = QueryBuilder::new("EXPLAIN QUERY PLAN ");
            push_page(&mut statement, &query, &PageRequest { limit: 50, after: after.map(str::to_owned) });
            let rows: Vec<(i64, i64, i64, String)> =
                statement.build_query_as().fetch_all(&store.readers).await.unwrap();
            rows.into_iter().map(|row| row.3 + "\n").collect::<String>()
        };
        let state = JobQuery { state: Some(JobState::Queued), ..JobQuery::default() };
        let of_state = plan(state.clone(), None).await;
        assert!(of_state.contains("INDEX job_state (state=?)") && !of_state.contains("TEMP B-TREE"), "{of_state}");
        let next_page = plan(state, Some("x")).await;
        assert!(next_page.contains("INDEX job_state (state=? AND id<?)"), "{next_page}");
        let scene = plan(JobQuery { scene: Some("s".to_owned()), ..JobQuery::default() }, None).await;
        assert!(scene.contains("INDEX job_scene (scene_id=?)") && !scene.contains("TEMP B-TREE"), "{scene}");
        let labels = BTreeMap::from([("nightly".to_owned(), "yes".to_owned())]);
        let label = plan(JobQuery { labels, ..JobQuery::default() }, None).await;
        assert!(label.contains("INDEX job_label_value (key=? AND value=?)") && !label.contains("SCAN j"), "{label}");
        let text = plan(JobQuery { text: Some("x".to_owned()), ..JobQuery::default() }, None).await;
        assert!(text.contains("LIST SUBQUERY") && !text.contains("TEMP B-TREE"), "scenes once, jobs in order: {text}");
        assert!(text.contains("SEARCH l USING PRIMARY KEY (job_id=?)"), "{text}");
    }
}
