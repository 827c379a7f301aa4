//! Suites: never changed, never deleted; another content is another version.

use async_trait::async_trait;
use lightshaft_api::farm::{Suite, SuiteSummary};
use sqlx::FromRow;

use crate::store::sqlite::{SqliteStore, commit, context, from_json, timestamp, to_json};
use crate::store::{PageRequest, Result, SuiteStore};

#[derive(FromRow)]
struct SuiteRow {
    id: String,
    hash: String,
    name: String,
    description: String,
    scenes: String,
    cases: String,
    created_at: i64,
}

#[derive(FromRow)]
struct SummaryRow {
    id: String,
    hash: String,
    name: String,
    description: String,
    cases: u32,
    created_at: i64,
}

#[async_trait]
impl SuiteStore for SqliteStore {
    async fn insert_suite(&self, suite: &Suite) -> Result<(String, bool)> {
        let mut tx = self.begin().await?;
        let known: Option<String> = sqlx::query_scalar("SELECT id FROM farm_suite WHERE hash = $1")
            .bind(&suite.hash)
            .fetch_optional(&mut *tx)
            .await
            .map_err(context("looking up a suite"))?;
        if let Some(id) = known {
            return Ok((id, false));
        }
        sqlx::query(
            "INSERT INTO farm_suite (id, hash, name, description, scenes, cases, created_at)
             VALUES ($1, $2, $3, $4, $5, $6, $7)",
        )
        .bind(&suite.id)
        .bind(&suite.hash)
        .bind(&suite.name)
        .bind(&suite.description)
        .bind(to_json(&suite.scenes)?)
        .bind(to_json(&suite.cases)?)
        .bind(suite.created_at.as_millisecond())
        .execute(&mut *tx)
        .await
        .map_err(context("adding a suite"))?;
        commit(tx).await?;
        Ok((suite.id.clone(), true))
    }

    async fn suite(&self, id: &str) -> Result<Option<Suite>> {
        let row: Option<SuiteRow> = sqlx::query_as(
            "SELECT id, hash, name, description, scenes, cases, created_at FROM farm_suite WHERE id = $1",
        )
        .bind(id)
        .fetch_optional(&self.readers)
        .await
        .map_err(context("reading a suite"))?;
        row.map(|row| {
            Ok(Suite {
                id: row.id,
                name: row.name,
                description: row.description,
                hash: row.hash,
                scenes: from_json(&row.scenes)?,
                cases: from_json(&row.cases)?,
                created_at: timestamp(row.created_at)?,
            })
        })
        .transpose()
    }

    async fn suites(&self, name: Option<&str>, page: &PageRequest) -> Result<Vec<SuiteSummary>> {
        let rows: Vec<SummaryRow> = sqlx::query_as(
            "SELECT id, hash, name, description, json_array_length(cases) AS cases, created_at FROM farm_suite
             WHERE ($1 IS NULL OR name = $1) AND ($2 IS NULL OR id < $2) ORDER BY id DESC LIMIT $3",
        )
        .bind(name)
        .bind(&page.after)
        .bind(page.limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading suites"))?;
        rows.into_iter()
            .map(|row| {
                Ok(SuiteSummary {
                    id: row.id,
                    name: row.name,
                    description: row.description,
                    hash: row.hash,
                    cases: row.cases,
                    created_at: timestamp(row.created_at)?,
                })
            })
            .collect()
    }
}
