//! The output phase: from sums to files.

use std::borrow::Cow;

use lightshaft_api::job::{Metrics, TaskWork};
use lightshaft_api::settings::Output;
use lightshaft_engine::film::{EncodeError, PassFilm, encode_exr, encode_png};

use super::part::Part;
use super::{Task, TaskError};
use crate::settings;

/// A file that a task leaves.
#[derive(Clone, Debug, PartialEq)]
pub struct Artifact {
    pub name: Cow<'static, str>,
    pub media_type: &'static str,
    pub bytes: Vec<u8>,
}

/// The pictures that the settings ask for; parts of a picture are not encoded.
pub(super) fn encode(task: &Task<'_>, part: &Part) -> Result<Vec<Artifact>, TaskError> {
    if matches!(task.work, TaskWork::Tile { .. } | TaskWork::Pass { .. }) {
        return Ok(Vec::new());
    }
    let mut artifacts = Vec::new();
    for output in &task.settings.outputs {
        task.check_stop()?;
        artifacts.push(match output {
            Output::Png => {
                Artifact { name: "image.png".into(), media_type: "image/png", bytes: png(task, &part.film)? }
            }
            Output::Exr => Artifact { name: "image.exr".into(), media_type: "image/x-exr", bytes: exr(task, part)? },
        });
    }
    Ok(artifacts)
}

/// The tone-mapped picture so far.
pub(super) fn png(task: &Task<'_>, film: &PassFilm) -> Result<Vec<u8>, TaskError> {
    let region = film.region;
    let tone_map = settings::tone_map(task.settings.tone_map);
    let metadata = metadata(task, film);
    encode_png(region.width, region.height, &film.mean(), tone_map, task.settings.exposure, &metadata)
        .map_err(encode_error)
}

fn exr(task: &Task<'_>, part: &Part) -> Result<Vec<u8>, TaskError> {
    let region = part.film.region;
    let metadata = metadata(task, &part.film);
    encode_exr(region.width, region.height, &part.film.mean(), part.aovs.as_ref(), &metadata).map_err(encode_error)
}

/// What a picture says of itself. The same job gives the same bytes, so there are no times and no machine in it.
fn metadata(task: &Task<'_>, film: &PassFilm) -> Vec<(&'static str, String)> {
    vec![
        ("Software", format!("lightshaft {}", env!("CARGO_PKG_VERSION"))),
        ("Integrator", format!("{:?}", task.settings.integrator).to_lowercase()),
        ("Samples", film.samples.to_string()),
        ("Seed", task.settings.seed.to_string()),
    ]
}

/// What was measured, for people and scripts.
pub(crate) fn metrics_json(metrics: &Metrics) -> Result<Artifact, TaskError> {
    let bytes = serde_json::to_vec_pretty(metrics)
        .map_err(|error| TaskError::worker(format!("the metrics could not be written as JSON: {error}")))?;
    Ok(Artifact { name: "metrics.json".into(), media_type: "application/json", bytes })
}

fn encode_error(error: EncodeError) -> TaskError {
    TaskError::worker(format!("the picture could not be encoded: {error}"))
}
