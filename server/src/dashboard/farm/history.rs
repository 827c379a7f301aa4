//! `/farm/history`: a case over its labels: times with their noise, pictures, decisions.

use askama::Template;
use axum::extract::Query;
use axum::response::{IntoResponse, Response};
use lightshaft_api::farm::{AcceptedPicture, History, HistoryPoint, TimeVerdict};
use serde::Deserialize;

use super::super::client::{Api, with_query};
use super::super::filters;
use super::super::page::{Page, PageError};
use super::chart::{self, Chart};

/// Which case.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(in crate::dashboard) struct Case {
    suite: String,
    case: String,
    device_class: String,
    baseline: String,
}

impl Case {
    fn url(&self, path: &str, device_class: &str) -> String {
        let pairs = [
            ("suite", self.suite.as_str()),
            ("case", &self.case),
            ("device_class", device_class),
            ("baseline", &self.baseline),
        ];
        with_query(path, &pairs)
    }
}

#[derive(Template)]
#[template(path = "farm_history.html")]
struct HistoryPage {
    here: &'static str,
    history: History,
    /// Every class of devices, its page, and whether it is this one.
    classes: Vec<(String, String, bool)>,
    chart: Option<Chart>,
}

impl HistoryPage {
    fn time_verdict(point: &HistoryPoint) -> Option<&'static str> {
        point.time.map(TimeVerdict::as_str)
    }

    /// Where an accepted picture can be looked at.
    fn picture(accepted: &AcceptedPicture) -> Option<&str> {
        let png = accepted.artifacts.iter().find(|artifact| artifact.media_type == "image/png");
        png.map(|artifact| artifact.href.as_str())
    }

    /// Newest first.
    fn newest(&self) -> impl Iterator<Item = &HistoryPoint> {
        self.history.points.iter().rev()
    }
}

pub(in crate::dashboard) async fn show(api: Api, Query(case): Query<Case>) -> Result<Response, PageError> {
    let history: History = api.get(&case.url("/v1/farm/history", &case.device_class)).await?;
    let classes = history.device_classes.iter();
    let page = HistoryPage {
        here: "farm",
        classes: classes
            .map(|class| (class.clone(), case.url("/farm/history", class), *class == history.device_class))
            .collect(),
        chart: chart::of(&history),
        history,
    };
    Ok(Page(page).into_response())
}
