//! The worker protocol.

use std::time::{Duration, Instant};

use http::StatusCode;
use lightshaft_api::job::{AttemptOutcome, JobState, TaskState, TaskWork};
use lightshaft_api::lease::HeartbeatReply;
use lightshaft_server::clock::Clock;
use serde_json::json;

use crate::harness::{Service, lease_request, new_job, triangle_glb};

#[tokio::test]
async fn a_job_goes_from_submit_to_done() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene })).await;
    assert_eq!(job.summary.state, JobState::Queued);

    let lease = service.lease(&worker).await.unwrap();
    assert_eq!((lease.job.as_str(), lease.attempt_number, &lease.work), (job.summary.id.as_str(), 1, &TaskWork::Frame));
    assert_eq!(lease.scene.files.len(), 1);
    assert_eq!(lease.scene.files[0].path, "scene.glb");
    assert_eq!(lease.scene.meshes.len(), 1);
    assert!(lease.traceparent.contains(&job.summary.trace_id), "one trace from submit to done");
    let input = service.get(&format!("/v1/blobs/{}", lease.scene.files[0].blob)).await;
    assert_eq!(input.body, triangle_glb(0));

    let beat = service.report(&lease, "heartbeat", json!({ "phase": "render", "progress": 0.5 })).await;
    assert_eq!(beat.status, StatusCode::OK);
    let running = service.read_job(&job.summary.id).await;
    assert_eq!((running.summary.state, running.summary.progress), (JobState::Running, 0.5));

    assert_eq!(service.complete(&lease, "image.png", "a picture").await.status, StatusCode::OK);
    let done = service.read_job(&job.summary.id).await;
    assert_eq!((done.summary.state, done.summary.progress), (JobState::Succeeded, 1.0));
    assert_eq!(done.attempts[0].outcome, AttemptOutcome::Succeeded);
    assert_eq!(done.artifacts[0].name, "image.png");
    assert!(done.metrics.is_some() && done.summary.finished_at.is_some());
    let picture = service.get(&done.artifacts[0].href).await;
    assert_eq!((picture.header("content-type"), picture.body.as_slice()), ("image/png", b"a picture".as_slice()));
}

#[tokio::test]
async fn a_waiting_worker_gets_a_new_job_at_once() {
    let service = Service::start().await;
    let client = service.listen().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let mut latencies = Vec::new();
    for _ in 0..10 {
        let (poller, request) = (client.clone(), lease_request(&worker, 20));
        let poll = tokio::spawn(async move { (poller.lease(&request).await.unwrap(), Instant::now()) });
        tokio::time::sleep(Duration::from_millis(50)).await;
        let submitted = Instant::now();
        let job = client.create_job(&new_job(&scene), None).await.unwrap();
        let (lease, leased) = poll.await.unwrap();
        let lease = lease.unwrap();
        assert_eq!(lease.job, job.summary.id);
        latencies.push(leased - submitted);
        client
            .fail(
                &lease.token,
                &serde_json::from_value(json!({ "class": "task", "error": "x", "fatal": true })).unwrap(),
            )
            .await
            .unwrap();
    }
    latencies.sort();
    println!("submit to lease: median {:?}, worst {:?}", latencies[5], latencies[9]);
    // Measured at a few milliseconds; far more only when the long poll does not wake.
    assert!(latencies[5] < Duration::from_millis(500), "{latencies:?}");
}

#[tokio::test]
async fn reports_may_be_repeated_but_not_contradicted() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    service.job(json!({ "scene": scene })).await;
    let lease = service.lease(&worker).await.unwrap();
    let first = service.complete(&lease, "image.png", "x").await;
    let second = service.complete(&lease, "image.png", "x").await;
    assert_eq!((first.status, &first.body), (second.status, &second.body));
    let fail = service.report(&lease, "fail", json!({ "class": "task", "error": "late" })).await;
    assert_eq!((fail.status, fail.problem().code()), (StatusCode::CONFLICT, "stale-lease"));
    let beat = service.report(&lease, "heartbeat", json!({ "phase": "render", "progress": 1 })).await;
    assert_eq!((beat.status, beat.problem().code()), (StatusCode::GONE, "lease-ended"));
}

#[tokio::test]
async fn a_silent_worker_loses_its_task_and_its_late_report_changes_nothing() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let (slow, other) = (service.worker(&["cpu"]).await, service.worker(&["cpu"]).await);
    let job = service.job(json!({ "scene": scene })).await;
    let stale = service.lease(&slow).await.unwrap();
    service.clock.advance(59_000);
    assert_eq!(service.app.expire_leases().await.unwrap(), 0);
    service.clock.advance(1_000);
    assert_eq!(service.app.expire_leases().await.unwrap(), 1);
    let lease = service.lease(&other).await.unwrap();
    assert_eq!((lease.task.as_str(), lease.attempt_number), (stale.task.as_str(), 2));
    assert_eq!(service.complete(&stale, "image.png", "late").await.status, StatusCode::CONFLICT);
    assert_eq!(service.complete(&lease, "image.png", "good").await.status, StatusCode::OK);
    let done = service.read_job(&job.summary.id).await;
    let outcomes: Vec<_> = done.attempts.iter().map(|attempt| attempt.outcome).collect();
    assert_eq!(outcomes, [AttemptOutcome::Expired, AttemptOutcome::Succeeded]);
    assert_eq!(service.get(&done.artifacts[0].href).await.body, b"good");
}

#[tokio::test]
async fn heartbeats_keep_a_lease_for_ever() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    service.job(json!({ "scene": scene })).await;
    let lease = service.lease(&worker).await.unwrap();
    for i in 0..100 {
        service.clock.advance(7_000);
        let progress = f64::from(i) / 100.0;
        let beat = service.report(&lease, "heartbeat", json!({ "phase": "render", "progress": progress })).await;
        assert_eq!(beat.status, StatusCode::OK);
        assert_eq!(service.app.expire_leases().await.unwrap(), 0);
    }
}

#[tokio::test]
async fn cancelling_reaches_the_worker_by_its_next_heartbeat() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    let lease = service.lease(&worker).await.unwrap();
    let cancelled = service.post(&format!("/v1/jobs/{job}/cancel"), json!(null)).await;
    assert_eq!(cancelled.status, StatusCode::OK);
    assert_eq!(service.read_job(&job).await.summary.state, JobState::Running);
    let beat = service.report(&lease, "heartbeat", json!({ "phase": "render", "progress": 0.1 })).await;
    assert!(beat.json::<HeartbeatReply>().cancel);
    assert_eq!(service.report(&lease, "release", json!({ "cancelled": true })).await.status, StatusCode::OK);
    assert_eq!(service.read_job(&job).await.summary.state, JobState::Cancelled);
}

#[tokio::test]
async fn a_release_spends_no_attempt() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene, "max_attempts": 1 })).await.summary.id;
    for _ in 0..5 {
        let lease = service.lease(&worker).await.unwrap();
        assert_eq!(service.report(&lease, "release", json!({})).await.status, StatusCode::OK);
    }
    let job = service.read_job(&job).await;
    assert_eq!((job.summary.state, job.tasks[0].state, job.tasks[0].attempt), (JobState::Queued, TaskState::Ready, 0));
    assert_eq!(job.attempts.len(), 5);
}

#[tokio::test]
async fn a_split_job_merges_its_parts() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let settings = json!({ "width": 64, "height": 64, "split": { "tiles": [2, 1] } });
    let job = service.job(json!({ "scene": scene, "settings": settings })).await;
    assert_eq!(job.tasks.len(), 3);
    let (left, right) = (service.lease(&worker).await.unwrap(), service.lease(&worker).await.unwrap());
    assert_eq!(left.work, TaskWork::Tile { x: 0, y: 0, width: 32, height: 64 });
    assert!(service.lease(&worker).await.is_none(), "the merge waits");
    service.complete(&right, "part", "right").await;
    service.complete(&left, "part", "left").await;
    let merge = service.lease(&worker).await.unwrap();
    assert_eq!(merge.work, TaskWork::Merge);
    assert_eq!(merge.parts.iter().map(|part| &part.work).collect::<Vec<_>>(), [&left.work, &right.work]);
    service.complete(&merge, "image.png", "whole").await;
    let done = service.read_job(&job.summary.id).await;
    assert_eq!(done.summary.state, JobState::Succeeded);
    assert_eq!(done.artifacts.len(), 1, "the parts are not shown");
}

#[tokio::test]
async fn progress_never_goes_back_while_a_lease_lasts() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene, "settings": { "split": { "tiles": [2, 1] } } })).await.summary.id;
    let first = service.lease(&worker).await.unwrap();
    let shown = async || {
        let listed: serde_json::Value = service.get("/v1/jobs").await.json();
        let read = service.read_job(&job).await;
        assert_eq!(listed["items"][0]["progress"], read.summary.progress, "the list and the job agree");
        read.summary.progress
    };
    let mut before = 0.0;
    let beats = [(0.1, 0), (0.4, 0), (0.2, 0), (0.6, 11_000), (0.5, 0), (0.5, 11_000), (0.9, 0)];
    for (progress, later_ms) in beats {
        service.clock.advance(later_ms);
        let beat = json!({ "phase": "render", "progress": progress, "spp": 1 });
        assert_eq!(service.report(&first, "heartbeat", beat).await.status, StatusCode::OK);
        let now = shown().await;
        assert!(now >= before, "from {before} to {now} by a heartbeat of {progress}");
        before = now;
    }
    assert!((before - 0.3).abs() < 1e-9, "nine tenths of one task of three: {before}");
    service.complete(&first, "part", "left").await;
    assert!((shown().await - 1.0 / 3.0).abs() < 1e-9);

    let second = service.lease(&worker).await.unwrap();
    let beat = json!({ "phase": "render", "progress": 0.5, "spp": 1 });
    service.report(&second, "heartbeat", beat).await;
    service.post(&format!("/v1/jobs/{job}/cancel"), json!(null)).await;
    service.report(&second, "release", json!({ "cancelled": true })).await;
    assert!((shown().await - 0.5).abs() < 1e-9, "a cancelled job stays where it was");
}

#[tokio::test]
async fn a_preview_is_shown_while_the_task_runs() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    let path = format!("/v1/jobs/{job}/preview.png");
    assert_eq!(service.get(&path).await.status, StatusCode::NOT_FOUND);
    let lease = service.lease(&worker).await.unwrap();
    let before = service.blob_files();
    for content in ["first picture", "second picture"] {
        let preview = service.store_blob(content).await;
        let beat = json!({ "phase": "render", "progress": 0.5, "preview": preview, "spp": 1 });
        assert_eq!(service.report(&lease, "heartbeat", beat).await.status, StatusCode::OK);
        assert_eq!(service.get(&path).await.body, content.as_bytes());
        service.app.delete_discarded().await.unwrap();
        assert_eq!(service.blob_files(), before + 1, "the picture before is gone");
    }
    assert_eq!(service.read_job(&job).await.preview, Some(path.clone()));
    service.complete(&lease, "image.png", "second picture").await;
    assert_eq!(service.read_job(&job).await.preview, None);
    assert_eq!(service.get(&path).await.body, b"second picture", "a page that asks late gets the whole picture");
    assert_eq!(service.blob_files(), before + 1, "what became an artifact stays");
}

#[tokio::test]
async fn logs_are_read_back_by_job_and_by_attempt() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    assert_eq!(service.get(&format!("/v1/jobs/{job}/log")).await.body, b"=== no attempt has begun\n");
    let lease = service.lease(&worker).await.unwrap();
    for _ in 0..2 {
        let chunk = json!({ "first_sequence": 0, "lines": ["loading", "rendering"] });
        assert_eq!(service.report(&lease, "logs", chunk).await.json::<serde_json::Value>()["next_sequence"], 2);
    }
    let one = service.get(&format!("/v1/jobs/{job}/log?attempt={}", lease.attempt)).await;
    assert_eq!(one.body, b"loading\nrendering\n");
    let all = service.get(&format!("/v1/jobs/{job}/log")).await;
    assert_eq!(all.body, b"=== task 0, attempt 1, worker worker\nloading\nrendering\n");
    assert_eq!(service.get(&format!("/v1/jobs/{job}/log?attempt=x")).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn artifacts_must_be_what_they_claim() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    service.job(json!({ "scene": scene })).await;
    let lease = service.lease(&worker).await.unwrap();
    let blob = service.store_blob("12345").await;
    let missing = "0".repeat(64);
    let metrics = serde_json::to_value(lightshaft_api::job::Metrics::default()).unwrap();
    let artifacts = json!([
        { "name": "../x", "media_type": "image/png", "bytes": 5, "blob": blob },
        { "name": "a.png", "media_type": "text/html; charset", "bytes": 5, "blob": blob },
        { "name": "a.png", "media_type": "image/png", "bytes": 4, "blob": blob },
        { "name": "b.png", "media_type": "image/png", "bytes": 5, "blob": missing },
    ]);
    let answer = service.report(&lease, "complete", json!({ "artifacts": artifacts, "metrics": metrics })).await;
    assert_eq!(
        answer.pointers(),
        [
            "/artifacts/0/name",
            "/artifacts/1/media_type",
            "/artifacts/2/name",
            "/artifacts/2/bytes",
            "/artifacts/3/blob"
        ]
    );
    let good = json!([{ "name": "a.png", "media_type": "image/png", "bytes": 5, "blob": blob }]);
    let answer = service.report(&lease, "complete", json!({ "artifacts": good, "metrics": metrics })).await;
    assert_eq!(answer.status, StatusCode::OK, "the lease lives on after a wrong report");
}

#[tokio::test]
async fn requests_for_leases_are_checked() {
    let service = Service::start().await;
    let unknown = service.post("/v1/leases", json!({ "worker": "nobody" })).await;
    assert_eq!((unknown.status, unknown.problem().code()), (StatusCode::NOT_FOUND, "not-found"));
    let worker = service.worker(&["cpu"]).await;
    let wrong = service.post("/v1/leases", json!({ "worker": worker, "wait_s": 31, "warm": ["x"] })).await;
    assert_eq!(wrong.pointers(), ["/wait_s", "/warm/0"]);
    let token = service.post("/v1/leases/secret/heartbeat", json!({ "phase": "render", "progress": 0 })).await;
    assert_eq!(token.status, StatusCode::NOT_FOUND);
    assert!(!token.problem().detail.contains("secret"));
}

#[tokio::test]
async fn a_lease_that_ran_out_is_held_until_somebody_takes_it_away() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    let lease = service.lease(&worker).await.unwrap();
    // The service was away for longer than a lease lasts.
    service.clock.advance(600_000);
    let beat = service.report(&lease, "heartbeat", json!({ "phase": "render", "progress": 0.5 })).await;
    assert_eq!(beat.status, StatusCode::OK);
    assert_eq!(service.app.expire_leases().await.unwrap(), 0, "it was renewed");
    let logs = service.report(&lease, "logs", json!({ "first_sequence": 0, "lines": ["x"] })).await;
    assert_eq!(logs.status, StatusCode::OK);
    service.clock.advance(600_000);
    assert_eq!(service.complete(&lease, "image.png", "whole").await.status, StatusCode::OK);
    assert_eq!(service.read_job(&job).await.attempts.len(), 1);
}

#[tokio::test]
async fn a_stale_lease_is_told_so_before_anything_else() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    service.job(json!({ "scene": scene })).await;
    let stale = service.lease(&worker).await.unwrap();
    service.clock.advance(60_000);
    assert_eq!(service.app.expire_leases().await.unwrap(), 1);
    let wrong = json!([{ "name": "../x", "media_type": "?", "bytes": 1, "blob": "none" }]);
    let metrics = serde_json::to_value(lightshaft_api::job::Metrics::default()).unwrap();
    let body = json!({ "artifacts": wrong, "metrics": metrics });
    let complete = service.report(&stale, "complete", body.clone()).await;
    assert_eq!((complete.status, complete.problem().code()), (StatusCode::CONFLICT, "stale-lease"));
    let fail = service.report(&stale, "fail", json!({ "class": "task", "error": "x".repeat(20_000) })).await;
    assert_eq!(fail.status, StatusCode::CONFLICT);
    let beat = json!({ "phase": "render", "progress": 0.5, "preview": "none" });
    assert_eq!(service.report(&stale, "heartbeat", beat).await.status, StatusCode::GONE);
    assert_eq!(service.post("/v1/leases/unknown/complete", body).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn a_preview_goes_only_when_nobody_else_shows_it_and_nobody_put_it_lately() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    for _ in 0..2 {
        service.job(json!({ "scene": scene })).await;
    }
    let (one, two) = (service.lease(&worker).await.unwrap(), service.lease(&worker).await.unwrap());
    let (black, grey) = (service.store_blob("black").await, service.store_blob("grey").await);
    let show = async |lease, preview: &str| {
        let beat = json!({ "phase": "render", "progress": 0.5, "preview": preview });
        assert_eq!(service.report(lease, "heartbeat", beat).await.status, StatusCode::OK);
    };
    let is_there = async |hash: &str| service.get(&format!("/v1/blobs/{hash}")).await.status == StatusCode::OK;
    show(&one, &black).await;
    show(&two, &black).await;
    show(&one, &grey).await;
    service.app.delete_discarded().await.unwrap();
    assert!(is_there(&black).await, "the other task shows it");
    // Somebody is about to name the same bytes.
    service.write_blob_at(&black, service.clock.now() - 60_000);
    show(&two, &grey).await;
    service.app.delete_discarded().await.unwrap();
    assert!(is_there(&black).await, "it was put a minute ago");
    service.clock.advance(300_000);
    service.app.delete_discarded().await.unwrap();
    assert!(!is_there(&black).await && is_there(&grey).await);
}

#[tokio::test]
async fn a_report_may_name_every_mesh_of_a_large_scene() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    let lease = service.lease(&worker).await.unwrap();
    let mut metrics = serde_json::to_value(lightshaft_api::job::Metrics::default()).unwrap();
    let report = |i: usize| json!({ "mesh": format!("{i:064x}"), "structure": "bvh", "source": "memory", "seconds": 0.1, "bytes": 9 });
    metrics["cache"] = (0..20_000).map(report).collect();
    let body = json!({ "artifacts": [], "metrics": metrics });
    assert!(body.to_string().len() > 2 << 20);
    assert_eq!(service.report(&lease, "complete", body).await.status, StatusCode::OK);
    assert_eq!(service.read_job(&job).await.metrics.unwrap().cache.len(), 20_000);
}
