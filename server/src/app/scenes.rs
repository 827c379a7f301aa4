//! Scenes: an upload is staged, imported, and only then kept, so that there never is half of one.

use axum::extract::Request;
use futures::TryStreamExt;
use lightshaft_api::lease::SceneFile;
use lightshaft_api::problem::FieldError;
use lightshaft_api::scene::{Scene, SceneSummary};
use uuid::Uuid;

use super::import::{Files, Format};
use super::{App, multipart};
use crate::blob::Staged;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::store::{PageRequest, Removal, SceneRecord};
use crate::web::body::{media_type, upload};

const THUMBNAIL_BATCH: u32 = 20;
const ACCEPTED: &str = "model/gltf-binary (.glb), application/zip, model/gltf+json or multipart/form-data";

/// What came of an upload.
#[derive(Clone, Debug)]
pub enum Uploaded {
    New(Box<Scene>),
    Known(Box<Scene>),
    /// Only checked.
    Valid(Box<SceneSummary>),
}

/// The files of an upload, staged.
struct Package {
    /// Each with its relative path.
    files: Vec<(String, Staged)>,
    format: Option<Format>,
    name: Option<String>,
}

impl Package {
    fn single(staged: Staged, format: Option<Format>, name: Option<String>) -> Self {
        // What is none of the formats goes to the importer as what it claims to be, which says what is wrong with it.
        let path = format.unwrap_or(Format::Glb).file_name().to_owned();
        Self { files: vec![(path, staged)], format, name }
    }

    /// Of a single file, its own hash; of several, that of their list in order of path.
    fn hash(&self) -> String {
        if let [(_, staged)] = self.files.as_slice() {
            return staged.hash().to_owned();
        }
        let mut list: Vec<String> =
            self.files.iter().map(|(path, staged)| format!("{}\0{path}\0", staged.hash())).collect();
        list.sort();
        blake3::hash(list.concat().as_bytes()).to_hex().to_string()
    }

    fn bytes(&self) -> u64 {
        self.files.iter().map(|(_, staged)| staged.bytes()).sum()
    }

    fn on_disk(&self) -> Files {
        match (self.format, self.files.as_slice()) {
            (Some(Format::Zip), [(_, staged)]) => Files::Zip(staged.path().to_owned()),
            (_, files) => {
                Files::Set(files.iter().map(|(path, staged)| (path.clone(), staged.path().to_owned())).collect())
            }
        }
    }
}

impl App {
    pub async fn upload_scene(
        &self,
        request: Request,
        name: Option<String>,
        validate_only: bool,
    ) -> ApiResult<Uploaded> {
        self.check_running()?;
        if name.as_ref().is_some_and(|name| !(1..=200).contains(&name.chars().count())) {
            return Err(ApiError::bad_request("query/name", "must have 1 to 200 characters"));
        }
        let package = self.receive(request).await?;
        let hash = package.hash();
        if !validate_only && let Some(scene) = self.store.scene_by_hash(&hash).await? {
            return Ok(Uploaded::Known(Box::new(scene)));
        }
        let summary = self.import(package.on_disk()).await;
        let result = if summary.is_ok() { "imported" } else { "refused" };
        metrics::counter!("lightshaft_scene_imports_total", "result" => result).increment(1);
        let summary = summary?;
        check_meshes(&summary, self.config.limits.scene_meshes)?;
        if validate_only {
            return Ok(Uploaded::Valid(Box::new(summary)));
        }
        self.keep(package, hash, name, summary).await
    }

    async fn keep(
        &self,
        package: Package,
        hash: String,
        name: Option<String>,
        summary: SceneSummary,
    ) -> ApiResult<Uploaded> {
        let bytes = package.bytes();
        let name = name.or(package.name).unwrap_or_else(|| format!("scene {}", &hash[..8]));
        let mut files = Vec::with_capacity(package.files.len());
        let in_use = self.blob_use.read().await;
        for (path, staged) in package.files {
            files.push(SceneFile { path, blob: staged.hash().to_owned(), bytes: staged.bytes() });
            self.blobs.commit(staged).await.map_err(ApiError::internal)?;
        }
        let record = SceneRecord { id: Uuid::now_v7().to_string(), hash, name, bytes, summary, files };
        let (id, is_new) = self.store.insert_scene(&record, self.now()).await?;
        drop(in_use);
        let scene = self.scene(&id).await?;
        if !is_new {
            return Ok(Uploaded::Known(Box::new(scene)));
        }
        tracing::info!(scene.id = %id, bytes, triangles = scene.summary.triangles_total, "scene imported");
        if self.config.thumbnails && scene.summary.instances > 0 {
            // The scene is there whatever comes of this; a chore makes up for it.
            if let Err(error) = self.create_thumbnail_jobs(&scene).await {
                tracing::error!(scene.id = %scene.id, error = %error, "no job for the scene's thumbnail");
            }
        }
        Ok(Uploaded::New(Box::new(scene)))
    }

    async fn receive(&self, request: Request) -> ApiResult<Package> {
        let limit = self.config.limits.scene_bytes;
        let media = media_type(request.headers()).unwrap_or_default();
        let declared = match media.as_str() {
            "model/gltf-binary" => Format::Glb,
            "application/zip" | "application/x-zip-compressed" => Format::Zip,
            "model/gltf+json" => Format::Gltf,
            "multipart/form-data" => return self.receive_parts(request, limit).await,
            "" => return Err(unsupported(format!("the Content-Type header is missing: expected {ACCEPTED}"))),
            other => return Err(unsupported(format!("`{other}` is not accepted: expected {ACCEPTED}"))),
        };
        let staged = self.stage(upload(request, limit)?, limit).await?;
        let found = Format::sniff(staged.start());
        if let Some(found) = found.filter(|&found| found != declared) {
            let (declared, found) = (declared.media_type(), found.media_type());
            return Err(unsupported(format!("declared as {declared}, but the content is {found}")));
        }
        Ok(Package::single(staged, Some(declared), None))
    }

    async fn receive_parts(&self, request: Request, limit: u64) -> ApiResult<Package> {
        let mut multipart = multipart::open(request, limit).await?;
        let mut files: Vec<(String, Staged)> = Vec::new();
        let mut left = limit;
        while let Some(field) = self.next_part(&mut multipart).await? {
            let Some(path) = field.file_name().map(str::to_owned) else { continue };
            if files.len() >= self.config.limits.scene_files {
                let limit = self.config.limits.scene_files;
                return Err(ApiError::new(Code::TooLarge, format!("an upload must be at most {limit} files")));
            }
            let stall = self.config.limits.upload_stall;
            let stream = field.map_err(|error| error.body_text());
            let staged = self.blobs.stage(Box::pin(stream), left, stall).await?;
            left -= staged.bytes();
            files.push((path, staged));
        }
        let stem = |path: &str| {
            path.rsplit('/').next().and_then(|file| file.rsplit_once('.')).map(|(stem, _)| stem.to_owned())
        };
        match files.len() {
            0 => {
                let detail = "no part has a file name: send each file as a part with its relative path as `filename`";
                Err(ApiError::with_errors(Code::InvalidScene, vec![FieldError::new("file", detail)]))
            }
            1 => {
                let (path, staged) = files.remove(0);
                let format = Format::sniff(staged.start());
                Ok(Package::single(staged, format, stem(&path)))
            }
            _ => {
                let main = files.iter().find(|(path, _)| path.to_ascii_lowercase().ends_with(".gltf"));
                let name = main.and_then(|(path, _)| stem(path));
                Ok(Package { files, format: None, name })
            }
        }
    }

    pub async fn scene(&self, id: &str) -> ApiResult<Scene> {
        self.store.scene(id).await?.ok_or_else(|| ApiError::not_found("scene", id))
    }

    pub async fn scenes(&self, page: &PageRequest) -> ApiResult<Vec<Scene>> {
        Ok(self.store.scenes(page).await?)
    }

    pub async fn delete_scene(&self, id: &str) -> ApiResult<()> {
        let blobs = self.store.scene_blobs(id).await?;
        match self.store.delete_scene(id, self.now()).await? {
            Removal::Done => {
                self.changed();
                self.discard(blobs);
                self.clean_up().await;
                Ok(())
            }
            Removal::Unknown => Err(ApiError::not_found("scene", id)),
            Removal::InUse => {
                Err(ApiError::new(Code::InUse, "unfinished jobs use the scene: cancel them or wait for them first"))
            }
        }
    }

    /// Makes the jobs for thumbnails that scenes still lack, at most a batch.
    pub async fn create_missing_thumbnail_jobs(&self) -> ApiResult<()> {
        if !self.config.thumbnails {
            return Ok(());
        }
        for scene in self.store.scenes_without_thumbnail(THUMBNAIL_BATCH).await? {
            self.create_thumbnail_jobs(&scene).await?;
        }
        Ok(())
    }

    /// Hash of the scene's small picture.
    pub async fn thumbnail(&self, id: &str) -> ApiResult<String> {
        self.scene(id).await?;
        let artifacts = match self.store.thumbnail_job(id).await? {
            Some(job) => self.store.artifacts(&job).await?,
            None => Vec::new(),
        };
        let picture = artifacts.into_iter().find(|artifact| artifact.name == "image.png");
        let none = || ApiError::new(Code::NotFound, "the scene has no thumbnail yet");
        picture.map(|artifact| artifact.hash).ok_or_else(none)
    }
}

/// Reports of workers name every mesh, and have a budget, too.
fn check_meshes(summary: &SceneSummary, limit: usize) -> ApiResult<()> {
    let found = summary.meshes.len();
    if found <= limit {
        return Ok(());
    }
    let detail = format!("{found} different meshes are more than the limit of {limit}: merge some of them");
    Err(ApiError::with_errors(Code::InvalidScene, vec![FieldError::new("file/meshes", detail)]))
}

fn unsupported(detail: String) -> ApiError {
    ApiError::new(Code::UnsupportedMediaType, detail)
}
