//! Decisions and what they leave: `/v1/farm/decisions`, `/v1/farm/baselines`.

use http::StatusCode;
use lightshaft_api::farm::{Baseline, Decision, DecisionKind, ImageVerdict};
use lightshaft_api::page::Page;
use serde_json::{Value, json};

use super::{Farm, SUITE, only};

async fn baselines(farm: &Farm) -> Vec<Baseline> {
    farm.service.get("/v1/farm/baselines/main?suite=small").await.json::<Page<Baseline>>().items
}

#[tokio::test]
async fn every_decision_is_kept_with_who_when_and_why() {
    let farm = Farm::start().await;
    let base = farm.baseline().await;
    let red = farm.run("red", json!({ "exposure": 30 })).await;
    let rejected: Decision = farm.decide(&red, "plain", "reject").await.json();
    assert_eq!(
        (rejected.kind, rejected.who.as_str(), rejected.why.as_str()),
        (DecisionKind::Rejected, "Ada", "as intended")
    );
    assert_eq!(rejected.at.as_millisecond(), farm.service.app.now());
    assert_eq!(rejected.pixels, only(&red).image.as_ref().unwrap().pixels);
    let read = farm.read(&red.summary.id).await;
    assert_eq!((read.summary.ok, read.summary.counts.rejected, read.summary.counts.undecided), (Some(false), 1, 0));
    let list = async |query: &str| {
        let page: Page<Decision> = farm.service.get(&format!("/v1/farm/decisions{query}")).await.json();
        page.items.into_iter().map(|decision| decision.id).collect::<Vec<_>>()
    };
    assert_eq!(list("").await.len(), 2);
    assert_eq!(list(&format!("?run={}", red.summary.id)).await, std::slice::from_ref(&rejected.id));
    assert_eq!(
        list("?kind=rejected&suite=small&case=plain&who=Ada&baseline=main").await,
        std::slice::from_ref(&rejected.id)
    );
    assert!(list("?who=Bob").await.is_empty() && list(&format!("?run={}", base.summary.id)).await.len() == 1);
    let wrong = farm.service.get("/v1/farm/decisions?kind=perhaps").await;
    assert_eq!(wrong.pointers(), ["query/kind"]);
    let path = format!("/v1/farm/runs/{}/cases/plain/approve", red.summary.id);
    let nobody = farm.service.post(&path, json!({ "who": " ", "why": "x".repeat(2001) })).await;
    assert_eq!(nobody.pointers(), ["/who", "/why"]);
    assert_eq!(farm.decide(&red, "other", "approve").await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn several_pictures_may_be_accepted_and_a_rejection_takes_one_back() {
    let farm = Farm::start().await;
    farm.baseline().await;
    let other = farm.run("other", json!({ "exposure": 30 })).await;
    farm.decide(&other, "plain", "approve").await;
    farm.decide(&other, "plain", "approve").await;
    assert_eq!(baselines(&farm).await[0].pictures.len(), 2, "the same picture is accepted once");
    for exposure in [0, 30] {
        let run = farm.run("again", json!({ "exposure": exposure })).await;
        assert_eq!(only(&run).image.as_ref().unwrap().verdict, ImageVerdict::Identical);
    }
    farm.decide(&other, "plain", "reject").await;
    assert_eq!(baselines(&farm).await[0].pictures.len(), 1);
    let run = farm.run("again", json!({ "exposure": 30 })).await;
    assert_eq!(only(&run).image.as_ref().unwrap().verdict, ImageVerdict::Changed);
}

#[tokio::test]
async fn many_cases_are_decided_of_at_once_or_none() {
    let farm = Farm::start().await;
    let two = format!("{SUITE}\n[[case]]\nname = \"second / one\"\nscene = \"triangle\"\n");
    let suite = farm.suite(&two).await;
    let run = farm.begin_of(&suite, "one", json!({})).await;
    let early = farm.decide(&run, "plain", "approve").await;
    assert_eq!((early.status, early.problem().code()), (StatusCode::CONFLICT, "wrong-state"));
    let run = farm.work_off(&run.summary.id, super::honest).await;
    let path = format!("/v1/farm/runs/{}/approve", run.summary.id);
    let wrong = farm.service.post(&path, json!({ "who": "Ada", "cases": ["plain", "none", "plain"] })).await;
    assert_eq!(wrong.pointers(), ["/cases/1", "/cases/2"]);
    assert_eq!(farm.read(&run.summary.id).await.summary.counts.undecided, 2, "nothing was decided");
    let all: Page<Decision> = farm.service.post(&path, json!({ "who": "Ada" })).await.json();
    assert_eq!(all.items.len(), 2);
    assert_eq!(farm.read(&run.summary.id).await.summary.ok, Some(true));
    let spaced = format!("/v1/farm/runs/{}/cases/second%20%2F%20one/reject", run.summary.id);
    assert_eq!(farm.service.post(&spaced, json!({ "who": "Ada" })).await.status, StatusCode::OK);
}

#[tokio::test]
async fn a_reset_takes_back_what_was_accepted() {
    let farm = Farm::start().await;
    farm.baseline().await;
    let found = baselines(&farm).await;
    assert_eq!((found.len(), found[0].times[0].samples_s.clone()), (1, vec![0.4; 3]));
    assert_eq!(found[0].times[0].versions["build"], "one");
    let reset = |body: Value| farm.service.post("/v1/farm/baselines/main/reset", body);
    let nothing = reset(json!({ "who": "Ada", "suite": "small", "case": "none" })).await;
    assert_eq!(nothing.status, StatusCode::NOT_FOUND);
    let done: Decision =
        reset(json!({ "who": "Ada", "why": "new machine", "suite": "small", "case": "plain" })).await.json();
    assert_eq!((done.kind, done.run, done.case.as_deref()), (DecisionKind::Reset, None, Some("plain")));
    assert!(baselines(&farm).await.is_empty());
    let run = farm.run("after", json!({})).await;
    assert_eq!(only(&run).image.as_ref().unwrap().verdict, ImageVerdict::Missing);
    let decisions: Page<Decision> = farm.service.get("/v1/farm/decisions").await.json();
    assert_eq!(decisions.items.len(), 2);
}

#[tokio::test]
async fn baselines_of_other_names_are_others() {
    let farm = Farm::start().await;
    farm.baseline().await;
    let run = farm.begin("branch", json!({ "baseline": "branch" })).await;
    let run = farm.work_off(&run.summary.id, super::honest).await;
    assert_eq!(only(&run).image.as_ref().unwrap().verdict, ImageVerdict::Missing);
}

#[tokio::test]
async fn old_runs_go_but_what_they_accepted_stays() {
    let farm = Farm::start_with(|config| config.keep_runs = Some(2)).await;
    let base = farm.baseline().await;
    for label in ["two", "three"] {
        farm.run(label, json!({})).await;
    }
    assert_eq!(farm.service.app.delete_old_runs().await.unwrap(), 1);
    assert_eq!(farm.service.get(&format!("/v1/farm/runs/{}", base.summary.id)).await.status, StatusCode::NOT_FOUND);
    assert_eq!(baselines(&farm).await[0].pictures.len(), 1);
    assert_eq!(farm.service.get("/v1/farm/decisions").await.json::<Page<Decision>>().items.len(), 1);
    assert_eq!(farm.run("four", json!({})).await.summary.ok, Some(true));
}

#[tokio::test]
async fn accepted_pictures_outlive_the_jobs_that_rendered_them() {
    let farm = Farm::start().await;
    let base = farm.baseline().await;
    for job in &only(&base).jobs {
        assert_eq!(farm.service.delete(&format!("/v1/jobs/{}", job.job)).await.status, StatusCode::NO_CONTENT);
    }
    let picture = &baselines(&farm).await[0].pictures[0];
    farm.service.write_blob_at(&picture.artifacts[0].hash, 1_000_000_000_000);
    let later = jiff::Timestamp::from_millisecond(1_700_000_000_000).unwrap();
    assert_eq!(farm.service.app.sweep_blobs(later).await.unwrap(), 0);
    assert_eq!(farm.service.get(&picture.artifacts[0].href).await.status, StatusCode::OK);
    let same = farm.run("same", json!({})).await;
    assert_eq!(same.summary.ok, Some(true));
}
