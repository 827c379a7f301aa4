//! Requests that must be refused, each with the field that is wrong.

use lightshaft_tests::Service;
use lightshaft_tests::glb::Gltf;
use reqwest::Method;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

#[tokio::test]
async fn every_wrong_setting_is_named() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let cases = [
        (json!({"width": 0}), "/settings/width"),
        (json!({"width": 20_000}), "/settings/width"),
        (json!({"height": 0}), "/settings/height"),
        (json!({"width": "wide"}), "/settings/width"),
        (json!({"width": -5}), "/settings/width"),
        (json!({"spp": 0}), "/settings/spp"),
        (json!({"spp": 2_000_000}), "/settings/spp"),
        (json!({"max_bounces": 65}), "/settings/max_bounces"),
        (json!({"ao_samples": 0}), "/settings/ao_samples"),
        (json!({"ao_distance": -1.0}), "/settings/ao_distance"),
        (json!({"device": "tpu"}), "/settings/device"),
        (json!({"integrator": "magic"}), "/settings/integrator"),
        (json!({"colour": "red"}), "/settings/colour"),
        (json!({"camera": 3}), "/settings/camera"),
        (json!({"camera": "nobody"}), "/settings/camera"),
        (json!({"camera": {"position": [0, 0, 1]}}), "/settings/camera"),
        (json!({"camera": {"position": [0, 0, 1], "target": [0, 0, 1]}}), "/settings/camera"),
        (json!({"camera": {"position": [0, 0, 1], "target": [0, 0, 0], "fov_y_deg": 180.0}}), "/settings/camera"),
        (json!({"environment": -1.0}), "/settings/environment"),
        (json!({"environment": {"map": "0000"}}), "/settings/environment"),
        (json!({"lights": [{"kind": "laser"}]}), "/settings/lights"),
        (json!({"lights": [{"kind": "point"}]}), "/settings/lights/0"),
        (json!({"outputs": ["gif"]}), "/settings/outputs"),
        (json!({"aovs": ["smell"]}), "/settings/aovs"),
        (json!({"tone_map": "sepia"}), "/settings/tone_map"),
        (json!({"exposure": 99}), "/settings/exposure"),
        (json!({"acceleration": {"structure": "pyramid"}}), "/settings/acceleration"),
        (json!({"acceleration": {"speed": 11}}), "/settings/acceleration/speed"),
        (json!({"acceleration": {"policy": "adaptive"}}), "/settings/acceleration/policy"),
        (json!({"acceleration": {"line_space": {"n": 99}}}), "/settings/acceleration/line_space/n"),
        (json!({"acceleration": {"line_space": {"payload": "soup"}}}), "/settings/acceleration/line_space/payload"),
        (json!({"acceleration": {"structure": "grid", "line_space": {}}}), "/settings/acceleration/line_space"),
        (json!({"time_limit_s": -1}), "/settings/time_limit_s"),
        (json!({"split": {"tiles": [0, 1]}}), "/settings/split"),
        (json!({"split": {"passes": 1}}), "/settings/split"),
    ];
    for (settings, pointer) in cases {
        for path in ["/v1/jobs", "/v1/jobs?validate_only=true"] {
            let reply = service.post(path, &json!({"scene": scene, "settings": settings})).await;
            assert_names(&reply.problem(422), pointer, &settings);
        }
    }
    let jobs = service.get("/v1/jobs").await.json();
    let submitted = jobs["items"].as_array().unwrap().iter().filter(|job| job["settings"]["width"] == 640).count();
    assert_eq!(submitted, 0, "no job came of it: {jobs}");
}

#[tokio::test]
async fn all_wrong_fields_are_named_at_once() {
    let service = Service::start_with(&["--workers", "0"]);
    let body = json!({
        "scene": 7, "colour": "red",
        "settings": {"width": "wide", "integrator": "magic", "outputs": ["gif"], "spp": 4},
    });
    let problem = service.post("/v1/jobs", &body).await.problem(422);
    for pointer in ["/scene", "/colour", "/settings/width", "/settings/integrator", "/settings/outputs"] {
        assert_names(&problem, pointer, &body);
    }
    let problem = service.post("/v1/jobs", &json!(["scene"])).await.problem(422);
    assert!(problem["detail"].as_str().unwrap().contains("must be a JSON object"), "{problem}");
}

#[tokio::test]
async fn every_wrong_field_of_a_job_is_named() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let many: Value = (0..33).map(|i| (format!("label-{i}"), json!("x"))).collect::<serde_json::Map<_, _>>().into();
    let cases = [
        (json!({"scene": scene, "kind": "dance"}), "/kind"),
        (json!({"scene": scene, "kind": "compare"}), "/settings/a"),
        (json!({"scene": scene, "kind": "benchmark"}), "/settings/effects"),
        (json!({"scene": scene, "kind": "benchmark", "settings": {"preset": "keul-9.9"}}), "/settings/preset"),
        (json!({"scene": scene, "kind": "build", "settings": {"spp": 4}}), "/settings/spp"),
        (json!({"scene": scene, "priority": 1000}), "/priority"),
        (json!({"scene": scene, "max_attempts": 0}), "/max_attempts"),
        (json!({"scene": scene, "max_attempts": 99}), "/max_attempts"),
        (json!({"scene": scene, "labels": many}), "/labels"),
        (json!({"scene": scene, "labels": {"k".repeat(65): "v"}}), "/labels"),
        (json!({"scene": scene, "labels": {"k": "v".repeat(257)}}), "/labels"),
        (json!({"scene": scene, "labels": {"k": 7}}), "/labels"),
        (json!({"scene": scene, "colour": "red"}), "/colour"),
        (json!({"scene": 7}), "/scene"),
        (json!({"settings": {}}), "/scene"),
        (json!({"scene": "no-such-scene"}), "/scene"),
    ];
    for (body, pointer) in cases {
        let reply = service.post("/v1/jobs", &body).await;
        assert_names(&reply.problem(422), pointer, &body);
    }

    let two = service.post("/v1/jobs", &json!({"scene": scene, "settings": {"width": 0, "spp": 0}})).await.problem(422);
    assert_names(&two, "/settings/width", &two);
    assert_names(&two, "/settings/spp", &two);
}

#[tokio::test]
async fn bodies_that_are_no_json_are_refused() {
    let service = Service::start_with(&["--workers", "0"]);
    let send = async |media_type: &str, body: &str| {
        let request = service.request(Method::POST, "/v1/jobs").header("content-type", media_type);
        service.send(request.body(body.to_owned())).await
    };
    send("application/json", "{\"scene\": ").await.problem(400);
    send("application/json", "").await.problem(400);
    send("text/plain", "{}").await.problem(415);
    let deep = "[".repeat(100_000);
    send("application/json", &deep).await.problem(400);
}

/// Refused by its announced length, before a byte of it was sent.
#[tokio::test]
async fn a_body_that_is_too_large_is_refused_at_once() {
    let service = Service::start_with(&["--workers", "0"]);
    let mut socket = tokio::net::TcpStream::connect(service.url().trim_start_matches("http://")).await.unwrap();
    let head =
        "POST /v1/jobs HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: 20000000\r\n\r\n";
    socket.write_all(head.as_bytes()).await.unwrap();
    assert_too_large(&mut socket).await;
}

/// A client that first sends and then reads must find the answer, not a connection reset under its hands.
#[tokio::test]
async fn a_client_that_sends_on_still_gets_the_refusal() {
    let service = Service::start_with(&["--workers", "0"]);
    let length = 20_000_000;
    for framing in [format!("content-length: {length}"), "transfer-encoding: chunked".to_owned()] {
        let mut socket = tokio::net::TcpStream::connect(service.url().trim_start_matches("http://")).await.unwrap();
        let head = format!("POST /v1/jobs HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\n{framing}\r\n\r\n");
        socket.write_all(head.as_bytes()).await.unwrap();
        let body = vec![b' '; length];
        if framing.ends_with("chunked") {
            socket.write_all(format!("{length:x}\r\n").as_bytes()).await.unwrap();
        }
        socket.write_all(&body).await.expect("the service reads on");
        if framing.ends_with("chunked") {
            socket.write_all(b"\r\n0\r\n\r\n").await.unwrap();
        }
        assert_too_large(&mut socket).await;

        let again = "GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n";
        socket.write_all(again.as_bytes()).await.expect("the connection lives on");
        assert!(one_answer(&mut socket).await.starts_with("HTTP/1.1 200 "), "{framing}");
    }
}

async fn assert_too_large(socket: &mut tokio::net::TcpStream) {
    let answer = one_answer(socket).await;
    assert!(answer.starts_with("HTTP/1.1 413 ") && answer.contains("application/problem+json"), "{answer}");
}

/// One answer, read by its announced length.
async fn one_answer(socket: &mut tokio::net::TcpStream) -> String {
    let mut answer = Vec::new();
    let whole = |answer: &[u8]| {
        let text = String::from_utf8_lossy(answer).to_lowercase();
        let Some((head, body)) = text.split_once("\r\n\r\n") else { return false };
        let length = head.lines().find_map(|line| line.strip_prefix("content-length: ")?.parse::<usize>().ok());
        body.len() >= length.expect("an answer with a length")
    };
    while !whole(&answer) {
        let read = socket.read_buf(&mut answer).await.expect("an answer, not a reset");
        assert!(read > 0, "the connection ended after {}", String::from_utf8_lossy(&answer));
    }
    String::from_utf8_lossy(&answer).into_owned()
}

#[tokio::test]
async fn unknown_things_are_not_found() {
    let service = Service::start_with(&["--workers", "0"]);
    let hash = "0".repeat(64);
    for path in [
        "/v1/scenes/nope".to_owned(),
        "/v1/scenes/nope/thumbnail.png".to_owned(),
        "/v1/jobs/nope".to_owned(),
        "/v1/jobs/nope/events".to_owned(),
        "/v1/jobs/nope/log".to_owned(),
        "/v1/jobs/nope/artifacts/image.png".to_owned(),
        format!("/v1/meshes/{hash}"),
        format!("/v1/blobs/{hash}"),
        "/v1/workers/nope".to_owned(),
        "/v1/nothing".to_owned(),
        "/nothing".to_owned(),
    ] {
        service.get(&path).await.problem(404);
    }
    for path in ["/v1/jobs/nope/cancel", "/v1/jobs/nope/retry"] {
        service.send(service.request(Method::POST, path)).await.problem(404);
    }
    service.send(service.request(Method::DELETE, "/v1/scenes/nope")).await.problem(404);
}

#[tokio::test]
async fn wrong_methods_and_queries_are_refused() {
    let service = Service::start_with(&["--workers", "0"]);
    let reply = service.send(service.request(Method::PATCH, "/v1/jobs")).await;
    reply.problem(405);
    assert!(reply.header("allow").contains("GET"), "{:?}", reply.headers);
    for (query, pointer) in [
        ("limit=0", "query/limit"),
        ("limit=100000", "query/limit"),
        ("limit=many", "query/limit"),
        ("cursor=garbage", "query/cursor"),
        ("state=sleeping", "query/state"),
        ("flavour=mint", "query/flavour"),
    ] {
        let problem = service.get(&format!("/v1/jobs?{query}")).await.problem(400);
        assert_names(&problem, pointer, &json!(query));
    }
}

/// The problem lists an error at `pointer` or below it, with a detail.
fn assert_names(problem: &Value, pointer: &str, input: &Value) {
    let errors = problem["errors"].as_array().cloned().unwrap_or_default();
    let named = errors.iter().any(|error| {
        error["pointer"].as_str().is_some_and(|p| p.starts_with(pointer))
            && error["detail"].as_str().is_some_and(|d| d.len() > 5)
    });
    assert!(named, "{input}: no error at {pointer}: {problem}");
}
