//! What is told of jobs: lists, the queue, events, measurements, totals.

use std::collections::BTreeMap;

use lightshaft_api::event::EventKind;
use lightshaft_api::job::{JobState, Metrics, RayCounts};
use lightshaft_api::lease::{Complete, Fail, RetryClass};
use lightshaft_api::settings::{DeviceChoice, Integrator, RenderSettings, Split};

use super::{Farm, TTL, picture};
use crate::store::{Automatic, JobQuery, PageRequest};

fn first_page(limit: u32) -> PageRequest {
    PageRequest { limit, after: None }
}

pub(super) async fn jobs_are_listed_newest_first_and_filtered(farm: &Farm) {
    let ((one, _), (two, _)) = (farm.scene().await, farm.scene().await);
    let label = |key: &str, value: &str| BTreeMap::from([(key.to_owned(), value.to_owned())]);
    let plain = farm.job(&one).await;
    let labelled = farm.job_with(&two, |job| job.labels = label("suite", "Night")).await;
    let automatic = farm.job_with(&two, |job| job.automatic = Some(Automatic::Thumbnail)).await;
    farm.store.cancel_job(&plain, farm.now()).await.unwrap();
    let list = |query: JobQuery| async move {
        let jobs = farm.store.jobs(&query, &first_page(10)).await.unwrap();
        jobs.into_iter().map(|job| job.summary.id).collect::<Vec<_>>()
    };
    let all = JobQuery::default();
    assert_eq!(list(all.clone()).await, [automatic.clone(), labelled.clone(), plain.clone()]);
    let state = Some(JobState::Cancelled);
    assert_eq!(list(JobQuery { state, ..all.clone() }).await, [plain.as_str()]);
    let scene = Some(two.clone());
    assert_eq!(list(JobQuery { scene, ..all.clone() }).await, [automatic.clone(), labelled.clone()]);
    assert_eq!(list(JobQuery { automatic: Some(true), ..all.clone() }).await, [automatic.as_str()]);
    assert_eq!(list(JobQuery { automatic: Some(false), ..all.clone() }).await, [labelled.clone(), plain.clone()]);
    assert_eq!(list(JobQuery { labels: label("suite", "Night"), ..all.clone() }).await, [labelled.as_str()]);
    assert!(list(JobQuery { labels: label("suite", "Day"), ..all.clone() }).await.is_empty());
    let text = |text: &str| JobQuery { text: Some(text.to_owned()), ..all.clone() };
    assert_eq!(list(text("night")).await, [labelled]);
    assert_eq!(list(text("SCENE 0")).await, [plain.as_str()]);
    assert_eq!(list(text(&plain)).await, [plain]);
    assert!(list(text("%")).await.is_empty(), "text is text, not a pattern");
}

pub(super) async fn pages_join_without_gap_or_repeat(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let mut made = Vec::new();
    for _ in 0..7 {
        made.push(farm.job(&scene).await);
    }
    made.reverse();
    let (mut seen, mut after) = (Vec::new(), None);
    loop {
        let page = farm.store.jobs(&JobQuery::default(), &PageRequest { limit: 3, after }).await.unwrap();
        let Some(last) = page.last() else { break };
        after = Some(last.summary.id.clone());
        seen.extend(page.into_iter().map(|job| job.summary.id));
        farm.job(&scene).await;
    }
    assert_eq!(seen, made, "jobs made meanwhile do not shift the pages");
}

pub(super) async fn the_queue_stands_in_the_order_of_turns(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let low = farm.job_with(&scene, |job| job.priority = -5).await;
    farm.wait(10);
    let first = farm.job(&scene).await;
    farm.wait(10);
    let second = farm.job(&scene).await;
    let paused = farm.job_with(&scene, |job| job.priority = 50).await;
    farm.store.patch_job(&paused, None, Some(true), farm.now()).await.unwrap();
    let done = farm.job(&scene).await;
    farm.store.cancel_job(&done, farm.now()).await.unwrap();
    let order = async || -> Vec<String> {
        let queue = farm.store.queue(10, farm.now()).await.unwrap();
        queue.into_iter().map(|record| record.job.summary.id).collect()
    };
    assert_eq!(order().await, [&first, &second, &low, &paused].map(Clone::clone));
    farm.store.patch_job(&low, Some(5), None, farm.now()).await.unwrap();
    assert_eq!(order().await[0], low, "a changed priority takes effect");
    let held = farm.claim(&farm.worker().await).await.unwrap();
    assert_eq!(held.task.job, low, "the first of the queue is the first to be taken");
    farm.store.patch_job(&second, Some(9), None, farm.now()).await.unwrap();
    assert_eq!(order().await, [&low, &second, &first, &paused].map(Clone::clone), "what runs stands first");
    assert_eq!(farm.store.queue(2, farm.now()).await.unwrap().len(), 2);
}

pub(super) async fn the_queue_tells_what_holds_a_job_up(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let tiles = |job: &mut crate::store::JobRecord| {
        picture(job).split = Some(Split::Tiles([2, 1]));
        picture(job).device = DeviceChoice::Gpu;
        picture(job).adapter = Some("Radeon".to_owned());
    };
    let job = farm.job_with(&scene, tiles).await;
    let (worker, other) = (farm.worker_with(&["Radeon"]).await, farm.worker_with(&["Radeon Pro"]).await);
    let read = async || farm.store.queue(10, farm.now()).await.unwrap().remove(0);
    let waiting = read().await;
    assert_eq!((waiting.tasks_ready, waiting.tasks_blocked, waiting.failures), (2, 1, 0));
    assert_eq!(waiting.demand.adapter.as_deref(), Some("radeon"));
    assert_eq!((waiting.ready_at, waiting.leases.len()), (Some(farm.now()), 0));

    for error in ["first", "second"] {
        let held = farm.claim(&worker).await.unwrap();
        let report = Fail { class: RetryClass::Worker, error: error.to_owned(), fatal: false };
        farm.store.fail(&held.token, &report, 0.0, farm.now()).await.unwrap();
        farm.wait(1);
    }
    let held = farm.claim(&other).await.unwrap();
    let record = read().await;
    assert_eq!(record.job.summary.id, job);
    assert_eq!((record.failures, record.last_error.as_deref()), (2, Some("second")));
    let lease = &record.leases[0];
    assert_eq!((&lease.task, &lease.worker, lease.attempt), (&held.task.task, &other, held.task.number));
    assert_eq!(lease.expires_at.as_millisecond(), farm.now() + TTL);
    let block = &record.blocked_workers[0];
    assert_eq!((&block.worker, block.failures), (&worker, 2));
    farm.wait(block.until.as_millisecond() - farm.now());
    assert!(read().await.blocked_workers.is_empty(), "it may try again");
}

pub(super) async fn measurements_are_those_of_jobs_that_rendered_alike(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let worker = farm.worker().await;
    let job = farm.job_with(&scene, |job| (picture(job).width, picture(job).height) = (40, 30)).await;
    let held = farm.claim(&worker).await.unwrap();
    assert_eq!(held.task.job, job);
    let rays = RayCounts { primary: 5000, shadow: 4000, ao: 0, indirect: 1000 };
    let metrics = Metrics {
        rays,
        mrays_per_s: 2.5,
        spp: 4,
        device: "AVX2".into(),
        device_kind: "cpu".into(),
        ..Metrics::default()
    };
    let report = Complete { artifacts: Vec::new(), metrics };
    farm.store.complete(&held.token, &report, farm.now()).await.unwrap();
    farm.job(&scene).await;
    let of = async |integrator| farm.store.measurements(integrator, 10).await.unwrap();
    let found = of(RenderSettings::default().integrator).await;
    let [measured] = found.as_slice() else { panic!("one has succeeded: {found:?}") };
    assert_eq!((measured.samples, measured.rays), (40.0 * 30.0 * 4.0, 10_000.0));
    assert_eq!((measured.scene == scene, measured.device_kind.as_str()), (true, "cpu"));
    assert!(of(Integrator::Aov).await.is_empty());
}

pub(super) async fn events_tell_a_jobs_story_in_order(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    farm.fail(&held, RetryClass::Task).await;
    let held = farm.claim(&worker).await.unwrap();
    farm.complete(&held).await;
    let events = farm.store.events_after(0, Some(&job), 100).await.unwrap();
    let kinds: Vec<_> = events.iter().map(|event| event.kind).collect();
    use EventKind::{JobChanged, JobCreated, JobStarted, JobSucceeded, TaskLeased, TaskRetried, TaskSucceeded};
    let story = [
        JobCreated,
        JobStarted,
        TaskLeased,
        TaskRetried,
        JobChanged,
        JobChanged,
        TaskLeased,
        TaskSucceeded,
        JobSucceeded,
    ];
    assert_eq!(kinds, story);
    let third = events[2].id.unwrap();
    let rest = farm.store.events_after(third, Some(&job), 2).await.unwrap();
    assert_eq!(rest, events[3..5], "resuming goes on after the last one seen");
    assert!(farm.store.last_event().await.unwrap() > third);
}

pub(super) async fn totals_count_everything(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job_with(&scene, |job| picture(job).split = Some(Split::Tiles([3, 1]))).await;
    let cancelled = farm.job(&scene).await;
    farm.store.cancel_job(&cancelled, farm.now()).await.unwrap();
    let worker = farm.worker().await;
    farm.claim(&worker).await.unwrap();
    let totals = farm.store.totals().await.unwrap();
    assert_eq!((totals.jobs.running, totals.jobs.cancelled, totals.scenes), (1, 1, 1));
    let tasks = totals.tasks;
    assert_eq!((tasks.leased, tasks.ready, tasks.blocked, tasks.cancelled), (1, 2, 1, 1));
}
