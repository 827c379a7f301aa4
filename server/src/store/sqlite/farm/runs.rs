//! Runs: made, listed, read whole, cancelled, deleted.

use std::collections::BTreeMap;

use async_trait::async_trait;
use lightshaft_api::farm::{FarmJob, Run, RunCase, RunCounts, RunState, RunSummary};
use lightshaft_api::job::Artifact;
use sqlx::{FromRow, QueryBuilder, Sqlite};

use super::decisions::read_decisions_of_run;
use crate::queue::Millis;
use crate::store::sqlite::idempotency::OF_RUNS;
use crate::store::sqlite::jobs::cancel_open_job;
use crate::store::sqlite::{SqliteStore, Tx, commit, context, from_json, from_name, signed, timestamp, to_json};
use crate::store::{
    CaseRecord, CaseStep, Creation, Idempotency, OpenCase, PageRequest, Result, RunQuery, RunRecord, RunStore, Step,
};

const SUMMARIES: &str =
    "SELECT r.id, r.kind, r.suite_id, r.suite_name, r.label, r.labels, r.baseline, r.state, r.created_at,
           r.finished_at, r.scenes, r.overrides, r.priority,
           COUNT(*) AS cases, SUM(c.state = 'finished') AS finished, SUM(c.ok IS TRUE) AS passed,
           SUM(c.ok IS FALSE AND c.decision_id IS NULL) AS undecided,
           SUM(c.ok IS FALSE AND c.decision_id IS NOT NULL) AS rejected,
           json_group_array(c.image_verdict) AS image_verdicts, json_group_array(c.time_verdict) AS time_verdicts
    FROM farm_run r JOIN farm_case c ON c.run_id = r.id WHERE TRUE";

#[derive(FromRow)]
struct RunRow {
    id: String,
    kind: String,
    suite_id: String,
    suite_name: String,
    label: String,
    labels: String,
    baseline: String,
    state: String,
    created_at: i64,
    finished_at: Option<i64>,
    scenes: String,
    overrides: String,
    priority: i32,
    cases: u32,
    finished: u32,
    passed: u32,
    undecided: u32,
    rejected: u32,
    image_verdicts: String,
    time_verdicts: String,
}

impl RunRow {
    fn summary(&self) -> Result<RunSummary> {
        let images: Vec<Option<String>> = from_json(&self.image_verdicts)?;
        let times: Vec<Option<String>> = from_json(&self.time_verdicts)?;
        let count = |verdicts: &[Option<String>], name: &str| {
            verdicts.iter().filter(|verdict| verdict.as_deref() == Some(name)).count() as u32
        };
        let state: RunState = from_name(&self.state)?;
        Ok(RunSummary {
            id: self.id.clone(),
            kind: from_name(&self.kind)?,
            suite: self.suite_id.clone(),
            suite_name: self.suite_name.clone(),
            label: self.label.clone(),
            labels: from_json(&self.labels)?,
            baseline: self.baseline.clone(),
            state,
            ok: (state == RunState::Finished).then_some(self.passed == self.cases),
            counts: RunCounts {
                cases: self.cases,
                finished: self.finished,
                ok: self.passed,
                undecided: self.undecided,
                rejected: self.rejected,
                identical: count(&images, "identical"),
                within_tolerance: count(&images, "within_tolerance"),
                changed: count(&images, "changed"),
                missing: count(&images, "missing"),
                failed: count(&images, "failed"),
                faster: count(&times, "faster"),
                same: count(&times, "same"),
                slower: count(&times, "slower"),
                too_noisy_to_say: count(&times, "too_noisy_to_say"),
            },
            created_at: timestamp(self.created_at)?,
            finished_at: self.finished_at.map(timestamp).transpose()?,
        })
    }
}

#[derive(FromRow)]
struct CaseRow {
    name: String,
    state: String,
    ok: Option<bool>,
    scene_id: String,
    settings: String,
    repeat: u32,
    tolerance: String,
    time_tolerance: String,
    device_class: Option<String>,
    worker_id: Option<String>,
    versions: Option<String>,
    image: Option<String>,
    time: Option<String>,
    decision_id: Option<String>,
}

#[derive(FromRow)]
struct JobRow {
    case_name: String,
    job_id: String,
    phase: String,
    position: u32,
    time_s: Option<f64>,
}

#[derive(FromRow)]
struct ArtifactRow {
    case_name: String,
    name: String,
    media_type: String,
    bytes: i64,
    blob: String,
}

#[async_trait]
impl RunStore for SqliteStore {
    async fn create_run(&self, run: &RunRecord, idempotency: Option<&Idempotency>, now: Millis) -> Result<Creation> {
        let mut tx = self.begin().await?;
        if let Some(idempotency) = idempotency
            && let Some(creation) = OF_RUNS.repeated(&mut tx, idempotency).await?
        {
            return Ok(creation);
        }
        sqlx::query(
            "INSERT INTO farm_run (id, kind, suite_id, suite_name, label, labels, baseline, scenes, overrides, priority,
                                   times, state, created_at)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, 'running', $12)",
        )
        .bind(&run.id)
        .bind(run.kind.as_str())
        .bind(&run.suite)
        .bind(&run.suite_name)
        .bind(&run.label)
        .bind(to_json(&run.labels)?)
        .bind(&run.baseline)
        .bind(to_json(&run.scenes)?)
        .bind(to_json(&run.overrides)?)
        .bind(run.priority)
        .bind(run.times)
        .bind(now)
        .execute(&mut *tx)
        .await
        .map_err(context("adding a run"))?;
        for (position, case) in run.cases.iter().enumerate() {
            insert_case(&mut tx, &run.id, position, case).await?;
        }
        if let Some(idempotency) = idempotency {
            OF_RUNS.keep(&mut tx, idempotency, &run.id, now).await?;
        }
        commit(tx).await?;
        Ok(Creation::Created)
    }

    async fn repeated_run(&self, idempotency: &Idempotency) -> Result<Option<Creation>> {
        let mut tx = self.readers.begin().await.map_err(context("beginning to read"))?;
        OF_RUNS.repeated(&mut tx, idempotency).await
    }

    async fn run(&self, id: &str) -> Result<Option<Run>> {
        let mut statement = QueryBuilder::new(SUMMARIES);
        statement.push(" AND r.id = ").push_bind(id).push(" GROUP BY r.id");
        let row: Option<RunRow> =
            statement.build_query_as().fetch_optional(&self.readers).await.map_err(context("reading a run"))?;
        let Some(row) = row else { return Ok(None) };
        Ok(Some(Run {
            summary: row.summary()?,
            scenes: from_json(&row.scenes)?,
            overrides: from_json(&row.overrides)?,
            priority: row.priority,
            cases: self.read_cases(id).await?,
        }))
    }

    async fn calibration_times(&self, id: &str) -> Result<Option<u32>> {
        sqlx::query_scalar("SELECT times FROM farm_run WHERE id = $1 AND kind = 'calibration'")
            .bind(id)
            .fetch_optional(&self.readers)
            .await
            .map_err(context("reading a calibration"))
    }

    async fn runs(&self, query: &RunQuery, page: &PageRequest) -> Result<Vec<RunSummary>> {
        let mut statement = QueryBuilder::new(SUMMARIES);
        push_conditions(&mut statement, query, page);
        let rows: Vec<RunRow> =
            statement.build_query_as().fetch_all(&self.readers).await.map_err(context("reading runs"))?;
        rows.iter().map(RunRow::summary).collect()
    }

    async fn open_cases(&self) -> Result<Vec<OpenCase>> {
        self.read_open_cases().await
    }

    async fn step_case(&self, case: &OpenCase, step: &CaseStep, now: Millis) -> Result<Step> {
        self.do_step_case(case, step, now).await
    }

    async fn cancel_run(&self, id: &str, now: Millis) -> Result<Option<RunState>> {
        let mut tx = self.begin().await?;
        let state: Option<String> = sqlx::query_scalar("SELECT state FROM farm_run WHERE id = $1")
            .bind(id)
            .fetch_optional(&mut *tx)
            .await
            .map_err(context("reading a run's state"))?;
        let Some(state) = state else { return Ok(None) };
        let state: RunState = from_name(&state)?;
        if state != RunState::Running {
            return Ok(Some(state));
        }
        sqlx::query("UPDATE farm_run SET state = 'cancelled', finished_at = $2 WHERE id = $1")
            .bind(id)
            .bind(now)
            .execute(&mut *tx)
            .await
            .map_err(context("cancelling a run"))?;
        sqlx::query(
            "UPDATE farm_case SET state = 'cancelled' WHERE run_id = $1 AND state IN ('rendering', 'confirming')",
        )
        .bind(id)
        .execute(&mut *tx)
        .await
        .map_err(context("cancelling cases"))?;
        cancel_jobs(&mut tx, id, None, now).await?;
        commit(tx).await?;
        Ok(Some(RunState::Cancelled))
    }

    async fn old_runs(&self, keep: u32, limit: u32) -> Result<Vec<String>> {
        sqlx::query_scalar(
            "SELECT id FROM (SELECT id, state, ROW_NUMBER() OVER (PARTITION BY suite_name, kind ORDER BY id DESC) AS age
                             FROM farm_run)
             WHERE age > $1 AND state <> 'running' ORDER BY id LIMIT $2",
        )
        .bind(keep)
        .bind(limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("looking for old runs"))
    }

    async fn delete_run(&self, id: &str) -> Result<Vec<String>> {
        let mut tx = self.begin().await?;
        let blobs: Vec<String> = sqlx::query_scalar("SELECT DISTINCT blob FROM farm_artifact WHERE run_id = $1")
            .bind(id)
            .fetch_all(&mut *tx)
            .await
            .map_err(context("reading what a run left"))?;
        sqlx::query("DELETE FROM farm_run WHERE id = $1 AND state <> 'running'")
            .bind(id)
            .execute(&mut *tx)
            .await
            .map_err(context("deleting a run"))?;
        commit(tx).await?;
        Ok(blobs)
    }
}

/// Cancels unfinished jobs of a run, or of one of its cases.
pub(super) async fn cancel_jobs(tx: &mut Tx, run: &str, case: Option<&str>, now: Millis) -> Result<()> {
    let jobs: Vec<String> = sqlx::query_scalar(
        "SELECT j.id FROM farm_job f JOIN job j ON j.id = f.job_id
         WHERE f.run_id = $1 AND ($2 IS NULL OR f.case_name = $2) AND j.state IN ('queued', 'running')",
    )
    .bind(run)
    .bind(case)
    .fetch_all(&mut **tx)
    .await
    .map_err(context("looking for a run's jobs"))?;
    for job in jobs {
        cancel_open_job(tx, &job, now).await?;
    }
    Ok(())
}

/// A run as it is inside a transaction.
pub(super) async fn read_summary(tx: &mut Tx, id: &str) -> Result<RunSummary> {
    let mut statement = QueryBuilder::new(SUMMARIES);
    statement.push(" AND r.id = ").push_bind(id).push(" GROUP BY r.id");
    let row: RunRow =
        statement.build_query_as().fetch_one(&mut **tx).await.map_err(context("reading a run that has ended"))?;
    row.summary()
}

fn push_conditions(statement: &mut QueryBuilder<Sqlite>, query: &RunQuery, page: &PageRequest) {
    if let Some(kind) = query.kind {
        statement.push(" AND r.kind = ").push_bind(kind.as_str());
    }
    if let Some(state) = query.state {
        statement.push(" AND r.state = ").push_bind(state.as_str());
    }
    for (column, value) in
        [("r.suite_name", &query.suite_name), ("r.label", &query.label), ("r.baseline", &query.baseline)]
    {
        if let Some(value) = value {
            statement.push(format!(" AND {column} = ")).push_bind(value.clone());
        }
    }
    if let Some(after) = &page.after {
        statement.push(" AND r.id < ").push_bind(after.clone());
    }
    statement.push(" GROUP BY r.id");
    if let Some(ok) = query.ok {
        statement.push(" HAVING r.state = 'finished' AND (passed = cases) = ").push_bind(ok);
    }
    statement.push(" ORDER BY r.id DESC LIMIT ").push_bind(page.limit);
}

async fn insert_case(tx: &mut Tx, run: &str, position: usize, case: &CaseRecord) -> Result<()> {
    sqlx::query(
        "INSERT INTO farm_case (run_id, name, position, state, scene_id, settings, repeat, tolerance, time_tolerance,
                                device_class)
         VALUES ($1, $2, $3, 'rendering', $4, $5, $6, $7, $8, $9)",
    )
    .bind(run)
    .bind(&case.name)
    .bind(signed(position as u64))
    .bind(&case.scene)
    .bind(to_json(&case.settings)?)
    .bind(case.repeat)
    .bind(to_json(&case.tolerance)?)
    .bind(to_json(&case.time_tolerance)?)
    .bind(&case.device_class)
    .execute(&mut **tx)
    .await
    .map_err(context("adding a case"))?;
    Ok(())
}

impl SqliteStore {
    async fn read_cases(&self, run: &str) -> Result<Vec<RunCase>> {
        let rows: Vec<CaseRow> = sqlx::query_as(
            "SELECT name, state, ok, scene_id, settings, repeat, tolerance, time_tolerance, device_class, worker_id,
                    versions, image,
                    time, decision_id
             FROM farm_case WHERE run_id = $1 ORDER BY position",
        )
        .bind(run)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading a run's cases"))?;
        let mut jobs = self.read_jobs_of_run(run).await?;
        let mut artifacts = self.read_artifacts_of_run(run).await?;
        let mut decisions = read_decisions_of_run(&self.readers, run).await?;
        rows.into_iter()
            .map(|row| {
                Ok(RunCase {
                    state: from_name(&row.state)?,
                    ok: row.ok,
                    scene: row.scene_id,
                    settings: from_json(&row.settings)?,
                    repeat: row.repeat,
                    tolerance: from_json(&row.tolerance)?,
                    time_tolerance: from_json(&row.time_tolerance)?,
                    device_class: row.device_class,
                    worker: row.worker_id,
                    versions: row.versions.map_or(Ok(BTreeMap::new()), |text| from_json(&text))?,
                    image: row.image.map(|text| from_json(&text)).transpose()?,
                    time: row.time.map(|text| from_json(&text)).transpose()?,
                    decision: row.decision_id.and_then(|id| decisions.remove(&id)),
                    jobs: jobs.remove(&row.name).unwrap_or_default(),
                    artifacts: artifacts.remove(&row.name).unwrap_or_default(),
                    name: row.name,
                })
            })
            .collect()
    }

    async fn read_jobs_of_run(&self, run: &str) -> Result<BTreeMap<String, Vec<FarmJob>>> {
        // Of the generation that counts: what was begun before its worker was lost is no part of the case any more.
        let rows: Vec<JobRow> = sqlx::query_as(
            "SELECT f.case_name, f.job_id, f.phase, f.position, f.time_s
             FROM farm_job f JOIN farm_case c ON c.run_id = f.run_id AND c.name = f.case_name
             WHERE f.run_id = $1 AND f.generation = c.generation ORDER BY f.case_name, f.job_id",
        )
        .bind(run)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading a run's jobs"))?;
        let mut jobs: BTreeMap<String, Vec<FarmJob>> = BTreeMap::new();
        for row in rows {
            let job =
                FarmJob { job: row.job_id, phase: from_name(&row.phase)?, position: row.position, time_s: row.time_s };
            jobs.entry(row.case_name).or_default().push(job);
        }
        Ok(jobs)
    }

    async fn read_artifacts_of_run(&self, run: &str) -> Result<BTreeMap<String, Vec<Artifact>>> {
        let rows: Vec<ArtifactRow> = sqlx::query_as(
            "SELECT case_name, name, media_type, bytes, blob FROM farm_artifact WHERE run_id = $1 ORDER BY case_name, name",
        )
        .bind(run)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading a run's pictures"))?;
        let mut artifacts: BTreeMap<String, Vec<Artifact>> = BTreeMap::new();
        for row in rows {
            let artifact = stored_picture(row.name, row.media_type, row.bytes, row.blob);
            artifacts.entry(row.case_name).or_default().push(artifact);
        }
        Ok(artifacts)
    }
}

/// A picture that the farm keeps; blobs are served under their hash.
pub(super) fn stored_picture(name: String, media_type: String, bytes: i64, blob: String) -> Artifact {
    Artifact { name, media_type, bytes: bytes.unsigned_abs(), href: format!("/v1/blobs/{blob}"), hash: blob }
}
