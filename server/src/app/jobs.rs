//! Jobs: what people ask for.

use std::collections::BTreeMap;

use futures::stream::{self, StreamExt};
use lightshaft_api::job::{
    Artifact, CAMERA_LABEL, Job, JobPatch, JobSummary, NewJob, RESERVED_LABEL_PREFIX, TaskState, ValidatedJob,
};
use lightshaft_api::problem::FieldError;
use lightshaft_api::scene::Scene;
use lightshaft_api::settings::{CameraChoice, Environment, Integrator, JobSettings, Output, RenderSettings};
use serde::Serialize;
use uuid::Uuid;

use super::App;
use super::logs::LogStream;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::queue::{Millis, plan};
use crate::store::{Automatic, Change, Creation, Idempotency, JobQuery, JobRecord, JobRemoval, ListedJob, PageRequest};
use crate::web::context;

pub(super) const DEFAULT_MAX_ATTEMPTS: u32 = 3;
/// Jobs deleted in one go by age.
const DELETE_BATCH: u32 = 100;
/// Idempotency keys are kept this long.
pub const KEY_LIFETIME_MS: i64 = 24 * 3_600_000;
/// The label of the automatic job that renders a scene's thumbnail; its value is `true`.
pub const THUMBNAIL_LABEL: &str = "lightshaft.thumbnail";
/// Cameras of a scene that get a picture of their own; the first one's is the thumbnail.
const MOST_CAMERAS: usize = 8;

/// The answer to a key that was used for another request.
pub(super) fn key_reused(made: &str) -> ApiError {
    let detail = format!("this Idempotency-Key was used within 24 hours for another {made}");
    ApiError::new(Code::IdempotencyKeyReused, detail)
}

/// A job, and whether this call made it.
#[derive(Clone, Debug)]
pub struct Created {
    pub job: Job,
    pub is_new: bool,
}

impl App {
    pub async fn create_job(&self, new: &NewJob, key: Option<&str>) -> ApiResult<Created> {
        self.check_running()?;
        let idempotency = key.map(|key| self.idempotency(key, new)).transpose()?;
        // A repeated request is answered before anything is checked: the scene may be gone by now.
        if let Some(idempotency) = &idempotency
            && let Some(creation) = self.store.repeated_job(idempotency).await?
        {
            return self.created(creation, "").await;
        }
        // From the look at the map to the job that names it.
        let in_use = self.blob_use.read().await;
        let new = &self.checked_job(new).await?;
        let record = JobRecord {
            id: Uuid::now_v7().to_string(),
            scene: new.scene.clone(),
            priority: new.priority,
            max_attempts: new.max_attempts.unwrap_or(DEFAULT_MAX_ATTEMPTS),
            labels: new.labels.clone(),
            settings: new.settings.clone(),
            tasks: plan(&new.settings),
            trace_id: context::trace_id(),
            automatic: None,
            worker: None,
        };
        let creation = self.store.create_job(&record, idempotency.as_ref(), self.now()).await?;
        drop(in_use);
        self.created(creation, &record.id).await
    }

    async fn created(&self, creation: Creation, id: &str) -> ApiResult<Created> {
        match creation {
            Creation::Created => {
                tracing::info!(job.id = %id, "job created");
                self.changed();
                Ok(Created { job: self.job(id).await?, is_new: true })
            }
            Creation::Repeated(id) => Ok(Created { job: self.job(&id).await?, is_new: false }),
            Creation::KeyReused => Err(key_reused("job")),
            Creation::UnknownScene => Err(ApiError::fields(vec![FieldError::new("/scene", "there is no such scene")])),
        }
    }

    pub async fn validate_job(&self, new: &NewJob) -> ApiResult<ValidatedJob> {
        let new = &self.checked_job(new).await?;
        let job = NewJob { max_attempts: new.max_attempts.or(Some(DEFAULT_MAX_ATTEMPTS)), ..new.clone() };
        // A scene that was deleted since then is refused when the job is made.
        let scene = self.store.scene(&new.scene).await?.ok_or_else(|| ApiError::not_found("scene", &new.scene))?;
        let estimate = self.estimate(&new.scene, &scene.summary, &new.settings).await?;
        Ok(ValidatedJob { tasks: plan(&new.settings).len() as u32, job, estimate })
    }

    /// Renders small pictures of a new scene and of what its cameras see, when nothing else is to do. The thumbnail, which
    /// says that the scene has all of them, is made last and rendered first.
    pub(super) async fn create_thumbnail_jobs(&self, scene: &Scene) -> ApiResult<()> {
        let cameras = scene.summary.cameras.len().min(MOST_CAMERAS) as u32;
        for camera in 1..cameras {
            let view = RenderSettings {
                camera: Some(CameraChoice::Index(camera)),
                width: 240,
                height: 180,
                spp: 16,
                ..small_picture()
            };
            let label = (CAMERA_LABEL.to_owned(), camera.to_string());
            self.create_automatic_job(scene, Automatic::Camera, -60, label, view).await?;
        }
        let label = (THUMBNAIL_LABEL.to_owned(), "true".to_owned());
        self.create_automatic_job(scene, Automatic::Thumbnail, -50, label, small_picture()).await
    }

    async fn create_automatic_job(
        &self,
        scene: &Scene,
        automatic: Automatic,
        priority: i32,
        label: (String, String),
        settings: RenderSettings,
    ) -> ApiResult<()> {
        let settings = JobSettings::from(settings);
        let record = JobRecord {
            id: Uuid::now_v7().to_string(),
            scene: scene.id.clone(),
            priority,
            max_attempts: DEFAULT_MAX_ATTEMPTS,
            labels: BTreeMap::from([label]),
            tasks: plan(&settings),
            settings,
            trace_id: context::trace_id(),
            automatic: Some(automatic),
            worker: None,
        };
        if self.store.create_job(&record, None, self.now()).await? == Creation::Created {
            self.changed();
        }
        Ok(())
    }

    pub async fn job(&self, id: &str) -> ApiResult<Job> {
        let running = self.live.tasks();
        let mut job = self.store.job(id).await?.ok_or_else(|| ApiError::not_found("job", id))?;
        for task in job.tasks.iter_mut().filter(|task| task.state == TaskState::Leased) {
            if let Some(live) = running.get(&task.id) {
                task.progress = task.progress.max(live.progress);
                if let Some(attempt) = job.attempts.iter_mut().rfind(|attempt| attempt.task == task.id) {
                    attempt.phase = Some(live.phase);
                }
            }
        }
        if !job.summary.state.is_final() {
            job.preview = self.live.preview_of(id).map(|_| format!("/v1/jobs/{id}/preview.png"));
        }
        job.summary.progress = job.tasks.iter().map(|task| task.progress).sum::<f64>() / job.tasks.len().max(1) as f64;
        job.waiting = self.why_waiting(&job).await?;
        Ok(job)
    }

    pub async fn jobs(&self, query: &JobQuery, page: &PageRequest) -> ApiResult<Vec<JobSummary>> {
        let running = self.live.tasks();
        let jobs = self.store.jobs(query, page).await?.into_iter();
        let with_live = |job: ListedJob| {
            let progress = job.progress.of_job(|task| Some(running.get(task)?.progress));
            JobSummary { progress, ..job.summary }
        };
        Ok(jobs.map(with_live).collect())
    }

    pub async fn cancel_job(&self, id: &str) -> ApiResult<Job> {
        let change = self.store.cancel_job(id, self.now()).await?;
        self.after_change(id, change, "only queued and running jobs can be cancelled").await
    }

    pub async fn retry_job(&self, id: &str) -> ApiResult<Job> {
        self.check_running()?;
        let change = self.store.retry_job(id, self.now()).await?;
        self.after_change(id, change, "only failed and cancelled jobs can be retried").await
    }

    pub async fn patch_job(&self, id: &str, patch: &JobPatch) -> ApiResult<Job> {
        if patch.priority.is_some_and(|priority| !(-100..=100).contains(&priority)) {
            return Err(ApiError::fields(vec![FieldError::new("/priority", "must be -100 to 100")]));
        }
        let change = self.store.patch_job(id, patch.priority, patch.paused, self.now()).await?;
        self.after_change(id, change, "only queued and running jobs can be changed").await
    }

    async fn after_change(&self, id: &str, change: Change, rule: &str) -> ApiResult<Job> {
        match change {
            Change::Done => {
                self.changed();
                self.job(id).await
            }
            Change::Unknown => Err(ApiError::not_found("job", id)),
            Change::Refused(state) => {
                Err(ApiError::new(Code::WrongState, format!("the job is {}: {rule}", state.as_str())))
            }
            Change::SceneGone => Err(ApiError::new(Code::WrongState, "the job's scene was deleted: upload it again")),
        }
    }

    /// Hash of the picture so far; of the whole picture once it is there, since a page may ask for one just when the other
    /// takes its place.
    pub async fn preview(&self, id: &str) -> ApiResult<String> {
        let job = self.job(id).await?;
        if let Some(hash) = self.live.preview_of(id).filter(|_| job.preview.is_some()) {
            return Ok(hash);
        }
        let whole = job.artifacts.into_iter().find(|artifact| artifact.name == "image.png");
        let none = || ApiError::new(Code::NotFound, "the job has no picture yet");
        whole.map(|artifact| artifact.hash).ok_or_else(none)
    }

    pub async fn artifact(&self, id: &str, name: &str) -> ApiResult<Artifact> {
        let artifacts = self.store.artifacts(id).await?;
        if let Some(artifact) = artifacts.into_iter().find(|artifact| artifact.name == name) {
            return Ok(artifact);
        }
        self.store.job_state(id).await?.ok_or_else(|| ApiError::not_found("job", id))?;
        Err(ApiError::not_found("artifact of this job", name))
    }

    /// Deletes a finished job with its pictures and logs.
    pub async fn delete_job(&self, id: &str) -> ApiResult<()> {
        match self.store.delete_job(id, self.now()).await? {
            JobRemoval::Unknown => Err(ApiError::not_found("job", id)),
            JobRemoval::Unfinished(state) => {
                let detail =
                    format!("the job is {}: cancel it, or wait for its end, and then delete it", state.as_str());
                Err(ApiError::new(Code::WrongState, detail))
            }
            JobRemoval::Done { blobs, attempts } => {
                tracing::info!(job.id = %id, "job deleted");
                self.changed();
                self.discard(blobs);
                for attempt in attempts {
                    if let Err(error) = self.logs.delete(&attempt).await {
                        tracing::error!(attempt.id = %attempt, error = %error, "a log was not deleted");
                    }
                }
                self.clean_up().await;
                Ok(())
            }
        }
    }

    /// Deletes jobs that ended longer ago than jobs are kept, at most a batch; returns how many.
    pub async fn delete_old_jobs(&self) -> ApiResult<usize> {
        let Some(keep) = self.config.keep_jobs else { return Ok(0) };
        let keep = Millis::try_from(keep.as_millis()).unwrap_or(Millis::MAX);
        let old = self.store.jobs_finished_before(self.now().saturating_sub(keep), DELETE_BATCH).await?;
        for id in &old {
            self.delete_job(id).await?;
        }
        Ok(old.len())
    }

    /// Logs of all attempts of a job under headings, or that of one.
    pub async fn job_log(&self, id: &str, attempt: Option<&str>) -> ApiResult<LogStream> {
        let job = self.job(id).await?;
        if let Some(wanted) = attempt {
            let known = job.attempts.iter().any(|attempt| attempt.id == wanted);
            if !known {
                return Err(ApiError::not_found("attempt of this job", wanted));
            }
            return Ok(self.logs.read(wanted));
        }
        if job.attempts.is_empty() {
            return Ok(text("=== no attempt has begun\n".to_owned()));
        }
        let sections: Vec<LogStream> = job
            .attempts
            .iter()
            .map(|attempt| {
                let task = job.tasks.iter().find(|task| task.id == attempt.task).map_or(0, |task| task.index);
                let (number, worker) = (attempt.number, &attempt.worker_name);
                let heading = text(format!("=== task {task}, attempt {number}, worker {worker}\n"));
                heading.chain(self.logs.read(&attempt.id)).boxed()
            })
            .collect();
        Ok(stream::iter(sections).flatten().boxed())
    }

    /// The key of a request that may be repeated.
    pub(super) fn idempotency(&self, key: &str, new: &impl Serialize) -> ApiResult<Idempotency> {
        let canonical = serde_json::to_vec(new).map_err(ApiError::internal)?;
        Ok(Idempotency {
            key: key.to_owned(),
            fingerprint: blake3::hash(&canonical).to_hex().to_string(),
            not_before: self.now() - KEY_LIFETIME_MS,
        })
    }

    /// The job with everything that the service fills in.
    async fn checked_job(&self, new: &NewJob) -> ApiResult<NewJob> {
        let job = match &new.settings {
            JobSettings::Compare(request) => match self.with_pictures(new, request).await? {
                Ok(job) => job,
                Err(errors) => return Err(ApiError::fields([new.validate(), errors].concat())),
            },
            _ => new.clone(),
        };
        let errors = self.job_errors(&job).await?;
        if errors.is_empty() { Ok(job) } else { Err(ApiError::fields(errors)) }
    }

    /// Everything that is wrong with a job, also by its scene and its blobs.
    pub(super) async fn job_errors(&self, new: &NewJob) -> ApiResult<Vec<FieldError>> {
        let mut errors = new.validate();
        let mut scenes = Vec::new();
        match self.store.scene(&new.scene).await? {
            Some(scene) => scenes.push(scene),
            None => errors.push(FieldError::new("/scene", "there is no such scene")),
        }
        for (i, id) in new.settings.further_scenes().iter().enumerate() {
            match self.store.scene(id).await? {
                _ if *id == new.scene => {
                    errors.push(FieldError::new(format!("/settings/scenes/{i}"), "is the job's own scene"));
                }
                Some(scene) => scenes.push(scene),
                None => errors.push(FieldError::new(format!("/settings/scenes/{i}"), "there is no such scene")),
            }
        }
        match &new.settings {
            JobSettings::Render(settings) => {
                let camera = settings.camera.as_ref().zip(scenes.first());
                errors.extend(camera.and_then(|(camera, scene)| check_camera("/settings/camera", camera, scene)));
                self.check_environment(settings, &mut errors).await?;
            }
            JobSettings::Benchmark(settings) => {
                for (i, view) in settings.views.iter().enumerate() {
                    let pointer = format!("/settings/views/{i}");
                    errors.extend(scenes.iter().find_map(|scene| check_camera(&pointer, view, scene)));
                }
            }
            JobSettings::Build(_) | JobSettings::Compare(_) => {}
        }
        Ok(errors)
    }

    async fn check_environment(&self, settings: &RenderSettings, errors: &mut Vec<FieldError>) -> ApiResult<()> {
        if let Some(Environment::Map(map)) = &settings.environment {
            let pointer = "/settings/environment/map";
            match self.blobs.start(&map.map, 16).await.map_err(ApiError::internal)? {
                None if errors.iter().any(|error| error.pointer == pointer) => {}
                None => errors.push(FieldError::new(pointer, "is not in the blob store: put it first")),
                Some(start) if !is_environment_map(&start) => {
                    errors.push(FieldError::new(pointer, "is neither a Radiance .hdr nor an OpenEXR file"));
                }
                Some(_) => {}
            }
        }
        Ok(())
    }
}

/// A picture that shows what a scene is, and takes little.
fn small_picture() -> RenderSettings {
    RenderSettings {
        integrator: Integrator::Path,
        width: 320,
        height: 240,
        spp: 32,
        max_bounces: 3,
        outputs: vec![Output::Png],
        ..RenderSettings::default()
    }
}

fn text(text: String) -> LogStream {
    stream::once(std::future::ready(Ok(text.into()))).boxed()
}

fn check_camera(pointer: &str, camera: &CameraChoice, scene: &Scene) -> Option<FieldError> {
    let cameras = &scene.summary.cameras;
    let detail = match camera {
        CameraChoice::Custom(_) => return None,
        CameraChoice::Index(i) if (*i as usize) < cameras.len() => return None,
        CameraChoice::Name(name) if cameras.iter().any(|camera| camera.name == *name) => return None,
        _ if cameras.is_empty() => "the scene has no cameras: leave it null, or give one here".to_owned(),
        CameraChoice::Index(_) => format!("must be 0 to {}", cameras.len() - 1),
        CameraChoice::Name(_) => {
            let names: Vec<String> = cameras.iter().take(20).map(|camera| format!("`{}`", camera.name)).collect();
            format!("the scene has no such camera; it has {}", names.join(", "))
        }
    };
    Some(FieldError::new(pointer, detail))
}

/// By its first bytes: Radiance RGBE, or OpenEXR's magic number 20000630.
fn is_environment_map(start: &[u8]) -> bool {
    start.starts_with(b"#?RADIANCE") || start.starts_with(b"#?RGBE") || start.starts_with(&20_000_630u32.to_le_bytes())
}

/// The key of a `label.<key>` parameter may be one of the service's own, too.
pub fn is_label_key(key: &str) -> bool {
    key.starts_with(RESERVED_LABEL_PREFIX) || (1..=64).contains(&key.chars().count())
}
