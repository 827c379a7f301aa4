//! Decisions: written once, with what they change.

use std::collections::BTreeMap;

use lightshaft_api::farm::{Decision, DecisionKind};
use lightshaft_api::job::Artifact;
use sqlx::{FromRow, QueryBuilder, SqliteExecutor};
use uuid::Uuid;

use super::webhooks::tell_of_decision;
use crate::queue::Millis;
use crate::store::sqlite::{SqliteStore, Tx, commit, context, from_name, signed, timestamp, to_json};
use crate::store::{Acceptance, CaseDecision, DecisionQuery, PageRequest, Result};

const DECISIONS: &str =
    "SELECT id, kind, who, why, at, baseline, suite_name, case_name, device_class, run_id, label, pixels
    FROM farm_decision WHERE TRUE";

#[derive(FromRow)]
struct DecisionRow {
    id: String,
    kind: String,
    who: String,
    why: String,
    at: i64,
    baseline: String,
    suite_name: String,
    case_name: Option<String>,
    device_class: Option<String>,
    run_id: Option<String>,
    label: Option<String>,
    pixels: Option<String>,
}

impl DecisionRow {
    fn into_decision(self) -> Result<Decision> {
        Ok(Decision {
            id: self.id,
            kind: from_name(&self.kind)?,
            who: self.who,
            why: self.why,
            at: timestamp(self.at)?,
            baseline: self.baseline,
            suite: self.suite_name,
            case: self.case_name,
            device_class: self.device_class,
            run: self.run_id,
            label: self.label,
            pixels: self.pixels,
        })
    }
}

pub(super) async fn read_decisions_of_run(
    db: impl SqliteExecutor<'_>,
    run: &str,
) -> Result<BTreeMap<String, Decision>> {
    let mut statement = QueryBuilder::new(DECISIONS);
    statement.push(" AND run_id = ").push_bind(run);
    let rows: Vec<DecisionRow> =
        statement.build_query_as().fetch_all(db).await.map_err(context("reading a run's decisions"))?;
    rows.into_iter().map(|row| Ok((row.id.clone(), row.into_decision()?))).collect()
}

impl SqliteStore {
    pub(super) async fn read_decisions(&self, query: &DecisionQuery, page: &PageRequest) -> Result<Vec<Decision>> {
        let mut statement = QueryBuilder::new(DECISIONS);
        if let Some(kind) = query.kind {
            statement.push(" AND kind = ").push_bind(kind.as_str());
        }
        for (column, value) in [
            ("suite_name", &query.suite_name),
            ("case_name", &query.case),
            ("baseline", &query.baseline),
            ("run_id", &query.run),
            ("who", &query.who),
        ] {
            if let Some(value) = value {
                statement.push(format!(" AND {column} = ")).push_bind(value.clone());
            }
        }
        if let Some(after) = &page.after {
            statement.push(" AND id < ").push_bind(after.clone());
        }
        statement.push(" ORDER BY id DESC LIMIT ").push_bind(page.limit);
        let rows: Vec<DecisionRow> =
            statement.build_query_as().fetch_all(&self.readers).await.map_err(context("reading decisions"))?;
        rows.into_iter().map(DecisionRow::into_decision).collect()
    }

    pub(super) async fn do_decide(&self, decisions: &[CaseDecision], now: Millis) -> Result<()> {
        let mut tx = self.begin().await?;
        for CaseDecision { decision, accepted, ok } in decisions {
            insert_decision(&mut tx, decision).await?;
            sqlx::query("UPDATE farm_case SET decision_id = $3, ok = $4 WHERE run_id = $1 AND name = $2")
                .bind(&decision.run)
                .bind(&decision.case)
                .bind(&decision.id)
                .bind(ok)
                .execute(&mut *tx)
                .await
                .map_err(context("noting a decision"))?;
            if decision.kind == DecisionKind::Rejected {
                withdraw(&mut tx, decision).await?;
            }
            if let Some(accepted) = accepted {
                accept(&mut tx, decision, accepted, now).await?;
            }
        }
        commit(tx).await
    }
}

/// Keeps a decision, and tells of it.
pub(super) async fn insert_decision(tx: &mut Tx, decision: &Decision) -> Result<()> {
    sqlx::query(
        "INSERT INTO farm_decision (id, kind, who, why, at, baseline, suite_name, case_name, device_class, run_id, label,
                                    pixels)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12)",
    )
    .bind(&decision.id)
    .bind(decision.kind.as_str())
    .bind(&decision.who)
    .bind(&decision.why)
    .bind(decision.at.as_millisecond())
    .bind(&decision.baseline)
    .bind(&decision.suite)
    .bind(&decision.case)
    .bind(&decision.device_class)
    .bind(&decision.run)
    .bind(&decision.label)
    .bind(&decision.pixels)
    .execute(&mut **tx)
    .await
    .map_err(context("keeping a decision"))?;
    tell_of_decision(tx, decision).await
}

/// What an approval of the same case of the same run accepted is accepted no longer.
async fn withdraw(tx: &mut Tx, decision: &Decision) -> Result<()> {
    for statement in [
        "DELETE FROM farm_accepted WHERE suite_name = $1 AND case_name = $2 AND run_id = $3",
        "DELETE FROM farm_times WHERE suite_name = $1 AND case_name = $2 AND run_id = $3",
    ] {
        sqlx::query(statement)
            .bind(&decision.suite)
            .bind(&decision.case)
            .bind(&decision.run)
            .execute(&mut **tx)
            .await
            .map_err(context("withdrawing an approval"))?;
    }
    Ok(())
}

async fn accept(tx: &mut Tx, decision: &Decision, accepted: &Acceptance, now: Millis) -> Result<()> {
    let id = Uuid::now_v7().to_string();
    let added = sqlx::query(
        "INSERT INTO farm_accepted (id, baseline, suite_name, case_name, device_class, pixels, source, run_id, label,
                                    decision_id, accepted_at)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11) ON CONFLICT DO NOTHING",
    )
    .bind(&id)
    .bind(&accepted.key.baseline)
    .bind(&accepted.key.suite_name)
    .bind(&accepted.key.case)
    .bind(&accepted.key.device_class)
    .bind(&accepted.pixels)
    .bind(accepted.source.as_str())
    .bind(&decision.run)
    .bind(&decision.label)
    .bind(&decision.id)
    .bind(now)
    .execute(&mut **tx)
    .await
    .map_err(context("accepting a picture"))?;
    if added.rows_affected() > 0 {
        insert_files(tx, &id, &accepted.files).await?;
    }
    accept_times(tx, decision, accepted, now).await
}

async fn insert_files(tx: &mut Tx, accepted: &str, files: &[Artifact]) -> Result<()> {
    for file in files {
        sqlx::query(
            "INSERT INTO farm_accepted_file (accepted_id, name, media_type, bytes, blob) VALUES ($1, $2, $3, $4, $5)",
        )
        .bind(accepted)
        .bind(&file.name)
        .bind(&file.media_type)
        .bind(signed(file.bytes))
        .bind(&file.hash)
        .execute(&mut **tx)
        .await
        .map_err(context("keeping an accepted picture"))?;
    }
    Ok(())
}

async fn accept_times(tx: &mut Tx, decision: &Decision, accepted: &Acceptance, now: Millis) -> Result<()> {
    let Some(times) = &accepted.times else { return Ok(()) };
    let key = &accepted.key;
    if accepted.replaces_times {
        sqlx::query(
            "DELETE FROM farm_times WHERE suite_name = $1 AND case_name = $2 AND baseline = $3 AND device_class = $4",
        )
        .bind(&key.suite_name)
        .bind(&key.case)
        .bind(&key.baseline)
        .bind(&key.device_class)
        .execute(&mut **tx)
        .await
        .map_err(context("replacing accepted times"))?;
    }
    sqlx::query(
        "INSERT OR REPLACE INTO farm_times (baseline, suite_name, case_name, device_class, run_id, metric, samples, scene_id,
                                            settings, versions, label, decision_id, accepted_at)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13)",
    )
    .bind(&key.baseline)
    .bind(&key.suite_name)
    .bind(&key.case)
    .bind(&key.device_class)
    .bind(&decision.run)
    .bind(times.metric.as_str())
    .bind(to_json(&times.samples_s)?)
    .bind(&times.scene)
    .bind(to_json(&times.settings)?)
    .bind(to_json(&times.versions)?)
    .bind(&times.label)
    .bind(&decision.id)
    .bind(now)
    .execute(&mut **tx)
    .await
    .map_err(context("accepting times"))?;
    Ok(())
}
