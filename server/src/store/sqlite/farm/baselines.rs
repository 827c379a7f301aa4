//! Baselines: accepted pictures, accepted times, noise floors.

use std::collections::BTreeMap;

use async_trait::async_trait;
use lightshaft_api::farm::{AcceptedPicture, AcceptedTimes, Baseline, Decision, HistoryPoint};
use sqlx::FromRow;

use super::decisions::insert_decision;
use super::runs::stored_picture;
use crate::queue::Millis;
use crate::store::sqlite::{SqliteStore, commit, context, from_json, from_name, timestamp};
use crate::store::{
    BaselineKey, BaselineStore, CaseDecision, DecisionQuery, PageRequest, Reference, ReferenceTimes, Result,
};

#[derive(FromRow)]
struct PictureRow {
    id: String,
    case_name: String,
    device_class: String,
    pixels: String,
    source: String,
    label: String,
    decision_id: String,
    accepted_at: i64,
}

#[derive(FromRow)]
struct TimesRow {
    case_name: String,
    device_class: String,
    metric: String,
    samples: String,
    scene_id: String,
    settings: String,
    versions: String,
    label: String,
    decision_id: String,
    accepted_at: i64,
}

#[derive(FromRow)]
struct FileRow {
    name: String,
    media_type: String,
    bytes: i64,
    blob: String,
}

/// What of a baseline: $3 and $4 are the case and the device class, all when null.
macro_rules! of_baseline {
    ($select:literal, $rest:literal) => {
        concat!(
            $select,
            " WHERE baseline = $1 AND suite_name = $2 AND ($3 IS NULL OR case_name = $3)
                AND ($4 IS NULL OR device_class = $4) ",
            $rest
        )
    };
}

#[async_trait]
impl BaselineStore for SqliteStore {
    async fn reference(&self, key: &BaselineKey) -> Result<Reference> {
        let (case, class) = (Some(key.case.as_str()), Some(key.device_class.as_str()));
        let pictures = self.read_pictures(&key.baseline, &key.suite_name, case, class).await?;
        let times = self.read_times(&key.baseline, &key.suite_name, case, class).await?;
        let floors: Vec<(String, f64)> = sqlx::query_as(
            "SELECT metric, floor FROM farm_noise WHERE suite_name = $1 AND case_name = $2 AND device_class = $3",
        )
        .bind(&key.suite_name)
        .bind(&key.case)
        .bind(&key.device_class)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading noise floors"))?;
        Ok(Reference {
            pictures: pictures.into_iter().map(|(_, picture)| picture).collect(),
            times: times
                .into_iter()
                .map(|row| {
                    Ok(ReferenceTimes {
                        metric: from_name(&row.metric)?,
                        samples_s: from_json(&row.samples)?,
                        scene: row.scene_id,
                        settings: from_json(&row.settings)?,
                        versions: from_json(&row.versions)?,
                        label: row.label,
                    })
                })
                .collect::<Result<_>>()?,
            noise_floors: floors
                .into_iter()
                .map(|(metric, floor)| Ok((from_name(&metric)?, floor)))
                .collect::<Result<_>>()?,
        })
    }

    async fn baselines(&self, baseline: &str, suite_name: &str) -> Result<Vec<Baseline>> {
        let mut found: BTreeMap<(String, String), Baseline> = BTreeMap::new();
        for ((case, class), picture) in self.read_pictures(baseline, suite_name, None, None).await? {
            entry(&mut found, baseline, suite_name, case, class).pictures.push(picture);
        }
        for row in self.read_times(baseline, suite_name, None, None).await? {
            let times = AcceptedTimes {
                metric: from_name(&row.metric)?,
                samples_s: from_json(&row.samples)?,
                label: row.label,
                decision: row.decision_id,
                accepted_at: timestamp(row.accepted_at)?,
                versions: from_json(&row.versions)?,
            };
            entry(&mut found, baseline, suite_name, row.case_name, row.device_class).times.push(times);
        }
        Ok(found.into_values().collect())
    }

    async fn decide(&self, decisions: &[CaseDecision], now: Millis) -> Result<()> {
        self.do_decide(decisions, now).await
    }

    async fn reset_baseline(&self, decision: &Decision) -> Result<Vec<String>> {
        let mut tx = self.begin().await?;
        insert_decision(&mut tx, decision).await?;
        let blobs: Vec<String> = sqlx::query_scalar(of_baseline!(
            "SELECT DISTINCT f.blob FROM farm_accepted a JOIN farm_accepted_file f ON f.accepted_id = a.id",
            ""
        ))
        .bind(&decision.baseline)
        .bind(&decision.suite)
        .bind(&decision.case)
        .bind(&decision.device_class)
        .fetch_all(&mut *tx)
        .await
        .map_err(context("reading accepted pictures"))?;
        for statement in [of_baseline!("DELETE FROM farm_accepted", ""), of_baseline!("DELETE FROM farm_times", "")] {
            sqlx::query(statement)
                .bind(&decision.baseline)
                .bind(&decision.suite)
                .bind(&decision.case)
                .bind(&decision.device_class)
                .execute(&mut *tx)
                .await
                .map_err(context("resetting a baseline"))?;
        }
        commit(tx).await?;
        Ok(blobs)
    }

    async fn decisions(&self, query: &DecisionQuery, page: &PageRequest) -> Result<Vec<Decision>> {
        self.read_decisions(query, page).await
    }

    async fn device_classes(&self, suite_name: &str, case: &str) -> Result<Vec<String>> {
        self.read_device_classes(suite_name, case).await
    }

    async fn history(&self, suite_name: &str, case: &str, class: &str, limit: u32) -> Result<Vec<HistoryPoint>> {
        self.read_history(suite_name, case, class, limit).await
    }
}

fn entry<'a>(
    found: &'a mut BTreeMap<(String, String), Baseline>,
    baseline: &str,
    suite: &str,
    case: String,
    device_class: String,
) -> &'a mut Baseline {
    found.entry((case.clone(), device_class.clone())).or_insert_with(|| Baseline {
        baseline: baseline.to_owned(),
        suite: suite.to_owned(),
        case,
        device_class,
        pictures: Vec::new(),
        times: Vec::new(),
    })
}

impl SqliteStore {
    /// With the case and the device class of each, oldest first.
    async fn read_pictures(
        &self,
        baseline: &str,
        suite: &str,
        case: Option<&str>,
        class: Option<&str>,
    ) -> Result<Vec<((String, String), AcceptedPicture)>> {
        let rows: Vec<PictureRow> = sqlx::query_as(of_baseline!(
            "SELECT id, case_name, device_class, pixels, source, label, decision_id, accepted_at FROM farm_accepted",
            "ORDER BY id"
        ))
        .bind(baseline)
        .bind(suite)
        .bind(case)
        .bind(class)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading accepted pictures"))?;
        let mut pictures = Vec::with_capacity(rows.len());
        for row in rows {
            let files: Vec<FileRow> = sqlx::query_as(
                "SELECT name, media_type, bytes, blob FROM farm_accepted_file WHERE accepted_id = $1 ORDER BY name",
            )
            .bind(&row.id)
            .fetch_all(&self.readers)
            .await
            .map_err(context("reading an accepted picture"))?;
            let file = |file: FileRow| stored_picture(file.name, file.media_type, file.bytes, file.blob);
            let picture = AcceptedPicture {
                pixels: row.pixels,
                source: from_name(&row.source)?,
                artifacts: files.into_iter().map(file).collect(),
                decision: row.decision_id,
                label: row.label,
                accepted_at: timestamp(row.accepted_at)?,
            };
            pictures.push(((row.case_name, row.device_class), picture));
        }
        Ok(pictures)
    }

    /// Newest first.
    async fn read_times(
        &self,
        baseline: &str,
        suite: &str,
        case: Option<&str>,
        class: Option<&str>,
    ) -> Result<Vec<TimesRow>> {
        sqlx::query_as(of_baseline!(
            "SELECT case_name, device_class, metric, samples, scene_id, settings, versions, label, decision_id, accepted_at
             FROM farm_times",
            "ORDER BY accepted_at DESC, run_id DESC"
        ))
        .bind(baseline)
        .bind(suite)
        .bind(case)
        .bind(class)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading accepted times"))
    }
}
