//! How far two pictures are apart.
//!
//! A comparison follows from the hashes of two blobs, the names of their layers and some options, and so do the addresses
//! of its pictures: nothing is stored. The last ones are kept in memory, so that asking for the figures and then for the
//! heat map is one piece of work.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use axum::extract::Request;
use bytes::Bytes;
use futures::TryStreamExt;
use lightshaft_api::blob::is_hash;
use lightshaft_api::compare::{CompareRequest, Compared, ComparedPicture, PictureChoice};
use lightshaft_api::job::NewJob;
use lightshaft_api::problem::FieldError;
use lightshaft_api::settings::JobSettings;
use lightshaft_compare::Options;
use lightshaft_engine::film::COLOR;

use super::pictures::escape;
use super::{App, multipart};
use crate::blob::Staged;
use crate::error::{ApiError, ApiResult};
use crate::web::body::parse;
use lightshaft_worker::picture::PictureError;
use lightshaft_worker::picture::compare::{self as comparing, Bounds, Figures, Pixels};

/// Comparisons that are kept.
const KEPT: usize = 16;
const HEAT_MAP: &str = "heat-map.png";
/// What a job's picture is called, best first.
const PICTURES: [&str; 2] = ["image.exr", "image.png"];

/// A comparison as an address names it.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparisonKey {
    pub a: ComparedPicture,
    pub b: ComparedPicture,
    pub exposure: f32,
    pub tolerance: f32,
    /// Whether by HDR-FLIP too.
    pub hdr: bool,
}

/// Uploaded pictures, staged: the parts `a` and `b`.
#[derive(Debug, Default)]
pub struct UploadedPictures {
    a: Option<Staged>,
    b: Option<Staged>,
}

/// The last comparisons, newest first.
#[derive(Default)]
pub(super) struct Comparisons(Mutex<VecDeque<(ComparisonKey, Arc<Finding>)>>);

struct Finding {
    figures: Figures,
    /// PNG, with a scale bar and without.
    heat_map: Bytes,
    bare_heat_map: Bytes,
}

/// Which of the two pictures.
#[derive(Clone, Copy, Debug)]
enum Side {
    A,
    B,
}

impl Side {
    fn name(self) -> &'static str {
        match self {
            Self::A => "a",
            Self::B => "b",
        }
    }
}

/// Where the pictures of a comparison are named, for problems.
#[derive(Clone, Copy)]
enum Asked {
    /// In a JSON body.
    Body,
    /// In an address.
    Address,
}

impl Asked {
    fn problem(self, side: Side, error: &PictureError) -> ApiError {
        let side = side.name();
        let pointer = match (self, error) {
            (Self::Body, PictureError::NotLinear(_)) => "/hdr".to_owned(),
            (Self::Address, PictureError::NotLinear(_)) => "query/hdr".to_owned(),
            (Self::Body, PictureError::NoLayer(_)) => format!("/{side}/layer"),
            (Self::Body, PictureError::Unreadable(_)) => format!("/{side}"),
            (Self::Address, PictureError::NoLayer(_)) => format!("query/{side}_layer"),
            (Self::Address, PictureError::Unreadable(_)) => format!("path/{side}"),
        };
        ApiError::fields(vec![FieldError::new(pointer, error.to_string())])
    }
}

impl Comparisons {
    fn find(&self, key: &ComparisonKey) -> Option<Arc<Finding>> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().find(|(known, _)| known == key).map(|(_, finding)| Arc::clone(finding))
    }

    fn keep(&self, key: ComparisonKey, finding: Arc<Finding>) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.truncate(KEPT - 1);
        kept.push_front((key, finding));
    }
}

impl ComparisonKey {
    /// Address of a picture of the comparison.
    fn href(&self, name: &str) -> String {
        let (a, b) = (escape(&self.a.layer), escape(&self.b.layer));
        let exposure = if self.exposure == 0.0 { String::new() } else { format!("&exposure={}", self.exposure) };
        let hdr = if self.hdr && name == HEAT_MAP { "&hdr=true" } else { "" };
        format!("/v1/compare/{}/{}/{name}?a_layer={a}&b_layer={b}{exposure}{hdr}", self.a.hash, self.b.hash)
    }

    /// The page that shows both.
    fn page(&self) -> String {
        let layer = if self.a.layer == COLOR { String::new() } else { format!("&layer={}", escape(&self.a.layer)) };
        format!("/compare?p={}&p={}{layer}", self.a.hash, self.b.hash)
    }

    fn options(&self) -> Options {
        Options { exposure: self.exposure, tolerance: self.tolerance, ..Options::default() }
    }
}

impl App {
    /// Reads a comparison whose pictures are uploaded: a part `a`, a part `b`, or both, and `request` with the rest.
    pub async fn receive_comparison(&self, request: Request) -> ApiResult<(CompareRequest, UploadedPictures)> {
        let limits = &self.config.limits;
        let mut multipart = multipart::open(request, limits.picture_bytes.saturating_mul(2)).await?;
        let (mut wanted, mut uploads) = (CompareRequest::default(), UploadedPictures::default());
        while let Some(field) = self.next_part(&mut multipart).await? {
            match field.name() {
                Some("request") => wanted = parse(&self.read_part(field, limits.json_bytes).await?)?,
                Some(name @ ("a" | "b")) => {
                    let place = if name == "a" { &mut uploads.a } else { &mut uploads.b };
                    let stream = Box::pin(field.map_err(|error| error.body_text()));
                    *place = Some(self.blobs.stage(stream, limits.picture_bytes, limits.upload_stall).await?);
                }
                _ => return Err(ApiError::bad_request("body", "the parts must be called a, b and request")),
            }
        }
        Ok((wanted, uploads))
    }

    /// Compares two pictures. Uploaded ones are kept as blobs, a week at least.
    pub async fn compare(&self, wanted: &CompareRequest, uploads: UploadedPictures) -> ApiResult<Compared> {
        self.check_running()?;
        let mut errors = wanted.validate("");
        let mut pictures = Vec::new();
        for (side, choice, upload) in [(Side::A, &wanted.a, uploads.a), (Side::B, &wanted.b, uploads.b)] {
            match self.find_picture(choice, upload).await? {
                Ok(hash) => {
                    let layer = choice.layer.clone().unwrap_or_else(|| COLOR.to_owned());
                    pictures.push(ComparedPicture { hash, layer });
                }
                Err((field, detail)) => errors.push(FieldError::new(format!("/{}{field}", side.name()), detail)),
            }
        }
        let (true, Ok([a, b])) = (errors.is_empty(), <[ComparedPicture; 2]>::try_from(pictures)) else {
            return Err(ApiError::fields(errors));
        };
        let hdr = wanted.wants_hdr();
        let key = ComparisonKey { a, b, exposure: wanted.exposure, tolerance: wanted.tolerance, hdr };
        let found = self.find_or_compare(&key, Asked::Body).await?;
        let bounds = Bounds::of(wanted);
        Ok(Compared {
            report: comparing::report(&found.figures, bounds),
            heat_map: key.href(HEAT_MAP),
            difference: key.href("difference.png"),
            page: key.page(),
            a: key.a,
            b: key.b,
        })
    }

    /// A job that compares, with the blobs of its pictures filled in, which stay what they are, and with the scene of a job
    /// whose picture it is, where it names none; or what is wrong with it.
    pub(super) async fn with_pictures(
        &self,
        new: &NewJob,
        request: &CompareRequest,
    ) -> ApiResult<Result<NewJob, Vec<FieldError>>> {
        let (mut found, mut errors) = (request.clone(), Vec::new());
        let mut scene = Some(new.scene.clone()).filter(|scene| !scene.is_empty());
        for (side, choice) in [(Side::A, &mut found.a), (Side::B, &mut found.b)] {
            let pointer = format!("/settings/{}", side.name());
            if choice.job.is_none() && choice.blob.is_none() {
                errors.push(FieldError::new(pointer, "must name a job or a blob"));
                continue;
            }
            match self.find_picture(choice, None).await? {
                Ok(hash) => choice.blob = Some(hash),
                Err((field, detail)) => errors.push(FieldError::new(format!("{pointer}{field}"), detail)),
            }
            if let (None, Some(job)) = (&scene, &choice.job) {
                scene = self.store.job(job).await?.map(|job| job.summary.scene);
            }
        }
        match scene {
            Some(scene) if errors.is_empty() => {
                let settings = JobSettings::Compare(Box::new(found));
                return Ok(Ok(NewJob { scene, settings, ..new.clone() }));
            }
            None if errors.is_empty() => {
                errors.push(FieldError::new("/scene", "must name a scene: neither picture is a job's"));
            }
            _ => {}
        }
        Ok(Err(errors))
    }

    /// The FLIP or HDR-FLIP error of every pixel as a PNG, with a scale bar beside it or alone.
    pub async fn heat_map(&self, key: &ComparisonKey, scale: bool) -> ApiResult<Bytes> {
        let found = self.find_or_compare(key, Asked::Address).await?;
        Ok(if scale { &found.heat_map } else { &found.bare_heat_map }.clone())
    }

    /// The absolute difference times `gain` as a PNG.
    pub async fn difference(&self, key: &ComparisonKey, gain: f32) -> ApiResult<Bytes> {
        let drawn = self.with_pair(key, Asked::Address, move |a, b| comparing::difference_png(a, b, gain));
        Ok(drawn.await?.into())
    }

    /// The hash of a chosen picture; or the field that is wrong, and why.
    async fn find_picture(
        &self,
        choice: &PictureChoice,
        upload: Option<Staged>,
    ) -> ApiResult<Result<String, (&'static str, String)>> {
        let wrong = |field: &'static str, detail: &str| Ok(Err((field, detail.to_owned())));
        match (upload, &choice.blob, &choice.job) {
            (Some(staged), None, None) => {
                let hash = staged.hash().to_owned();
                let _in_use = self.blob_use.read().await;
                self.blobs.commit(staged).await.map_err(ApiError::internal)?;
                Ok(Ok(hash))
            }
            (None, Some(blob), None) if !is_hash(blob) => wrong("/blob", "must be 64 lower-case hex digits"),
            (None, Some(blob), None) => match self.blobs.size(blob).await.map_err(ApiError::internal)? {
                Some(_) => Ok(Ok(blob.clone())),
                None => wrong("/blob", "is not in the blob store"),
            },
            (None, None, Some(job)) => self.find_artifact(job, choice.artifact.as_deref()).await,
            (None, Some(blob), Some(job)) => match self.find_artifact(job, choice.artifact.as_deref()).await? {
                Ok(hash) if hash != *blob => wrong("/blob", "must be that of the job's artifact, or left out"),
                found => Ok(found),
            },
            (None, None, None) => wrong("", "must name a job or a blob, or be sent as a part of multipart/form-data"),
            _ => wrong("", "must be one of these: a job or a blob, or a part of multipart/form-data"),
        }
    }

    async fn find_artifact(&self, job: &str, name: Option<&str>) -> ApiResult<Result<String, (&'static str, String)>> {
        if self.store.job_state(job).await?.is_none() {
            let job: String = job.chars().take(128).collect();
            return Ok(Err(("/job", format!("there is no job `{job}`"))));
        }
        let artifacts = self.store.artifacts(job).await?;
        let find = |name: &str| artifacts.iter().find(|artifact| artifact.name == name);
        let found = match name {
            Some(name) => find(name),
            None => PICTURES.into_iter().find_map(find),
        };
        Ok(found.map(|artifact| artifact.hash.clone()).ok_or_else(|| {
            let there: Vec<&str> = artifacts.iter().map(|artifact| artifact.name.as_str()).collect();
            let there = if there.is_empty() { "none yet".to_owned() } else { there.join(", ") };
            ("/artifact", format!("is not among the job's artifacts: it has {there}"))
        }))
    }

    async fn find_or_compare(&self, key: &ComparisonKey, asked: Asked) -> ApiResult<Arc<Finding>> {
        if let Some(known) = self.comparisons.find(key) {
            return Ok(known);
        }
        let (options, hdr) = (key.options(), key.hdr);
        let finding = self.with_pair(key, asked, move |a, b| {
            let outcome = comparing::layers(a, b, &options, hdr)?;
            let heat_map = comparing::heat_map_png(&outcome.error_map)?.into();
            let bare_heat_map = comparing::bare_heat_map_png(&outcome.error_map)?.into();
            Ok(Finding { figures: outcome.figures, heat_map, bare_heat_map })
        });
        let finding = Arc::new(finding.await?);
        self.comparisons.keep(key.clone(), Arc::clone(&finding));
        Ok(finding)
    }

    /// Reads both layers, which must have one size, and works on them when it is their turn.
    async fn with_pair<T, F>(&self, key: &ComparisonKey, asked: Asked, work: F) -> ApiResult<T>
    where
        T: Send + 'static,
        F: FnOnce(&Pixels, &Pixels) -> Result<T, PictureError> + Send + 'static,
    {
        let _turn = self.picture_turn().await?;
        let (first, second) = (self.picture_bytes(&key.a.hash).await?, self.picture_bytes(&key.b.hash).await?);
        let (a_layer, b_layer) = (key.a.layer.clone(), key.b.layer.clone());
        let max_pixels = self.config.limits.compare_pixels;
        let worked = tokio::task::spawn_blocking(move || {
            let a = Pixels::read(&first, &a_layer, max_pixels).map_err(|error| (Side::A, error))?;
            let b = Pixels::read(&second, &b_layer, max_pixels).map_err(|error| (Side::B, error))?;
            drop((first, second));
            if let Some(problem) = comparing::size_problem(&a, &b) {
                return Err((Side::B, PictureError::Unreadable(problem)));
            }
            work(&a, &b).map_err(|error| (Side::B, error))
        });
        worked.await.map_err(ApiError::internal)?.map_err(|(side, error)| asked.problem(side, &error))
    }
}
