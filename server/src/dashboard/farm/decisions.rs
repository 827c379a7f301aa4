//! `/farm/decisions`: who approved, rejected and reset what, when and why.

use askama::Template;
use axum::extract::Query;
use axum::response::{IntoResponse, Response};
use lightshaft_api::farm::{Decision, DecisionKind};
use lightshaft_api::page::Page as List;
use serde::Deserialize;

use super::super::client::{Api, with_query};
use super::super::filters;
use super::super::page::{Page, PageError};

/// Filters, as the form of the page sends them: empty means any.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(in crate::dashboard) struct Filter {
    kind: String,
    suite: String,
    case: String,
    who: String,
    cursor: String,
}

impl Filter {
    fn any(&self) -> bool {
        [&self.kind, &self.suite, &self.case, &self.who].iter().any(|filter| !filter.is_empty())
    }

    fn url(&self, path: &str, cursor: &str) -> String {
        let pairs = [
            ("kind", self.kind.trim()),
            ("suite", self.suite.trim()),
            ("case", self.case.trim()),
            ("who", self.who.trim()),
            ("cursor", cursor),
        ];
        with_query(path, &pairs)
    }
}

#[derive(Template)]
#[template(path = "farm_decisions.html")]
struct DecisionsPage {
    here: &'static str,
    decisions: Vec<Decision>,
    filter: Filter,
    kinds: [DecisionKind; 3],
    first: Option<String>,
    next: Option<String>,
}

pub(in crate::dashboard) async fn list(api: Api, Query(filter): Query<Filter>) -> Result<Response, PageError> {
    let decisions: List<Decision> = api.get(&filter.url("/v1/farm/decisions", &filter.cursor)).await?;
    let page = DecisionsPage {
        here: "farm",
        first: (!filter.cursor.is_empty()).then(|| filter.url("/farm/decisions", "")),
        next: decisions.next_cursor.map(|cursor| filter.url("/farm/decisions", &cursor)),
        decisions: decisions.items,
        kinds: [DecisionKind::Approved, DecisionKind::Rejected, DecisionKind::Reset],
        filter,
    };
    Ok(Page(page).into_response())
}
