//! Scenes: uploads from files, and what is known of them.

use std::path::{Path, PathBuf};

use bytes::Bytes;
use reqwest::header::{CONTENT_LENGTH, CONTENT_TYPE};
use reqwest::multipart::{Form, Part};
use reqwest::{Body, Method, RequestBuilder, StatusCode};

use super::blobs::open;
use super::{Client, ClientError, Result, segment};
use crate::page::Page;
use crate::scene::{Scene, SceneSummary};

/// One file of a multipart upload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenePart {
    /// Relative path as the glTF names it, with `/`.
    pub path: String,
    pub file: PathBuf,
}

/// What is uploaded as a scene.
#[derive(Debug)]
pub enum Upload {
    /// A `.glb`, of so many bytes where known.
    Glb(Body, Option<u64>),
    /// A `.zip` with one `.gltf` or `.glb` and its files.
    Zip(Body, Option<u64>),
    /// A `.gltf` and its files.
    Files(Vec<ScenePart>),
}

impl Upload {
    /// A `.glb` or `.zip` file by its ending.
    pub async fn file(path: &Path) -> Result<Self> {
        let file = open(path).await?;
        let length = file.metadata().await.ok().map(|metadata| metadata.len());
        let is_zip = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("zip"));
        Ok(if is_zip { Self::Zip(file.into(), length) } else { Self::Glb(file.into(), length) })
    }
}

impl Client {
    /// Uploads a scene; the flag says whether it is new (the same bytes give the same scene).
    pub async fn upload_scene(&self, upload: Upload, name: Option<&str>) -> Result<(Scene, bool)> {
        let request = self.request(Method::POST, "v1/scenes").query(&[("name", name)]);
        let response = self.send_upload(attach(request, upload).await?).await?;
        let created = response.status() == StatusCode::CREATED;
        Ok((Self::read_json(response).await?, created))
    }

    /// Uploads a scene only to have it checked: nothing is kept.
    pub async fn validate_scene(&self, upload: Upload) -> Result<SceneSummary> {
        let request = self.request(Method::POST, "v1/scenes").query(&[("validate_only", "true")]);
        Self::read_json(self.send_upload(attach(request, upload).await?).await?).await
    }

    pub async fn scenes(&self, limit: Option<u32>, cursor: Option<&str>) -> Result<Page<Scene>> {
        self.get_json("v1/scenes", &[("limit", limit.map(|n| n.to_string())), ("cursor", cursor.map(str::to_owned))])
            .await
    }

    pub async fn scene(&self, id: &str) -> Result<Scene> {
        self.get_json(&format!("v1/scenes/{}", segment(id)), &()).await
    }

    pub async fn delete_scene(&self, id: &str) -> Result<()> {
        self.send(self.request(Method::DELETE, &format!("v1/scenes/{}", segment(id)))).await?;
        Ok(())
    }

    pub async fn thumbnail(&self, id: &str) -> Result<Bytes> {
        self.bytes(&format!("v1/scenes/{}/thumbnail.png", segment(id))).await
    }
}

async fn attach(request: RequestBuilder, upload: Upload) -> Result<RequestBuilder> {
    let single = |request: RequestBuilder, media_type: &str, body, length: Option<u64>| {
        let request = request.header(CONTENT_TYPE, media_type).body::<Body>(body);
        match length {
            Some(length) => request.header(CONTENT_LENGTH, length),
            None => request,
        }
    };
    Ok(match upload {
        Upload::Glb(body, length) => single(request, "model/gltf-binary", body, length),
        Upload::Zip(body, length) => single(request, "application/zip", body, length),
        Upload::Files(parts) => {
            let mut form = Form::new();
            for part in parts {
                let file = open(&part.file).await?;
                let file_error = |source| ClientError::File { path: part.file.display().to_string(), source };
                let length = file.metadata().await.map_err(file_error)?.len();
                form = form.part("file", Part::stream_with_length(file, length).file_name(part.path));
            }
            request.multipart(form)
        }
    })
}
