//! Jobs, scenes, meshes, workers and events.

use std::collections::BTreeMap;

use lightshaft_api::event::EventKind;
use lightshaft_api::job::{AttemptOutcome, CacheReport, CacheSource, JobState, Metrics, RayCounts, TaskState};
use lightshaft_api::lease::{Complete, Fail, NewArtifact, RetryClass};
use lightshaft_api::mesh::{FindStructures, NewStructure};
use lightshaft_api::settings::{DeviceChoice, Environment, EnvironmentMap, Integrator, RenderSettings, Split};

use super::{Farm, TTL, job_record, picture, scene_record};
use crate::store::{Automatic, Change, Close, Creation, Idempotency, JobQuery, JobRemoval, PageRequest, Removal};

fn first_page(limit: u32) -> PageRequest {
    PageRequest { limit, after: None }
}

pub(super) async fn a_job_needs_a_scene(farm: &Farm) {
    let creation = farm.store.create_job(&job_record("none"), None, farm.now()).await.unwrap();
    assert_eq!(creation, Creation::UnknownScene);
    assert!(farm.store.jobs(&JobQuery::default(), &first_page(10)).await.unwrap().is_empty());
}

pub(super) async fn an_idempotency_key_makes_one_job(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let key = |fingerprint: &str| Idempotency {
        key: "k".to_owned(),
        fingerprint: fingerprint.to_owned(),
        not_before: farm.now() - 1000,
    };
    let first = job_record(&scene);
    assert_eq!(farm.store.create_job(&first, Some(&key("a")), farm.now()).await.unwrap(), Creation::Created);
    let again = farm.store.create_job(&job_record(&scene), Some(&key("a")), farm.now()).await.unwrap();
    assert_eq!(again, Creation::Repeated(first.id.clone()));
    let other = farm.store.create_job(&job_record(&scene), Some(&key("b")), farm.now()).await.unwrap();
    assert_eq!(other, Creation::KeyReused);
    assert_eq!(farm.store.repeated_job(&key("a")).await.unwrap(), Some(Creation::Repeated(first.id)));
    assert_eq!(farm.store.jobs(&JobQuery::default(), &first_page(10)).await.unwrap().len(), 1);
}

pub(super) async fn an_idempotency_key_is_forgotten(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let key = |fingerprint: &str| Idempotency {
        key: "k".to_owned(),
        fingerprint: fingerprint.to_owned(),
        not_before: farm.now() - 1000,
    };
    farm.store.create_job(&job_record(&scene), Some(&key("a")), farm.now()).await.unwrap();
    farm.wait(1001);
    assert_eq!(farm.store.repeated_job(&key("b")).await.unwrap(), None);
    let later = farm.store.create_job(&job_record(&scene), Some(&key("b")), farm.now()).await.unwrap();
    assert_eq!(later, Creation::Created);
    assert_eq!(farm.store.forget_before(farm.now() + 1, 0).await.unwrap(), 1);
}

pub(super) async fn a_merge_waits_for_every_part(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| picture(job).split = Some(Split::Passes(2))).await;
    let worker = farm.worker().await;
    use TaskState::{Blocked, Leased, Ready, Succeeded};
    assert_eq!(farm.task_states(&job).await, [Ready, Ready, Blocked]);
    let (first, second) = (farm.claim(&worker).await.unwrap(), farm.claim(&worker).await.unwrap());
    farm.complete(&second).await;
    assert_eq!(farm.task_states(&job).await, [Leased, Succeeded, Blocked]);
    farm.complete(&first).await;
    let merge = farm.claim(&worker).await.unwrap();
    let parts: Vec<_> = merge.task.parts.iter().map(|part| part.work.clone()).collect();
    assert_eq!(parts, [first.task.work.clone(), second.task.work.clone()]);
    farm.complete(&merge).await;
    let job = farm.read(&job).await;
    assert_eq!((job.summary.state, job.artifacts.len()), (JobState::Succeeded, 1));
    assert_eq!(job.metrics.unwrap().render_s, 3.0, "over all tasks");
}

pub(super) async fn a_merged_picture_leaves_no_parts(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| picture(job).split = Some(Split::Passes(2))).await;
    let worker = farm.worker().await;
    let report = |blob: &str, name: &str, source| {
        let cache = CacheReport { mesh: "m".to_owned(), structure: "bvh".to_owned(), source, seconds: 1.0, bytes: 8 };
        let artifact =
            NewArtifact { name: name.to_owned(), media_type: "x/y".to_owned(), bytes: 1, blob: blob.to_owned() };
        Complete { artifacts: vec![artifact], metrics: Metrics { cache: vec![cache], ..Metrics::default() } }
    };
    for blob in ["left", "right"] {
        let held = farm.claim(&worker).await.unwrap();
        let part = report(blob, NewArtifact::PART, CacheSource::Memory);
        assert!(farm.store.complete(&held.token, &part, farm.now()).await.unwrap().freed.is_empty());
        assert!(farm.store.is_blob_used(blob).await.unwrap());
    }
    let merge = farm.claim(&worker).await.unwrap();
    let whole = report("whole", "image.png", CacheSource::Memory);
    let mut completed = farm.store.complete(&merge.token, &whole, farm.now()).await.unwrap();
    completed.freed.sort();
    assert_eq!(completed.freed, ["left", "right"]);
    for (blob, is_used) in [("left", false), ("right", false), ("whole", true)] {
        assert_eq!(farm.store.is_blob_used(blob).await.unwrap(), is_used, "{blob}");
    }
    let cache = farm.read(&job).await.metrics.unwrap().cache;
    assert_eq!((cache.len(), cache[0].seconds), (1, 3.0), "once, however many tasks");
    let again = farm.store.complete(&merge.token, &whole, farm.now()).await.unwrap();
    assert_eq!((again.close, again.freed.len()), (Close::Already(AttemptOutcome::Succeeded), 0));
}

pub(super) async fn only_finished_jobs_are_deleted_and_then_with_everything(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let key = Idempotency { key: "k".to_owned(), fingerprint: "f".to_owned(), not_before: 0 };
    let mut record = job_record(&scene);
    record.labels.insert("a".to_owned(), "b".to_owned());
    let map = EnvironmentMap { map: "sky".to_owned(), intensity: 1.0, rotation_deg: 0.0 };
    picture(&mut record).environment = Some(Environment::Map(map));
    farm.store.create_job(&record, Some(&key), farm.now()).await.unwrap();
    let (job, other) = (record.id, farm.job(&scene).await);
    let worker = farm.worker().await;
    let delete = async |id: &str| farm.store.delete_job(id, farm.now()).await.unwrap();
    assert_eq!(delete("none").await, JobRemoval::Unknown);
    assert_eq!(delete(&job).await, JobRemoval::Unfinished(JobState::Queued));
    let failed = farm.claim(&worker).await.unwrap();
    farm.fail(&failed, RetryClass::Task).await;
    let held = farm.claim(&worker).await.unwrap();
    assert_eq!(held.task.job, job);
    assert_eq!(delete(&job).await, JobRemoval::Unfinished(JobState::Running));
    farm.complete(&held).await;
    let artifact = format!("blob of {}", held.token);
    let JobRemoval::Done { blobs, attempts } = delete(&job).await else { panic!("it has ended") };
    assert_eq!((blobs, attempts.len()), (vec![artifact.clone(), "sky".to_owned()], 2));
    assert!(farm.store.job(&job).await.unwrap().is_none() && farm.store.lease(&held.token).await.unwrap().is_none());
    assert!(!farm.store.is_blob_used(&artifact).await.unwrap() && !farm.store.is_blob_used("sky").await.unwrap());
    assert_eq!(farm.store.repeated_job(&key).await.unwrap(), None, "its key is free again");
    let events = farm.store.events_after(0, Some(&job), 100).await.unwrap();
    assert_eq!(events.iter().map(|event| event.kind).collect::<Vec<_>>(), [EventKind::JobDeleted]);
    assert_eq!(delete(&job).await, JobRemoval::Unknown);
    assert_eq!(farm.state(&other).await, JobState::Queued, "others stay");
}

pub(super) async fn old_jobs_are_found_but_thumbnails_stay(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let thumbnail = farm.job_with(&scene, |job| job.automatic = Some(Automatic::Thumbnail)).await;
    let view = farm.job_with(&scene, |job| job.automatic = Some(Automatic::Camera)).await;
    let (old, recent, open) = (farm.job(&scene).await, farm.job(&scene).await, farm.job(&scene).await);
    for id in [&thumbnail, &view, &old] {
        farm.store.cancel_job(id, farm.now()).await.unwrap();
    }
    farm.wait(1_000);
    farm.store.cancel_job(&recent, farm.now()).await.unwrap();
    let find = async |before| farm.store.jobs_finished_before(before, 10).await.unwrap();
    assert_eq!(find(farm.now()).await, std::slice::from_ref(&old));
    assert_eq!(find(farm.now() + 1).await, [old.clone(), recent.clone()]);
    assert_eq!(farm.store.jobs_finished_before(farm.now() + 1, 1).await.unwrap(), std::slice::from_ref(&old));
    farm.store.cancel_job(&open, farm.now()).await.unwrap();
    farm.store.delete_scene(&scene, farm.now()).await.unwrap();
    assert!(find(farm.now()).await.contains(&thumbnail), "its scene has gone");
}

pub(super) async fn scenes_get_one_thumbnail_each(farm: &Farm) {
    let (first, second) = (farm.scene().await.0, farm.scene().await.0);
    let bare = async || {
        let scenes = farm.store.scenes_without_thumbnail(10).await.unwrap();
        scenes.into_iter().map(|scene| scene.id).collect::<Vec<_>>()
    };
    assert_eq!(bare().await, [first.clone(), second.clone()]);
    farm.job(&first).await;
    let view = |job: &mut crate::store::JobRecord| job.automatic = Some(Automatic::Camera);
    farm.job_with(&first, view).await;
    assert_eq!(bare().await, [first.clone(), second.clone()], "what a camera sees is none");
    let job = farm.job_with(&first, |job| job.automatic = Some(Automatic::Thumbnail)).await;
    farm.job_with(&first, view).await;
    assert_eq!(bare().await, std::slice::from_ref(&second));
    assert_eq!(farm.store.thumbnail_job(&first).await.unwrap(), Some(job));
    farm.store.delete_scene(&second, farm.now()).await.unwrap();
    assert!(bare().await.is_empty());
}

pub(super) async fn a_retry_repeats_only_what_did_not_succeed(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| picture(job).split = Some(Split::Passes(2))).await;
    let worker = farm.worker().await;
    let (good, bad) = (farm.claim(&worker).await.unwrap(), farm.claim(&worker).await.unwrap());
    farm.complete(&good).await;
    farm.fail_for_good(&bad).await;
    assert_eq!(farm.state(&job).await, JobState::Failed);
    assert_eq!(farm.store.retry_job(&job, farm.now()).await.unwrap(), Change::Done);
    use TaskState::{Blocked, Ready, Succeeded};
    assert_eq!(farm.task_states(&job).await, [Succeeded, Ready, Blocked]);
    let read = farm.read(&job).await;
    assert_eq!((read.summary.state, read.summary.error, read.summary.finished_at), (JobState::Running, None, None));
    for _ in 0..2 {
        let held = farm.claim(&worker).await.unwrap();
        farm.complete(&held).await;
    }
    assert_eq!(farm.state(&job).await, JobState::Succeeded);
}

pub(super) async fn a_job_that_nobody_can_do_is_given_up_unless_taken(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let anywhere = farm.job(&scene).await;
    let demand = |job: &mut crate::store::JobRecord| {
        picture(job).device = DeviceChoice::Gpu;
        picture(job).adapter = Some("Radeon".to_owned());
        picture(job).split = Some(Split::Tiles([2, 1]));
    };
    let (job, taken) = (farm.job_with(&scene, demand).await, farm.job_with(&scene, demand).await);
    let paused = farm.job_with(&scene, demand).await;
    farm.store.patch_job(&paused, None, Some(true), farm.now()).await.unwrap();
    let demanding = farm.store.demanding_jobs().await.unwrap();
    let ids: Vec<&str> = demanding.iter().map(|demanding| demanding.job.as_str()).collect();
    assert_eq!(ids, [&job, &taken], "neither those without a demand nor paused ones");
    assert_eq!(demanding[0].demand.adapter.as_deref(), Some("radeon"));
    assert_eq!(demanding[0].ready_since, farm.now());

    farm.store.cancel_job(&anywhere, farm.now()).await.unwrap();
    let worker = farm.worker_with(&["Radeon RX"]).await;
    let first = farm.claim(&worker).await.unwrap();
    farm.complete(&first).await;
    assert!(farm.store.give_up_job(&job, "nobody has it", farm.now()).await.unwrap());
    use TaskState::{Cancelled, Failed, Ready, Succeeded};
    assert_eq!(farm.task_states(&job).await, [Succeeded, Failed, Cancelled]);
    let read = farm.read(&job).await;
    assert_eq!((read.summary.state, read.summary.error.as_deref()), (JobState::Failed, Some("nobody has it")));
    assert_eq!(read.tasks[1].error.as_deref(), Some("nobody has it"));

    for _ in 0..2 {
        assert_eq!(farm.claim(&worker).await.unwrap().task.job, taken);
    }
    assert!(!farm.store.give_up_job(&taken, "nobody has it", farm.now()).await.unwrap(), "somebody had it");
    assert_eq!(farm.state(&taken).await, JobState::Running);

    farm.store.retry_job(&job, farm.now()).await.unwrap();
    assert_eq!(farm.task_states(&job).await, [Succeeded, Ready, TaskState::Blocked]);
    assert_eq!(farm.read(&job).await.tasks[1].error, None);
}

pub(super) async fn running_and_succeeded_jobs_are_not_retried(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let worker = farm.worker().await;
    let retry = || farm.store.retry_job(&job, farm.now());
    assert_eq!(retry().await.unwrap(), Change::Refused(JobState::Queued));
    let held = farm.claim(&worker).await.unwrap();
    assert_eq!(retry().await.unwrap(), Change::Refused(JobState::Running));
    farm.complete(&held).await;
    assert_eq!(retry().await.unwrap(), Change::Refused(JobState::Succeeded));
    assert_eq!(farm.store.retry_job("none", farm.now()).await.unwrap(), Change::Unknown);
}

pub(super) async fn cancelling_is_idempotent_and_refused_at_the_end(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    for _ in 0..2 {
        assert_eq!(farm.store.cancel_job(&job, farm.now()).await.unwrap(), Change::Done);
        assert_eq!(farm.state(&job).await, JobState::Cancelled);
    }
    let worker = farm.worker().await;
    assert!(farm.claim(&worker).await.is_none());
    let done = farm.job(&scene).await;
    let held = farm.claim(&worker).await.unwrap();
    farm.complete(&held).await;
    let refused = farm.store.cancel_job(&done, farm.now()).await.unwrap();
    assert_eq!(refused, Change::Refused(JobState::Succeeded));
    assert_eq!(farm.store.cancel_job("none", farm.now()).await.unwrap(), Change::Unknown);
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

pub(super) async fn the_same_scene_is_kept_once(farm: &Farm) {
    let first = farm.store.insert_scene(&scene_record(7, "m"), farm.now()).await.unwrap();
    let second = farm.store.insert_scene(&scene_record(7, "m"), farm.now()).await.unwrap();
    assert_eq!((first.1, second.1, &first.0), (true, false, &second.0));
    assert_eq!(farm.store.scenes(&first_page(10)).await.unwrap().len(), 1);
    assert_eq!(farm.store.scene_by_hash("scene 7").await.unwrap().unwrap().id, first.0);
    assert_eq!(farm.store.delete_scene(&first.0, farm.now()).await.unwrap(), Removal::Done);
    assert_eq!(farm.store.delete_scene(&first.0, farm.now()).await.unwrap(), Removal::Unknown);
    let third = farm.store.insert_scene(&scene_record(7, "m"), farm.now()).await.unwrap();
    assert!(third.1 && third.0 != first.0, "after its deletion it is a new one");
}

pub(super) async fn a_scene_in_use_is_not_deleted(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    assert_eq!(farm.store.delete_scene(&scene, farm.now()).await.unwrap(), Removal::InUse);
    farm.store.cancel_job(&job, farm.now()).await.unwrap();
    assert_eq!(farm.store.delete_scene(&scene, farm.now()).await.unwrap(), Removal::Done);
    assert!(farm.store.scene(&scene).await.unwrap().is_none());
    assert_eq!(farm.read(&job).await.summary.scene_name, "Scene 0", "finished jobs stay");
    assert_eq!(farm.store.retry_job(&job, farm.now()).await.unwrap(), Change::SceneGone);
    let creation = farm.store.create_job(&job_record(&scene), None, farm.now()).await.unwrap();
    assert_eq!(creation, Creation::UnknownScene);
}

pub(super) async fn deleting_a_scene_cancels_its_automatic_jobs(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| job.automatic = Some(Automatic::Thumbnail)).await;
    assert_eq!(farm.store.delete_scene(&scene, farm.now()).await.unwrap(), Removal::Done);
    assert_eq!(farm.state(&job).await, JobState::Cancelled);
}

pub(super) async fn the_first_structure_of_a_key_is_kept(farm: &Farm) {
    let (_, mesh) = farm.scene().await;
    let structure = |blob: &str| NewStructure {
        kind: "bvh".to_owned(),
        parameters: "quality=medium".to_owned(),
        builder_version: 1,
        bytes: 10,
        build_s: 0.5,
        blob: blob.to_owned(),
        replaces: None,
    };
    let first = farm.store.add_structure(&mesh, &structure("a"), farm.now()).await.unwrap().unwrap();
    let second = farm.store.add_structure(&mesh, &structure("b"), farm.now()).await.unwrap().unwrap();
    assert_eq!((first.blob.as_str(), second.blob.as_str()), ("a", "a"));
    assert_eq!(farm.store.mesh(&mesh).await.unwrap().unwrap().structures, [first]);
    assert!(farm.store.add_structure("none", &structure("a"), farm.now()).await.unwrap().is_none());
    assert_eq!(farm.store.meshes(None, &first_page(10)).await.unwrap().len(), 1);

    let (_, other) = farm.scene().await;
    let find = async |parameters: &str, builder_version| {
        let meshes = vec![mesh.clone(), other.clone(), "none".to_owned()];
        let wanted =
            FindStructures { meshes, kind: "bvh".to_owned(), parameters: parameters.to_owned(), builder_version };
        farm.store.find_structures(&wanted).await.unwrap()
    };
    assert_eq!(find("quality=medium", 1).await, BTreeMap::from([(mesh.clone(), "a".to_owned())]));
    assert!(find("quality=high", 1).await.is_empty() && find("quality=medium", 2).await.is_empty());
}

pub(super) async fn an_unreadable_structure_is_replaced_once(farm: &Farm) {
    let (_, mesh) = farm.scene().await;
    let add = async |blob: &str, replaces: Option<&str>| {
        let structure = NewStructure {
            kind: "bvh".to_owned(),
            parameters: "p".to_owned(),
            builder_version: 1,
            bytes: 4,
            build_s: 1.0,
            blob: blob.to_owned(),
            replaces: replaces.map(str::to_owned),
        };
        farm.store.add_structure(&mesh, &structure, farm.now()).await.unwrap().unwrap().blob
    };
    assert_eq!(add("bad", None).await, "bad");
    assert_eq!(add("good", Some("bad")).await, "good");
    assert_eq!(add("late", Some("bad")).await, "good", "what was bad has been replaced already");
    assert!(!farm.store.is_blob_used("bad").await.unwrap());
}

pub(super) async fn used_blobs_are_known(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| {
        let map = EnvironmentMap { map: "sky".to_owned(), intensity: 1.0, rotation_deg: 0.0 };
        picture(job).environment = Some(Environment::Map(map));
    });
    job.await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    farm.complete(&held).await;
    for used in ["file of 0", "sky", &format!("blob of {}", held.token)] {
        assert!(farm.store.is_blob_used(used).await.unwrap(), "{used}");
    }
    assert!(!farm.store.is_blob_used("other").await.unwrap());
    assert_eq!(farm.store.scene_blobs(&scene).await.unwrap(), ["file of 0"]);
    farm.store.delete_scene(&scene, farm.now()).await.unwrap();
    assert!(!farm.store.is_blob_used("file of 0").await.unwrap());
}

pub(super) async fn a_busy_worker_is_not_removed(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    assert_eq!(farm.store.worker(&worker).await.unwrap().unwrap().current.unwrap().task, held.task.task);
    assert_eq!(farm.store.remove_worker(&worker, farm.now()).await.unwrap(), Removal::InUse);
    farm.complete(&held).await;
    assert_eq!(farm.store.remove_worker(&worker, farm.now()).await.unwrap(), Removal::Done);
    assert_eq!(farm.store.remove_worker(&worker, farm.now()).await.unwrap(), Removal::Unknown);
    assert!(farm.store.workers().await.unwrap().is_empty());
}

pub(super) async fn the_store_can_be_written(farm: &Farm) {
    farm.store.check_writable(farm.now()).await.unwrap();
    farm.store.check_writable(farm.now() + 1).await.unwrap();
    farm.store.checkpoint().await.unwrap();
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
