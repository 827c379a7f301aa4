//! Jobs: made, cancelled, retried, given up, deleted.

use lightshaft_api::event::EventKind;
use lightshaft_api::job::{AttemptOutcome, CacheReport, CacheSource, JobState, Metrics, TaskState};
use lightshaft_api::lease::{Complete, NewArtifact, RetryClass};
use lightshaft_api::settings::{DeviceChoice, Environment, EnvironmentMap, Split};

use super::{Farm, job_record, picture};
use crate::store::{Automatic, Change, Close, Creation, Idempotency, JobQuery, JobRemoval, PageRequest};

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
        let cache = CacheReport {
            mesh: "m".to_owned(),
            structure: "bvh".to_owned(),
            source,
            built_on: None,
            seconds: 1.0,
            bytes: 8,
        };
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
