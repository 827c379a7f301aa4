//! Jobs that are no renders: benchmarks, builds and comparisons.

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

/// A finished job that left this picture.
async fn pictured(service: &Service, scene: &str, worker: &str, name: &str, content: &'static str) -> String {
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    let lease = service.lease(worker).await.unwrap();
    assert_eq!(service.complete(&lease, name, content).await.status, StatusCode::OK);
    job
}

#[tokio::test]
async fn a_comparison_names_its_blobs_and_the_scene_of_its_pictures() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let a = pictured(&service, &scene, &worker, "image.png", "one picture").await;
    let b = pictured(&service, &scene, &worker, "image.exr", "another").await;
    let settings = json!({ "a": { "job": a }, "b": { "job": b, "layer": "depth" }, "max_flip": 0.1 });
    let job = service.job(json!({ "kind": "compare", "settings": settings })).await;
    assert_eq!((job.summary.kind, job.summary.scene.as_str()), (JobKind::Compare, scene.as_str()));
    let lease = service.lease(&worker).await.unwrap();
    assert_eq!((&lease.work, &lease.job), (&TaskWork::Compare, &job.summary.id));
    let JobSettings::Compare(request) = &lease.settings else { panic!("{:?}", lease.settings) };
    let hash = |content: &str| Some(blake3::hash(content.as_bytes()).to_hex().to_string());
    assert_eq!((&request.a.blob, &request.b.blob), (&hash("one picture"), &hash("another")));
    assert_eq!((request.b.layer.as_deref(), request.max_flip), (Some("depth"), Some(0.1)));

    // What it compares stays as long as it does, whatever becomes of the jobs.
    for job in [&a, &b] {
        assert_eq!(service.delete(&format!("/v1/jobs/{job}")).await.status, StatusCode::NO_CONTENT);
    }
    service.clock.advance(3_600_000);
    service.app.delete_discarded().await.unwrap();
    let picture = format!("/v1/blobs/{}", request.a.blob.as_ref().unwrap());
    assert_eq!(service.get(&picture).await.status, StatusCode::OK);
    assert_eq!(service.complete(&lease, "comparison.json", "{}").await.status, StatusCode::OK);
    assert_eq!(service.delete(&format!("/v1/jobs/{}", job.summary.id)).await.status, StatusCode::NO_CONTENT);
    service.clock.advance(3_600_000);
    service.app.delete_discarded().await.unwrap();
    assert_eq!(service.get(&picture).await.status, StatusCode::NOT_FOUND, "nothing names it any more");
}

#[tokio::test]
async fn mistakes_in_a_comparison_are_named_with_their_place() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = pictured(&service, &scene, &worker, "image.png", "a picture").await;
    let blob = blake3::hash(b"a picture").to_hex().to_string();
    let check = async |body: Value| {
        let mut body = body;
        body["kind"] = json!("compare");
        service.post("/v1/jobs?validate_only=true", body).await
    };
    let both = json!({ "job": job, "blob": blob });
    let good = check(json!({ "settings": { "a": both, "b": { "blob": blob } } })).await;
    assert_eq!(good.status, StatusCode::OK, "{}", String::from_utf8_lossy(&good.body));
    assert_eq!(good.json::<ValidatedJob>().job.scene, scene);
    let wrong_hash = blob.replace(&blob[..1], if blob.starts_with('0') { "1" } else { "0" });
    for (settings, pointers) in [
        (json!({}), vec!["/settings/a", "/settings/b"]),
        (json!({ "a": { "job": "none" }, "b": { "blob": "x" } }), vec!["/settings/a/job", "/settings/b/blob"]),
        (json!({ "a": { "job": job, "artifact": "x.png" }, "b": both }), vec!["/settings/a/artifact"]),
        (json!({ "a": { "job": job, "blob": wrong_hash }, "b": both }), vec!["/settings/a/blob"]),
        (json!({ "a": { "blob": blob }, "b": { "blob": blob } }), vec!["/scene"]),
        (json!({ "a": both, "b": both, "max_flip": -1 }), vec!["/settings/max_flip"]),
        (json!({ "a": both, "b": both, "spp": 1 }), vec!["/settings/spp"]),
    ] {
        assert_eq!(check(json!({ "settings": settings })).await.pointers(), pointers, "{settings}");
    }
    let with_scene = json!({ "scene": scene, "settings": { "a": { "blob": blob }, "b": { "blob": blob } } });
    assert_eq!(check(with_scene).await.status, StatusCode::OK);
    assert_eq!(service.post("/v1/jobs", json!({ "settings": {} })).await.pointers(), ["/scene"], "of a render");
}
