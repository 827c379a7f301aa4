//! `/compare`: pictures side by side, over each other, and what sets them apart.
//!
//! The server finds the pictures and says what they are; the script shows them, and keeps how they are seen in the address.
//! `p` names a picture, as often as there are pictures: a job (`019a…`), one of its artifacts (`019a…/image.png`), or a blob
//! by its hash. What else the address may hold, the script reads (`compare-state.js`).

use askama::Template;
use axum::extract::Query;
use axum::response::{IntoResponse, Response};
use lightshaft_api::blob::is_hash;
use lightshaft_api::job::{Job, JobSummary};
use lightshaft_api::page::Page as List;
use lightshaft_api::problem::Problem;

use super::client::{Api, escape};
use super::filters;
use super::job::{JobCard, JobRow};
use super::page::{Page, PageError};

/// More than these are not told apart on a screen.
const MOST: usize = 8;
/// What a job's picture is called, best first.
const PICTURES: [&str; 2] = ["image.exr", "image.png"];

/// A picture that is compared.
struct Chosen {
    /// As the address names it.
    spec: String,
    title: String,
    about: String,
    /// Page of the job.
    page: Option<String>,
    hash: String,
    /// Address of the file; its layers lie below it.
    file: String,
    /// The same picture as a browser can show it by itself.
    png: Option<String>,
}

impl Chosen {
    async fn find(api: &Api, spec: &str) -> Result<Self, PageError> {
        if is_hash(spec) {
            let file = format!("/v1/blobs/{spec}");
            return Ok(Self {
                spec: spec.to_owned(),
                title: format!("File {}", &spec[..8]),
                about: "by its hash".to_owned(),
                page: None,
                hash: spec.to_owned(),
                png: None,
                file,
            });
        }
        let (id, name) = spec.split_once('/').map_or((spec, None), |(id, name)| (id, Some(name)));
        let job: Job = api.get(&format!("/v1/jobs/{}", escape(id))).await?;
        let find = |name: &str| job.artifacts.iter().find(|artifact| artifact.name == name).cloned();
        let artifact = match name {
            Some(name) => find(name),
            None => PICTURES.into_iter().find_map(find),
        };
        let Some(artifact) = artifact else {
            let detail = match name {
                Some(name) => format!("the job {id} has no file `{name}`"),
                None => format!("the job {id} has no picture to compare (yet)"),
            };
            return Err(missing(detail));
        };
        let png = if artifact.name.ends_with(".png") { Some(artifact.clone()) } else { find("image.png") };
        let card = JobCard::new(job);
        Ok(Self {
            spec: spec.to_owned(),
            title: card.row.job.scene_name.clone(),
            about: format!("{}; {}", card.about, artifact.name),
            page: Some(format!("/jobs/{}", escape(id))),
            hash: artifact.hash,
            file: artifact.href,
            png: png.map(|artifact| artifact.href),
        })
    }

    fn letter(index: &usize) -> char {
        char::from(b'A' + u8::try_from(*index).unwrap_or_default())
    }
}

fn missing(detail: String) -> PageError {
    PageError::Problem(Box::new(Problem {
        kind: "/problems/not-found".to_owned(),
        code: "not-found".to_owned(),
        title: "There is no such picture".to_owned(),
        status: 404,
        detail,
        errors: Vec::new(),
        instance: None,
        request_id: None,
    }))
}

#[derive(Template)]
#[template(path = "compare.html")]
struct ComparePage {
    here: &'static str,
    pictures: Vec<Chosen>,
    /// Jobs to choose from.
    recent: Vec<JobRow>,
    is_full: bool,
}

pub(super) async fn show(api: Api, Query(query): Query<Vec<(String, String)>>) -> Result<Response, PageError> {
    let mut pictures = Vec::new();
    let specs = query.iter().filter(|(name, spec)| name == "p" && !spec.trim().is_empty());
    for (_, spec) in specs.take(MOST) {
        pictures.push(Chosen::find(&api, spec.trim()).await?);
    }
    let recent: List<JobSummary> = api.get("/v1/jobs?kind=render&state=succeeded&automatic=false&limit=50").await?;
    let page = ComparePage {
        here: "compare",
        is_full: pictures.len() >= MOST,
        pictures,
        recent: recent.items.into_iter().map(|job| JobRow { job }).collect(),
    };
    Ok(Page(page).into_response())
}
