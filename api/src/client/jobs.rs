//! Jobs and what they leave behind.

use std::collections::BTreeMap;
use std::path::Path;

use bytes::Bytes;
use reqwest::Method;

use super::{Client, Result, segment};
use crate::job::{Job, JobPatch, JobState, JobSummary, NewJob, ValidatedJob};
use crate::page::Page;

/// What `GET /v1/jobs` may be asked for; empty takes all, newest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JobFilter {
    pub state: Option<JobState>,
    pub scene: Option<String>,
    pub labels: BTreeMap<String, String>,
    /// Text in the scene's name, the id or a label's value.
    pub q: Option<String>,
    /// Only (or no) jobs that the service made by itself, such as thumbnails.
    pub automatic: Option<bool>,
    pub limit: Option<u32>,
    pub cursor: Option<String>,
}

impl JobFilter {
    fn query(&self) -> Vec<(String, String)> {
        let mut query = Vec::new();
        let mut add = |key: &str, value: Option<String>| query.extend(value.map(|value| (key.to_owned(), value)));
        add("state", self.state.map(|state| state.as_str().to_owned()));
        add("scene", self.scene.clone());
        add("q", self.q.clone());
        add("automatic", self.automatic.map(|automatic| automatic.to_string()));
        add("limit", self.limit.map(|limit| limit.to_string()));
        add("cursor", self.cursor.clone());
        for (key, value) in &self.labels {
            add(&format!("label.{key}"), Some(value.clone()));
        }
        query
    }
}

impl Client {
    /// With a key, repeating the call within 24 hours gives the same job instead of a second one.
    pub async fn create_job(&self, job: &NewJob, idempotency_key: Option<&str>) -> Result<Job> {
        self.post_once("v1/jobs", job, idempotency_key).await
    }

    /// Checks a job without making it.
    pub async fn validate_job(&self, job: &NewJob) -> Result<ValidatedJob> {
        self.post_json("v1/jobs?validate_only=true", job).await
    }

    pub async fn jobs(&self, filter: &JobFilter) -> Result<Page<JobSummary>> {
        self.get_json("v1/jobs", &filter.query()).await
    }

    pub async fn job(&self, id: &str) -> Result<Job> {
        self.get_json(&job_path(id, ""), &()).await
    }

    pub async fn cancel_job(&self, id: &str) -> Result<Job> {
        self.post_json(&job_path(id, "/cancel"), &()).await
    }

    pub async fn retry_job(&self, id: &str) -> Result<Job> {
        self.post_json(&job_path(id, "/retry"), &()).await
    }

    /// Deletes a finished job with what it left.
    pub async fn delete_job(&self, id: &str) -> Result<()> {
        self.send(self.request(Method::DELETE, &job_path(id, ""))).await.map(|_| ())
    }

    pub async fn patch_job(&self, id: &str, patch: &JobPatch) -> Result<Job> {
        self.send_json(self.request(Method::PATCH, &job_path(id, "")).json(patch)).await
    }

    /// The logs of all attempts, or of one.
    pub async fn job_log(&self, id: &str, attempt: Option<&str>) -> Result<String> {
        let request = self.request(Method::GET, &job_path(id, "/log")).query(&[("attempt", attempt)]);
        let bytes = self.send(request).await?.bytes().await.map_err(super::transport)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    pub async fn artifact(&self, job: &str, name: &str) -> Result<Bytes> {
        self.bytes(&artifact_path(job, name)).await
    }

    /// Streams an artifact into a new file; returns the bytes written.
    pub async fn download_artifact(&self, job: &str, name: &str, path: &Path) -> Result<u64> {
        self.download(&artifact_path(job, name), path).await
    }

    /// The picture so far, as PNG.
    pub async fn preview(&self, job: &str) -> Result<Bytes> {
        self.bytes(&job_path(job, "/preview.png")).await
    }
}

fn job_path(id: &str, rest: &str) -> String {
    format!("v1/jobs/{}{rest}", segment(id))
}

fn artifact_path(job: &str, name: &str) -> String {
    job_path(job, &format!("/artifacts/{}", segment(name)))
}
