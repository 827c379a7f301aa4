//! The same job on both devices, and jobs for devices that are not there. `make test` installs lavapipe.

use std::process::{Command, Output};

use lightshaft_tests::{Service, binary, picture};
use serde_json::json;

#[tokio::test]
async fn both_devices_give_the_same_picture() {
    let service = Service::start();
    for (kind, integrator) in [
        ("cornell-box", "path"),
        ("demo", "path"),
        ("foliage-cards", "direct"),
        ("sphere-flake", "whitted"),
        ("demo", "ao"),
    ] {
        let scene = service.generated(&[kind]).await;
        let settings =
            |device: &str| json!({"width": 96, "height": 72, "spp": 8, "integrator": integrator, "device": device});
        let cpu = service.render(&scene, settings("cpu")).await;
        let gpu = service.render(&scene, settings("gpu")).await;
        assert_eq!(cpu["metrics"]["device_kind"], "cpu");
        assert_eq!(gpu["metrics"]["device_kind"], "gpu");
        let pictures = (service.artifact(&cpu, "image.png").await, service.artifact(&gpu, "image.png").await);
        let report = picture::against(&picture::png(&pictures.0), &picture::png(&pictures.1)).report;
        assert!(report.flip_mean < 0.01, "{kind} by {integrator}: {report:?}");
        let ratio = report.differences.mean_ratio.expect("a picture that is not black");
        assert!((ratio - 1.0).abs() < 0.005, "{kind} by {integrator}: {report:?}");
    }
}

#[tokio::test]
async fn a_job_for_a_device_that_no_worker_has_fails_and_says_why() {
    let service = Service::start_with(&["--device", "cpu", "--device-grace-s", "3"]);
    let scene = service.generated(&["cornell-box"]).await;
    service.render(&scene, json!({"width": 16, "height": 16, "spp": 1})).await;
    // The scene's thumbnail is done too: while anything is, the service is active, however long another job waits.
    service
        .until("the service to be idle", async || {
            (service.get("/v1/status").await.json()["state"] == "idle").then_some(())
        })
        .await;
    let id = service.submit(&scene, json!({"width": 16, "height": 16, "spp": 1, "device": "gpu"})).await;
    service
        .until("the status to say waiting", async || {
            (service.get("/v1/status").await.json()["state"] == "waiting").then_some(())
        })
        .await;
    let waiting = service.job(&id).await;
    assert_eq!(waiting["state"], "queued");
    assert!(waiting["waiting"].as_str().is_some_and(|why| why.contains("a GPU")), "{waiting:#}");
    let failed = service.job_in(&id, &["failed"]).await;
    let error = failed["error"].as_str().unwrap();
    assert!(error.contains("a GPU") && error.contains("`local-1` has cpu "), "{error}");

    let url = service.url();
    let submit = ["job", "submit", &scene, "--device", "gpu", "--adapter", "Voodoo 2", "--wait", "--server", url];
    let output = binary::run(&submit);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("voodoo 2") && stderr.contains("`local-1` has cpu "), "{stderr}");
    service.render(&scene, json!({"width": 16, "height": 16, "spp": 2, "device": "cpu"})).await;
}

#[test]
fn an_adapter_that_is_not_there_is_an_error_with_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (folder.path().join("s.glb"), folder.path().join("o.png"));
    let (scene, out) = (scene.to_str().unwrap(), out.to_str().unwrap());
    binary::run_ok(&["scene", "generate", "cornell-box", "-o", scene]);
    let output = binary::run(&["render", scene, "-o", out, "--device", "gpu", "--adapter", "Voodoo 2"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && stderr.contains("Voodoo 2"), "{stderr}");
}

/// Without a Vulkan driver there is no adapter, whatever the machine has.
fn without_adapters(args: &[&str]) -> Output {
    let mut command = Command::new(binary::lightshaft());
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        command.env(variable, "/no/such/driver.json");
    }
    command.args(args).output().expect("lightshaft starts")
}

#[test]
fn a_gpu_that_is_not_there_is_a_clear_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (scene, picture, cache) = (path("s.glb"), path("o.png"), path("cache"));
    binary::run_ok(&["scene", "generate", "cornell-box", "-o", &scene]);
    let render = ["render", &scene, "-o", &picture, "--device", "gpu"];
    let worker = ["worker", "--device", "gpu", "--server", "http://127.0.0.1:9", "--cache", &cache];
    for (args, mentions) in [(&render[..], "no adapter"), (&worker[..], "no GPU was found")] {
        let output = without_adapters(args);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{args:?}: {stderr}");
        assert!(stderr.contains(mentions), "{args:?}: {stderr}");
    }
}
