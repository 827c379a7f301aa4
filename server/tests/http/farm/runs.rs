//! `/v1/farm/runs`: how a picture is judged, and how a run goes on.

use axum::body::Body;
use http::{Method, StatusCode};
use lightshaft_api::farm::{CaseState, FarmJobPhase, ImageVerdict, Run, RunState, RunSummary};
use lightshaft_api::job::JobState;
use lightshaft_api::page::Page;
use serde_json::json;

use super::{Farm, Rendered, SUITE, honest, only};

#[tokio::test]
async fn a_picture_is_missing_then_accepted_then_identical_within_tolerance_or_changed() {
    let farm = Farm::start().await;
    let first = farm.run("one", json!({})).await;
    assert_eq!((first.summary.ok, first.summary.counts.missing, first.summary.counts.undecided), (Some(false), 1, 1));
    assert_eq!(only(&first).image.as_ref().unwrap().verdict, ImageVerdict::Missing);
    assert_eq!(only(&first).device_class.as_deref(), Some("cpu: AVX2"));
    assert_eq!(farm.decide(&first, "plain", "approve").await.status, StatusCode::OK);
    let approved = farm.read(&first.summary.id).await;
    assert_eq!((approved.summary.ok, approved.summary.counts.ok), (Some(true), 1));
    assert_eq!(only(&approved).decision.as_ref().unwrap().who, "Ada");

    let same = farm.run("two", json!({})).await;
    let image = only(&same).image.clone().unwrap();
    assert_eq!((same.summary.ok, image.verdict), (Some(true), ImageVerdict::Identical));
    assert_eq!(image.accepted, image.pixels);

    let harmless = farm.run("three", json!({ "exposure": 1 })).await;
    let image = only(&harmless).image.clone().unwrap();
    assert_eq!((harmless.summary.ok, image.verdict), (Some(true), ImageVerdict::WithinTolerance));
    assert_eq!(image.figures.unwrap().differing_pixels, 64);

    let broken = farm.run("four", json!({ "exposure": 30 })).await;
    let image = only(&broken).image.clone().unwrap();
    assert_eq!((broken.summary.ok, image.verdict), (Some(false), ImageVerdict::Changed));
    assert!(image.reason.unwrap().starts_with("RMSE is 0.0"), "the limit is named");
    let names: Vec<&str> = only(&broken).artifacts.iter().map(|artifact| artifact.name.as_str()).collect();
    assert_eq!(names, ["accepted.png", "difference.png", "heat-map.png", "image.png"]);
    for artifact in &only(&broken).artifacts {
        let answer = farm.service.get(&artifact.href).await;
        assert_eq!((answer.status, answer.header("content-type")), (StatusCode::OK, "image/png"), "{}", artifact.name);
        let width = image::load_from_memory(&answer.body).unwrap().width();
        assert!(if artifact.name == "heat-map.png" { width > 8 } else { width == 8 }, "{} {width}", artifact.name);
        let path = format!("/v1/farm/runs/{}/cases/plain/artifacts/{}", broken.summary.id, artifact.name);
        assert_eq!(farm.service.get(&path).await.body, answer.body);
    }
}

#[tokio::test]
async fn a_run_is_made_of_ordinary_jobs_on_one_worker() {
    let farm = Farm::start().await;
    let other = farm.service.worker(&["cpu"]).await;
    let run = farm.begin("one", json!({ "labels": { "commit": "abc" }, "priority": 7 })).await;
    assert_eq!((run.summary.state, run.summary.ok, run.summary.counts.cases), (RunState::Running, None, 1));
    farm.service.app.follow_farm().await.unwrap();
    let read = farm.read(&run.summary.id).await;
    let warm_up = &only(&read).jobs;
    assert_eq!((warm_up.len(), warm_up[0].phase), (1, FarmJobPhase::WarmUp));
    let job = farm.service.read_job(&warm_up[0].job).await;
    assert_eq!((job.summary.labels["farm_run"].as_str(), job.summary.priority), (run.summary.id.as_str(), 7));
    assert_eq!(job.summary.labels["farm_case"], "plain");
    let lease = farm.service.lease(&farm.worker).await.unwrap();
    farm.complete(&lease, &honest).await;
    farm.service.app.follow_farm().await.unwrap();
    assert!(farm.service.lease(&other).await.is_none(), "the samples wait for the worker that warmed up");
    let ended = farm.work_off(&run.summary.id, honest).await;
    let phases: Vec<FarmJobPhase> = only(&ended).jobs.iter().map(|job| job.phase).collect();
    assert_eq!(phases, [FarmJobPhase::WarmUp, FarmJobPhase::Sample, FarmJobPhase::Sample, FarmJobPhase::Sample]);
    assert_eq!(only(&ended).worker.as_ref(), Some(&farm.worker));
    assert_eq!(only(&ended).time.as_ref().unwrap().samples_s, [0.4; 3]);
}

#[tokio::test]
async fn a_case_begins_anew_when_its_worker_leaves() {
    let farm = Farm::start().await;
    let run = farm.begin("one", json!({})).await;
    farm.service.app.follow_farm().await.unwrap();
    let lease = farm.service.lease(&farm.worker).await.unwrap();
    farm.complete(&lease, &honest).await;
    farm.service.app.follow_farm().await.unwrap();
    let lost = only(&farm.read(&run.summary.id).await).jobs.clone();
    assert_eq!(lost.len(), 4);
    farm.service.post(&format!("/v1/workers/{}/part", farm.worker), json!({})).await;
    farm.service.app.follow_farm().await.unwrap();
    for job in &lost[1..] {
        assert_eq!(farm.service.read_job(&job.job).await.summary.state, JobState::Cancelled);
    }
    let other = farm.service.worker(&["cpu"]).await;
    let farm = Farm { worker: other, ..farm };
    let ended = farm.work_off(&run.summary.id, honest).await;
    assert_eq!(only(&ended).worker.as_ref(), Some(&farm.worker));
    assert_eq!((only(&ended).jobs.len(), ended.summary.counts.missing), (4, 1));
}

#[tokio::test]
async fn a_case_whose_job_fails_has_failed_and_cannot_be_approved() {
    let farm = Farm::start().await;
    let run = farm.begin("one", json!({})).await;
    farm.service.app.follow_farm().await.unwrap();
    let lease = farm.service.lease(&farm.worker).await.unwrap();
    let fail = json!({ "class": "task", "error": "the shader does not compile", "fatal": true });
    let answer = farm.service.report(&lease, "fail", fail).await;
    assert_eq!(answer.status, StatusCode::OK, "{}", String::from_utf8_lossy(&answer.body));
    let run = farm.work_off(&run.summary.id, honest).await;
    let image = only(&run).image.clone().unwrap();
    assert_eq!((image.verdict, run.summary.ok), (ImageVerdict::Failed, Some(false)));
    assert!(image.reason.unwrap().contains("the shader does not compile"));
    let refused = farm.decide(&run, "plain", "approve").await;
    assert_eq!((refused.status, refused.problem().code()), (StatusCode::CONFLICT, "wrong-state"));
    let all = format!("/v1/farm/runs/{}/approve", run.summary.id);
    let none: Page<serde_json::Value> = farm.service.post(&all, json!({ "who": "Ada" })).await.json();
    assert!(none.items.is_empty(), "nothing of it can be approved");
}

#[tokio::test]
async fn repetitions_that_differ_are_told() {
    let farm = Farm::start().await;
    farm.baseline().await;
    let run = farm.begin("two", json!({})).await;
    let count = std::cell::Cell::new(0);
    let unsteady = |settings: &lightshaft_api::settings::RenderSettings, phase: Option<FarmJobPhase>| {
        count.set(count.get() + 1);
        Rendered { grey: 100 + u8::from(count.get() == 4), ..honest(settings, phase) }
    };
    let run = farm.work_off(&run.summary.id, unsteady).await;
    let image = only(&run).image.clone().unwrap();
    assert!(image.unsteady && image.verdict == ImageVerdict::Identical);
    assert_eq!(run.summary.ok, Some(false));
    assert!(image.reason.unwrap().contains("same seed"));
}

#[tokio::test]
async fn a_cancelled_run_ends_with_its_jobs() {
    let farm = Farm::start().await;
    let run = farm.begin("one", json!({})).await;
    farm.service.app.follow_farm().await.unwrap();
    let job = only(&farm.read(&run.summary.id).await).jobs[0].job.clone();
    let path = format!("/v1/farm/runs/{}/cancel", run.summary.id);
    for _ in 0..2 {
        let cancelled: Run = farm.service.post(&path, json!({})).await.json();
        assert_eq!((cancelled.summary.state, only(&cancelled).state), (RunState::Cancelled, CaseState::Cancelled));
    }
    assert_eq!(farm.service.read_job(&job).await.summary.state, JobState::Cancelled);
    farm.service.app.follow_farm().await.unwrap();
    assert_eq!(farm.read(&run.summary.id).await.summary.state, RunState::Cancelled);
    let ended = farm.run("two", json!({})).await;
    let refused = farm.service.post(&format!("/v1/farm/runs/{}/cancel", ended.summary.id), json!({})).await;
    assert_eq!((refused.status, refused.problem().code()), (StatusCode::CONFLICT, "wrong-state"));
}

#[tokio::test]
async fn what_is_wrong_with_a_run_is_named_before_it_begins() {
    let farm = Farm::start().await;
    let suite = farm.suite(SUITE).await;
    let pointers = async |body: serde_json::Value| {
        let answer = farm.service.post("/v1/farm/runs", body).await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{}", String::from_utf8_lossy(&answer.body));
        answer.pointers()
    };
    let scenes = json!({ "triangle": farm.scene });
    assert_eq!(pointers(json!({ "suite": "none", "label": "x" })).await, ["/suite"]);
    assert_eq!(pointers(json!({ "suite": suite, "label": "x" })).await, ["/scenes/triangle"]);
    assert_eq!(
        pointers(json!({ "suite": suite, "label": "x", "scenes": { "triangle": "none" } })).await,
        ["/scenes/triangle"]
    );
    let more = json!({ "suite": suite, "label": " ", "priority": 101, "scenes": { "triangle": farm.scene, "square": "x" },
                       "cases": ["plain", "other"] });
    assert_eq!(pointers(more).await, ["/label", "/priority", "/cases/1", "/scenes/square"]);
    let over = json!({ "suite": suite, "label": "x", "scenes": scenes, "overrides": { "sppp": 1 } });
    assert_eq!(pointers(over).await, ["/overrides/sppp"]);
    let range = json!({ "suite": suite, "label": "x", "scenes": scenes, "overrides": { "spp": 0, "time_limit_s": 1 } });
    assert_eq!(pointers(range).await, ["/overrides/time_limit_s", "/overrides/spp"]);
    let camera = farm.suite(&SUITE.replace("scene = \"triangle\"", "scene = \"triangle\"\ncamera = \"back\"")).await;
    assert_eq!(pointers(json!({ "suite": camera, "label": "x", "scenes": scenes })).await, ["/suite/camera"]);
    assert_eq!(pointers(json!({ "suite": suite, "label": "x", "typo": 1 })).await, ["/typo"]);
    let hash =
        farm.service.get(&format!("/v1/scenes/{}", farm.scene)).await.json::<serde_json::Value>()["hash"].clone();
    let by_hash = farm.begin_of(&suite, "x", json!({ "scenes": { "triangle": hash } })).await;
    assert_eq!(only(&by_hash).scene, farm.scene);
}

#[tokio::test]
async fn runs_are_listed_by_what_they_are() {
    let farm = Farm::start().await;
    let base = farm.baseline().await;
    let red = farm.run("red", json!({ "exposure": 30 })).await;
    let list = async |query: &str| {
        let page: Page<RunSummary> = farm.service.get(&format!("/v1/farm/runs{query}")).await.json();
        page.items.into_iter().map(|run| run.id).collect::<Vec<_>>()
    };
    let (base, red) = (base.summary.id, red.summary.id);
    assert_eq!(list("").await, [red.clone(), base.clone()]);
    assert_eq!(list("?ok=true").await, std::slice::from_ref(&base));
    assert_eq!(list("?ok=false&suite=small&baseline=main&kind=check&state=finished").await, std::slice::from_ref(&red));
    assert_eq!(list("?label=base").await, std::slice::from_ref(&base));
    assert_eq!(list(&format!("?cursor={red}")).await, std::slice::from_ref(&base));
    assert!(list("?suite=other").await.is_empty() && list("?kind=calibration").await.is_empty());
    let wrong = farm.service.get("/v1/farm/runs?state=red").await;
    assert_eq!((wrong.status, wrong.pointers()), (StatusCode::BAD_REQUEST, vec!["query/state".to_owned()]));
}

#[tokio::test]
async fn an_idempotency_key_begins_one_run() {
    let farm = Farm::start().await;
    let suite = farm.suite(SUITE).await;
    let body =
        |label: &str| json!({ "suite": suite, "label": label, "scenes": { "triangle": farm.scene } }).to_string();
    let begin = async |key: &str, label: &str| {
        let headers = [("content-type", "application/json"), ("idempotency-key", key)];
        farm.service.request(Method::POST, "/v1/farm/runs", &headers, Body::from(body(label))).await
    };
    let (first, second) = (begin("key", "one").await, begin("key", "one").await);
    assert_eq!((first.status, second.status), (StatusCode::CREATED, StatusCode::OK));
    assert_eq!(first.json::<Run>().summary.id, second.json::<Run>().summary.id);
    let other = begin("key", "two").await;
    assert_eq!((other.status, other.problem().code()), (StatusCode::UNPROCESSABLE_ENTITY, "idempotency-key-reused"));
    assert_eq!(begin("a b", "one").await.pointers(), ["header/idempotency-key"]);
    farm.service.clock.advance(24 * 3_600_000 + 1);
    assert_eq!(begin("key", "one").await.status, StatusCode::CREATED, "forgotten after a day");
}
