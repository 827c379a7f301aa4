//! What a tile or pass task leaves, and how the parts become the whole picture again.
//!
//! An artifact `part` is the length of a JSON text as a little-endian `u64`, the metrics of the task as that text, and
//! the engine's part (sums and layers, checksummed). The metrics travel along so that the merge can write a
//! `metrics.json` about the whole job.

use lightshaft_api::job::{Metrics, TaskWork};
use lightshaft_api::lease::NewArtifact;
use lightshaft_engine::device::Region;
use lightshaft_engine::film::{AovBuffers, PassFilm, decode_part, encode_part, merge_aovs, merge_films};

use super::TaskError;
use super::output::Artifact;

const LENGTH_BYTES: usize = size_of::<u64>();

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Part {
    pub film: PassFilm,
    pub aovs: Option<AovBuffers>,
}

impl Part {
    pub(super) fn encode(&self, metrics: &Metrics) -> Result<Artifact, TaskError> {
        let metrics = serde_json::to_vec(metrics)
            .map_err(|error| TaskError::worker(format!("the metrics could not be written as JSON: {error}")))?;
        let mut bytes = (metrics.len() as u64).to_le_bytes().to_vec();
        bytes.extend_from_slice(&metrics);
        bytes.extend_from_slice(&encode_part(&self.film, self.aovs.as_ref()));
        Ok(Artifact { name: NewArtifact::PART, media_type: "application/octet-stream", bytes })
    }

    /// # Errors
    /// What is wrong with the bytes, in words.
    pub(super) fn decode(bytes: &[u8]) -> Result<(Self, Metrics), String> {
        let truncated = "it is truncated";
        let (length, rest) = bytes.split_first_chunk::<LENGTH_BYTES>().ok_or(truncated)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| truncated)?;
        let (metrics, body) = rest.split_at_checked(length).ok_or(truncated)?;
        let metrics = serde_json::from_slice(metrics).map_err(|error| format!("its metrics are malformed: {error}"))?;
        let (film, aovs) = decode_part(body).map_err(|error| error.to_string())?;
        Ok((Self { film, aovs }, metrics))
    }
}

/// For messages.
pub fn name(work: &TaskWork) -> String {
    match work {
        TaskWork::Frame => "the whole picture".into(),
        TaskWork::Tile { x, y, .. } => format!("the tile at ({x}, {y})"),
        TaskWork::Pass { first_sample, samples } => {
            format!("samples {first_sample} to {}", first_sample.saturating_add(*samples))
        }
        TaskWork::Merge => "a merge".into(),
    }
}

/// Puts tiles side by side and adds passes up, in the order of their samples, so that the picture does not depend on
/// which worker was first.
pub(super) fn merge(full: Region, mut parts: Vec<(TaskWork, Part)>) -> Result<Part, TaskError> {
    if parts.is_empty() {
        return Err(TaskError::bad_input("there are no parts to merge"));
    }
    parts.sort_by_key(|(work, part)| match work {
        TaskWork::Pass { first_sample, .. } => (*first_sample, 0, 0),
        TaskWork::Frame | TaskWork::Tile { .. } | TaskWork::Merge => (0, part.film.region.y, part.film.region.x),
    });
    let (films, aovs): (Vec<PassFilm>, Vec<Option<AovBuffers>>) =
        parts.into_iter().map(|(_, part)| (part.film, part.aovs)).unzip();
    let unfit = |error: lightshaft_engine::film::PartError| {
        TaskError::bad_input(format!("the parts do not make up the picture: {error}"))
    };
    let film = merge_films(full, &films).map_err(unfit)?;
    let count = aovs.len();
    let aovs: Vec<AovBuffers> = aovs.into_iter().flatten().collect();
    if !aovs.is_empty() && aovs.len() != count {
        return Err(TaskError::bad_input("the parts do not make up the picture: some lack their layers"));
    }
    let aovs = if aovs.is_empty() { None } else { Some(merge_aovs(full, &aovs).map_err(unfit)?) };
    Ok(Part { film, aovs })
}

#[cfg(test)]
mod tests {
    use super::*;
    use lightshaft_engine::settings::Aov;

    const FULL: Region = Region { x: 0, y: 0, width: 4, height: 3 };

    fn part(region: Region, samples: u32, value: f64) -> Part {
        let mut film = PassFilm::new(region);
        film.samples = samples;
        film.sum.fill([value; 3]);
        Part { film, aovs: Some(AovBuffers::new(region, &[Aov::Depth])) }
    }

    fn pass(first_sample: u32, samples: u32, value: f64) -> (TaskWork, Part) {
        (TaskWork::Pass { first_sample, samples }, part(FULL, samples, value))
    }

    #[test]
    fn a_part_comes_back_with_its_metrics_and_a_damaged_one_does_not() {
        let metrics = Metrics { render_s: 1.5, ..Metrics::default() };
        let bytes = part(FULL, 7, 0.1).encode(&metrics).unwrap().bytes;
        assert_eq!(Part::decode(&bytes).unwrap(), (part(FULL, 7, 0.1), metrics));
        for at in [0, 3, 8, 20, bytes.len() - 1] {
            assert!(Part::decode(&bytes[..at]).is_err(), "cut at {at}");
        }
        let mut damaged = bytes;
        damaged[7] = 0xff;
        assert_eq!(Part::decode(&damaged).unwrap_err(), "it is truncated");
    }

    #[test]
    fn passes_add_up_in_the_order_of_their_samples() {
        let merged = merge(FULL, vec![pass(4, 4, 0.2), pass(0, 4, 0.1), pass(8, 2, 0.3)]).unwrap();
        assert_eq!(merged.film.samples, 10);
        assert_eq!(merged.film.sum[0][0], 0.1 + 0.2 + 0.3);
        assert!(merged.aovs.is_some());
    }

    #[test]
    fn parts_that_leave_holes_or_lack_layers_are_refused() {
        let half = Region { width: 2, ..FULL };
        let tile = (TaskWork::Tile { x: 0, y: 0, width: 2, height: 3 }, part(half, 1, 1.0));
        assert!(merge(FULL, vec![tile]).is_err());
        let (work, mut bare) = pass(4, 4, 1.0);
        bare.aovs = None;
        assert!(merge(FULL, vec![pass(0, 4, 1.0), (work, bare)]).is_err());
        assert!(merge(FULL, vec![]).is_err());
    }
}
