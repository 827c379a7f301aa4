//! What a benchmark found, on its job's page: tables with whiskers, pictures and heat maps.

mod scatter;

use lightshaft_api::benchmark::{BenchmarkResults, Comparison, Row};
use lightshaft_api::job::{Artifact, Job};
use lightshaft_worker::benchmark::report::{self, RESULTS_CSV, RESULTS_JSON, RESULTS_MARKDOWN, Table};

use self::scatter::Scatter;
pub(super) use self::scatter::{HEIGHT, WIDTH};
use super::client::{Api, escape};
use super::page::PageError;

/// Width of the whiskers' drawing in its own units, less what the end of a whisker needs.
const FULL: f64 = 990.0;

/// A benchmark's results.
pub(super) struct Found {
    pub(super) title: String,
    pub(super) preamble: Vec<String>,
    /// The results as files.
    pub(super) exports: Vec<Artifact>,
    pub(super) comparisons: Vec<Compared>,
}

pub(super) struct Compared {
    pub(super) table: Table,
    pub(super) whiskers: Vec<Whisker>,
    pub(super) charts: Vec<Scatter>,
    pub(super) pictures: Vec<Pair>,
}

/// Speed of one configuration: median and quartiles, on one scale that ends with the greatest upper quartile.
pub(super) struct Whisker {
    pub(super) name: String,
    pub(super) label: String,
    pub(super) low: f64,
    pub(super) median: f64,
    pub(super) high: f64,
}

/// A picture, and where it differs from the reference's.
pub(super) struct Pair {
    pub(super) name: String,
    pub(super) picture: String,
    pub(super) heat_map: String,
    pub(super) flip: f64,
}

impl Found {
    /// `None` while there are no results.
    pub(super) async fn of(api: &Api, job: &Job) -> Result<Option<Self>, PageError> {
        let has = |name: &str| job.artifacts.iter().find(|artifact| artifact.name == name);
        if has(RESULTS_JSON).is_none() {
            return Ok(None);
        }
        let path = format!("/v1/jobs/{}/artifacts/{RESULTS_JSON}", escape(&job.summary.id));
        let results: BenchmarkResults = api.get(&path).await?;
        let exports = [RESULTS_JSON, RESULTS_CSV, RESULTS_MARKDOWN];
        let comparisons = results.scenes.iter().flat_map(|scene| &scene.comparisons);
        let compared = report::tables(&results).into_iter().zip(comparisons).map(|(table, comparison)| Compared {
            table,
            whiskers: whiskers(comparison),
            charts: scatter::charts(comparison),
            pictures: comparison.rows.iter().filter_map(|row| pair(row, &job.artifacts)).collect(),
        });
        Ok(Some(Self {
            title: results.title.clone(),
            preamble: report::preamble(&results),
            exports: exports.into_iter().filter_map(has).cloned().collect(),
            comparisons: compared.collect(),
        }))
    }
}

fn whiskers(comparison: &Comparison) -> Vec<Whisker> {
    let timed = || comparison.rows.iter().filter_map(|row| Some((row, row.timed.as_ref()?.mrays_per_s)));
    let most = timed().map(|(_, speed)| speed.upper).fold(0.0, f64::max);
    if most <= 0.0 {
        return Vec::new();
    }
    let place = |speed: f64| speed / most * FULL;
    let whisker = |(row, speed): (&Row, lightshaft_api::benchmark::Quartiles)| Whisker {
        name: row.configuration.clone(),
        label: format!("{:.3} MRays/s, quartiles {:.3} and {:.3}", speed.median, speed.lower, speed.upper),
        low: place(speed.lower),
        median: place(speed.median),
        high: place(speed.upper),
    };
    timed().map(whisker).collect()
}

fn pair(row: &Row, artifacts: &[Artifact]) -> Option<Pair> {
    let difference = row.picture.as_ref()?;
    let address = |name: &str| artifacts.iter().find(|artifact| artifact.name == name).map(|a| a.href.clone());
    Some(Pair {
        name: row.configuration.clone(),
        picture: address(&difference.picture)?,
        heat_map: address(&difference.heat_map)?,
        flip: difference.flip,
    })
}

#[cfg(test)]
mod tests {
    use lightshaft_api::benchmark::{Quartiles, Timed};

    use super::*;

    fn row(name: &str, speed: Option<f64>) -> Row {
        Row {
            configuration: name.into(),
            acceleration: serde_json::Value::Null,
            unavailable: None,
            built: None,
            timed: speed.map(|median| Timed {
                mrays_per_s: Quartiles { lower: 0.5 * median, median, upper: 2.0 * median },
                frames_per_s: Quartiles::default(),
                ratio: None,
                rays: Default::default(),
                per_ray: Default::default(),
                samples: Vec::new(),
            }),
            picture: None,
            paper: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn whiskers_share_one_scale_and_leave_out_what_was_not_timed() {
        let rows = vec![row("a", Some(1.0)), row("b", None), row("c", Some(4.0))];
        let comparison = Comparison {
            effect: None,
            title: String::new(),
            note: String::new(),
            reference: None,
            views: Vec::new(),
            rows,
        };
        let drawn = whiskers(&comparison);
        let places: Vec<[f64; 3]> = drawn.iter().map(|w| [w.low, w.median, w.high]).collect();
        assert_eq!(places, [[61.875, 123.75, 247.5], [247.5, 495.0, 990.0]]);
        assert_eq!(drawn[1].label, "4.000 MRays/s, quartiles 2.000 and 8.000");
        assert!(whiskers(&Comparison { rows: Vec::new(), ..comparison }).is_empty());
    }
}
