//! Blobs, meshes and structures.

use std::path::Path;

use bytes::Bytes;
use futures::StreamExt;
use reqwest::{Body, Method};
use tokio::io::AsyncWriteExt;

use super::{Client, ClientError, Result, segment, transport};
use crate::blob::{BlobQuery, MissingBlobs, StoredBlob};
use crate::mesh::{FindStructures, FoundStructures, Mesh, NewStructure, Structure};
use crate::page::Page;

impl Client {
    /// Stores `body` under the hash that it must have; repeating it is harmless.
    pub async fn put_blob(&self, hash: &str, body: impl Into<Body>) -> Result<StoredBlob> {
        let path = format!("v1/blobs/{}", segment(hash));
        Self::read_json(self.send_upload(self.request(Method::PUT, &path).body(body)).await?).await
    }

    /// Stores `body` and answers its hash.
    pub async fn store_blob(&self, body: impl Into<Body>) -> Result<StoredBlob> {
        Self::read_json(self.send_upload(self.request(Method::POST, "v1/blobs").body(body)).await?).await
    }

    /// Stores a file, streamed, and answers its hash.
    pub async fn store_blob_file(&self, path: &Path) -> Result<StoredBlob> {
        self.store_blob(open(path).await?).await
    }

    pub async fn missing_blobs(&self, hashes: Vec<String>) -> Result<Vec<String>> {
        let missing: MissingBlobs = self.post_json("v1/blobs:missing", &BlobQuery { hashes }).await?;
        Ok(missing.missing)
    }

    pub async fn blob(&self, hash: &str) -> Result<Bytes> {
        self.bytes(&format!("v1/blobs/{}", segment(hash))).await
    }

    /// Streams a blob into a new file at `path`; returns the bytes written. The caller checks the hash.
    pub async fn download_blob(&self, hash: &str, path: &Path) -> Result<u64> {
        self.download(&format!("v1/blobs/{}", segment(hash)), path).await
    }

    pub async fn meshes(&self, limit: Option<u32>, cursor: Option<&str>) -> Result<Page<Mesh>> {
        self.get_json("v1/meshes", &[("limit", limit.map(|n| n.to_string())), ("cursor", cursor.map(str::to_owned))])
            .await
    }

    pub async fn mesh(&self, hash: &str) -> Result<Mesh> {
        self.get_json(&format!("v1/meshes/{}", segment(hash)), &()).await
    }

    /// Which of these meshes have a structure of one kind, and where it is.
    pub async fn find_structures(&self, wanted: &FindStructures) -> Result<FoundStructures> {
        self.post_json("v1/meshes:structures", wanted).await
    }

    /// Tells of a structure whose blob was put before.
    pub async fn add_structure(&self, mesh: &str, structure: &NewStructure) -> Result<Structure> {
        self.post_json(&format!("v1/meshes/{}/structures", segment(mesh)), structure).await
    }

    /// The whole body at a path or `href` of the API.
    pub async fn bytes(&self, path: &str) -> Result<Bytes> {
        self.send(self.request(Method::GET, path)).await?.bytes().await.map_err(transport)
    }

    /// Streams the body at a path or `href` of the API into a new file; returns the bytes written. A file that could
    /// not be finished is removed.
    pub async fn download(&self, path: &str, file: &Path) -> Result<u64> {
        let response = self.send(self.request(Method::GET, path)).await?;
        let result = write_body(response, file).await;
        if result.is_err() {
            // The download's own error is the one to report.
            tokio::fs::remove_file(file).await.ok();
        }
        result
    }
}

async fn write_body(response: reqwest::Response, path: &Path) -> Result<u64> {
    let file_error = |source| ClientError::File { path: path.display().to_string(), source };
    let mut file = tokio::fs::File::create(path).await.map_err(file_error)?;
    let mut body = response.bytes_stream();
    let mut written = 0;
    while let Some(chunk) = body.next().await {
        let chunk = chunk.map_err(transport)?;
        file.write_all(&chunk).await.map_err(file_error)?;
        written += chunk.len() as u64;
    }
    file.flush().await.map_err(file_error)?;
    Ok(written)
}

pub(super) async fn open(path: &Path) -> Result<tokio::fs::File> {
    tokio::fs::File::open(path).await.map_err(|source| ClientError::File { path: path.display().to_string(), source })
}
