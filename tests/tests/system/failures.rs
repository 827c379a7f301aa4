//! Workers and services that die or hang in the middle: every job is done exactly once all the same.

use std::time::Duration;

use lightshaft_tests::{Service, picture, process};
use reqwest::Method;
use serde_json::{Value, json};

/// Long enough to be struck in the middle, and then over at the same time on every machine.
fn three_seconds() -> Value {
    json!({"width": 160, "height": 120, "spp": 1 << 20, "time_limit_s": 3, "device": "cpu"})
}

#[tokio::test]
async fn a_killed_worker_is_restarted_and_the_job_is_done_once() {
    let service = Service::start_with(SHORT_LEASES);
    let scene = service.generated(&["demo"]).await;
    let id = service.submit(&scene, three_seconds()).await;
    rendering(&service, &id).await;

    let worker = service.worker_pid().await;
    process::signal(worker, "KILL");
    let job = service.succeeded(&id).await;

    assert_eq!(outcomes(&job), ["expired", "succeeded"], "{job:#}");
    assert_one_picture(&service, &job).await;
    assert_ne!(service.worker_pid().await, worker, "serve started another worker");
}

#[tokio::test]
async fn the_late_report_of_a_frozen_worker_is_refused() {
    let service = Service::start_with(SHORT_LEASES);
    let scene = service.generated(&["demo"]).await;
    let id = service.submit(&scene, three_seconds()).await;
    rendering(&service, &id).await;

    let worker = service.worker_pid().await;
    process::signal(worker, "STOP");
    service
        .until("the lease to expire", async || (outcomes(&service.job(&id).await)[0] == "expired").then_some(()))
        .await;
    process::signal(worker, "CONT");
    let job = service.succeeded(&id).await;

    assert_eq!(outcomes(&job), ["expired", "succeeded"], "{job:#}");
    assert_one_picture(&service, &job).await;
    assert_eq!(service.worker_pid().await, worker, "the worker survived");
    let metrics = service.get("/metrics").await.text();
    let fenced = metrics.lines().filter(|line| line.starts_with("lightshaft_fenced_reports_total"));
    let fenced: f64 = fenced.filter_map(|line| line.rsplit_once(' ')?.1.parse::<f64>().ok()).sum();
    assert!(fenced >= 1.0, "the late report was refused:\n{metrics}");
}

#[tokio::test]
async fn a_killed_service_goes_on_where_it_was() {
    let mut service = Service::start_with(SHORT_LEASES);
    let scene = service.generated(&["demo"]).await;
    let done = service.render(&scene, json!({"width": 32, "height": 32, "spp": 1})).await;
    let running = service.submit(&scene, three_seconds()).await;
    let queued = service.submit(&scene, json!({"width": 32, "height": 32, "spp": 2})).await;
    rendering(&service, &running).await;

    service.kill_and_restart();

    let job = service.succeeded(&running).await;
    assert_eq!(outcomes(&job), ["expired", "succeeded"], "{job:#}");
    assert_one_picture(&service, &job).await;
    service.succeeded(&queued).await;
    let before = service.job(done["id"].as_str().unwrap()).await;
    assert_eq!((&before["state"], &before["artifacts"]), (&done["state"], &done["artifacts"]));
}

#[tokio::test]
async fn a_worker_elsewhere_goes_on_while_the_service_is_away() {
    let mut service = Service::start_with(&[SHORT_LEASES, &["--workers", "0"]].concat());
    let _worker = service.join_worker();
    let scene = service.generated(&["demo"]).await;
    let id = service.submit(&scene, three_seconds()).await;
    rendering(&service, &id).await;

    service.kill_and_restart();

    let job = service.succeeded(&id).await;
    assert_eq!(outcomes(&job), ["succeeded"], "the one attempt went on: {job:#}");
    assert_one_picture(&service, &job).await;
}

#[tokio::test]
async fn a_service_killed_while_it_takes_a_report_counts_it_once() {
    let mut service = Service::start_with(&["--workers", "0", "--no-thumbnails"]);
    let scene = service.generated(&["demo"]).await;
    let cpu = json!({"kind": "cpu", "name": "cpu", "driver": "", "backend": "", "device_type": ""});
    let registered = service.post("/v1/workers", &json!({"name": "w", "version": "1", "devices": [cpu]})).await;
    let worker = registered.json()["id"].as_str().expect("a worker has an id").to_owned();
    for round in 0..8 {
        let id = service.submit(&scene, json!({"width": 8, "height": 8})).await;
        let lease = service.post("/v1/leases", &json!({"worker": worker})).await.json();
        let picture = format!("picture {round}");
        let put = service.request(Method::POST, "/v1/blobs").body(picture.clone());
        let blob = service.send(put).await.json()["hash"].clone();
        let artifact = json!({"name": "image.png", "media_type": "image/png", "bytes": picture.len(), "blob": blob});
        let report = json!({"artifacts": [artifact], "metrics": no_metrics()});
        let path = format!("/v1/leases/{}/complete", lease["token"].as_str().expect("a lease has a token"));

        // From before the report is read until after it is answered.
        let sending = tokio::spawn(service.request(Method::POST, &path).json(&report).send());
        tokio::time::sleep(Duration::from_micros(700 * round)).await;
        service.kill_and_restart();
        let _ = sending.await;

        let again = service.post(&path, &report).await;
        assert_eq!((again.status, &again.json()["outcome"]), (200, &json!("succeeded")), "{again:?}");
        let job = service.succeeded(&id).await;
        assert_eq!(outcomes(&job), ["succeeded"], "{job:#}");
        assert_eq!(service.artifact(&job, "image.png").await, picture.as_bytes());
        let done = service.get(&format!("/v1/workers/{worker}")).await.json()["tasks_done"].clone();
        assert_eq!(done, round + 1, "each report counts once");
    }
}

#[tokio::test]
async fn a_service_that_is_told_to_stop_takes_its_worker_along() {
    let service = Service::start_with(SHORT_LEASES);
    let scene = service.generated(&["demo"]).await;
    let id = service.submit(&scene, three_seconds()).await;
    rendering(&service, &id).await;
    let (serve, worker) = (service.pid(), service.worker_pid().await);
    process::signal(serve, "TERM");
    for pid in [serve, worker] {
        service.until("the process to end", async || (!process::is_alive(pid)).then_some(())).await;
    }
}

/// Leases that expire within seconds, so that tests need not wait a minute.
const SHORT_LEASES: &[&str] = &["--lease-ttl-s", "2"];

/// Waits until a job's first samples are there.
pub(crate) async fn rendering(service: &Service, id: &str) {
    service
        .until("the job to render", async || {
            let job = service.job(id).await;
            (job["state"] == "running" && job["attempts"][0]["phase"] == "render").then_some(())
        })
        .await;
    tokio::time::sleep(Duration::from_millis(300)).await;
}

/// A report of a worker that measured nothing.
fn no_metrics() -> Value {
    json!({
        "scene_s": 0, "build_s": 0, "prepare_s": 0, "render_s": 0, "output_s": 0, "total_s": 0,
        "rays": {"primary": 0, "shadow": 0, "ao": 0, "indirect": 0}, "mrays_per_s": 0, "structure_bytes": 0,
        "line_space_bytes": 0, "peak_bytes": 0, "device": "", "device_kind": "", "spp": 0, "cache": [], "versions": {},
        "warnings": [],
    })
}

pub(crate) fn outcomes(job: &Value) -> Vec<String> {
    let attempts = job["attempts"].as_array().expect("a list of attempts");
    attempts.iter().map(|attempt| attempt["outcome"].as_str().unwrap_or_default().to_owned()).collect()
}

pub(crate) async fn assert_one_picture(service: &Service, job: &Value) {
    let names: Vec<&str> = job["artifacts"].as_array().unwrap().iter().filter_map(|a| a["name"].as_str()).collect();
    assert_eq!(names.iter().filter(|name| **name == "image.png").count(), 1, "{names:?}");
    assert!(picture::shows_something(&picture::png(&service.artifact(job, "image.png").await)));
}
