//! `/farm/runs/{id}`: the cases of a run with their verdicts, and deciding of many at once.

use askama::Template;
use axum::extract::{Path, Query};
use axum::response::{IntoResponse, Response};
use lightshaft_api::farm::{ConfirmationState, ImageVerdict, Run, RunCase, TimeVerdict};
use lightshaft_api::job::Artifact;
use serde::Deserialize;

use super::super::client::{Api, escape, with_query};
use super::super::filters;
use super::super::page::{Page, PageError};

/// Which cases are shown; nothing shows all.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(in crate::dashboard) struct Filter {
    /// One of [`SHOWN`].
    show: String,
    /// Part of a case's name.
    q: String,
}

/// Name of a filter, what it is called, and which cases it keeps.
type Shown = (&'static str, &'static str, fn(&RunCase) -> bool);

const SHOWN: [Shown; 7] = [
    ("undecided", "Waits for a decision", is_undecided),
    ("changed", "Changed or missing", |case| {
        image(case).is_some_and(|verdict| matches!(verdict, ImageVerdict::Changed | ImageVerdict::Missing))
    }),
    ("slower", "Slower", |case| time(case) == Some(TimeVerdict::Slower)),
    ("noisy", "Too noisy to say", |case| time(case) == Some(TimeVerdict::TooNoisyToSay)),
    ("failed", "Failed", |case| image(case) == Some(ImageVerdict::Failed)),
    ("ok", "Well", |case| case.ok == Some(true)),
    ("unfinished", "Unfinished", |case| case.ok.is_none()),
];

fn image(case: &RunCase) -> Option<ImageVerdict> {
    case.image.as_ref().map(|image| image.verdict)
}

fn time(case: &RunCase) -> Option<TimeVerdict> {
    case.time.as_ref().and_then(|time| time.verdict)
}

fn is_undecided(case: &RunCase) -> bool {
    case.ok == Some(false) && case.decision.is_none()
}

/// A filter with what it would show.
struct Choice {
    title: &'static str,
    count: usize,
    url: String,
    is_current: bool,
}

/// A case with the addresses that its card shows.
struct Cell {
    picture: Option<String>,
    accepted: Option<String>,
    heat_map: Option<String>,
    /// The page that compares it with the accepted picture.
    compare: Option<String>,
    history: String,
    case: RunCase,
}

impl Cell {
    fn new(case: RunCase, run: &Run) -> Self {
        let find = |name: &str| case.artifacts.iter().find(|artifact| artifact.name == name);
        let address = |name: &str| find(name).map(|artifact| artifact.href.clone());
        let best = |names: [&str; 2]| names.into_iter().find_map(find).map(|artifact: &Artifact| artifact.hash.clone());
        let pair = best(["accepted.exr", "accepted.png"]).zip(best(["image.exr", "image.png"]));
        let class = case.device_class.clone().unwrap_or_default();
        let query = [
            ("suite", run.summary.suite_name.as_str()),
            ("case", &case.name),
            ("device_class", &class),
            ("baseline", &run.summary.baseline),
        ];
        Self {
            picture: address("image.png"),
            accepted: address("accepted.png"),
            heat_map: address("heat-map.png"),
            compare: pair.map(|(accepted, picture)| format!("/compare?p={accepted}&p={picture}&mode=swipe")),
            history: with_query("/farm/history", &query),
            case,
        }
    }

    fn time_verdict(&self) -> Option<&'static str> {
        time(&self.case).map(TimeVerdict::as_str)
    }

    /// What came of running both versions in turns, where that was needed.
    fn confirmation(&self) -> Option<&'static str> {
        let state = self.case.time.as_ref()?.confirmation.state;
        match state {
            ConfirmationState::NotNeeded => None,
            ConfirmationState::Running => Some("both versions run again in turns"),
            ConfirmationState::Confirmed => Some("confirmed by running both versions in turns"),
            ConfirmationState::Refuted => Some("not confirmed by running both versions in turns"),
            ConfirmationState::Impossible => Some("could not be confirmed"),
        }
    }

    fn is_undecided(&self) -> bool {
        is_undecided(&self.case)
    }
}

#[derive(Template)]
#[template(path = "farm_run.html")]
struct RunPage {
    here: &'static str,
    run: Run,
    filter: Filter,
    choices: Vec<Choice>,
    cells: Vec<Cell>,
    /// Finished cases, which can be decided of.
    can_decide: bool,
}

impl RunPage {
    /// Share of the cases that have their verdict.
    fn progress(&self) -> f64 {
        f64::from(self.run.summary.counts.finished) / f64::from(self.run.summary.counts.cases.max(1))
    }
}

pub(in crate::dashboard) async fn show(
    api: Api,
    Path(id): Path<String>,
    Query(filter): Query<Filter>,
) -> Result<Response, PageError> {
    let run: Run = api.get(&format!("/v1/farm/runs/{}", escape(&id))).await?;
    let here = format!("/farm/runs/{}", escape(&id));
    let url = |show: &str| with_query(&here, &[("show", show), ("q", &filter.q)]);
    let mut choices = vec![Choice {
        title: "All",
        count: run.cases.len(),
        url: url(""),
        is_current: !SHOWN.iter().any(|shown| shown.0 == filter.show),
    }];
    for (name, title, keeps) in SHOWN {
        let count = run.cases.iter().filter(|case| keeps(case)).count();
        let is_current = filter.show == name;
        if count > 0 || is_current {
            choices.push(Choice { title, count, url: url(name), is_current });
        }
    }
    let keeps = SHOWN.iter().find(|shown| shown.0 == filter.show).map(|shown| shown.2);
    let text = filter.q.trim().to_lowercase();
    let shown = run.cases.iter().filter(|case| keeps.is_none_or(|keeps| keeps(case)));
    let shown = shown.filter(|case| text.is_empty() || case.name.to_lowercase().contains(&text));
    let page = RunPage {
        here: "farm",
        cells: shown.map(|case| Cell::new(case.clone(), &run)).collect(),
        can_decide: run.cases.iter().any(|case| case.ok.is_some()),
        choices,
        filter,
        run,
    };
    Ok(Page(page).into_response())
}
