//! `/v1/workers` and `/v1/meshes`

use std::time::{Duration, Instant};

use http::StatusCode;
use lightshaft_api::mesh::Mesh;
use lightshaft_api::page::Page;
use lightshaft_api::worker::{Worker, WorkerState};
use serde_json::{Value, json};

use crate::harness::{Service, lease_request, new_worker};

#[tokio::test]
async fn workers_come_work_drain_and_go() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let id = service.worker(&["cpu", "llvmpipe"]).await;
    let path = format!("/v1/workers/{id}");
    let worker: Worker = service.get(&path).await.json();
    assert_eq!((worker.state, worker.devices.len()), (WorkerState::Idle, 2));
    service.job(json!({ "scene": scene })).await;
    let lease = service.lease(&id).await.unwrap();
    assert_eq!(service.get(&path).await.json::<Worker>().state, WorkerState::Busy);
    let drained: Worker = service.post(&format!("{path}/drain"), json!(null)).await.json();
    assert_eq!(drained.state, WorkerState::Draining);
    let beat = service.report(&lease, "heartbeat", json!({ "phase": "render", "progress": 0 })).await;
    assert_eq!(beat.json::<Value>()["drain"], true);
    let in_use = service.delete(&path).await;
    assert_eq!((in_use.status, in_use.problem().code()), (StatusCode::CONFLICT, "in-use"));
    service.complete(&lease, "image.png", "x").await;
    service.job(json!({ "scene": scene })).await;
    assert!(service.lease(&id).await.is_none(), "drained");
    let undrained: Worker = service.post(&format!("{path}/undrain"), json!(null)).await.json();
    assert_eq!((undrained.state, undrained.tasks_done), (WorkerState::Idle, 1));
    service.clock.advance(91_000);
    assert_eq!(service.get(&path).await.json::<Worker>().state, WorkerState::Gone);
    let all: Page<Worker> = service.get("/v1/workers").await.json();
    assert_eq!(all.items.len(), 1);
    assert_eq!(service.delete(&path).await.status, StatusCode::NO_CONTENT);
    assert_eq!(service.delete(&path).await.status, StatusCode::NOT_FOUND);
    assert_eq!(service.get(&path).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn a_worker_that_comes_back_keeps_its_id_and_loses_its_task() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let id = service.worker(&["cpu"]).await;
    service.job(json!({ "scene": scene })).await;
    let lost = service.lease(&id).await.unwrap();
    let mut again = serde_json::to_value(new_worker(&["cpu"])).unwrap();
    again["id"] = json!(id);
    let answer = service.post("/v1/workers", again).await;
    assert_eq!(answer.json::<Value>()["id"], json!(id));
    assert_eq!(
        service.report(&lost, "heartbeat", json!({ "phase": "render", "progress": 0 })).await.status,
        StatusCode::GONE
    );
    assert_eq!(service.lease(&id).await.unwrap().attempt_number, 2);
}

#[tokio::test]
async fn registrations_are_checked() {
    let service = Service::start().await;
    let device = json!({ "kind": "cpu", "name": "x".repeat(300) });
    let body = json!({ "id": "me", "name": "", "version": "1", "devices": [device], "tags": [""] });
    let answer = service.post("/v1/workers", body).await;
    assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY);
    assert_eq!(answer.pointers(), ["/id", "/name", "/devices/0", "/tags/0"]);
    let kind = json!({ "name": "a", "version": "1", "devices": [{ "kind": "tpu", "name": "x" }] });
    assert_eq!(service.post("/v1/workers", kind).await.pointers(), ["/devices/0/kind"]);
}

#[tokio::test]
async fn structures_are_shared_and_show_who_holds_them_warm() {
    let service = Service::start().await;
    service.scene(0).await;
    let meshes: Page<Mesh> = service.get("/v1/meshes").await.json();
    let mesh = meshes.items[0].hash.clone();
    assert_eq!((meshes.items[0].triangles, meshes.items[0].structures.len()), (1, 0));
    let blob = service.store_blob("a structure").await;
    let path = format!("/v1/meshes/{mesh}/structures");
    let mut structure = json!({
        "kind": "bvh", "parameters": "quality=medium", "builder_version": 1, "bytes": 11, "build_s": 0.1, "blob": blob,
    });
    assert_eq!(service.post(&path, structure.clone()).await.status, StatusCode::OK);
    let worker = service.worker(&["cpu"]).await;
    service.lease_warm(&worker, std::slice::from_ref(&mesh)).await;
    let read: Mesh = service.get(&format!("/v1/meshes/{mesh}")).await.json();
    assert_eq!((read.structures[0].blob.as_str(), &read.structures[0].workers), (blob.as_str(), &vec![worker]));
    structure["bytes"] = json!(12);
    structure["kind"] = json!("");
    assert_eq!(service.post(&path, structure.clone()).await.pointers(), ["/kind", "/bytes"]);
    let unknown = format!("/v1/meshes/{}", "0".repeat(64));
    assert_eq!(service.get(&unknown).await.status, StatusCode::NOT_FOUND);
    structure["bytes"] = json!(11);
    structure["kind"] = json!("bvh");
    assert_eq!(service.post(&format!("{unknown}/structures"), structure).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn nothing_is_kept_of_a_worker_that_there_is_not() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let scene: Value = service.get(&format!("/v1/scenes/{scene}")).await.json();
    let mesh = scene["meshes"][0]["hash"].as_str().unwrap();
    let blob = service.store_blob("bvh").await;
    let structure =
        json!({ "kind": "bvh", "parameters": "", "builder_version": 1, "bytes": 3, "build_s": 0.5, "blob": blob });
    service.post(&format!("/v1/meshes/{mesh}/structures"), structure).await;
    let poll =
        async |worker: &str| service.post("/v1/leases", json!({ "worker": worker, "warm": [mesh] })).await.status;
    let warm = async || service.get(&format!("/v1/meshes/{mesh}")).await.json::<Mesh>().structures.remove(0).workers;
    assert_eq!((poll("nobody").await, warm().await), (StatusCode::NOT_FOUND, Vec::new()));
    let worker = service.worker(&["cpu"]).await;
    assert_eq!((poll(&worker).await, warm().await), (StatusCode::NO_CONTENT, vec![worker.clone()]));
    service.delete(&format!("/v1/workers/{worker}")).await;
    assert_eq!((poll(&worker).await, warm().await), (StatusCode::NOT_FOUND, Vec::new()));
}

#[tokio::test]
async fn a_worker_that_leaves_has_its_poll_answered_and_gets_nothing_until_it_is_back() {
    let service = Service::start().await;
    let client = service.listen().await;
    let scene = service.scene(0).await;
    let id = service.worker(&["cpu"]).await;
    let (poller, request) = (client.clone(), lease_request(&id, 20));
    let asked = Instant::now();
    let poll = tokio::spawn(async move { poller.lease(&request).await.unwrap() });
    tokio::time::sleep(Duration::from_millis(50)).await;
    client.part_worker(&id).await.unwrap();
    assert!(poll.await.unwrap().is_none() && asked.elapsed() < Duration::from_secs(10), "{:?}", asked.elapsed());
    assert_eq!(client.worker(&id).await.unwrap().state, WorkerState::Gone);

    service.job(json!({ "scene": scene })).await;
    assert!(service.lease(&id).await.is_none());
    let mut again = new_worker(&["cpu"]);
    again.id = Some(id.clone());
    client.register_worker(&again).await.unwrap();
    assert!(service.lease(&id).await.is_some());
    assert_eq!(client.part_worker("nobody").await.unwrap_err().status(), Some(404));
}

#[tokio::test]
async fn heartbeats_are_asked_for_twice_a_second_and_at_least_thrice_a_lease() {
    for (ttl, period) in [(60_000, 0.5), (900, 0.3)] {
        let service = Service::start_with(|config| config.lease_ttl = Duration::from_millis(ttl)).await;
        let scene = service.scene(0).await;
        let id = service.worker(&["cpu"]).await;
        service.job(json!({ "scene": scene })).await;
        assert_eq!(service.lease(&id).await.unwrap().heartbeat_s, period);
    }
}
