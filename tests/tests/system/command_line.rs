//! The command line: every command, its JSON and its exit codes.

use std::process::{Command, Output};

use lightshaft_tests::binary::{lightshaft, run, run_ok};
use lightshaft_tests::glb::Gltf;
use lightshaft_tests::{Service, picture};
use serde_json::{Value, json};

/// Runs a command against a service, with `--json`; expects the exit code and one JSON value on standard output.
fn json_of(service: &Service, args: &[&str], code: i32) -> Value {
    let output = at(service, args);
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "{args:?}: {stdout}\n{stderr}");
    serde_json::from_str(&stdout).unwrap_or_else(|e| panic!("{args:?}: {e}: {stdout}"))
}

fn at(service: &Service, args: &[&str]) -> Output {
    let mut command = Command::new(lightshaft());
    command.env("LIGHTSHAFT_SERVER", service.url()).arg("--json").args(args).output().expect("lightshaft starts")
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_else(|| panic!("a text: {value}"))
}

#[tokio::test]
async fn a_whole_session_by_commands() {
    let service = Service::start();
    let file = service.scratch("scene.glb");
    let file = file.to_str().unwrap();
    run_ok(&["scene", "generate", "cornell-box", "-o", file]);

    let scene = json_of(&service, &["scene", "upload", file], 0);
    let scene = text(&scene["id"]);
    let listed = json_of(&service, &["scene", "list"], 0);
    assert!(listed.to_string().contains(scene), "{listed}");
    assert_eq!(json_of(&service, &["scene", "show", scene], 0)["id"], scene);

    let submit = ["job", "submit", scene, "--width", "40", "--height", "30", "--spp", "2", "--setting", "exposure=1"];
    let job = json_of(&service, &submit, 0);
    let job = text(&job["id"]);
    let watched = json_of(&service, &["job", "watch", job], 0);
    assert_eq!(watched["state"], "succeeded", "{watched}");
    let shown = json_of(&service, &["job", "show", job], 0);
    assert_eq!((&shown["settings"]["width"], &shown["settings"]["exposure"]), (&json!(40), &json!(1.0)));
    assert!(json_of(&service, &["job", "list", "--state", "succeeded"], 0).to_string().contains(job));

    let folder = service.scratch("out");
    json_of(&service, &["job", "download", job, "-o", folder.to_str().unwrap()], 0);
    let shown = picture::png(&std::fs::read(folder.join("image.png")).unwrap());
    assert_eq!((shown.width(), shown.height()), (40, 30));
    assert!(folder.join("image.exr").is_file() && folder.join("metrics.json").is_file());

    json_of(&service, &["scene", "delete", scene], 0);
    assert_eq!(at(&service, &["scene", "show", scene]).status.code(), Some(2), "it is gone");
}

#[tokio::test]
async fn jobs_are_cancelled_and_retried_by_commands() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let job = json_of(&service, &["job", "submit", &scene], 0);
    let job = text(&job["id"]);
    assert_eq!(json_of(&service, &["job", "priority", job, "-7"], 0)["priority"], -7);
    assert_eq!(json_of(&service, &["job", "pause", job], 0)["paused"], true);
    assert_eq!(json_of(&service, &["job", "resume", job], 0)["paused"], false);
    json_of(&service, &["job", "cancel", job], 0);
    assert_eq!(service.job(job).await["state"], "cancelled");
    assert_eq!(at(&service, &["job", "watch", job]).status.code(), Some(1), "the answer is no: it did not succeed");
    json_of(&service, &["job", "retry", job], 0);
    assert_eq!(service.job(job).await["state"], "queued");
}

#[tokio::test]
async fn workers_are_drained_by_commands() {
    let service = Service::start();
    let registered =
        service.until("a worker", async || json_of(&service, &["workers", "list"], 0).get(0).cloned()).await;
    let worker = text(&registered["id"]);
    assert_eq!(json_of(&service, &["workers", "drain", worker], 0)["draining"], true);
    assert_eq!(json_of(&service, &["workers", "show", worker], 0)["state"], "draining");
    assert_eq!(json_of(&service, &["workers", "undrain", worker], 0)["draining"], false);
    let table = at(&service, &["workers", "list"]);
    assert!(String::from_utf8_lossy(&table.stdout).contains(worker));
    json_of(&service, &["workers", "forget", worker], 0);
    assert_eq!(at(&service, &["workers", "show", worker]).status.code(), Some(2), "it is forgotten");
}

#[tokio::test]
async fn mistakes_exit_with_2_and_name_what_is_wrong() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let broken = service.scratch("broken.glb");
    std::fs::write(&broken, b"not a model").unwrap();
    let broken = broken.to_str().unwrap();
    let wrong: [(&[&str], &str); 9] = [
        (&["job", "submit", "no-such-scene"], "/scene"),
        (&["job", "submit", &scene, "--setting", "widht=3"], "widht"),
        (&["job", "submit", &scene, "--camera", "7"], "camera"),
        (&["job", "show", "no-such-job"], "no-such-job"),
        (&["scene", "upload", broken], "file"),
        (&["scene", "upload", "/no/such/file.glb"], "/no/such/file.glb"),
        (&["scene", "generate", "dodecahedron", "-o", "/tmp/never.glb"], "dodecahedron"),
        (&["render", broken, "-o", "/tmp/never.png"], "broken.glb"),
        (&["serve", "--listen", "nowhere"], "nowhere"),
    ];
    for (args, mentions) in wrong {
        let output = at(&service, args);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(stderr.contains(mentions), "{args:?}: {stderr}");
        assert!(output.stdout.is_empty(), "messages go to standard error: {args:?}");
    }
}

#[test]
fn a_service_that_is_not_there_exits_with_3() {
    for args in [["scene", "list"], ["job", "list"]] {
        let output = run(&[&args[..], &["--server", "http://127.0.0.1:9"]].concat());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{args:?}: {stderr}");
        assert!(stderr.contains("127.0.0.1:9"), "{stderr}");
    }
}

#[test]
fn an_address_that_others_reach_must_be_allowed() {
    let output = run(&["serve", "--listen", "0.0.0.0:0", "--data", "/tmp/never"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--insecure-local"));
}

#[tokio::test]
async fn a_folder_serves_one_service_at_a_time() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let data = service.data();
    let data = data.to_str().unwrap();
    let output = run(&["serve", "--listen", "127.0.0.1:0", "--data", data]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{stderr}");
    assert!(stderr.contains(data) && stderr.contains("in use") && stderr.lines().count() == 1, "{stderr}");
    assert!(output.stdout.is_empty(), "it never listened");
    assert_eq!(service.get(&format!("/v1/scenes/{scene}")).await.status, 200, "the first one is unharmed");
}

#[test]
fn a_file_renders_without_a_service_and_compares_with_itself() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (scene, png, exr, metrics) = (path("s.glb"), path("a.png"), path("b.exr"), path("m.json"));
    run_ok(&["scene", "generate", "cornell-box", "-o", &scene]);
    let size = ["--width", "48", "--height", "36", "--spp", "4", "--device", "cpu"];
    let render = |out: &str, more: &[&str]| run_ok(&[&["render", &scene, "-o", out][..], &size, more].concat());
    render(&png, &["--metrics", &metrics]);
    render(&exr, &["--json"]);

    let shown = picture::png(&std::fs::read(&png).unwrap());
    assert!((shown.width(), shown.height()) == (48, 36) && picture::shows_something(&shown));
    let measured: Value = serde_json::from_slice(&std::fs::read(&metrics).unwrap()).unwrap();
    assert_eq!(measured["rays"]["primary"], 48 * 36 * 4);

    let same: Value = serde_json::from_str(&run_ok(&["compare", &exr, &exr, "--json", "--max-flip", "0"])).unwrap();
    assert_eq!((&same["rmse"], &same["flip_mean"]), (&json!(0.0), &json!(0.0)));
    let other = path("other.exr");
    render(&other, &["--seed", "2"]);
    let heat = path("heat.png");
    let different = run(&["compare", &exr, &other, "--max-rmse", "0.000001", "--heat-map", &heat]);
    assert_eq!(different.status.code(), Some(1), "the answer is no");
    let map = picture::png(&std::fs::read(&heat).unwrap());
    assert!(picture::shows_something(&map) && map.width() > 48, "the map with its scale bar");

    let hdr: Value = serde_json::from_str(&run_ok(&["compare", &exr, &other, "--json", "--hdr"])).unwrap();
    assert!(hdr["hdr_flip"]["mean"].as_f64().unwrap() > 0.0 && hdr["hdr_flip"]["exposures"].as_u64().unwrap() > 1);
    assert!(run_ok(&["compare", &exr, &exr, "--max-hdr-flip", "0"]).contains("hdr_flip.mean"));
    assert_eq!(run(&["compare", &png, &png, "--hdr"]).status.code(), Some(2), "a PNG is tone mapped already");
}

#[test]
fn scenes_are_validated_without_a_service() {
    let folder = tempfile::tempdir().unwrap();
    let (good, bad) = (folder.path().join("good.glb"), folder.path().join("bad.glb"));
    std::fs::write(&good, Gltf::triangle().glb()).unwrap();
    std::fs::write(&bad, Gltf::triangle().with("/nodes/0/mesh", json!(5)).glb()).unwrap();
    let summary: Value =
        serde_json::from_str(&run_ok(&["--json", "scene", "validate", good.to_str().unwrap()])).unwrap();
    assert_eq!(summary["triangles_total"], 1, "{summary}");
    let output = run(&["scene", "validate", bad.to_str().unwrap()]);
    assert!(matches!(output.status.code(), Some(1 | 2)), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("nodes/0"), "{output:?}");
}

#[test]
fn devices_completions_and_help_need_nothing() {
    let devices: Value = serde_json::from_str(&run_ok(&["devices", "--json"])).unwrap();
    assert!(devices.to_string().contains("\"kind\":\"cpu\""), "{devices}");
    for shell in ["bash", "zsh", "fish"] {
        assert!(run_ok(&["completions", shell]).contains("lightshaft"), "{shell}");
    }
    let help = run_ok(&["--help"]);
    for command in ["serve", "worker", "scene", "job", "render", "compare", "devices"] {
        assert!(help.contains(command) && !run_ok(&[command, "--help"]).is_empty(), "{command}");
    }
    assert_eq!(run(&[]).status.code(), Some(2));
    assert_eq!(run(&["dance"]).status.code(), Some(2));
}
