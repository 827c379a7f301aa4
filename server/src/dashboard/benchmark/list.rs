//! `/benchmarks`: what benchmarks found, put together by scene, effect and device, and ordered by a parameter.
//!
//! Speeds compare only where scene, effect, device and size are the same: each of these has its own table and charts, with
//! the configurations of all benchmarks that measured it.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use askama::Template;
use axum::extract::Query;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lightshaft_api::benchmark::{BenchmarkResults, Column, Comparison, Row, SceneResults};
use lightshaft_api::job::{JobState, JobSummary};
use lightshaft_api::page::Page as List;
use lightshaft_worker::benchmark::report::{self, RESULTS_JSON};
use serde::Deserialize;
use serde_json::Value;

use super::bars::Bars;
use super::scatter::{self, Scatter};
use crate::dashboard::client::{Api, escape, with_query};
use crate::dashboard::filters;
use crate::dashboard::job::JobRow;
use crate::dashboard::page::{Page, PageError};

/// Benchmarks of a page of the list, whose results are read.
const PAGE: u32 = 20;
/// What a table shows of each configuration; what the paper found where any of them is in a paper.
const COLUMNS: [Column; 16] = [
    Column::MraysPerS,
    Column::PaperMraysPerS,
    Column::PaperFps,
    Column::Ratio,
    Column::PaperRatio,
    Column::InitS,
    Column::PaperInitS,
    Column::StructureMb,
    Column::PaperSizeMb,
    Column::PaperNodes,
    Column::LineSpaceMb,
    Column::PaperLineSpaceMb,
    Column::PaperLineSpaces,
    Column::Rmse,
    Column::PaperRmse,
    Column::Flip,
];
/// Those that are there even when nothing stands in them.
const OWN_COLUMNS: [Column; 7] = [
    Column::MraysPerS,
    Column::Ratio,
    Column::InitS,
    Column::StructureMb,
    Column::LineSpaceMb,
    Column::Rmse,
    Column::Flip,
];

/// As the form of the page sends it: empty means any.
#[derive(Clone, Default, Deserialize)]
#[serde(default)]
pub(in crate::dashboard) struct Filter {
    scene: String,
    device: String,
    /// A parameter of structures, such as `line_space.n`: what rows are ordered by.
    by: String,
    cursor: String,
}

impl Filter {
    fn any(&self) -> bool {
        [&self.scene, &self.device, &self.by].iter().any(|filter| !filter.is_empty())
    }

    fn url(&self, cursor: &str) -> String {
        let pairs = [("scene", &*self.scene), ("device", &self.device), ("by", &self.by), ("cursor", cursor)];
        with_query("/benchmarks", &pairs)
    }
}

/// The results of a job.
struct Measured {
    job: String,
    at: Timestamp,
    results: BenchmarkResults,
}

/// What can be compared: one scene, effect, device and size.
struct Group {
    title: String,
    note: String,
    headings: Vec<&'static str>,
    lines: Vec<Line>,
    bars: Vec<Bars>,
    charts: Vec<Scatter>,
}

/// A configuration.
struct Line {
    job: String,
    /// Of the parameter that was asked for.
    value: String,
    cells: Vec<String>,
    row: Row,
}

#[derive(Template)]
#[template(path = "benchmarks.html")]
struct BenchmarksPage {
    here: &'static str,
    jobs: Vec<JobRow>,
    groups: Vec<Group>,
    scenes: BTreeSet<String>,
    devices: BTreeSet<String>,
    parameters: BTreeSet<String>,
    filter: Filter,
    first: Option<String>,
    next: Option<String>,
}

pub(in crate::dashboard) async fn show(api: Api, Query(filter): Query<Filter>) -> Result<Response, PageError> {
    let path = with_query(&format!("/v1/jobs?kind=benchmark&limit={PAGE}"), &[("cursor", &filter.cursor)]);
    let jobs: List<JobSummary> = api.get(&path).await?;
    let mut measured = Vec::new();
    for job in jobs.items.iter().filter(|job| job.state == JobState::Succeeded) {
        let path = format!("/v1/jobs/{}/artifacts/{RESULTS_JSON}", escape(&job.id));
        let results: Option<BenchmarkResults> = api.find(&path).await?;
        measured.extend(results.map(|results| Measured { job: job.id.clone(), at: job.created_at, results }));
    }
    let scenes = measured.iter().flat_map(|m| &m.results.scenes);
    let page = BenchmarksPage {
        here: "benchmarks",
        scenes: scenes.clone().map(|scene| scene.name.clone()).collect(),
        devices: measured.iter().map(|m| m.results.device.clone()).collect(),
        parameters: parameters(scenes.flat_map(|scene| &scene.comparisons).flat_map(|comparison| &comparison.rows)),
        groups: groups(&measured, &filter),
        first: (!filter.cursor.is_empty()).then(|| filter.url("")),
        next: jobs.next_cursor.map(|cursor| filter.url(&cursor)),
        jobs: jobs.items.into_iter().map(|job| JobRow { job }).collect(),
        filter,
    };
    Ok(Page(page).into_response())
}

/// Everything that compares, in the order of its title.
fn groups(measured: &[Measured], filter: &Filter) -> Vec<Group> {
    let is_wanted = |filter: &str, value: &str| filter.is_empty() || filter == value;
    let mut all: BTreeMap<(String, String), Vec<Line>> = BTreeMap::new();
    for Measured { job, at, results } in measured.iter().filter(|m| is_wanted(&filter.device, &m.results.device)) {
        for scene in results.scenes.iter().filter(|scene| is_wanted(&filter.scene, &scene.name)) {
            for comparison in &scene.comparisons {
                let lines = all.entry(key(results, scene, comparison)).or_default();
                lines.extend(comparison.rows.iter().map(|row| line(job, *at, row, &filter.by)));
            }
        }
    }
    all.into_iter().map(|((title, note), lines)| group(title, note, lines, &filter.by)).collect()
}

/// Title and note of what compares.
fn key(results: &BenchmarkResults, scene: &SceneResults, comparison: &Comparison) -> (String, String) {
    let stand_in = if scene.stand_in { " (stand-in)" } else { "" };
    let size = format!("{} × {} pixels, {} spp", results.width, results.height, results.spp);
    (format!("{}{stand_in}: {}", scene.name, comparison.title), format!("{}; {size}", results.device))
}

fn line(job: &str, at: Timestamp, row: &Row, by: &str) -> Line {
    let value = leaves(&row.acceleration).remove(by).unwrap_or_default();
    Line {
        job: job.to_owned(),
        cells: Vec::new(),
        // One name is measured by many benchmarks.
        row: Row { configuration: format!("{}, {}", row.configuration, at.strftime("%m-%d %H:%M")), ..row.clone() },
        value,
    }
}

fn group(title: String, note: String, mut lines: Vec<Line>, by: &str) -> Group {
    if !by.is_empty() {
        lines.sort_by(|a, b| by_value(&a.value, &b.value));
        for line in lines.iter_mut().filter(|line| !line.value.is_empty()) {
            line.row.configuration = format!("{} = {}: {}", by, line.value, line.row.configuration);
        }
    }
    let columns: Vec<Column> = COLUMNS
        .into_iter()
        .filter(|column| {
            OWN_COLUMNS.contains(column) || lines.iter().any(|line| report::cell(*column, &line.row) != report::NONE)
        })
        .collect();
    for line in &mut lines {
        line.cells = columns.iter().map(|&column| report::cell(column, &line.row)).collect();
    }
    let rows: Vec<Row> = lines.iter().map(|line| line.row.clone()).collect();
    let headings = columns.into_iter().map(report::heading).collect();
    Group { title, note, headings, bars: Bars::all(&rows), charts: scatter::charts(&rows), lines }
}

/// Numbers by size, others by name; what has no value comes last.
fn by_value(a: &str, b: &str) -> Ordering {
    let number = |text: &str| text.parse::<f64>().ok();
    match (number(a), number(b)) {
        (Some(a), Some(b)) => a.total_cmp(&b),
        _ => a.is_empty().cmp(&b.is_empty()).then_with(|| a.cmp(b)),
    }
}

/// Names of parameters that differ between these configurations.
fn parameters<'a>(rows: impl Iterator<Item = &'a Row>) -> BTreeSet<String> {
    let all: Vec<BTreeMap<String, String>> = rows.map(|row| leaves(&row.acceleration)).collect();
    let names: BTreeSet<&String> = all.iter().flat_map(BTreeMap::keys).collect();
    let differs = |name: &str| all.iter().map(|row| row.get(name)).collect::<BTreeSet<_>>().len() > 1;
    names.into_iter().filter(|name| differs(name)).cloned().collect()
}

/// Values of an object's fields by their path, such as `line_space.n`; without those that are null.
fn leaves(value: &Value) -> BTreeMap<String, String> {
    fn walk(value: &Value, path: &str, found: &mut BTreeMap<String, String>) {
        match value {
            Value::Null => {}
            Value::Object(fields) => fields.iter().for_each(|(name, field)| {
                let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                walk(field, &path, found);
            }),
            Value::String(text) => drop(found.insert(path.to_owned(), text.clone())),
            other => drop(found.insert(path.to_owned(), other.to_string())),
        }
    }
    let mut found = BTreeMap::new();
    walk(value, "", &mut found);
    found
}

#[cfg(test)]
mod tests {
    use lightshaft_api::benchmark::PaperFigures;
    use serde_json::json;

    use super::super::tests::{results, row};
    use super::*;

    fn with(name: &str, speed: f64, acceleration: Value) -> Row {
        Row { acceleration, ..row(name, Some(speed)) }
    }

    #[test]
    fn the_papers_figures_stand_beside_ours_where_there_are_any() {
        let paper = PaperFigures { ratio: Some(2.39), nodes: Some(1234.0), ..PaperFigures::default() };
        let ls = Row { paper: Some(paper), ..with("LS", 3.0, json!({})) };
        let found = groups(&[measured("j1", vec![with("base", 1.0, json!({})), ls])], &Filter::default());
        let group = &found[0];
        let place = |name: &str| group.headings.iter().position(|heading| *heading == name).unwrap();
        assert_eq!(place("paper: ratio"), place("ratio [95 %]") + 1, "{:?}", group.headings);
        assert_eq!(group.lines[1].cells[place("paper: ratio")], "2.39");
        assert_eq!(group.lines[1].cells[place("paper: nodes")], "1234");
        assert_eq!(group.lines[0].cells.len(), group.headings.len());
        assert!(!group.headings.contains(&"paper: RMSE"), "nobody has one");
    }

    fn measured(job: &str, rows: Vec<Row>) -> Measured {
        Measured { job: job.to_owned(), at: "2026-11-22T10:00:00Z".parse().unwrap(), results: results(rows) }
    }

    #[test]
    fn configurations_of_all_benchmarks_of_one_scene_stand_together_by_a_parameter() {
        let n = |n: u32| json!({ "structure": "two_level", "line_space": { "n": n } });
        let all = [
            measured("j1", vec![with("large", 3.0, n(10)), with("none", 1.0, json!({ "structure": "two_level" }))]),
            measured("j2", vec![with("small", 2.0, n(5))]),
        ];
        let filter = Filter { by: "line_space.n".to_owned(), ..Filter::default() };
        let found = groups(&all, &filter);
        assert_eq!(found.len(), 1, "the same scene, effect and device");
        let order: Vec<(&str, &str)> = found[0].lines.iter().map(|l| (l.value.as_str(), l.job.as_str())).collect();
        assert_eq!(order, [("5", "j2"), ("10", "j1"), ("", "j1")], "by size, and what lacks it last");
        assert_eq!(found[0].bars[0].bars.len(), 3);
        assert!(found[0].headings.iter().all(|heading| !heading.contains("paper")), "{:?}", found[0].headings);
        let rows = all.iter().flat_map(|m| &m.results.scenes[0].comparisons[0].rows);
        assert_eq!(parameters(rows).into_iter().collect::<Vec<_>>(), ["line_space.n"], "what differs");
        let elsewhere = Filter { device: "another".to_owned(), ..Filter::default() };
        assert!(groups(&all, &elsewhere).is_empty());
    }
}
