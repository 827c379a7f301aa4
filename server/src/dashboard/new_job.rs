//! `/jobs/new`: the form that submits a job, empty, for a scene, or filled from an earlier job.

use std::collections::BTreeMap;

use askama::Template;
use axum::extract::Query;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use lightshaft_api::job::{Job, RESERVED_LABEL_PREFIX};
use lightshaft_api::page::Page as List;
use lightshaft_api::scene::Scene;
use lightshaft_api::settings::{CameraChoice, JobSettings, RenderSettings};
use serde::Deserialize;

use super::client::{Api, escape};
use super::filters;
use super::form::{self, Control, Field, Section};
use super::overview::base_url;
use super::page::{Page, PageError};

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Start {
    /// Scene to render.
    scene: String,
    /// Index of one of its cameras.
    camera: String,
    /// Job whose scene, settings and labels to start from.
    from: String,
}

#[derive(Template)]
#[template(path = "new_job.html")]
struct NewJobPage {
    here: &'static str,
    scenes: Vec<Scene>,
    scene: Option<Scene>,
    from: Option<String>,
    sections: Vec<Section>,
    lights: Vec<Vec<Field>>,
    /// Fields of one more light, with `__N__` for its number.
    blank_light: Vec<Field>,
    labels: String,
    priority: i32,
    max_attempts: String,
    base_url: String,
}

impl NewJobPage {
    fn is_chosen(&self, option: &Scene) -> bool {
        self.scene.as_ref().is_some_and(|scene| scene.id == option.id)
    }
}

pub(super) async fn show(api: Api, headers: HeaderMap, Query(start): Query<Start>) -> Result<Response, PageError> {
    let origin: Option<Job> = match start.from.as_str() {
        "" => None,
        id => Some(api.get(&format!("/v1/jobs/{}", escape(id))).await?),
    };
    let wanted = match (&start.scene, &origin) {
        (scene, Some(job)) if scene.is_empty() => job.summary.scene.clone(),
        (scene, _) => scene.clone(),
    };
    let mut scenes: Vec<Scene> = api.get::<List<Scene>>("/v1/scenes?limit=200").await?.items;
    let scene: Option<Scene> = match wanted.as_str() {
        "" => scenes.first().cloned(),
        id => Some(api.get(&format!("/v1/scenes/{}", escape(id))).await?),
    };
    if let Some(scene) = scene.as_ref().filter(|scene| scenes.iter().all(|known| known.id != scene.id)) {
        scenes.insert(0, scene.clone());
    }
    let mut settings = match origin.as_ref().map(|job| &job.settings) {
        Some(JobSettings::Render(settings)) => (**settings).clone(),
        Some(JobSettings::Benchmark(_) | JobSettings::Build(_) | JobSettings::Compare(_)) | None => {
            RenderSettings::default()
        }
    };
    if let Ok(camera) = start.camera.parse() {
        settings.camera = Some(CameraChoice::Index(camera));
    }
    let page = NewJobPage {
        here: "jobs",
        scenes,
        sections: form::sections(&settings, scene.as_ref()),
        scene,
        lights: (0..)
            .zip(&settings.lights)
            .map(|(n, light): (u32, _)| form::light::fields(&n.to_string(), light))
            .collect(),
        blank_light: form::light::fields("__N__", &form::light::new()),
        labels: origin.as_ref().map_or_else(String::new, |job| label_lines(&job.summary.labels)),
        priority: origin.as_ref().map_or(0, |job| job.summary.priority),
        max_attempts: origin.as_ref().map_or_else(String::new, |job| job.max_attempts.to_string()),
        from: origin.map(|job| job.summary.id),
        base_url: base_url(&headers),
    };
    Ok(Page(page).into_response())
}

/// One `key=value` a line; without the service's own labels, which a request may not set.
fn label_lines(labels: &BTreeMap<String, String>) -> String {
    let own = labels.iter().filter(|(key, _)| !key.starts_with(RESERVED_LABEL_PREFIX));
    own.map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>().join("\n")
}
