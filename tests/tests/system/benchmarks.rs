//! Benchmarks and builds from the outside: without a service, and as jobs.

use lightshaft_tests::Service;
use lightshaft_tests::binary::{run, run_ok};
use serde_json::{Value, json};

/// Submits a job of a kind; answers its id.
async fn submit(service: &Service, kind: &str, scene: &str, settings: &Value) -> String {
    let reply = service.post("/v1/jobs", &json!({ "scene": scene, "kind": kind, "settings": settings })).await;
    assert_eq!(reply.status, 201, "{}", reply.text());
    reply.json()["id"].as_str().unwrap().to_owned()
}

/// As quick as can be.
fn quick() -> Value {
    json!({
        "effects": [{ "kind": "ao", "samples": 2 }],
        "configurations": [{ "name": "base" }, { "name": "grid", "acceleration": { "structure": "grid" } }],
        "device": "cpu", "width": 32, "height": 24, "repetitions": 3, "min_sample_s": 0.001, "picture_spp": 2,
    })
}

#[tokio::test]
async fn a_benchmark_job_leaves_its_tables_and_shows_them() {
    let service = Service::start();
    let scene = service.generated(&["pile", "--count", "3", "--triangles", "600"]).await;
    let job = service.succeeded(&submit(&service, "benchmark", &scene, &quick()).await).await;
    assert_eq!(job["kind"], "benchmark");
    let results: Value = serde_json::from_slice(&service.artifact(&job, "results.json").await).unwrap();
    let rows = &results["scenes"][0]["comparisons"][0]["rows"];
    assert_eq!((&rows[0]["configuration"], &rows[1]["configuration"]), (&json!("base"), &json!("grid")));
    assert_eq!(rows[1]["picture"]["differing_pixels"], 0, "all structures give the same picture");
    assert!(rows[1]["timed"]["ratio"]["low"].as_f64() <= rows[1]["timed"]["ratio"]["high"].as_f64());
    assert_eq!(service.artifact(&job, "heatmap-grid.png").await[..4], *b"\x89PNG");
    let markdown = String::from_utf8(service.artifact(&job, "results.md").await).unwrap();
    assert!(markdown.contains("| base (reference) |"), "{markdown}");
    assert!(job["metrics"]["rays"]["ao"].as_u64().is_some_and(|rays| rays > 0), "{job}");

    let page = service.get(&format!("/jobs/{}", job["id"].as_str().unwrap())).await.text();
    for shown in ["base (reference)", "results.csv", "heatmap-grid.png", "ratio [95 %]", "<svg"] {
        assert!(page.contains(shown), "{shown} is not on the page");
    }
}

#[tokio::test]
async fn a_build_warms_the_cache_for_renders() {
    let service = Service::start();
    let scene = service.generated(&["pile", "--count", "3", "--triangles", "600"]).await;
    let line_space = json!({ "payload": "binary", "n": 3 });
    let settings = json!({ "acceleration": { "line_space": line_space } });
    let job = service.succeeded(&submit(&service, "build", &scene, &settings).await).await;
    let made = job["metrics"]["cache"].as_array().unwrap();
    assert!(made.iter().any(|report| report["structure"].as_str().unwrap().contains("binary")), "{made:?}");
    let mut render = json!({ "width": 16, "height": 16, "spp": 1, "device": "cpu" });
    render["acceleration"] = settings["acceleration"].clone();
    let rendered = service.render(&scene, render).await;
    let sources: Vec<&Value> =
        rendered["metrics"]["cache"].as_array().unwrap().iter().map(|report| &report["source"]).collect();
    assert!(sources.iter().all(|source| **source == "memory"), "{sources:?}");
    let page = service.get(&format!("/jobs/{}", job["id"].as_str().unwrap())).await.text();
    assert!(page.contains("binary") && page.contains("All structures"));
}

#[tokio::test]
async fn a_running_benchmark_can_be_cancelled_and_tried_again() {
    let service = Service::start();
    let scene = service.generated(&["pile", "--count", "3", "--triangles", "600"]).await;
    let mut endless = quick();
    endless["repetitions"] = json!(1000);
    endless["min_sample_s"] = json!(1.0);
    let id = submit(&service, "benchmark", &scene, &endless).await;
    let path = format!("/v1/jobs/{id}");
    let timing =
        async || service.job(&id).await["attempts"][0]["phase"].as_str().filter(|p| *p == "render").map(|_| ());
    service.until("the benchmark times something", timing).await;
    service.post(&format!("{path}/cancel"), &json!({})).await;
    let cancelled = service.job_in(&id, &["cancelled"]).await;
    assert_eq!(cancelled["attempts"][0]["outcome"], "cancelled");
    assert_eq!(service.post(&format!("{path}/retry"), &json!({})).await.status, 200);
    service.post(&format!("{path}/cancel"), &json!({})).await;
    service.job_in(&id, &["cancelled"]).await;
}

#[test]
fn the_command_line_prints_writes_and_refuses() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let own = path("own.json");
    std::fs::write(&own, quick().to_string()).unwrap();
    let generated = path("pile.glb");
    run_ok(&["scene", "generate", "pile", "--count", "3", "--triangles", "600", "-o", &generated]);
    let (json_file, csv, markdown, pictures) = (path("o.json"), path("o.csv"), path("o.md"), path("pictures"));
    let printed = run_ok(&[
        "bench",
        &own,
        "--scene",
        &generated,
        "--json",
        &json_file,
        "--csv",
        &csv,
        "--markdown",
        &markdown,
        "--heat-maps",
        &pictures,
    ]);
    assert!(printed.contains("base (reference)") && printed.contains("pile: ambient occlusion, 2 rays"), "{printed}");
    let results: Value = serde_json::from_slice(&std::fs::read(&json_file).unwrap()).unwrap();
    assert_eq!(results["scenes"][0]["measured"], "pile.glb");
    assert_eq!(std::fs::read_to_string(&csv).unwrap().lines().count(), 3);
    assert!(std::fs::read_to_string(&markdown).unwrap().contains("| grid |"));
    assert!(folder.path().join("pictures/heatmap-grid.png").is_file());

    let listed: Value = serde_json::from_str(&run_ok(&["bench", "--list", "--json"])).unwrap();
    assert_eq!((listed.as_array().unwrap().len(), &listed[0]["preset"]), (10, &json!("keul-4.1")));
    for wrong in [
        vec!["bench", "keul-9.9"],
        vec!["bench", own.as_str()],
        vec!["bench", "keul-4.1", "--only", "nothing"],
        vec!["bench", "keul-4.1", "--repeat", "1"],
        vec!["bench", own.as_str(), "--scene", "/no/such/file.glb"],
    ] {
        assert_eq!(run(&wrong).status.code(), Some(2), "{wrong:?}");
    }
}
