//! The service as a whole: status, health, metrics, start and end.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use http::StatusCode;
use lightshaft_api::client::Client;
use lightshaft_api::status::{ServiceState, Status};
use lightshaft_server::app::Stop;
use lightshaft_server::telemetry::SERIES;
use lightshaft_server::{Config, ServeError, serve};
use serde_json::{Value, json};
use tokio::sync::oneshot;

use crate::harness::Service;

#[tokio::test]
async fn the_status_says_whether_work_can_be_done() {
    let service = Service::start().await;
    let state = async || service.get("/v1/status").await.json::<Status>().state;
    assert_eq!(state().await, ServiceState::Idle);
    let scene = service.scene(0).await;
    service.job(json!({ "scene": scene })).await;
    assert_eq!(state().await, ServiceState::Inoperable, "work, and nobody to do it");
    let worker = service.worker(&["cpu"]).await;
    assert_eq!(state().await, ServiceState::Waiting);
    let lease = service.lease(&worker).await.unwrap();
    assert_eq!(state().await, ServiceState::Active);
    service.complete(&lease, "image.png", "x").await;
    let status: Status = service.get("/v1/status").await.json();
    assert_eq!((status.state, status.jobs.succeeded, status.scenes), (ServiceState::Idle, 1, 1));
    assert!(status.blob_bytes > 0);
}

#[tokio::test]
async fn readiness_ends_with_a_shutdown_and_health_does_not() {
    let service = Service::start().await;
    assert_eq!(service.get("/healthz").await.status, StatusCode::OK);
    assert_eq!(service.get("/readyz").await.status, StatusCode::OK);
    let scene = service.scene(0).await;
    service.app.shutdown.cancel();
    let answer = service.get("/readyz").await;
    assert_eq!((answer.status, answer.problem().code()), (StatusCode::SERVICE_UNAVAILABLE, "shutting-down"));
    assert_eq!(answer.header("retry-after"), "5");
    assert_eq!(service.get("/healthz").await.status, StatusCode::OK);
    assert_eq!(service.post("/v1/jobs", json!({ "scene": scene })).await.status, StatusCode::SERVICE_UNAVAILABLE);
    assert_eq!(service.get("/v1/jobs").await.status, StatusCode::OK, "reading goes on");
}

#[tokio::test]
async fn every_documented_series_is_recorded() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    service.job(json!({ "scene": scene })).await;
    service.lease(&worker).await.unwrap();
    service.clock.advance(60_000);
    service.app.expire_leases().await.unwrap();
    let lease = service.lease(&worker).await.unwrap();
    let cache = json!([{ "mesh": "m", "structure": "bvh", "source": "built", "seconds": 1, "bytes": 1 }]);
    let mut metrics = serde_json::to_value(lightshaft_api::job::Metrics::default()).unwrap();
    metrics["cache"] = cache;
    let report = json!({ "artifacts": [], "metrics": metrics });
    assert_eq!(service.report(&lease, "complete", report).await.status, StatusCode::OK);
    service.report(&lease, "fail", json!({ "class": "task", "error": "late" })).await;
    let text = String::from_utf8(service.get("/metrics").await.body).unwrap();
    for (name, ..) in SERIES {
        assert!(
            text.lines().any(|line| line.starts_with(&format!("{name}{{"))
                || line.starts_with(&format!("{name} "))
                || line.starts_with(&format!("{name}_bucket{{"))),
            "{name} is not recorded"
        );
    }
    let recorded = text.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next());
    for name in recorded.filter(|name| name.starts_with("lightshaft_")) {
        assert!(SERIES.iter().any(|(series, ..)| *series == name), "{name} is not documented");
    }
}

#[tokio::test]
async fn strangers_are_only_let_in_when_told_so() {
    let dir = tempfile::tempdir().unwrap();
    let config = Config::new(SocketAddr::from(([0, 0, 0, 0], 0)), dir.path().to_owned());
    let refused = serve(config, Stop::default(), oneshot::channel().0).await.unwrap_err();
    assert!(matches!(refused, ServeError::NotLoopback(_)));
    assert!(refused.to_string().contains("--insecure-local"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "nothing was begun");
}

#[tokio::test]
async fn a_service_starts_again_where_it_was_and_stops_in_time() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = Config::new(SocketAddr::from(([127, 0, 0, 1], 0)), dir.path().to_owned());
    config.thumbnails = false;
    let mut scene = None;
    for round in 0..2 {
        let stop = Stop::default();
        let (ready, address) = oneshot::channel();
        let running = tokio::spawn(serve(config.clone(), stop.clone(), ready));
        let client = Client::new(&format!("http://{}", address.await.unwrap())).unwrap();
        assert!(client.is_ready().await);
        let (uploaded, is_new) =
            client.upload_scene(crate::harness::glb_upload(crate::harness::triangle_glb(0)), None).await.unwrap();
        assert_eq!(is_new, round == 0);
        assert_eq!(*scene.get_or_insert(uploaded.id.clone()), uploaded.id);
        let _open_stream = client.events(None).await.unwrap();
        let stopped = Instant::now();
        stop.shutdown.cancel();
        tokio::time::timeout(Duration::from_secs(8), running).await.unwrap().unwrap().unwrap();
        assert!(stopped.elapsed() < Duration::from_secs(8));
    }
}

#[tokio::test]
async fn while_it_stops_nothing_new_is_taken_but_workers_bring_what_they_have() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    service.job(json!({ "scene": scene })).await;
    let lease = service.lease(&worker).await.unwrap();
    service.app.draining.cancel();
    for refused in [
        service.get("/readyz").await,
        service.post("/v1/leases", json!({ "worker": worker })).await,
        service.post("/v1/jobs", json!({ "scene": scene })).await,
        service.upload("model/gltf-binary", crate::harness::triangle_glb(1)).await,
    ] {
        assert_eq!((refused.status, refused.problem().code()), (StatusCode::SERVICE_UNAVAILABLE, "shutting-down"));
        assert_eq!(refused.header("retry-after"), "5");
    }
    let beat = service.report(&lease, "heartbeat", json!({ "phase": "output", "progress": 0.9 })).await;
    assert!(beat.json::<lightshaft_api::lease::HeartbeatReply>().drain);
    assert_eq!(service.complete(&lease, "image.png", "picture").await.status, StatusCode::OK);
    assert_eq!(service.read_job(&job).await.summary.state.as_str(), "succeeded");
}

#[tokio::test]
async fn problems_explain_themselves() {
    let service = Service::start().await;
    let all = String::from_utf8(service.get("/problems").await.body).unwrap();
    let problem = service.get("/v1/jobs/none").await.problem();
    let one = service.get(&problem.kind).await;
    assert_eq!(one.status, StatusCode::OK);
    assert!(all.contains(&String::from_utf8(one.body).unwrap()));
    assert_eq!(service.get("/problems/none").await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn the_trace_of_a_request_goes_on_in_its_job() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let trace = "0af7651916cd43dd8448eb211c80319c";
    let traceparent = format!("00-{trace}-b7ad6b7169203331-01");
    let headers = [("content-type", "application/json"), ("traceparent", &traceparent), ("x-request-id", "mine")];
    let body = json!({ "scene": scene }).to_string().into();
    let answer = service.request(http::Method::POST, "/v1/jobs", &headers, body).await;
    assert_eq!(answer.json::<Value>()["trace_id"], trace);
    assert_eq!(answer.header("x-request-id"), "mine");
}
