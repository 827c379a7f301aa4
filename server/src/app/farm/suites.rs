//! Suites: versions by content.

use lightshaft_api::farm::{NewSuite, Suite, SuiteSummary};
use uuid::Uuid;

use super::super::App;
use crate::error::{ApiError, ApiResult};
use crate::store::PageRequest;

impl App {
    /// Adds a version of a suite; the same content is the same suite. Returns whether it is new.
    pub async fn create_suite(&self, new: &NewSuite) -> ApiResult<(Suite, bool)> {
        let cases = new.resolve().map_err(ApiError::fields)?;
        // What is written out differently, but means the same, is the same version.
        let content = (&new.name, &new.description, &new.scenes, &cases);
        let canonical = serde_json::to_vec(&content).map_err(ApiError::internal)?;
        let suite = Suite {
            id: Uuid::now_v7().to_string(),
            name: new.name.clone(),
            description: new.description.clone(),
            hash: blake3::hash(&canonical).to_hex().to_string(),
            scenes: new.scenes.clone(),
            cases,
            created_at: self.timestamp()?,
        };
        let (id, is_new) = self.store.insert_suite(&suite).await?;
        if is_new {
            tracing::info!(suite.id = %id, cases = suite.cases.len(), "suite added");
        }
        Ok((self.suite(&id).await?, is_new))
    }

    pub async fn suite(&self, id: &str) -> ApiResult<Suite> {
        self.store.suite(id).await?.ok_or_else(|| ApiError::not_found("suite", id))
    }

    pub async fn suites(&self, name: Option<&str>, page: &PageRequest) -> ApiResult<Vec<SuiteSummary>> {
        Ok(self.store.suites(name, page).await?)
    }

    pub(super) fn timestamp(&self) -> ApiResult<jiff::Timestamp> {
        jiff::Timestamp::from_millisecond(self.now()).map_err(ApiError::internal)
    }
}
