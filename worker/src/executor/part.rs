//! What a tile or pass task leaves, and how the parts become the whole picture again.
//!
//! An artifact `part` is the length of a JSON text as a little-endian `u64`, the metrics of the task as that text, and
//! the engine's part (sums and layers, checksummed). The metrics travel along so that the merge can write a
//! `metrics.json` about the whole job.

use lightshaft_api::job::{Metrics, TaskWork};
use lightshaft_api::lease::NewArtifact;
use lightshaft_engine::device::Region;
use lightshaft_engine::film::{AovBuffers, Merger, PassFilm, encode_part};

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
        Ok(Artifact { name: NewArtifact::PART.into(), media_type: "application/octet-stream", bytes })
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
        TaskWork::Benchmark => "a benchmark".into(),
        TaskWork::Build => "the structures".into(),
        TaskWork::Compare => "a comparison".into(),
    }
}

/// In which order parts are put together: tiles by their place, passes by their samples, so that the picture does not
/// depend on which worker was first.
pub(super) fn order(works: &[TaskWork]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..works.len()).collect();
    order.sort_by_key(|&index| match works[index] {
        TaskWork::Pass { first_sample, .. } => (first_sample, 0, 0),
        TaskWork::Tile { x, y, .. } => (0, y, x),
        TaskWork::Frame | TaskWork::Merge | TaskWork::Benchmark | TaskWork::Build | TaskWork::Compare => (0, 0, 0),
    });
    order
}

/// The picture and the costs of the parts so far.
pub(super) struct Merge {
    pictures: Merger,
    costs: Metrics,
    parts: usize,
}

impl Merge {
    pub(super) fn new(full: Region) -> Self {
        Self { pictures: Merger::new(full), costs: Metrics::default(), parts: 0 }
    }

    /// # Errors
    /// What is wrong with the bytes, in words.
    pub(super) fn add(&mut self, bytes: &[u8]) -> Result<(), String> {
        let truncated = "it is truncated";
        let (length, rest) = bytes.split_first_chunk::<LENGTH_BYTES>().ok_or(truncated)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| truncated)?;
        let (metrics, body) = rest.split_at_checked(length).ok_or(truncated)?;
        let metrics = serde_json::from_slice(metrics).map_err(|error| format!("its metrics are malformed: {error}"))?;
        self.pictures.add(body).map_err(|error| error.to_string())?;
        self.costs.add(&metrics);
        self.parts += 1;
        Ok(())
    }

    /// The whole picture, and what making its parts cost.
    pub(super) fn finish(self) -> Result<(Part, Metrics), TaskError> {
        if self.parts == 0 {
            return Err(TaskError::bad_input("there are no parts to merge"));
        }
        let (film, aovs) = self
            .pictures
            .finish()
            .map_err(|error| TaskError::bad_input(format!("the parts do not make up the picture: {error}")))?;
        Ok((Part { film, aovs }, self.costs))
    }
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

    fn bytes(part: &Part) -> Vec<u8> {
        part.encode(&Metrics { render_s: 1.5, ..Metrics::default() }).unwrap().bytes
    }

    #[test]
    fn a_part_comes_back_with_its_metrics_and_a_damaged_one_does_not() {
        let part = part(FULL, 7, 0.1);
        let mut bytes = bytes(&part);
        let mut merge = Merge::new(FULL);
        for at in [0, 3, 8, 20, bytes.len() - 1] {
            assert!(merge.add(&bytes[..at]).is_err(), "cut at {at}");
        }
        merge.add(&bytes).unwrap();
        let (merged, costs) = merge.finish().unwrap();
        assert_eq!((merged, costs.render_s), (part, 1.5));
        bytes[7] = 0xff;
        assert_eq!(Merge::new(FULL).add(&bytes).unwrap_err(), "it is truncated");
    }

    #[test]
    fn parts_go_in_the_order_of_their_samples_or_places() {
        let passes = [8, 0, 4].map(|first_sample| TaskWork::Pass { first_sample, samples: 4 });
        assert_eq!(order(&passes), [1, 2, 0]);
        let tiles = [(2, 1), (0, 1), (2, 0)].map(|(x, y)| TaskWork::Tile { x, y, width: 2, height: 1 });
        assert_eq!(order(&tiles), [2, 1, 0]);
    }

    #[test]
    fn passes_add_up() {
        let mut merge = Merge::new(FULL);
        for (samples, value) in [(4, 0.1), (4, 0.2), (2, 0.3)] {
            merge.add(&bytes(&part(FULL, samples, value))).unwrap();
        }
        let (merged, costs) = merge.finish().unwrap();
        assert_eq!((merged.film.samples, merged.film.sum[0][0]), (10, 0.1 + 0.2 + 0.3));
        assert!(merged.aovs.is_some());
        assert_eq!(costs.render_s, 4.5);
    }

    #[test]
    fn parts_that_leave_holes_or_lack_layers_are_refused() {
        let mut merge = Merge::new(FULL);
        merge.add(&bytes(&part(Region { width: 2, ..FULL }, 1, 1.0))).unwrap();
        let bare = Part { aovs: None, ..part(FULL, 4, 1.0) };
        assert!(merge.add(&bytes(&bare)).unwrap_err().contains("layers"));
        assert!(merge.finish().is_err());
        assert!(Merge::new(FULL).finish().is_err());
    }
}
