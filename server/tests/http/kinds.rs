//! Jobs that are no renders: benchmarks and builds.

use http::StatusCode;
use lightshaft_api::job::{Job, JobKind, JobSummary, TaskWork, ValidatedJob};
use lightshaft_api::page::Page;
use lightshaft_api::settings::{BenchmarkPreset, JobSettings};
use serde_json::{Value, json};

use crate::harness::Service;

#[tokio::test]
async fn a_benchmark_is_one_task_with_every_scene() {
    let service = Service::start().await;
    let (first, second) = (service.scene(0).await, service.scene(1).await);
    let worker = service.worker(&["cpu"]).await;
    let settings = json!({ "preset": "keul-4.1", "scenes": [second], "repetitions": 5 });
    let job = service.job(json!({ "scene": first, "kind": "benchmark", "settings": settings })).await;
    assert_eq!(job.summary.kind, JobKind::Benchmark);
    let JobSettings::Benchmark(read) = &job.settings else { panic!("{:?}", job.settings) };
    assert_eq!((read.preset, read.repetitions, read.min_sample_s), (Some(BenchmarkPreset::Keul41), 5, 0.1));

    let in_use = service.delete(&format!("/v1/scenes/{second}")).await;
    assert_eq!(in_use.status, StatusCode::CONFLICT, "the benchmark needs it");
    let lease = service.lease(&worker).await.unwrap();
    assert_eq!((&lease.work, lease.scene.id.as_str()), (&TaskWork::Benchmark, first.as_str()));
    assert_eq!(lease.more_scenes.iter().map(|scene| &scene.id).collect::<Vec<_>>(), [&second]);
    assert_eq!(lease.more_scenes[0].files.len(), 1);
    assert!(service.lease(&worker).await.is_none(), "a benchmark is not shared");
    assert_eq!(service.complete(&lease, "results.json", "{}").await.status, StatusCode::OK);
    let done = service.read_job(&job.summary.id).await;
    assert!(done.metrics.is_some() && done.artifacts[0].name == "results.json");
    assert_eq!(service.delete(&format!("/v1/scenes/{second}")).await.status, StatusCode::NO_CONTENT);
}

#[tokio::test]
async fn a_build_is_one_task_and_kinds_are_told_apart_in_lists() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let settings = json!({ "acceleration": { "line_space": { "payload": "binary", "n": 4 } } });
    let build = service.job(json!({ "scene": scene, "kind": "build", "settings": settings })).await;
    let render = service.job(json!({ "scene": scene })).await;
    let of_kind = async |kind: &str| -> Vec<String> {
        let page: Page<JobSummary> = service.get(&format!("/v1/jobs?kind={kind}")).await.json();
        page.items.into_iter().map(|job| job.id).collect()
    };
    assert_eq!(of_kind("build").await, std::slice::from_ref(&build.summary.id));
    assert_eq!(of_kind("render").await, [render.summary.id]);
    assert!(of_kind("benchmark").await.is_empty());
    assert_eq!(service.get("/v1/jobs?kind=dance").await.status, StatusCode::BAD_REQUEST);
    let lease = service.lease(&worker).await.unwrap();
    assert_eq!((lease.work, lease.job), (TaskWork::Build, build.summary.id.clone()));
    let job: Job = service.get(&format!("/v1/jobs/{}", build.summary.id)).await.json();
    assert!(matches!(job.settings, JobSettings::Build(_)));
}

#[tokio::test]
async fn mistakes_in_a_benchmark_are_named_with_their_place() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let check = async |kind: &str, settings: Value| {
        let body = json!({ "scene": scene, "kind": kind, "settings": settings });
        service.post("/v1/jobs?validate_only=true", body).await
    };
    let valid = check("benchmark", json!({ "preset": "keul-8.3" })).await;
    assert_eq!(valid.status, StatusCode::OK);
    assert_eq!(valid.json::<ValidatedJob>().tasks, 1);

    let effects = json!([{ "kind": "ao", "samples": 0 }]);
    let configurations = json!([{ "name": "a", "acceleration": { "structure": "grid", "n": 3 } }, { "name": "a" }]);
    let wrong = json!({ "effects": effects, "configurations": configurations, "reference": "b", "views": [7],
                        "scenes": ["no-such-scene", scene], "repetitions": 1 });
    let mut found = check("benchmark", wrong).await.pointers();
    found.sort();
    let expected = [
        "configurations/0/acceleration/n",
        "configurations/1/name",
        "effects/0/samples",
        "reference",
        "repetitions",
        "scenes/0",
        "scenes/1",
        "views/0",
    ];
    assert_eq!(found, expected.map(|field| format!("/settings/{field}")));
    assert_eq!(check("benchmark", json!({ "preset": "keul-0.0" })).await.pointers(), ["/settings/preset"]);
    assert_eq!(check("benchmark", json!({ "spp": "many", "preset": "keul-4.1" })).await.pointers(), ["/settings/spp"]);
    let unknown = json!({ "effects": [{ "kind": "dance" }], "configurations": [{ "name": "a" }] });
    assert!(check("benchmark", unknown).await.pointers()[0].starts_with("/settings/effects"));
    assert_eq!(check("build", json!({ "width": 3 })).await.pointers(), ["/settings/width"]);
    let policy = json!({ "acceleration": { "policy": "approximate_occlusion" } });
    assert_eq!(check("build", policy).await.pointers(), ["/settings/acceleration/policy"]);
    assert_eq!(check("compare", json!({})).await.pointers(), ["/kind"]);
}

#[tokio::test]
async fn a_benchmark_that_demands_a_gpu_waits_for_one() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let settings = json!({ "preset": "keul-8.3", "device": "gpu" });
    service.job(json!({ "scene": scene, "kind": "benchmark", "settings": settings })).await;
    assert!(service.lease(&worker).await.is_none());
    let with_gpu = service.worker(&["cpu", "gpu"]).await;
    assert_eq!(service.lease(&with_gpu).await.unwrap().work, TaskWork::Benchmark);
}
