//! The regression farm: suites, runs, baselines.

use std::collections::BTreeMap;

use lightshaft_api::farm::{
    CaseState, Decision, DecisionKind, FarmJobPhase, ImageResult, ImageTolerance, ImageVerdict, PictureSource, RunKind,
    RunState, SettingsPatch, Suite, TimeMetric, TimeTolerance,
};
use lightshaft_api::job::{Artifact, JobState};
use lightshaft_api::settings::RenderSettings;
use uuid::Uuid;

use super::{Farm, job_record};
use crate::store::{
    Acceptance, BaselineKey, CaseDecision, CaseJob, CaseRecord, CaseStep, DecisionQuery, OpenCase, PageRequest,
    ReferenceTimes, RunRecord, Step,
};

fn timestamp(farm: &Farm) -> jiff::Timestamp {
    jiff::Timestamp::from_millisecond(farm.now()).unwrap()
}

async fn suite(farm: &Farm, hash: &str) -> (String, bool) {
    let suite = Suite {
        id: Uuid::now_v7().to_string(),
        name: "s".to_owned(),
        description: String::new(),
        hash: hash.to_owned(),
        scenes: BTreeMap::new(),
        cases: Vec::new(),
        created_at: timestamp(farm),
    };
    farm.store.insert_suite(&suite).await.unwrap()
}

/// A run of two cases, `a` and `b`; its id.
async fn run(farm: &Farm) -> String {
    let (suite, _) = suite(farm, "h").await;
    let (scene, _) = farm.scene().await;
    let case = |name: &str| CaseRecord {
        name: name.to_owned(),
        scene: scene.clone(),
        settings: RenderSettings::default(),
        device_class: None,
        repeat: 2,
        tolerance: ImageTolerance::IDENTICAL,
        time_tolerance: TimeTolerance::default(),
    };
    let record = RunRecord {
        id: Uuid::now_v7().to_string(),
        kind: RunKind::Check,
        suite,
        suite_name: "s".to_owned(),
        label: "one".to_owned(),
        labels: BTreeMap::new(),
        baseline: "main".to_owned(),
        scenes: BTreeMap::new(),
        overrides: SettingsPatch::default(),
        priority: 0,
        times: 1,
        cases: vec![case("a"), case("b")],
    };
    farm.store.create_run(&record, None, farm.now()).await.unwrap();
    record.id
}

async fn open(farm: &Farm, name: &str) -> OpenCase {
    let cases = farm.store.open_cases().await.unwrap();
    cases.into_iter().find(|case| case.case.name == name).unwrap()
}

fn job(case: &OpenCase) -> CaseJob {
    CaseJob { phase: FarmJobPhase::Sample, position: 0, job: job_record(&case.case.scene) }
}

fn image(verdict: ImageVerdict, pixels: &str) -> ImageResult {
    ImageResult {
        verdict,
        reason: None,
        pixels: Some(pixels.to_owned()),
        source: Some(PictureSource::Png),
        accepted: None,
        figures: None,
        z_test: None,
        unsteady: false,
    }
}

fn picture(blob: &str) -> Artifact {
    Artifact {
        name: "image.png".to_owned(),
        media_type: "image/png".to_owned(),
        bytes: 3,
        hash: blob.to_owned(),
        href: format!("/v1/blobs/{blob}"),
    }
}

fn finish(ok: bool) -> CaseStep {
    CaseStep {
        state: Some(CaseState::Finished),
        ok: Some(ok),
        device_class: Some("cpu".to_owned()),
        image: Some(image(ImageVerdict::Missing, "p")),
        artifacts: vec![picture("blob of a run")],
        ..CaseStep::default()
    }
}

async fn step(farm: &Farm, case: &OpenCase, step: &CaseStep) -> Step {
    farm.store.step_case(case, step, farm.now()).await.unwrap()
}

pub(super) async fn a_task_that_demands_a_worker_goes_to_no_other(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let (one, other) = (farm.worker().await, farm.worker().await);
    farm.job_with(&scene, |job| job.worker = Some(one.clone())).await;
    assert_eq!(farm.store.has_task_for(&other, farm.now()).await.unwrap(), Some(false));
    assert!(farm.claim(&other).await.is_none());
    let held = farm.claim(&one).await.unwrap();
    farm.fail(&held, lightshaft_api::lease::RetryClass::Worker).await;
    farm.wait(3_600_000);
    assert!(farm.claim(&other).await.is_none(), "not even after a failure");
    assert!(farm.claim(&one).await.is_some(), "nobody else may, so it gets another try");
}

pub(super) async fn the_same_suite_is_kept_once(farm: &Farm) {
    let (first, is_new) = suite(farm, "h").await;
    assert!(is_new);
    assert_eq!(suite(farm, "h").await, (first, false));
    assert!(suite(farm, "other").await.1);
    assert_eq!(farm.store.suites(Some("s"), &PageRequest { limit: 9, after: None }).await.unwrap().len(), 2);
}

pub(super) async fn a_case_goes_on_only_from_where_it_was_read(farm: &Farm) {
    run(farm).await;
    let first = open(farm, "a").await;
    let begins = CaseStep { jobs: vec![job(&first)], ..CaseStep::default() };
    assert_eq!(step(farm, &first, &begins).await, Step::Done);
    let read = open(farm, "a").await;
    let made = read.jobs[0].job.clone();
    assert_eq!(farm.state(&made).await, JobState::Queued);
    let anew = CaseStep { begins_anew: true, ..CaseStep::default() };
    assert_eq!(step(farm, &read, &anew).await, Step::Done);
    assert_eq!(farm.state(&made).await, JobState::Cancelled, "what it leaves is cancelled");
    assert_eq!(step(farm, &read, &finish(true)).await, Step::Overtaken, "it has begun anew");
    let again = open(farm, "a").await;
    assert!(again.jobs.is_empty() && again.generation == 1);
    assert_eq!(step(farm, &again, &finish(true)).await, Step::Done);
    assert_eq!(step(farm, &again, &finish(true)).await, Step::Overtaken, "it has ended");
}

pub(super) async fn a_step_whose_scene_is_gone_makes_nothing(farm: &Farm) {
    let run = run(farm).await;
    let case = open(farm, "a").await;
    farm.store.delete_scene(&case.case.scene, farm.now()).await.unwrap();
    let begins = CaseStep { jobs: vec![job(&case)], ..CaseStep::default() };
    assert_eq!(step(farm, &case, &begins).await, Step::SceneGone);
    assert!(farm.store.run(&run).await.unwrap().unwrap().cases[0].jobs.is_empty());
}

pub(super) async fn a_run_ends_with_its_last_case(farm: &Farm) {
    let run = run(farm).await;
    let state = async || farm.store.run(&run).await.unwrap().unwrap().summary;
    let (a, b) = (open(farm, "a").await, open(farm, "b").await);
    step(farm, &a, &finish(true)).await;
    assert_eq!((state().await.state, state().await.ok), (RunState::Running, None));
    step(farm, &b, &finish(false)).await;
    let summary = state().await;
    assert_eq!(
        (summary.state, summary.ok, summary.finished_at),
        (RunState::Finished, Some(false), Some(timestamp(farm)))
    );
    assert_eq!((summary.counts.ok, summary.counts.undecided, summary.counts.missing), (1, 1, 2));
    assert!(farm.store.open_cases().await.unwrap().is_empty());
}

pub(super) async fn a_cancelled_run_leaves_no_job_waiting(farm: &Farm) {
    let run = run(farm).await;
    let case = open(farm, "a").await;
    step(farm, &case, &CaseStep { jobs: vec![job(&case)], ..CaseStep::default() }).await;
    let made = open(farm, "a").await.jobs[0].job.clone();
    for _ in 0..2 {
        assert_eq!(farm.store.cancel_run(&run, farm.now()).await.unwrap(), Some(RunState::Cancelled));
    }
    assert_eq!(farm.state(&made).await, JobState::Cancelled);
    assert_eq!(step(farm, &case, &finish(true)).await, Step::Overtaken);
    assert_eq!(farm.store.cancel_run("none", farm.now()).await.unwrap(), None);
}

fn key() -> BaselineKey {
    BaselineKey {
        baseline: "main".to_owned(),
        suite_name: "s".to_owned(),
        case: "a".to_owned(),
        device_class: "cpu".to_owned(),
    }
}

fn decision(farm: &Farm, run: &str, kind: DecisionKind) -> Decision {
    Decision {
        id: Uuid::now_v7().to_string(),
        kind,
        who: "Ada".to_owned(),
        why: "because".to_owned(),
        at: timestamp(farm),
        baseline: "main".to_owned(),
        suite: "s".to_owned(),
        case: Some("a".to_owned()),
        device_class: Some("cpu".to_owned()),
        run: (kind != DecisionKind::Reset).then(|| run.to_owned()),
        label: Some("one".to_owned()),
        pixels: Some("p".to_owned()),
    }
}

async fn approve(farm: &Farm, run: &str, replaces_times: bool) {
    let times = ReferenceTimes {
        metric: TimeMetric::RenderS,
        samples_s: vec![1.0, 2.0],
        scene: "scene".to_owned(),
        settings: RenderSettings::default(),
        versions: BTreeMap::new(),
        label: "one".to_owned(),
    };
    let accepted = Acceptance {
        key: key(),
        pixels: "p".to_owned(),
        source: PictureSource::Png,
        files: vec![picture("accepted blob")],
        times: Some(times),
        replaces_times,
    };
    let decided =
        CaseDecision { decision: decision(farm, run, DecisionKind::Approved), accepted: Some(accepted), ok: true };
    farm.store.decide(&[decided], farm.now()).await.unwrap();
}

pub(super) async fn what_is_accepted_is_kept_until_a_reset_and_decisions_for_good(farm: &Farm) {
    let run = run(farm).await;
    let case = open(farm, "a").await;
    step(farm, &case, &finish(false)).await;
    approve(farm, &run, false).await;
    approve(farm, &run, false).await;
    let reference = farm.store.reference(&key()).await.unwrap();
    assert_eq!((reference.pictures.len(), reference.times.len()), (1, 1), "the same picture of the same run");
    assert_eq!(farm.store.run(&run).await.unwrap().unwrap().cases[0].ok, Some(true));
    assert!(farm.store.is_blob_used("accepted blob").await.unwrap());
    let other = BaselineKey { device_class: "gpu".to_owned(), ..key() };
    assert!(farm.store.reference(&other).await.unwrap().pictures.is_empty());
    let freed = farm.store.reset_baseline(&decision(farm, &run, DecisionKind::Reset)).await.unwrap();
    assert_eq!(freed, ["accepted blob"]);
    assert!(!farm.store.is_blob_used("accepted blob").await.unwrap());
    assert!(farm.store.reference(&key()).await.unwrap().times.is_empty());
    let all = farm.store.decisions(&DecisionQuery::default(), &PageRequest { limit: 9, after: None }).await.unwrap();
    assert_eq!(
        all.iter().map(|one| one.kind).collect::<Vec<_>>(),
        [DecisionKind::Reset, DecisionKind::Approved, DecisionKind::Approved]
    );
}

pub(super) async fn new_times_take_the_place_of_old_ones_where_the_level_changed(farm: &Farm) {
    let (one, two) = (run(farm).await, run(farm).await);
    approve(farm, &one, false).await;
    approve(farm, &two, false).await;
    assert_eq!(farm.store.reference(&key()).await.unwrap().times.len(), 2);
    approve(farm, &two, true).await;
    assert_eq!(farm.store.reference(&key()).await.unwrap().times.len(), 1);
    let rejected = CaseDecision { decision: decision(farm, &two, DecisionKind::Rejected), accepted: None, ok: false };
    farm.store.decide(&[rejected], farm.now()).await.unwrap();
    assert!(farm.store.reference(&key()).await.unwrap().times.is_empty(), "a rejection withdraws");
}

pub(super) async fn old_runs_are_found_and_deleted_with_their_pictures(farm: &Farm) {
    let (old, new) = (run(farm).await, run(farm).await);
    assert!(farm.store.old_runs(1, 9).await.unwrap().is_empty(), "it runs");
    for case in farm.store.open_cases().await.unwrap() {
        step(farm, &case, &finish(true)).await;
    }
    approve(farm, &old, false).await;
    assert_eq!(farm.store.old_runs(1, 9).await.unwrap(), std::slice::from_ref(&old));
    assert!(farm.store.is_blob_used("blob of a run").await.unwrap());
    assert_eq!(farm.store.delete_run(&old).await.unwrap(), ["blob of a run"]);
    assert!(farm.store.run(&old).await.unwrap().is_none() && farm.store.run(&new).await.unwrap().is_some());
    assert_eq!(farm.store.reference(&key()).await.unwrap().pictures.len(), 1, "what was accepted stays");
    assert!(farm.store.is_blob_used("accepted blob").await.unwrap());
}

pub(super) async fn a_noise_floor_is_that_of_the_last_calibration(farm: &Farm) {
    for floor in [0.1, 0.2] {
        run(farm).await;
        let case = open(farm, "a").await;
        step(farm, &case, &CaseStep { noise_floor: Some((TimeMetric::RenderS, floor)), ..finish(true) }).await;
    }
    assert_eq!(farm.store.reference(&key()).await.unwrap().noise_floors, [(TimeMetric::RenderS, 0.2)]);
}
