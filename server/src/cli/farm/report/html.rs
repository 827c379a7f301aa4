//! One HTML file with everything inside: it can be kept as an artifact of a CI, or sent by mail.

use std::collections::BTreeMap;
use std::io::Cursor;

use askama::Template;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::imageops::FilterType;
use image::{ImageFormat, ImageReader, Limits};
use lightshaft_api::client::Client;
use lightshaft_api::farm::{ImageVerdict, Run, RunCase, TimeResult};

use super::markdown::headline;
use crate::cli::error::{CliError, Result};
use crate::cli::farm::words::{self, Standing};

/// Longest edge of an embedded picture, pixels: larger ones are scaled down, so that the file can be opened.
const LONGEST_EDGE: u32 = 960;
/// Memory for decoding one of them.
const MAX_ALLOC_BYTES: u64 = 2 << 30;

/// Artifacts of a case that the report shows, and what they are to people.
const SHOWN: [(&str, &str); 4] = [
    ("accepted.png", "accepted"),
    ("image.png", "this run"),
    ("heat-map.png", "FLIP error"),
    ("difference.png", "difference"),
];

/// PNG files as data URIs, by case and artifact.
pub(super) type Pictures = BTreeMap<(String, String), String>;

/// Fetches what the report shows. Of a case whose pixels are the accepted ones, that is one picture.
pub(super) async fn pictures(run: &Run, client: &Client) -> Result<Pictures> {
    let mut pictures = Pictures::new();
    for case in &run.cases {
        let is_identical = case.image.as_ref().is_some_and(|image| image.verdict == ImageVerdict::Identical);
        for (name, _) in SHOWN {
            if case.artifacts.iter().any(|artifact| artifact.name == name) && (!is_identical || name == "image.png") {
                let png = client.case_artifact(&run.summary.id, &case.name, name).await?;
                pictures.insert((case.name.clone(), name.to_owned()), data_uri(&png)?);
            }
        }
    }
    Ok(pictures)
}

/// A PNG as a data URI, scaled down where it is large.
pub(super) fn data_uri(png: &[u8]) -> Result<String> {
    let unreadable = |error: image::ImageError| CliError::system(format!("a picture of the run is no PNG: {error}"));
    let mut reader = ImageReader::with_format(Cursor::new(png), ImageFormat::Png);
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_ALLOC_BYTES);
    reader.limits(limits);
    let picture = reader.decode().map_err(unreadable)?;
    let mut scaled = Vec::new();
    let bytes = if picture.width().max(picture.height()) > LONGEST_EDGE {
        let small = picture.resize(LONGEST_EDGE, LONGEST_EDGE, FilterType::Triangle);
        small.write_to(&mut Cursor::new(&mut scaled), ImageFormat::Png).map_err(unreadable)?;
        &scaled
    } else {
        png
    };
    Ok(format!("data:image/png;base64,{}", STANDARD.encode(bytes)))
}

#[derive(Template)]
#[template(path = "report.html")]
struct Page<'a> {
    suite: &'a str,
    headline: String,
    facts: Vec<(&'static str, String)>,
    labels: &'a BTreeMap<String, String>,
    page: &'a str,
    cases: Vec<Case<'a>>,
}

struct Case<'a> {
    name: &'a str,
    standing: &'static str,
    is_open: bool,
    image: String,
    time: String,
    reason: &'a str,
    figures: String,
    decision: String,
    device: &'a str,
    pictures: Vec<(&'static str, &'a str)>,
    chart: Option<Chart>,
}

/// Times as dots over the baseline's quartiles; places are percents of the width.
struct Chart {
    band: Option<Band>,
    dots: Vec<f64>,
    least: String,
    most: String,
    text: String,
}

struct Band {
    left: f64,
    width: f64,
    median: f64,
}

pub(super) fn report(run: &Run, pictures: &Pictures, page: &str) -> Result<String> {
    let summary = &run.summary;
    let mut cases: Vec<&RunCase> = run.cases.iter().collect();
    // What needs a look comes first.
    cases.sort_by_key(|case| Standing::of(case));
    let html = Page {
        suite: &summary.suite_name,
        headline: headline(run),
        facts: vec![
            ("label", summary.label.clone()),
            ("baseline", summary.baseline.clone()),
            ("cases", format!("{} of {} are well", summary.counts.ok, summary.counts.cases)),
            ("begun", format!("{:.0}", summary.created_at)),
            ("run", summary.id.clone()),
        ],
        labels: &summary.labels,
        page,
        cases: cases.into_iter().map(|case| shown(case, pictures)).collect(),
    };
    html.render().map_err(|error| CliError::system(format!("the report could not be written: {error}")))
}

fn shown<'a>(case: &'a RunCase, pictures: &'a Pictures) -> Case<'a> {
    let standing = Standing::of(case);
    let key = |name: &str| (case.name.clone(), name.to_owned());
    Case {
        name: &case.name,
        standing: standing.as_str(),
        is_open: standing < Standing::Approved,
        image: words::image(case),
        time: words::time(case),
        reason: case.time.as_ref().map_or("", |time| &time.reason),
        figures: words::figures(case),
        decision: words::decision(case),
        device: case.device_class.as_deref().unwrap_or_default(),
        pictures: SHOWN.iter().filter_map(|(name, title)| Some((*title, pictures.get(&key(name))?.as_str()))).collect(),
        chart: case.time.as_ref().and_then(chart),
    }
}

fn chart(time: &TimeResult) -> Option<Chart> {
    let spread = time.baseline.as_ref();
    let ends = spread.into_iter().flat_map(|spread| [spread.lower_quartile_s, spread.upper_quartile_s]);
    let all: Vec<f64> = time.samples_s.iter().copied().chain(ends).filter(|s| s.is_finite()).collect();
    let least = all.iter().copied().reduce(f64::min)?;
    let most = all.iter().copied().reduce(f64::max)?;
    // Some air on both sides, and a scale also where all are the same.
    let air = ((most - least) * 0.08).max(most * 0.02).max(1e-9);
    let (from, to) = (least - air, most + air);
    let place = |seconds: f64| 100.0 * (seconds - from) / (to - from);
    let median = time.spread.as_ref().map(|spread| words::seconds(spread.median_s)).unwrap_or_default();
    let text = match spread {
        Some(spread) => format!("median {median}; the baseline's {}", words::seconds(spread.median_s)),
        None => format!("median {median}"),
    };
    Some(Chart {
        band: spread.map(|spread| Band {
            left: place(spread.lower_quartile_s),
            width: (place(spread.upper_quartile_s) - place(spread.lower_quartile_s)).max(0.5),
            median: place(spread.median_s),
        }),
        dots: time.samples_s.iter().map(|&s| place(s)).collect(),
        least: words::seconds(least),
        most: words::seconds(most),
        text,
    })
}
