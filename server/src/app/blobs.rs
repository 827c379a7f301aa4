//! Blobs, meshes and structures.

use axum::body::Body;
use futures::{StreamExt, TryStreamExt};
use lightshaft_api::blob::{StoredBlob, is_hash};
use lightshaft_api::mesh::{FindStructures, FoundStructures, Mesh, NewStructure, Structure};
use lightshaft_api::problem::FieldError;

use super::App;
use crate::blob::{StageError, Staged};
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::store::PageRequest;

impl From<StageError> for ApiError {
    fn from(error: StageError) -> Self {
        match error {
            StageError::TooLarge { limit } => {
                Self::new(Code::TooLarge, format!("the body must be at most {limit} bytes"))
            }
            StageError::Stalled => Self::new(Code::UploadStalled, "the upload stood still for too long"),
            StageError::Incomplete(_) => Self::new(Code::IncompleteBody, "the body ended before its end was announced"),
            StageError::Io(_) => Self::internal(error),
        }
    }
}

impl App {
    pub(super) async fn stage(&self, body: Body, limit: u64) -> ApiResult<Staged> {
        let stream = body.into_data_stream();
        Ok(self.blobs.stage(stream, limit, self.config.limits.upload_stall).await?)
    }

    /// Stores a body; when `expected` is given, only under that hash.
    pub async fn put_blob(&self, body: Body, expected: Option<&str>) -> ApiResult<StoredBlob> {
        self.check_running()?;
        if expected.is_some_and(|hash| !is_hash(hash)) {
            return Err(ApiError::bad_request("path/hash", "must be 64 lower-case hex digits"));
        }
        let staged = self.stage(body, self.config.limits.blob_bytes).await?;
        let stored = StoredBlob { hash: staged.hash().to_owned(), bytes: staged.bytes() };
        if let Some(expected) = expected.filter(|&hash| hash != stored.hash) {
            let detail = format!("the body's hash is {}, not {expected}", stored.hash);
            return Err(ApiError::new(Code::HashMismatch, detail));
        }
        self.blobs.commit(staged).await.map_err(ApiError::internal)?;
        Ok(stored)
    }

    pub async fn missing_blobs(&self, hashes: Vec<String>) -> ApiResult<Vec<String>> {
        if hashes.len() > 10_000 {
            return Err(ApiError::fields(vec![FieldError::new("/hashes", "must be at most 10000 hashes")]));
        }
        let wrong = hashes.iter().enumerate().filter(|(_, hash)| !is_hash(hash));
        let wrong: Vec<FieldError> = wrong
            .map(|(i, _)| FieldError::new(format!("/hashes/{i}"), "must be 64 lower-case hex digits"))
            .take(100)
            .collect();
        if !wrong.is_empty() {
            return Err(ApiError::fields(wrong));
        }
        let mut missing = Vec::new();
        for hash in hashes {
            if self.blobs.size(&hash).await.map_err(ApiError::internal)?.is_none() {
                missing.push(hash);
            }
        }
        Ok(missing)
    }

    /// Deletes those of these blobs that nothing names any more.
    pub async fn delete_unused(&self, hashes: impl IntoIterator<Item = String, IntoIter: Send>) -> ApiResult<u64> {
        let mut hashes = hashes.into_iter().peekable();
        if hashes.peek().is_none() {
            return Ok(0);
        }
        let _alone = self.blob_use.write().await;
        let mut deleted = 0;
        for hash in hashes {
            if !self.store.is_blob_used(&hash).await? {
                self.blobs.delete(&hash).await.map_err(ApiError::internal)?;
                deleted += 1;
            }
        }
        Ok(deleted)
    }

    /// Deletes blobs that were last written before a time and that nothing names; returns how many.
    pub async fn sweep_blobs(&self, before: jiff::Timestamp) -> ApiResult<u64> {
        let mut batches = self.blobs.older_than(before).map_err(ApiError::internal).chunks(256);
        let mut deleted = 0;
        while let Some(batch) = batches.next().await {
            let hashes: Vec<String> = batch.into_iter().collect::<ApiResult<_>>()?;
            deleted += self.delete_unused(hashes).await?;
        }
        Ok(deleted)
    }

    pub async fn meshes(&self, page: &PageRequest) -> ApiResult<Vec<Mesh>> {
        let mut meshes = self.store.meshes(page).await?;
        meshes.iter_mut().for_each(|mesh| self.add_warm_workers(mesh));
        Ok(meshes)
    }

    pub async fn mesh(&self, hash: &str) -> ApiResult<Mesh> {
        let mut mesh = self.store.mesh(hash).await?.ok_or_else(|| ApiError::not_found("mesh", hash))?;
        self.add_warm_workers(&mut mesh);
        Ok(mesh)
    }

    pub async fn find_structures(&self, wanted: &FindStructures) -> ApiResult<FoundStructures> {
        if wanted.meshes.len() > 4096 {
            return Err(ApiError::fields(vec![FieldError::new("/meshes", "must be at most 4096 hashes")]));
        }
        if let Some(i) = wanted.meshes.iter().position(|hash| !is_hash(hash)) {
            let detail = "must be 64 lower-case hex digits";
            return Err(ApiError::fields(vec![FieldError::new(format!("/meshes/{i}"), detail)]));
        }
        Ok(FoundStructures { blobs: self.store.find_structures(wanted).await? })
    }

    fn add_warm_workers(&self, mesh: &mut Mesh) {
        let workers = self.live.workers_with(&mesh.hash, self.now());
        for structure in &mut mesh.structures {
            structure.workers.clone_from(&workers);
        }
    }

    pub async fn add_structure(&self, mesh: &str, structure: &NewStructure) -> ApiResult<Structure> {
        let mut errors = Vec::new();
        let mut check = |ok: bool, pointer: &str, detail: &str| {
            if !ok {
                errors.push(FieldError::new(pointer, detail));
            }
        };
        check((1..=64).contains(&structure.kind.len()), "/kind", "must have 1 to 64 characters");
        check(structure.parameters.len() <= 1024, "/parameters", "must have at most 1024 characters");
        check(structure.build_s.is_finite() && structure.build_s >= 0.0, "/build_s", "must not be negative");
        let _in_use = self.blob_use.read().await;
        let stored = self.blobs.size(&structure.blob).await.map_err(ApiError::internal)?;
        check(stored.is_some(), "/blob", "is not in the blob store: put it first");
        check(stored.is_none_or(|size| size == structure.bytes), "/bytes", "is not the blob's length");
        if !errors.is_empty() {
            return Err(ApiError::fields(errors));
        }
        let added = self.store.add_structure(mesh, structure, self.now()).await?;
        added.ok_or_else(|| ApiError::not_found("mesh", mesh))
    }
}
