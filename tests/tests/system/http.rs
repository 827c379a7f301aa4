//! What HTTP clients rely on: caching, ranges, events, health, metrics, the API's description.

use futures::StreamExt;
use lightshaft_tests::glb::Gltf;
use lightshaft_tests::{Reply, Service};
use reqwest::Method;
use serde_json::{Value, json};

const TINY: fn() -> Value = || json!({"width": 32, "height": 24, "spp": 2, "device": "cpu"});

#[tokio::test]
async fn artifacts_can_be_cached_and_read_in_parts() {
    let service = Service::start();
    let scene = service.scene(Gltf::triangle().glb()).await;
    let job = service.render(&scene, TINY()).await;
    let path = format!("/v1/jobs/{}/artifacts/image.png", job["id"].as_str().unwrap());
    let get = async |header: &str, value: &str| -> Reply {
        service.send(service.request(Method::GET, &path).header(header, value)).await
    };

    let whole = service.get(&path).await;
    assert_eq!((whole.status, whole.header("content-type")), (200, "image/png"));
    let etag = whole.header("etag").to_owned();
    assert!(etag.starts_with('"') && etag.len() > 10, "a strong ETag: {etag}");
    let length = whole.body.len();

    let unchanged = get("if-none-match", &etag).await;
    assert_eq!((unchanged.status, unchanged.body.len()), (304, 0));
    assert_eq!(get("if-none-match", "\"another\"").await.status, 200);

    let part = get("range", "bytes=1-3").await;
    assert_eq!((part.status, part.body.as_slice()), (206, &b"PNG"[..]));
    assert_eq!(part.header("content-range"), format!("bytes 1-3/{length}"));
    let tail = get("range", "bytes=-8").await;
    assert_eq!((tail.status, &tail.body[..]), (206, &whole.body[length - 8..]));
    assert_eq!(get("range", &format!("bytes={length}-")).await.status, 416);

    let head = service.send(service.request(Method::HEAD, &path)).await;
    assert_eq!((head.status, head.header("content-length"), head.body.len()), (200, length.to_string().as_str(), 0));
}

#[tokio::test]
async fn events_come_in_order_and_resume_after_the_last_one_seen() {
    let service = Service::start();
    let scene = service.scene(Gltf::triangle().glb()).await;
    let id = service.submit(&scene, TINY()).await;
    let all = events(&service, &id, None).await;
    let kinds: Vec<&str> = all.iter().map(|event| event.kind.as_str()).collect();
    assert_eq!(kinds.first(), Some(&"job.created"), "{kinds:?}");
    assert_eq!(kinds.last(), Some(&"job.succeeded"), "{kinds:?}");
    assert!(kinds.contains(&"task.leased") && kinds.contains(&"job.started"), "{kinds:?}");
    assert!(all.windows(2).all(|pair| pair[0].id < pair[1].id), "ids grow");
    assert!(all.iter().all(|event| event.data["job"] == id.as_str()), "only this job's");

    let seen = all.len() / 2;
    let rest = events(&service, &id, Some(all[seen - 1].id)).await;
    assert_eq!(rest, all[seen..], "what follows, without gap or repetition");
}

#[tokio::test]
async fn health_status_and_metrics_tell_how_the_service_is() {
    let service = Service::start();
    let scene = service.scene(Gltf::triangle().glb()).await;
    service.render(&scene, TINY()).await;
    assert_eq!(service.get("/healthz").await.status, 200);
    assert_eq!(service.get("/readyz").await.status, 200);
    let status = service.get("/v1/status").await.json();
    assert!(status["jobs"]["succeeded"].as_u64().unwrap() >= 1, "{status}");
    assert_eq!(status["scenes"], 1);
    let workers = service.get("/v1/workers").await.json();
    let worker = &workers["items"][0];
    assert!(worker["devices"].as_array().unwrap().iter().any(|device| device["kind"] == "cpu"), "{workers}");

    let metrics = service.get("/metrics").await;
    assert!(metrics.header("content-type").starts_with("text/plain"), "{:?}", metrics.headers);
    let text = metrics.text();
    let value = |series: &str| text.lines().find_map(|line| line.strip_prefix(series)?.trim().parse::<f64>().ok());
    for (series, least) in [
        (r#"lightshaft_jobs{state="succeeded"}"#, 1.0),
        (r#"lightshaft_attempts_total{outcome="succeeded"}"#, 1.0),
        (r#"lightshaft_scene_imports_total{result="imported"}"#, 1.0),
        ("lightshaft_scenes", 1.0),
        ("lightshaft_lease_wait_seconds_count", 1.0),
        ("lightshaft_blob_bytes", 100.0),
    ] {
        assert!(value(series).is_some_and(|found| found >= least), "{series} of at least {least} in\n{text}");
    }
    assert_eq!(value(r#"lightshaft_jobs{state="failed"}"#), Some(0.0), "{text}");
}

#[tokio::test]
async fn the_api_describes_itself_without_the_internet() {
    let service = Service::start_with(&["--workers", "0"]);
    let document = service.get("/openapi.json").await.json();
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"));
    let paths = document["paths"].as_object().unwrap();
    for path in ["/v1/scenes", "/v1/jobs/{id}", "/v1/leases/{token}/heartbeat", "/v1/status"] {
        assert!(paths.contains_key(path), "{path} among {:?}", paths.keys());
    }
    let docs = service.get("/docs").await;
    assert_eq!(docs.status, 200);
    let page = docs.text();
    for outside in ["src=\"http", "src='http", "href=\"http", "src=\"//", "@import"] {
        assert!(!page.contains(outside), "the page loads from elsewhere: {outside}");
    }
}

#[tokio::test]
async fn every_answer_carries_a_request_id_and_refuses_to_be_framed() {
    let service = Service::start_with(&["--workers", "0"]);
    let ids: Vec<String> = [service.get("/v1/status").await, service.get("/v1/jobs/nope").await]
        .iter()
        .map(|reply| reply.header("x-request-id").to_owned())
        .collect();
    assert!(ids.iter().all(|id| id.len() >= 8) && ids[0] != ids[1], "{ids:?}");
    let problem = service.get("/v1/jobs/nope").await;
    assert_eq!(problem.json()["request_id"], problem.header("x-request-id"));
}

#[tokio::test]
async fn one_trace_leads_from_the_submission_through_both_processes_to_the_end() {
    let service = Service::start_with(&["--log-format", "json"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let trace = "0af7651916cd43dd8448eb211c80319c";
    let request =
        service.request(Method::POST, "/v1/jobs").header("traceparent", format!("00-{trace}-b7ad6b7169203331-01"));
    let submitted = service.send(request.json(&json!({"scene": scene, "settings": TINY()}))).await.json();
    assert_eq!(submitted["trace_id"], trace);
    service.succeeded(submitted["id"].as_str().unwrap()).await;

    let of_trace = || -> Vec<(String, String)> {
        let log = service.log();
        let lines = log.lines().filter(|line| line.contains(trace)).filter_map(|line| serde_json::from_str(line).ok());
        let text = |line: &Value, field: &str| line[field].as_str().unwrap_or_default().to_owned();
        lines.map(|line: Value| (text(&line, "target"), text(&line, "message"))).collect()
    };
    let story = [
        ("lightshaft_server", "job created"),
        ("lightshaft_server", "task leased"),
        ("lightshaft_worker", "task started"),
        ("lightshaft_worker", "task done"),
        ("lightshaft_server", "PUT /v1/blobs/{hash} 20"),
        ("lightshaft_server", "attempt ended"),
    ];
    for (process, message) in story {
        let told = async || {
            let told = of_trace().iter().any(|(target, text)| target.starts_with(process) && text.starts_with(message));
            told.then_some(())
        };
        service.until(&format!("`{message}` from {process} in the trace"), told).await;
    }
}

#[derive(Debug, PartialEq)]
struct Event {
    id: i64,
    kind: String,
    data: Value,
}

/// Reads a job's events up to its final one.
async fn events(service: &Service, job: &str, last_seen: Option<i64>) -> Vec<Event> {
    let mut request = service.request(Method::GET, &format!("/v1/jobs/{job}/events"));
    if let Some(id) = last_seen {
        request = request.header("last-event-id", id.to_string());
    }
    let response = request.send().await.expect("the service answers");
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    let mut stream = response.bytes_stream();
    let mut text = String::new();
    let mut found = Vec::new();
    let reading = async {
        while let Some(chunk) = stream.next().await {
            text.push_str(&String::from_utf8_lossy(&chunk.expect("the stream goes on")));
            while let Some((block, rest)) = text.split_once("\n\n") {
                found.extend(parse(block));
                text = rest.to_owned();
            }
            if found.last().is_some_and(|event: &Event| event.kind == "job.succeeded") {
                break;
            }
        }
    };
    tokio::time::timeout(std::time::Duration::from_secs(60), reading).await.expect("the final event within a minute");
    found
}

/// One block of a stream; comments (keep-alives) are none.
fn parse(block: &str) -> Option<Event> {
    let field =
        |name: &str| block.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':').map(str::trim_start));
    Some(Event {
        id: field("id")?.parse().expect("ids are numbers"),
        kind: field("event")?.to_owned(),
        data: serde_json::from_str(field("data")?).expect("data is JSON"),
    })
}
