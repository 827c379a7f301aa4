//! How times are judged: noise, suspicion, confirmation, calibration, history.

use lightshaft_api::farm::{ConfirmationState, FarmJobPhase, History, ImageVerdict, Run, TimeResult, TimeVerdict};
use lightshaft_api::settings::RenderSettings;
use serde_json::json;

use super::{Farm, Rendered, honest, only};

fn time(run: &Run) -> &TimeResult {
    only(run).time.as_ref().unwrap()
}

#[tokio::test]
async fn a_slow_down_is_confirmed_in_turns_on_one_worker_and_can_be_approved() {
    let farm = Farm::start().await;
    farm.baseline().await;
    let slow = farm.run("slow", json!({ "spp": 12 })).await;
    let found = time(&slow);
    assert_eq!((slow.summary.ok, found.verdict), (Some(false), Some(TimeVerdict::Slower)));
    assert_eq!(found.confirmation.state, ConfirmationState::Confirmed, "{:?}", found.confirmation);
    assert_eq!((found.confirmation.a_s.clone(), found.confirmation.b_s.len()), (vec![0.4; 7], 7));
    assert!((found.confirmation.ratio.unwrap().value - 3.0).abs() < 1e-9);
    let turns: Vec<(FarmJobPhase, u32)> = only(&slow).jobs[4..].iter().map(|job| (job.phase, job.position)).collect();
    let expected: Vec<(FarmJobPhase, u32)> =
        (0..8).flat_map(|i| [(FarmJobPhase::A, i), (FarmJobPhase::B, i)]).collect();
    assert_eq!(turns, expected, "baseline and run alternate");
    for job in &only(&slow).jobs {
        assert_eq!(farm.service.read_job(&job.job).await.attempts[0].worker, farm.worker);
    }
    // Approved, the new level takes the place of the old one.
    farm.decide(&slow, "plain", "approve").await;
    let again = farm.run("slow-again", json!({ "spp": 12 })).await;
    assert_eq!((again.summary.ok, time(&again).verdict), (Some(true), Some(TimeVerdict::Same)));
    let fast = farm.run("fast", json!({})).await;
    assert_eq!((fast.summary.ok, time(&fast).verdict), (Some(true), Some(TimeVerdict::Faster)));
}

#[tokio::test]
async fn a_slow_down_that_the_re_run_does_not_show_is_not_told() {
    let farm = Farm::start().await;
    farm.baseline().await;
    let run = farm.begin("busy machine", json!({})).await;
    let busy = |settings: &RenderSettings, phase: Option<FarmJobPhase>| {
        let slow = if phase == Some(FarmJobPhase::Sample) { 3.0 } else { 1.0 };
        let quiet = honest(settings, phase);
        Rendered { render_s: slow * quiet.render_s, ..quiet }
    };
    let run = farm.work_off(&run.summary.id, busy).await;
    assert_eq!((run.summary.ok, time(&run).verdict), (Some(true), Some(TimeVerdict::Same)));
    assert_eq!(time(&run).confirmation.state, ConfirmationState::Refuted);
}

#[tokio::test]
async fn a_slow_down_against_a_build_that_is_gone_is_told_but_not_called_confirmed() {
    let farm = Farm::start().await;
    farm.baseline().await;
    let run = farm.begin("next build", json!({ "overrides": { "spp": 12 } })).await;
    let built = |settings: &RenderSettings, phase: Option<FarmJobPhase>| Rendered {
        build: "two".to_owned(),
        ..honest(settings, phase)
    };
    let run = farm.work_off(&run.summary.id, built).await;
    let found = time(&run);
    assert_eq!((run.summary.ok, found.verdict), (Some(false), Some(TimeVerdict::Slower)));
    assert_eq!(found.confirmation.state, ConfirmationState::Impossible);
    let reason = found.confirmation.reason.as_ref().unwrap();
    assert!(reason.contains("build was one, is two"), "{reason}");
}

#[tokio::test]
async fn calibrated_noise_is_no_slow_down() {
    let farm = Farm::start().await;
    farm.baseline().await;
    let count = std::cell::Cell::new(0_u32);
    let noisy = |settings: &RenderSettings, phase: Option<FarmJobPhase>| {
        // The first job warms up; then runs of three samples, at three levels in turn.
        let level = (count.get().saturating_sub(1) / 3) % 3;
        count.set(count.get() + 1);
        Rendered { render_s: 0.4 * (1.0 + 0.3 * f64::from(level)), ..honest(settings, phase) }
    };
    let calibration = farm.calibrate(6, noisy).await;
    let case = &calibration.cases[0];
    assert_eq!((case.medians_s.len(), case.steady, case.device_class.as_deref()), (6, Some(true), Some("cpu: AVX2")));
    let floor = case.noise_floor.unwrap();
    assert!((floor - 0.6).abs() < 0.05, "{floor}");
    let run = farm.begin("noise", json!({})).await;
    let slower =
        |settings: &RenderSettings, phase: Option<FarmJobPhase>| Rendered { render_s: 0.6, ..honest(settings, phase) };
    let run = farm.work_off(&run.summary.id, slower).await;
    assert_eq!((run.summary.ok, time(&run).verdict), (Some(true), Some(TimeVerdict::Same)));
    assert_eq!((time(&run).noise_floor, time(&run).confirmation.state), (Some(floor), ConfirmationState::NotNeeded));
    let wrong = farm.service.post("/v1/farm/calibrations", json!({ "suite": "none", "label": "x", "times": 2 })).await;
    assert_eq!(wrong.pointers(), ["/times", "/suite"]);
}

#[tokio::test]
async fn a_history_has_times_over_labels_and_where_they_change() {
    let farm = Farm::start().await;
    let mut first = None;
    for (i, label) in "abcdefghijklmn".chars().enumerate() {
        let spp = if i < 7 { 4 } else { 8 };
        let run = farm.run(&label.to_string(), json!({ "spp": spp })).await;
        first.get_or_insert(run);
    }
    farm.decide(&first.unwrap(), "plain", "approve").await;
    let history: History = farm.service.get("/v1/farm/history?suite=small&case=plain").await.json();
    let labels: String = history.points.iter().map(|point| point.label.as_str()).collect();
    assert_eq!((labels.as_str(), history.device_class.as_str()), ("abcdefghijklmn", "cpu: AVX2"));
    assert_eq!(history.change_points, [7]);
    assert_eq!(history.points[7].median_s, Some(0.8));
    assert_eq!((history.points[0].image, history.points[0].ok), (ImageVerdict::Missing, true));
    assert_eq!((history.pictures.len(), history.decisions.len()), (1, 1));
    let picture = farm.service.get(history.points[9].picture.as_ref().unwrap()).await;
    assert_eq!(picture.header("content-type"), "image/png");
    for query in ["?suite=small&case=none", "?suite=small&case=plain&device_class=gpu"] {
        assert_eq!(farm.service.get(&format!("/v1/farm/history{query}")).await.status, http::StatusCode::NOT_FOUND);
    }
    let missing = farm.service.get("/v1/farm/history?suite=small").await;
    assert_eq!(missing.pointers(), ["query/case"]);
}
