//! Jobs that compare: through the queue, by command, and on their page.

use lightshaft_tests::binary::run_ok;
use lightshaft_tests::{Service, picture};
use serde_json::{Value, json};

#[tokio::test]
async fn two_pictures_are_compared_by_a_worker_and_the_result_is_kept() {
    let service = Service::start_with(&["--no-thumbnails"]);
    let scene = service.generated(&["cornell-box"]).await;
    let render = async |seed: u32| {
        let settings =
            json!({ "width": 48, "height": 36, "spp": 4, "seed": seed, "device": "cpu", "outputs": ["png", "exr"] });
        service.render(&scene, settings).await["id"].as_str().expect("an id").to_owned()
    };
    let (a, b) = (render(1).await, render(2).await);
    let settings = json!({ "a": { "job": a }, "b": { "job": b }, "hdr": true, "max_flip": 0.000001 });
    let reply = service.post("/v1/jobs", &json!({ "kind": "compare", "settings": settings })).await;
    assert_eq!(reply.status, 201, "{}", reply.text());
    let job = service.succeeded(reply.json()["id"].as_str().expect("an id")).await;
    assert_eq!(job["scene"], json!(scene));

    let kept: Value = serde_json::from_slice(&service.artifact(&job, "comparison.json").await).expect("JSON");
    let at_once = service.post("/v1/compare", &settings).await.json();
    for field in ["a", "b", "rmse", "rel_mse", "psnr", "ssim", "flip_mean", "hdr_flip", "differing_pixels", "passed"] {
        assert_eq!(kept[field], at_once[field], "{field}");
    }
    assert_eq!(kept["passed"], false, "a limit that is passed fails no job");
    let drawn = service.artifact(&job, "heatmap.png").await;
    assert_eq!(drawn, service.get(at_once["heat_map"].as_str().expect("an address")).await.body);
    assert!(picture::shows_something(&picture::png(&drawn)));
    let page = service.get(&format!("/jobs/{}", job["id"].as_str().expect("an id"))).await.text();
    let compare =
        format!("/compare?p={}&#38;p={}", kept["a"]["hash"].as_str().unwrap(), kept["b"]["hash"].as_str().unwrap());
    for shown in ["Mean HDR-FLIP", "heatmap.png", "Not every limit is kept", "The whole comparison", compare.as_str()] {
        assert!(page.contains(shown), "{shown} is not on the page");
    }

    let folder = service.scratch("compared");
    let made = run_ok(&[
        "--server",
        service.url(),
        "--json",
        "job",
        "submit",
        "--a",
        &a,
        "--b",
        &format!("{b}/image.exr"),
        "--setting",
        "max_flip=0.000001",
        "--wait",
        "--output",
        folder.to_str().expect("a path"),
    ]);
    let made: Value = serde_json::from_str(&made).expect("JSON");
    assert_eq!((&made["kind"], &made["state"]), (&json!("compare"), &json!("succeeded")));
    let by_command = std::fs::read(folder.join("comparison.json")).expect("the result");
    let by_command: Value = serde_json::from_slice(&by_command).expect("JSON");
    assert_eq!((&by_command["flip_mean"], &by_command["hdr_flip"]), (&kept["flip_mean"], &Value::Null));
}

#[tokio::test]
async fn pictures_of_two_sizes_fail_for_good_and_say_why() {
    let service = Service::start_with(&["--no-thumbnails"]);
    let scene = service.generated(&["cornell-box"]).await;
    let render = async |width: u32| {
        let settings = json!({ "width": width, "height": 16, "spp": 1, "device": "cpu" });
        service.render(&scene, settings).await["id"].as_str().expect("an id").to_owned()
    };
    let (a, b) = (render(16).await, render(20).await);
    let settings = json!({ "a": { "job": a }, "b": { "job": b } });
    let reply = service.post("/v1/jobs", &json!({ "kind": "compare", "settings": settings })).await;
    let job = service.job_in(reply.json()["id"].as_str().expect("an id"), &["failed"]).await;
    assert!(job["error"].as_str().is_some_and(|error| error.contains("has 20 x 16 pixels")), "{job:#}");
    assert_eq!(job["attempts"].as_array().map(Vec::len), Some(1), "nobody else can do better");
}
