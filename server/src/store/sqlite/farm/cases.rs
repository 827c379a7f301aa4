//! Cases on their way to a verdict.

use std::collections::BTreeMap;

use lightshaft_api::farm::{CaseState, FarmJob};
use sqlx::FromRow;

use super::runs::cancel_jobs;
use super::webhooks::tell_of_case;
use crate::queue::Millis;
use crate::store::sqlite::jobs::{add_job, is_scene_there};
use crate::store::sqlite::{SqliteStore, Tx, commit, context, from_json, from_name, signed, to_json};
use crate::store::{CaseRecord, CaseStep, OpenCase, Result, Step};

#[derive(FromRow)]
struct OpenRow {
    run_id: String,
    kind: String,
    times: u32,
    baseline: String,
    suite_name: String,
    label: String,
    priority: i32,
    name: String,
    state: String,
    generation: u32,
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
}

impl SqliteStore {
    pub(super) async fn read_open_cases(&self) -> Result<Vec<OpenCase>> {
        let rows: Vec<OpenRow> = sqlx::query_as(
            "SELECT c.run_id, r.kind, r.times, r.baseline, r.suite_name, r.label, r.priority, c.name, c.state,
                    c.generation, c.scene_id, c.settings, c.repeat, c.tolerance, c.time_tolerance, c.device_class,
                    c.worker_id, c.versions, c.image, c.time
             FROM farm_run r JOIN farm_case c ON c.run_id = r.id AND c.state IN ('rendering', 'confirming')
             WHERE r.state = 'running' ORDER BY r.id, c.position",
        )
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading open cases"))?;
        let mut cases = Vec::with_capacity(rows.len());
        for row in rows {
            let jobs = self.read_case_jobs(&row.run_id, &row.name, row.generation).await?;
            cases.push(OpenCase {
                run: row.run_id,
                kind: from_name(&row.kind)?,
                times: row.times,
                baseline: row.baseline,
                suite_name: row.suite_name,
                label: row.label,
                priority: row.priority,
                state: from_name(&row.state)?,
                generation: row.generation,
                case: CaseRecord {
                    name: row.name,
                    scene: row.scene_id,
                    settings: from_json(&row.settings)?,
                    device_class: row.device_class,
                    repeat: row.repeat,
                    tolerance: from_json(&row.tolerance)?,
                    time_tolerance: from_json(&row.time_tolerance)?,
                },
                worker: row.worker_id,
                versions: row.versions.map_or(Ok(BTreeMap::new()), |text| from_json(&text))?,
                image: row.image.map(|text| from_json(&text)).transpose()?,
                time: row.time.map(|text| from_json(&text)).transpose()?,
                jobs,
            });
        }
        Ok(cases)
    }

    /// In the order in which they were made, which is that in which they run.
    async fn read_case_jobs(&self, run: &str, case: &str, generation: u32) -> Result<Vec<FarmJob>> {
        let rows: Vec<(String, String, u32, Option<f64>)> = sqlx::query_as(
            "SELECT job_id, phase, position, time_s FROM farm_job
             WHERE run_id = $1 AND case_name = $2 AND generation = $3 ORDER BY job_id",
        )
        .bind(run)
        .bind(case)
        .bind(generation)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading a case's jobs"))?;
        rows.into_iter()
            .map(|(job, phase, position, time_s)| Ok(FarmJob { job, phase: from_name(&phase)?, position, time_s }))
            .collect()
    }

    pub(super) async fn do_step_case(&self, case: &OpenCase, step: &CaseStep, now: Millis) -> Result<Step> {
        let mut tx = self.begin().await?;
        let generation = case.generation + u32::from(step.begins_anew);
        let stepped = sqlx::query(
            "UPDATE farm_case SET state = COALESCE($5, state), generation = $6,
                    device_class = COALESCE($7, device_class),
                    worker_id = CASE WHEN $8 THEN NULL ELSE COALESCE($9, worker_id) END,
                    versions = COALESCE($10, versions),
                    image = COALESCE($11, image), image_verdict = COALESCE($12, image_verdict),
                    time = COALESCE($13, time), time_verdict = COALESCE($14, time_verdict), ok = COALESCE($15, ok)
             WHERE run_id = $1 AND name = $2 AND state = $3 AND generation = $4",
        )
        .bind(&case.run)
        .bind(&case.case.name)
        .bind(case.state.as_str())
        .bind(case.generation)
        .bind(step.state.map(CaseState::as_str))
        .bind(generation)
        .bind(&step.device_class)
        .bind(step.begins_anew)
        .bind(&step.worker)
        .bind(step.versions.as_ref().map(to_json).transpose()?)
        .bind(step.image.as_ref().map(to_json).transpose()?)
        .bind(step.image.as_ref().map(|image| image.verdict.as_str()))
        .bind(step.time.as_ref().map(to_json).transpose()?)
        .bind(step.time.as_ref().and_then(|time| time.verdict).map(|verdict| verdict.as_str()))
        .bind(step.ok)
        .execute(&mut *tx)
        .await
        .map_err(context("taking a case further"))?;
        if stepped.rows_affected() == 0 {
            return Ok(Step::Overtaken);
        }
        if step.begins_anew || step.state == Some(CaseState::Finished) {
            cancel_jobs(&mut tx, &case.run, Some(&case.case.name), now).await?;
        }
        for job in &step.jobs {
            if !is_scene_there(&mut tx, &job.job.scene).await? {
                return Ok(Step::SceneGone);
            }
            add_job(&mut tx, &job.job, now).await?;
            sqlx::query(
                "INSERT INTO farm_job (job_id, run_id, case_name, generation, phase, position)
                 VALUES ($1, $2, $3, $4, $5, $6)",
            )
            .bind(&job.job.id)
            .bind(&case.run)
            .bind(&case.case.name)
            .bind(generation)
            .bind(job.phase.as_str())
            .bind(job.position)
            .execute(&mut *tx)
            .await
            .map_err(context("noting a case's job"))?;
        }
        keep_findings(&mut tx, case, step, now).await?;
        if matches!(step.state, Some(CaseState::Finished)) {
            let run_has_ended = finish_run(&mut tx, &case.run, now).await?;
            tell_of_case(&mut tx, case, step, run_has_ended, now).await?;
        }
        commit(tx).await?;
        Ok(Step::Done)
    }
}

async fn keep_findings(tx: &mut Tx, case: &OpenCase, step: &CaseStep, now: Millis) -> Result<()> {
    for (job, seconds) in &step.times_s {
        sqlx::query("UPDATE farm_job SET time_s = $2 WHERE job_id = $1")
            .bind(job)
            .bind(seconds)
            .execute(&mut **tx)
            .await
            .map_err(context("noting a job's time"))?;
    }
    for artifact in &step.artifacts {
        sqlx::query(
            "INSERT INTO farm_artifact (run_id, case_name, name, media_type, bytes, blob) VALUES ($1, $2, $3, $4, $5, $6)
             ON CONFLICT DO UPDATE SET media_type = $4, bytes = $5, blob = $6",
        )
        .bind(&case.run)
        .bind(&case.case.name)
        .bind(&artifact.name)
        .bind(&artifact.media_type)
        .bind(signed(artifact.bytes))
        .bind(&artifact.hash)
        .execute(&mut **tx)
        .await
        .map_err(context("keeping a case's picture"))?;
    }
    if let Some((metric, floor)) = step.noise_floor
        && let Some(class) = step.device_class.as_ref().or(case.case.device_class.as_ref())
    {
        sqlx::query(
            "INSERT INTO farm_noise (suite_name, case_name, device_class, metric, floor, run_id, measured_at)
             VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT DO UPDATE SET floor = $5, run_id = $6, measured_at = $7",
        )
        .bind(&case.suite_name)
        .bind(&case.case.name)
        .bind(class)
        .bind(metric.as_str())
        .bind(floor)
        .bind(&case.run)
        .bind(now)
        .execute(&mut **tx)
        .await
        .map_err(context("keeping a noise floor"))?;
    }
    Ok(())
}

/// With the last of its cases a run ends; whether it has now.
async fn finish_run(tx: &mut Tx, run: &str, now: Millis) -> Result<bool> {
    let ended = sqlx::query(
        "UPDATE farm_run SET state = 'finished', finished_at = $2
         WHERE id = $1 AND state = 'running'
           AND NOT EXISTS (SELECT 1 FROM farm_case WHERE run_id = $1 AND state IN ('rendering', 'confirming'))",
    )
    .bind(run)
    .bind(now)
    .execute(&mut **tx)
    .await
    .map_err(context("ending a run"))?;
    Ok(ended.rows_affected() > 0)
}
