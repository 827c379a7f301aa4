//! `/v1/jobs`

use axum::body::Body;
use http::{Method, StatusCode};
use lightshaft_api::job::{Job, JobState, JobSummary, ValidatedJob};
use lightshaft_api::page::Page;
use serde_json::{Value, json};

use crate::harness::Service;

async fn list(service: &Service, query: &str) -> Vec<String> {
    let page: Page<JobSummary> = service.get(&format!("/v1/jobs{query}")).await.json();
    page.items.into_iter().map(|job| job.id).collect()
}

#[tokio::test]
async fn a_job_is_created_with_its_defaults() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let body = json!({ "scene": scene, "labels": { "suite": "a" }, "priority": 7, "settings": { "camera": "front" } });
    let answer = service.post("/v1/jobs", body).await;
    assert_eq!(answer.status, StatusCode::CREATED);
    let job: Job = answer.json();
    assert_eq!(answer.header("location"), format!("/v1/jobs/{}", job.summary.id));
    assert_eq!((job.summary.state, job.summary.priority, job.max_attempts), (JobState::Queued, 7, 3));
    let settings = json!(job.settings);
    assert_eq!((&settings["width"], &settings["spp"]), (&json!(640), &json!(16)));
    assert_eq!(job.summary.labels["suite"], "a");
    assert_eq!(service.get(&format!("/v1/jobs/{}", job.summary.id)).await.json::<Job>(), job);
    let tasks: Value = service.get(&format!("/v1/jobs/{}/tasks", job.summary.id)).await.json();
    assert_eq!(tasks["items"][0]["work"], json!({ "kind": "frame" }));
    for list in ["attempts", "artifacts"] {
        let empty: Value = service.get(&format!("/v1/jobs/{}/{list}", job.summary.id)).await.json();
        assert_eq!(empty, json!({ "items": [], "next_cursor": null }));
    }
}

#[tokio::test]
async fn validating_makes_nothing() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let settings = json!({ "split": { "tiles": [2, 2] } });
    let answer = service.post("/v1/jobs?validate_only=true", json!({ "scene": scene, "settings": settings })).await;
    assert_eq!(answer.status, StatusCode::OK);
    let valid: ValidatedJob = answer.json();
    assert_eq!((valid.tasks, &json!(valid.job.settings)["width"]), (5, &json!(640)));
    let estimate = valid.estimate;
    assert_eq!((estimate.picture_bytes, estimate.line_space_bytes), (640 * 480 * 16, Some(0)));
    assert_eq!(estimate.bytes, estimate.scene_bytes + estimate.picture_bytes);
    assert_eq!((estimate.render_s, estimate.measured), (None, None), "nothing was measured yet");
    assert!(list(&service, "").await.is_empty());
    let wrong = service.post("/v1/jobs?validate_only=true", json!({ "scene": scene, "settings": { "spp": 0 } })).await;
    assert_eq!(wrong.pointers(), ["/settings/spp"]);
    let number = service.post("/v1/jobs?validate_only=1", json!({ "scene": scene })).await;
    assert_eq!(number.status, StatusCode::BAD_REQUEST);
    let typo = service.post("/v1/jobs?validate=true", json!({ "scene": scene })).await;
    assert_eq!((typo.status, typo.pointers()), (StatusCode::BAD_REQUEST, vec!["query/validate".to_owned()]));
}

#[tokio::test]
async fn an_idempotency_key_makes_one_job() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let create = async |key: &str, body: Value| {
        let headers = [("content-type", "application/json"), ("idempotency-key", key)];
        service.request(Method::POST, "/v1/jobs", &headers, Body::from(body.to_string())).await
    };
    let body = json!({ "scene": scene, "settings": { "spp": 4 } });
    let first = create("key", body.clone()).await;
    let same_but_for_spelling = json!({ "settings": { "spp": 4, "width": 640 }, "scene": scene });
    let second = create("key", same_but_for_spelling).await;
    assert_eq!((first.status, second.status), (StatusCode::CREATED, StatusCode::OK));
    assert_eq!(first.json::<Job>().summary.id, second.json::<Job>().summary.id);
    let other = create("key", json!({ "scene": scene, "settings": { "spp": 5 } })).await;
    assert_eq!((other.status, other.problem().code()), (StatusCode::UNPROCESSABLE_ENTITY, "idempotency-key-reused"));
    let bad_key = create("a b", body.clone()).await;
    assert_eq!(
        (bad_key.status, bad_key.pointers()),
        (StatusCode::BAD_REQUEST, vec!["header/idempotency-key".to_owned()])
    );
    assert_eq!(list(&service, "").await.len(), 1);
    service.clock.advance(24 * 3_600_000 + 1);
    assert_eq!(create("key", body).await.status, StatusCode::CREATED, "forgotten after a day");
}

#[tokio::test]
async fn settings_are_checked_against_the_scene_and_the_blobs() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let text = service.store_blob("no picture").await;
    let sky = service.store_blob("#?RADIANCE and so on").await;
    let missing = "0".repeat(64);
    let check = async |settings: Value| {
        let answer = service.post("/v1/jobs?validate_only=true", json!({ "scene": scene, "settings": settings })).await;
        if answer.status == StatusCode::OK { Vec::new() } else { answer.pointers() }
    };
    let camera = ["/settings/camera"];
    assert_eq!(check(json!({ "camera": "back" })).await, camera);
    assert_eq!(check(json!({ "camera": 1 })).await, camera);
    assert!(check(json!({ "camera": 0 })).await.is_empty());
    let map = ["/settings/environment/map"];
    for wrong in [missing.as_str(), text.as_str(), "zz"] {
        assert_eq!(check(json!({ "environment": { "map": wrong } })).await, map, "{wrong}");
    }
    assert!(check(json!({ "environment": { "map": sky } })).await.is_empty());
    let no_scene = service.post("/v1/jobs", json!({ "scene": "none", "priority": 101 })).await;
    assert_eq!(no_scene.pointers(), ["/priority", "/scene"]);
    let reserved = service.post("/v1/jobs", json!({ "scene": scene, "labels": { "lightshaft.x": "" } })).await;
    assert_eq!(reserved.pointers(), ["/labels/lightshaft.x"]);
}

#[tokio::test]
async fn jobs_are_listed_filtered_and_paged() {
    let service = Service::start().await;
    let (one, two) = (service.scene(0).await, service.scene(1).await);
    let mut made = Vec::new();
    for i in 0..5 {
        let scene = if i % 2 == 0 { &one } else { &two };
        let body = json!({ "scene": scene, "labels": { "n": i.to_string() } });
        made.insert(0, service.job(body).await.summary.id);
    }
    assert_eq!(list(&service, "").await, made);
    assert_eq!(list(&service, "?state=queued&kind=render&automatic=false").await, made);
    assert!(list(&service, "?state=failed").await.is_empty());
    assert_eq!(list(&service, &format!("?scene={two}")).await, [made[1].clone(), made[3].clone()]);
    assert_eq!(list(&service, "?label.n=4").await, [made[0].clone()]);
    assert!(list(&service, "?label.n=4&label.m=1").await.is_empty());
    let (mut seen, mut query) = (Vec::new(), "?limit=2".to_owned());
    loop {
        let page: Page<JobSummary> = service.get(&format!("/v1/jobs{query}")).await.json();
        seen.extend(page.items.into_iter().map(|job| job.id));
        let Some(cursor) = page.next_cursor else { break };
        query = format!("?limit=2&cursor={cursor}");
    }
    assert_eq!(seen, made);
    for (query, pointer) in [
        ("limit=0", "query/limit"),
        ("limit=201", "query/limit"),
        ("limit=x", "query/limit"),
        ("cursor=x", "query/cursor"),
        ("state=done", "query/state"),
        ("kind=x", "query/kind"),
        ("automatic=x", "query/automatic"),
        ("sate=queued", "query/sate"),
    ] {
        let answer = service.get(&format!("/v1/jobs?{query}")).await;
        assert_eq!((answer.status, answer.pointers()), (StatusCode::BAD_REQUEST, vec![pointer.to_owned()]), "{query}");
    }
}

#[tokio::test]
async fn jobs_are_cancelled_retried_and_changed() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let path = format!("/v1/jobs/{}", service.job(json!({ "scene": scene })).await.summary.id);
    let changed = service.patch(&path, json!({ "priority": 9, "paused": true })).await;
    assert_eq!(changed.status, StatusCode::OK);
    assert!(changed.json::<Job>().summary.paused);
    assert!(service.lease(&worker).await.is_none());
    assert_eq!(service.patch(&path, json!({ "priority": 101 })).await.pointers(), ["/priority"]);
    assert_eq!(service.patch(&path, json!({ "prio": 1 })).await.pointers(), ["/prio"]);

    let early = service.post(&format!("{path}/retry"), json!(null)).await;
    assert_eq!((early.status, early.problem().code()), (StatusCode::CONFLICT, "wrong-state"));
    for _ in 0..2 {
        let cancelled = service.post(&format!("{path}/cancel"), json!(null)).await;
        assert_eq!(cancelled.json::<Job>().summary.state, JobState::Cancelled);
    }
    assert_eq!(service.patch(&path, json!({ "priority": 1 })).await.status, StatusCode::CONFLICT);
    let retried = service.post(&format!("{path}/retry"), json!(null)).await;
    assert_eq!(retried.json::<Job>().summary.state, JobState::Queued);
    let lease = service.lease(&worker).await.unwrap();
    service.complete(&lease, "image.png", "x").await;
    for action in ["cancel", "retry"] {
        let late = service.post(&format!("{path}/{action}"), json!(null)).await;
        assert_eq!((late.status, late.problem().code()), (StatusCode::CONFLICT, "wrong-state"));
    }
}

#[tokio::test]
async fn unknown_jobs_are_not_found() {
    let service = Service::start().await;
    for rest in ["", "/tasks", "/attempts", "/artifacts", "/artifacts/image.png", "/log", "/events", "/preview.png"] {
        let answer = service.get(&format!("/v1/jobs/none{rest}")).await;
        assert_eq!((answer.status, answer.problem().code()), (StatusCode::NOT_FOUND, "not-found"), "{rest}");
    }
    for action in ["cancel", "retry"] {
        let answer = service.post(&format!("/v1/jobs/none/{action}"), json!(null)).await;
        assert_eq!(answer.status, StatusCode::NOT_FOUND);
    }
    assert_eq!(service.patch("/v1/jobs/none", json!({})).await.status, StatusCode::NOT_FOUND);
    let scene = service.scene(0).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    assert_eq!(service.get(&format!("/v1/jobs/{job}/artifacts/x.png")).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn a_job_for_a_device_that_no_worker_has_fails_after_the_grace() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let gpu = json!({ "scene": scene, "settings": { "device": "gpu" } });
    let id = service.job(gpu.clone()).await.summary.id;
    let grace_ms = service.app.config.device_grace.as_millis() as i64;
    let tick = async |ms: i64| {
        service.clock.advance(ms);
        service.app.give_up_unmet_jobs().await.unwrap();
        service.read_job(&id).await
    };
    let alone = tick(10 * grace_ms).await;
    assert_eq!(alone.waiting.as_deref(), Some("there is no worker"));
    assert_eq!(alone.summary.state, JobState::Queued, "workers may join");

    service.worker(&["cpu"]).await;
    let early = tick(0).await;
    let why = early.waiting.unwrap();
    assert!(why.contains("a GPU") && why.contains("`worker` has cpu") && why.contains("10 s"), "{why}");
    assert_eq!(tick(grace_ms - 1).await.summary.state, JobState::Queued);
    let failed = tick(1).await;
    assert_eq!((failed.summary.state, failed.waiting), (JobState::Failed, None));
    let error = failed.summary.error.unwrap();
    assert!(error.contains("a GPU") && error.contains("`worker` has cpu"), "{error}");
    assert!(failed.attempts.is_empty());

    let able = service.worker(&["cpu", "llvmpipe"]).await;
    let retried = service.post(&format!("/v1/jobs/{id}/retry"), json!(null)).await;
    assert_eq!(retried.json::<Job>().summary.error, None);
    assert_eq!(service.lease(&able).await.unwrap().job, id);
}

#[tokio::test]
async fn a_waiting_job_says_why() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let (busy, id) = (
        service.job(json!({ "scene": scene })).await.summary.id,
        service.job(json!({ "scene": scene })).await.summary.id,
    );
    let why = async || service.read_job(&id).await.waiting.unwrap_or_default();
    assert_eq!(why().await, "there is no worker");
    let worker = service.worker(&["cpu"]).await;
    assert_eq!(why().await, "a worker is about to take it");
    let lease = service.lease(&worker).await.unwrap();
    assert_eq!(lease.job, busy);
    assert_eq!(service.read_job(&busy).await.waiting, None);
    assert_eq!(why().await, "every worker that could do it is busy");
    service.complete(&lease, "image.png", "x").await;
    service.post(&format!("/v1/workers/{worker}/drain"), json!(null)).await;
    assert_eq!(why().await, "every worker that could do it is draining");
    service.post(&format!("/v1/workers/{worker}/undrain"), json!(null)).await;
    service.patch(&format!("/v1/jobs/{id}"), json!({ "paused": true })).await;
    assert_eq!(why().await, "the job is paused");
    service.patch(&format!("/v1/jobs/{id}"), json!({ "paused": false })).await;
    let lease = service.lease(&worker).await.unwrap();
    service.report(&lease, "fail", json!({ "class": "transient", "error": "download" })).await;
    assert!(why().await.starts_with("the next attempt is at 20"), "{}", why().await);
}

#[tokio::test]
async fn a_deleted_job_takes_its_pictures_and_logs_along() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    let path = format!("/v1/jobs/{job}");
    let early = service.delete(&path).await;
    assert_eq!((early.status, early.problem().code()), (StatusCode::CONFLICT, "wrong-state"));
    let lease = service.lease(&worker).await.unwrap();
    service.report(&lease, "logs", json!({ "first_sequence": 0, "lines": ["x"] })).await;
    let before = service.blob_files();
    service.complete(&lease, "image.png", "a picture").await;
    assert_eq!((service.blob_files(), service.log_files()), (before + 1, 1));
    assert_eq!(service.delete(&path).await.status, StatusCode::NO_CONTENT);
    assert_eq!((service.blob_files(), service.log_files()), (before, 0));
    assert_eq!(service.get(&path).await.status, StatusCode::NOT_FOUND);
    assert_eq!(service.delete(&path).await.status, StatusCode::NOT_FOUND);
    let listed: serde_json::Value = service.get("/v1/jobs").await.json();
    assert_eq!(listed["items"], json!([]));
}

#[tokio::test]
async fn finished_jobs_are_kept_as_long_as_was_asked_for() {
    let day = std::time::Duration::from_secs(24 * 3600);
    for (keep, left) in [(None, 2), (Some(day), 1)] {
        let service = Service::start_with(|config| config.keep_jobs = keep).await;
        let scene = service.scene(0).await;
        for _ in 0..2 {
            let job = service.job(json!({ "scene": scene })).await.summary.id;
            service.post(&format!("/v1/jobs/{job}/cancel"), json!(null)).await;
            service.clock.advance(12 * 3_600_000 + 1);
        }
        while service.app.delete_old_jobs().await.unwrap() > 0 {}
        let listed: serde_json::Value = service.get("/v1/jobs").await.json();
        assert_eq!(listed["items"].as_array().unwrap().len(), left);
    }
}

#[tokio::test]
async fn the_parts_of_a_picture_go_when_they_are_merged() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    service.job(json!({ "scene": scene, "settings": { "split": { "tiles": [2, 1] } } })).await;
    let before = service.blob_files();
    for content in ["left", "right"] {
        let lease = service.lease(&worker).await.unwrap();
        service.complete(&lease, "part", content).await;
    }
    let merge = service.lease(&worker).await.unwrap();
    assert_eq!(service.blob_files(), before + 2);
    service.complete(&merge, "image.png", "whole").await;
    service.app.delete_discarded().await.unwrap();
    assert_eq!(service.blob_files(), before + 1);
}
