//! `/jobs/{id}`: one job, its picture as it comes, and everything that is known about it.

use askama::Template;
use axum::extract::Path;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lightshaft_api::job::{
    Artifact, Attempt, AttemptOutcome, Job, JobKind, JobState, JobSummary, Metrics, Task, TaskWork,
};
use lightshaft_api::page::Page as List;
use lightshaft_api::scene::Scene;
use lightshaft_api::settings::{Effect, JobSettings, RenderSettings};

use super::client::{Api, escape};
use super::page::{Page, PageError};
use super::{benchmark, comparison, filters, form};

/// A job in a list, with the times that its pages show.
pub(super) struct JobRow {
    pub(super) job: JobSummary,
}

impl JobRow {
    pub(super) fn is_final(&self) -> bool {
        self.job.state.is_final()
    }

    /// Whether there is a picture to compare.
    pub(super) fn has_picture(&self) -> bool {
        self.job.kind == JobKind::Render && self.job.state == JobState::Succeeded
    }

    /// Seconds from start to end, or until now.
    pub(super) fn duration_s(&self) -> Option<f64> {
        let end = self.job.finished_at.unwrap_or_else(Timestamp::now);
        self.job.started_at.map(|start| seconds_between(start, end))
    }

    /// Seconds left, were the rest as quick as what was done; `None` while too little is done to tell: the first tenth
    /// is for fetching and structures, and says nothing of the speed of rendering.
    pub(super) fn remaining_s(&self) -> Option<f64> {
        let progress = self.job.progress;
        let known = self.job.state == JobState::Running && progress >= 0.15;
        known.then(|| self.duration_s()).flatten().map(|elapsed| elapsed * (1.0 - progress) / progress)
    }
}

/// A job with its picture.
pub(super) struct JobCard {
    pub(super) row: JobRow,
    /// Of its picture, should it have one.
    pub(super) settings: RenderSettings,
    /// Address of the finished picture.
    pub(super) picture: Option<String>,
    /// Address of the picture so far.
    pub(super) preview: Option<String>,
    /// What it does, in words.
    pub(super) about: String,
    pub(super) is_render: bool,
}

impl JobCard {
    pub(super) fn new(job: Job) -> Self {
        Self {
            picture: job.artifacts.iter().find(|artifact| artifact.name == "image.png").map(|a| a.href.clone()),
            preview: job.preview,
            about: about(&job.settings),
            is_render: matches!(job.settings, JobSettings::Render(_)),
            settings: match job.settings {
                JobSettings::Render(settings) => *settings,
                JobSettings::Benchmark(_) | JobSettings::Build(_) | JobSettings::Compare(_) => {
                    RenderSettings::default()
                }
            },
            row: JobRow { job: job.summary },
        }
    }

    /// The whole jobs of a list. One that vanished in between is left out.
    pub(super) async fn of_list(api: &Api, path: &str) -> Result<Vec<Self>, PageError> {
        let list: List<JobSummary> = api.get(path).await?;
        let mut cards = Vec::with_capacity(list.items.len());
        for summary in list.items {
            cards.extend(api.find(&format!("/v1/jobs/{}", escape(&summary.id))).await?.map(Self::new));
        }
        Ok(cards)
    }
}

fn about(settings: &JobSettings) -> String {
    match settings {
        JobSettings::Render(s) => {
            let integrator = filters::human_words(&form::name_of(&s.integrator));
            format!("{integrator}, {} × {}, {} spp", s.width, s.height, s.spp)
        }
        JobSettings::Benchmark(settings) => format!("benchmark: {}", settings.describe()),
        JobSettings::Build(settings) => format!("build: {}", settings.acceleration.describe()),
        JobSettings::Compare(request) => format!("comparing {}", request.describe()),
    }
}

fn seconds_between(start: Timestamp, end: Timestamp) -> f64 {
    end.duration_since(start).as_secs_f64().max(0.0)
}

/// A task and every attempt at it, newest last.
struct TaskRow {
    task: Task,
    work: String,
    attempts: Vec<AttemptCell>,
}

struct AttemptCell {
    attempt: Attempt,
    duration_s: f64,
}

/// One piece of a stacked bar, in thousandths of its width.
struct Segment {
    label: &'static str,
    /// Names the colour in the style sheet.
    class: &'static str,
    value: f64,
    share: f64,
    x: f64,
    width: f64,
}

fn stack(parts: &[(&'static str, &'static str, f64)]) -> Vec<Segment> {
    let total: f64 = parts.iter().map(|(_, _, value)| value).sum();
    let mut x = 0.0;
    parts
        .iter()
        .filter(|(_, _, value)| *value > 0.0)
        .map(|&(label, class, value)| {
            let share = value / total;
            let segment = Segment { label, class, value, share, x, width: share * 1000.0 };
            x += segment.width;
            segment
        })
        .collect()
}

struct Measured {
    metrics: Metrics,
    phases: Vec<Segment>,
    rays: Vec<Segment>,
    rays_total: u64,
}

impl Measured {
    fn new(metrics: Metrics) -> Self {
        let m = &metrics;
        let named = m.scene_s + m.build_s + m.prepare_s + m.render_s + m.output_s;
        let phases = stack(&[
            ("Scene", "c1", m.scene_s),
            ("Structures", "c2", m.build_s),
            ("Prepare", "c3", m.prepare_s),
            ("Render", "c4", m.render_s),
            ("Output", "c5", m.output_s),
            ("Other", "c6", (m.total_s - named).max(0.0)),
        ]);
        let r = m.rays;
        let rays = stack(&[
            ("Primary", "c1", r.primary as f64),
            ("Shadow", "c2", r.shadow as f64),
            ("Ambient occlusion", "c3", r.ao as f64),
            ("Indirect", "c4", r.indirect as f64),
        ]);
        Self { phases, rays, rays_total: r.primary + r.shadow + r.ao + r.indirect, metrics }
    }
}

#[derive(Template)]
#[template(path = "job.html")]
struct JobPage {
    here: &'static str,
    card: JobCard,
    max_attempts: u32,
    phase: Option<&'static str>,
    waiting: Option<String>,
    tasks: Vec<TaskRow>,
    measured: Option<Measured>,
    found: Option<benchmark::Found>,
    compared: Option<comparison::Found>,
    settings: Vec<(&'static str, Vec<(String, String)>)>,
    settings_json: String,
    artifacts: Vec<Artifact>,
}

pub(super) async fn show(api: Api, Path(id): Path<String>) -> Result<Response, PageError> {
    let mut job: Job = api.get(&format!("/v1/jobs/{}", escape(&id))).await?;
    let scene: Option<Scene> = api.find(&format!("/v1/scenes/{}", escape(&job.summary.scene))).await?;
    let running = job.attempts.iter().rev().find(|attempt| attempt.outcome == AttemptOutcome::Running);
    let page = JobPage {
        here: "jobs",
        max_attempts: job.max_attempts,
        phase: running.and_then(|attempt| attempt.phase).map(|phase| phase.as_str()),
        waiting: job.waiting.take(),
        tasks: task_rows(&job),
        found: benchmark::Found::of(&api, &job).await?,
        compared: comparison::Found::of(&api, &job).await?,
        settings: summary(&job.settings, scene.as_ref()),
        settings_json: serde_json::to_string_pretty(&job.settings).unwrap_or_default(),
        measured: job.metrics.take().map(Measured::new),
        artifacts: job.artifacts.clone(),
        card: JobCard::new(job),
    };
    Ok(Page(page).into_response())
}

/// Settings as label and value.
fn summary(settings: &JobSettings, scene: Option<&Scene>) -> Vec<(&'static str, Vec<(String, String)>)> {
    let row = |label: &str, value: String| (label.to_owned(), value);
    match settings {
        JobSettings::Render(settings) => form::summary(settings, scene),
        JobSettings::Compare(request) => {
            let limits = [("RMSE", request.max_rmse), ("FLIP", request.max_flip), ("HDR-FLIP", request.max_hdr_flip)];
            let limits =
                limits.into_iter().filter_map(|(name, limit)| Some(row(&format!("Most {name}"), limit?.to_string())));
            let mut rows = vec![row("Reference", request.a.describe()), row("Compared with it", request.b.describe())];
            rows.push(row("Exposure", format!("{} stops", request.exposure)));
            rows.push(row("Tolerance", request.tolerance.to_string()));
            rows.extend(limits);
            vec![("Comparison", rows)]
        }
        JobSettings::Build(settings) => vec![("Build", vec![row("Structures", settings.acceleration.describe())])],
        JobSettings::Benchmark(settings) => {
            let effects: Vec<String> = settings.effects.iter().map(Effect::describe).collect();
            let names: Vec<&str> = settings.configurations.iter().map(|c| c.name.as_str()).collect();
            let mut rows = vec![row("Benchmark", settings.describe())];
            if !effects.is_empty() {
                rows.push(row("Effects", effects.join("; ")));
                rows.push(row("Configurations", names.join("; ")));
            }
            rows.push(row("Rounds", settings.repetitions.to_string()));
            vec![("Benchmark", rows)]
        }
    }
}

fn task_rows(job: &Job) -> Vec<TaskRow> {
    let now = Timestamp::now();
    let cells = |task: &Task| {
        let of_task = job.attempts.iter().filter(|attempt| attempt.task == task.id);
        let mut cells: Vec<_> = of_task
            .map(|attempt| AttemptCell {
                duration_s: seconds_between(attempt.started_at, attempt.finished_at.unwrap_or(now)),
                attempt: attempt.clone(),
            })
            .collect();
        cells.sort_by_key(|cell| cell.attempt.number);
        cells
    };
    job.tasks
        .iter()
        .map(|task| TaskRow { work: describe(&task.work), attempts: cells(task), task: task.clone() })
        .collect()
}

fn describe(work: &TaskWork) -> String {
    match work {
        TaskWork::Frame => "Whole picture".to_owned(),
        TaskWork::Tile { x, y, width, height } => format!("Tile {width} × {height} at {x}, {y}"),
        TaskWork::Pass { first_sample, samples } => {
            format!("Samples {first_sample} to {}", first_sample.saturating_add(*samples).saturating_sub(1))
        }
        TaskWork::Merge => "Put the parts together".to_owned(),
        TaskWork::Benchmark => "The whole benchmark".to_owned(),
        TaskWork::Build => "All structures".to_owned(),
        TaskWork::Compare => "The whole comparison".to_owned(),
    }
}
