//! Compares two pictures as a task: what `POST /v1/compare` answers at once, for whoever wants it in the queue, kept as files.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use lightshaft_api::compare::{CompareRequest, ComparedPicture, Comparison, PictureChoice};
use lightshaft_api::job::{Metrics, Phase};
use lightshaft_compare::Options;
use lightshaft_engine::device::Device;
use lightshaft_engine::device::cpu::CpuDevice;
use lightshaft_engine::film::COLOR;

use super::{Artifact, Observer, Outputs, Progress, TaskError, metrics};
use crate::picture::compare::{Bounds, Pixels, heat_map_png, layers, report, size_problem};

/// Pixels of the largest picture that is read: that of the largest that is rendered.
const MAX_PIXELS: u64 = 1 << 26;
pub const COMPARISON_JSON: &str = "comparison.json";
pub const HEAT_MAP_PNG: &str = "heatmap.png";

/// Where progress stands when both pictures are there, and when they are compared.
const READ: f64 = 0.3;
const COMPARED: f64 = 0.9;

/// Blocks. Both pictures of `request` name blobs, whose bytes `read` gives. Limits that are passed are an answer, not a
/// failure.
///
/// # Errors
/// Those of `read`; and for good where a blob is no picture, has no such layer, or another size than the first.
pub fn compare(
    request: &CompareRequest,
    waited_s: f64,
    read: impl Fn(&str) -> Result<Vec<u8>, TaskError>,
    observer: &dyn Observer,
    stop: &AtomicBool,
) -> Result<Outputs, TaskError> {
    let started = Instant::now();
    let report_progress = |phase, fraction| observer.progress(Progress { phase, fraction, spp: 0 });
    report_progress(Phase::Fetch, 0.0);
    let (a, first) = open("a", &request.a, &read)?;
    let (b, second) = open("b", &request.b, &read)?;
    if let Some(problem) = size_problem(&first, &second) {
        return Err(TaskError::bad_input(format!("/settings/b: {problem}")));
    }
    let mut measured = Metrics { queue_s: Some(waited_s), versions: metrics::versions(), ..Metrics::default() };
    measured.scene_s = started.elapsed().as_secs_f64();
    check_stop(stop)?;
    report_progress(Phase::Render, READ);
    let comparing = Instant::now();
    let options = Options { exposure: request.exposure, tolerance: request.tolerance, ..Options::default() };
    let outcome = layers(&first, &second, &options, request.wants_hdr())
        .map_err(|error| TaskError::bad_input(format!("/settings: {error}")))?;
    measured.render_s = comparing.elapsed().as_secs_f64();
    check_stop(stop)?;
    report_progress(Phase::Output, COMPARED);
    let found = Comparison { a, b, report: report(&outcome.figures, Bounds::of(request)) };
    for passed in &found.report.over_limits {
        observer.log(passed.clone());
    }
    let heat_map = heat_map_png(&outcome.error_map).map_err(|error| TaskError::worker(error.to_string()))?;
    let json = serde_json::to_vec_pretty(&found).map_err(|error| TaskError::worker(error.to_string()))?;
    let device = CpuDevice::new().info();
    (measured.device, measured.device_kind) = (device.name, device.kind.to_owned());
    measured.peak_bytes = metrics::peak_bytes();
    measured.total_s = started.elapsed().as_secs_f64();
    let artifacts = vec![
        Artifact { name: COMPARISON_JSON.into(), media_type: "application/json", bytes: json },
        Artifact { name: HEAT_MAP_PNG.into(), media_type: "image/png", bytes: heat_map },
    ];
    Ok(Outputs { artifacts, metrics: measured })
}

fn open(
    side: &str,
    choice: &PictureChoice,
    read: impl Fn(&str) -> Result<Vec<u8>, TaskError>,
) -> Result<(ComparedPicture, Pixels), TaskError> {
    let Some(hash) = choice.blob.clone() else {
        return Err(TaskError::bad_input(format!("/settings/{side}/blob: is not named")));
    };
    let layer = choice.layer.clone().unwrap_or_else(|| COLOR.to_owned());
    let bytes = read(&hash)?;
    let pixels = Pixels::read(&bytes, &layer, MAX_PIXELS)
        .map_err(|error| TaskError::bad_input(format!("/settings/{side}: {error}")))?;
    Ok((ComparedPicture { hash, layer }, pixels))
}

fn check_stop(stop: &AtomicBool) -> Result<(), TaskError> {
    if stop.load(Ordering::Relaxed) { Err(TaskError::Stopped) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use lightshaft_engine::film::encode_png_srgb8;

    use super::*;

    struct Quiet;

    impl Observer for Quiet {
        fn progress(&self, _: Progress) {}
        fn log(&self, _: String) {}
        fn wants_preview(&self) -> bool {
            false
        }
        fn preview(&self, _: Vec<u8>) {}
    }

    fn png(width: u32, grey: u8) -> Vec<u8> {
        encode_png_srgb8(width, 4, &vec![grey; width as usize * 12], &[]).unwrap()
    }

    fn compared(change: impl FnOnce(&mut CompareRequest)) -> Result<Outputs, TaskError> {
        let blobs =
            BTreeMap::from([("dark", png(8, 50)), ("light", png(8, 200)), ("wide", png(9, 50)), ("text", b"x".into())]);
        let named = |blob: &str| PictureChoice { blob: Some(blob.to_owned()), ..PictureChoice::default() };
        let mut request = CompareRequest { a: named("dark"), b: named("light"), ..CompareRequest::default() };
        change(&mut request);
        compare(&request, 1.5, |hash| Ok(blobs[hash].clone()), &Quiet, &AtomicBool::new(false))
    }

    fn failure(change: impl FnOnce(&mut CompareRequest)) -> String {
        match compared(change) {
            Err(TaskError::Failed { fatal: true, message, .. }) => message,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_comparison_leaves_its_figures_and_a_heat_map_whether_limits_are_kept_or_not() {
        let outputs = compared(|request| request.max_flip = Some(0.01)).unwrap();
        let names: Vec<&str> = outputs.artifacts.iter().map(|artifact| artifact.name.as_ref()).collect();
        assert_eq!(names, [COMPARISON_JSON, HEAT_MAP_PNG]);
        let found: Comparison = serde_json::from_slice(&outputs.artifacts[0].bytes).unwrap();
        assert_eq!((found.a.hash.as_str(), found.b.layer.as_str()), ("dark", COLOR));
        assert!(found.report.flip_mean > 0.1 && !found.report.passed && found.report.differing_pixels == 32);
        assert_eq!(outputs.artifacts[1].bytes[..4], *b"\x89PNG");
        assert_eq!(outputs.metrics.queue_s, Some(1.5));
    }

    #[test]
    fn what_cannot_be_compared_says_which_and_why() {
        let blob = |name: &str| Some(name.to_owned());
        assert!(failure(|request| request.b.blob = blob("wide")).starts_with("/settings/b: has 9 x 4 pixels"));
        assert!(failure(|request| request.a.blob = blob("text")).starts_with("/settings/a: not a picture"));
        assert!(failure(|request| request.b.layer = blob("depth")).contains("no layer `depth`"));
        assert!(failure(|request| request.hdr = true).contains("HDR-FLIP"));
    }
}
