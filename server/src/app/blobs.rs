//! Blobs, meshes and structures.

use axum::body::Body;
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
        if expected.is_some_and(|hash| !is_hash(hash)) {
            return Err(ApiError::bad_request("path/hash", "must be 64 lower-case hex digits"));
        }
        let staged = self.stage(body, self.config.limits.blob_bytes).await?;
        let stored = StoredBlob { hash: staged.hash().to_owned(), bytes: staged.bytes() };
        if let Some(expected) = expected.filter(|&hash| hash != stored.hash) {
            let detail = format!("the body's hash is {}, not {expected}", stored.hash);
            return Err(ApiError::new(Code::HashMismatch, detail));
        }
        let _in_use = self.blob_use.read().await;
        self.blobs.commit(staged).await.map_err(ApiError::internal)?;
        Ok(stored)
    }

    /// Those that are there count as put now: whoever asks will name them, and not send them again.
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
        let _in_use = self.blob_use.read().await;
        let mut missing = Vec::new();
        for hash in hashes {
            if !self.blobs.touch(&hash).await.map_err(ApiError::internal)? {
                missing.push(hash);
            }
        }
        Ok(missing)
    }

    pub async fn meshes(&self, scene: Option<&str>, page: &PageRequest) -> ApiResult<Vec<Mesh>> {
        let mut meshes = self.store.meshes(scene, page).await?;
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
        let in_use = self.blob_use.read().await;
        let stored = self.blobs.size(&structure.blob).await.map_err(ApiError::internal)?;
        check(stored.is_some(), "/blob", "is not in the blob store: put it first");
        check(stored.is_none_or(|size| size == structure.bytes), "/bytes", "is not the blob's length");
        if !errors.is_empty() {
            return Err(ApiError::fields(errors));
        }
        let added = self.store.add_structure(mesh, structure, self.now()).await?;
        drop(in_use);
        self.discard(structure.replaces.clone());
        added.ok_or_else(|| ApiError::not_found("mesh", mesh))
    }
}
