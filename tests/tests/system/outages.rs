//! Workers that lose the service, and services that lose their workers, at every stage of a task: the job is done
//! exactly once all the same.

use std::path::Path;
use std::time::{Duration, Instant};

use lightshaft_tests::{Proxy, Service, Worker, process};
use reqwest::Method;
use serde_json::{Value, json};

use crate::failures::{assert_one_picture, outcomes, rendering};

/// No worker of its own, and leases that run out after a second.
const FARM: &[&str] = &["--workers", "0", "--lease-ttl-s", "1", "--no-thumbnails"];

/// Over at the same time on every machine, and long enough for what happens meanwhile.
fn lasting(seconds: u32) -> Value {
    json!({"width": 160, "height": 120, "spp": 1 << 20, "time_limit_s": seconds, "device": "cpu"})
}

/// Ends after one pass, so that nothing but its outputs is uploaded.
fn short() -> Value {
    json!({"width": 64, "height": 48, "spp": 1, "device": "cpu"})
}

#[tokio::test]
async fn an_outage_longer_than_the_lease_costs_no_work_when_nobody_took_it_away() {
    let mut service = Service::start_with(FARM);
    let _worker = service.join_worker();
    let scene = service.generated(&["demo"]).await;
    let id = service.submit(&scene, lasting(6)).await;
    rendering(&service, &id).await;

    service.kill();
    tokio::time::sleep(Duration::from_millis(2_500)).await;
    service.restart();

    let job = service.succeeded(&id).await;
    assert_eq!(outcomes(&job), ["succeeded"], "the one attempt went on: {job:#}");
    assert_one_picture(&service, &job).await;
}

#[tokio::test]
async fn a_worker_that_was_cut_off_drops_what_the_service_took_away() {
    let service = Service::start_with(FARM);
    let proxy = Proxy::to(service.url()).await;
    let mut worker = service.join_worker_through(&proxy.url(), &service.scratch("worker"));
    let scene = service.generated(&["demo"]).await;
    let id = service.submit(&scene, lasting(4)).await;
    rendering(&service, &id).await;

    proxy.cut();
    service
        .until("the lease to expire", async || (outcomes(&service.job(&id).await)[0] == "expired").then_some(()))
        .await;
    proxy.mend();

    let job = service.succeeded(&id).await;
    assert_eq!(outcomes(&job), ["expired", "succeeded"], "{job:#}");
    assert_one_picture(&service, &job).await;
    assert!(worker.ended().is_none(), "the worker survived");
    let log = service.log();
    assert!(log.contains("the service has taken the task away"), "{log}");
}

#[tokio::test]
async fn an_idle_worker_that_leaves_while_a_task_comes_gives_it_back_and_spends_no_attempt() {
    let service = Service::start_with(FARM);
    let proxy = Proxy::to(service.url()).await;
    let scene = service.generated(&["demo"]).await;
    // The worker's poll is on its way when a task is there and the order to leave comes.
    proxy.hold_at("POST /v1/leases ");
    let mut worker = service.join_worker_through(&proxy.url(), &service.scratch("worker"));
    proxy.held().await;
    let id = service.submit(&scene, short()).await;
    proxy.hold_at("POST /v1/workers/");
    process::signal(worker.pid(), "TERM");
    proxy.held().await;
    // The poll goes on, and brings the task to a worker that is about to leave.
    proxy.release();
    service.until("the worker to end", async || worker.ended()).await;

    let job = service.job(&id).await;
    assert_eq!((&job["state"], outcomes(&job)), (&json!("queued"), vec!["interrupted".to_owned()]), "{job:#}");
    assert_eq!(job["tasks"][0]["attempt"], 0, "no attempt was spent: {job:#}");
    let _other = service.join_worker();
    assert_eq!(outcomes(&service.succeeded(&id).await), ["interrupted", "succeeded"]);
}

/// A service, and a worker that has lost its life in the middle of a job.
struct Struck {
    service: Service,
    job: String,
}

/// Kills a worker where it makes a request that begins with `at`, and awaits that its lease runs out.
async fn struck(at: &str, warm_up: bool, settings: Value) -> Struck {
    let service = Service::start_with(FARM);
    let proxy = Proxy::to(service.url()).await;
    let scene = service.generated(&["demo"]).await;
    let mut worker = service.join_worker_through(&proxy.url(), &service.scratch("worker"));
    if warm_up {
        service.render(&scene, short()).await;
    }
    proxy.hold_at(at);
    let job = service.submit(&scene, settings).await;
    proxy.held().await;
    worker.kill();
    Struck { service, job }
}

/// The next worker takes over the dead one's cache folder and the job.
async fn is_done_once(Struck { service, job }: &Struck, expected: &[&str]) {
    let _next: Worker = service.join_worker();
    let job = service.succeeded(job).await;
    assert_eq!(outcomes(&job), expected, "{job:#}");
    assert_one_picture(service, &job).await;
    let warnings = &job["metrics"]["warnings"];
    assert_eq!(warnings, &json!([]), "nothing in the cache was corrupt");
}

#[tokio::test]
async fn a_worker_killed_while_it_fetches_the_scene() {
    is_done_once(&struck("GET /v1/blobs/", false, short()).await, &["expired", "succeeded"]).await;
}

#[tokio::test]
async fn a_worker_killed_while_it_builds_structures() {
    is_done_once(&struck("POST /v1/meshes:structures", false, short()).await, &["expired", "succeeded"]).await;
}

#[tokio::test]
async fn a_worker_killed_while_it_uploads_its_picture() {
    is_done_once(&struck("PUT /v1/blobs/", true, short()).await, &["expired", "succeeded"]).await;
}

#[tokio::test]
async fn a_worker_killed_while_it_merges() {
    let mut settings = short();
    settings["split"] = json!({"tiles": [2, 1]});
    // The scene and its structures are in memory: the only blobs that are fetched are the parts.
    let struck = struck("GET /v1/blobs/", true, settings).await;
    is_done_once(&struck, &["succeeded", "succeeded", "expired", "succeeded"]).await;
}

#[tokio::test]
async fn a_worker_killed_before_its_report_arrives() {
    let struck = struck("POST /v1/leases/", true, short()).await;
    is_done_once(&struck, &["expired", "succeeded"]).await;
}

/// A job whose picture is there, while the structure that was built for it does not get to the service.
async fn publishing() -> (Service, Proxy, Worker, String) {
    let service = Service::start_with(FARM);
    let proxy = Proxy::to(service.url()).await;
    let scene = service.generated(&["cornell-box"]).await;
    let worker = service.join_worker_through(&proxy.url(), &service.scratch("worker"));
    proxy.hold_at("POST /v1/meshes/");
    let job = service.submit(&scene, short()).await;
    proxy.held().await;
    let phase = async || (service.job(&job).await["attempts"][0]["phase"] == "output").then_some(());
    service.until("the picture", phase).await;
    (service, proxy, worker, job)
}

#[tokio::test]
async fn a_cancelled_task_does_not_wait_for_structures_that_are_being_published() {
    let (service, _proxy, _worker, job) = publishing().await;
    let asked = Instant::now();
    service.send(service.request(Method::POST, &format!("/v1/jobs/{job}/cancel"))).await;
    service.job_in(&job, &["cancelled"]).await;
    assert!(asked.elapsed() < Duration::from_secs(6), "{:?}", asked.elapsed());
}

#[tokio::test]
async fn a_worker_that_drains_does_not_wait_for_structures_that_are_being_published() {
    let (service, _proxy, mut worker, job) = publishing().await;
    let asked = Instant::now();
    process::signal(worker.pid(), "TERM");
    service.until("the worker to end", async || worker.ended()).await;
    assert!(asked.elapsed() < Duration::from_secs(6), "{:?}", asked.elapsed());
    assert_eq!(service.job(&job).await["state"], "succeeded", "its task was finished first");
}

#[tokio::test]
async fn a_worker_that_cannot_write_its_cache_says_so_and_does_the_next_job() {
    let service = Service::start_with(FARM);
    // Writes fail past 256 KiB of a file, as they do on a full disk.
    let cache = service.scratch("small");
    let _worker = service.join_worker_with_small_files(&cache, 256);
    let big = service.generated(&["furnace-sphere", "--triangles", "40000"]).await;
    let small = service.generated(&["cornell-box"]).await;

    let job = service.submit(&big, short()).await;
    let job = service.job_in(&job, &["succeeded", "failed"]).await;
    assert_eq!(outcomes(&job), ["worker", "worker", "worker"], "no verdict on the job: {job:#}");
    let error = job["error"].as_str().expect("an error");
    assert!(error.contains("could not be written to the worker's cache"), "{error}");
    assert_eq!(files_below(&cache.join("blobs")), 0, "nothing half written is left");

    let job = service.render(&small, short()).await;
    assert_one_picture(&service, &job).await;
    assert_eq!(files_below(&cache.join("blobs")), 1);
}

fn files_below(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries.map(|path| if path.is_dir() { files_below(&path) } else { 1 }).sum()
}
