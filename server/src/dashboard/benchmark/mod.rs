//! What a benchmark found, on its job's page: tables, bars with whiskers, charts, pictures and heat maps.

mod bars;
pub(super) mod list;
mod scatter;

use lightshaft_api::benchmark::{BenchmarkResults, Row};
use lightshaft_api::job::{Artifact, Job};
use lightshaft_worker::benchmark::report::{self, RESULTS_CSV, RESULTS_JSON, RESULTS_MARKDOWN, Table};

pub(super) use self::bars::Bars;
use self::scatter::Scatter;
pub(super) use self::scatter::{HEIGHT, WIDTH};
use super::client::{Api, escape};
use super::page::PageError;

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
    pub(super) bars: Vec<Bars>,
    pub(super) charts: Vec<Scatter>,
    pub(super) pictures: Vec<Pair>,
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
            bars: Bars::all(&comparison.rows),
            charts: scatter::charts(&comparison.rows),
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
    use lightshaft_api::benchmark::{Comparison, Quartiles, SceneResults, Timed};

    use super::*;

    /// A configuration, timed or not.
    pub(super) fn row(name: &str, speed: Option<f64>) -> Row {
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

    /// Results of one comparison in one scene.
    pub(super) fn results(rows: Vec<Row>) -> BenchmarkResults {
        let comparison = Comparison {
            effect: None,
            title: "ambient occlusion".into(),
            note: String::new(),
            reference: None,
            views: Vec::new(),
            rows,
        };
        BenchmarkResults {
            title: "Benchmark".into(),
            preset: None,
            source: None,
            device: "AVX2, 2 threads".into(),
            device_kind: "cpu".into(),
            driver: String::new(),
            versions: Default::default(),
            width: 32,
            height: 24,
            spp: 1,
            picture_spp: 2,
            seed: 1,
            repetitions: 3,
            min_sample_s: 0.001,
            columns: Vec::new(),
            scenes: vec![SceneResults {
                name: "pile".into(),
                measured: "pile.glb".into(),
                stand_in: false,
                triangles: 12,
                spheres: 0,
                instances: 1,
                meshes: 1,
                comparisons: vec![comparison],
            }],
            total_s: 1.0,
        }
    }
}
