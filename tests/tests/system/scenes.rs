//! Scenes: every way to upload them, what the service says about them, the generator.

use lightshaft_tests::glb::{self, Gltf};
use lightshaft_tests::service::generate;
use lightshaft_tests::{Service, picture};
use reqwest::Method;
use reqwest::multipart::{Form, Part};
use serde_json::json;

#[tokio::test]
async fn the_same_bytes_are_the_same_scene() {
    let service = Service::start_with(&["--workers", "0"]);
    let bytes = Gltf::triangle().glb();
    let first = service.upload("model/gltf-binary", bytes.clone()).await;
    assert_eq!(first.status, 201);
    let again = service.upload("model/gltf-binary", bytes).await;
    assert_eq!((again.status, &again.json()["id"]), (200, &first.json()["id"]));
    let scene = first.json();
    assert_eq!(scene["triangles_total"], 1);
    assert_eq!(scene["instances"], 1);
    assert_eq!(scene["meshes"][0]["triangles"], 1);
    assert_eq!(scene["meshes"][0]["hash"].as_str().unwrap().len(), 64);
    assert_eq!(scene["bounds"], json!({"min": [0.0, 0.0, 0.0], "max": [1.0, 1.0, 0.0]}));
}

#[tokio::test]
async fn glb_zip_and_multipart_hold_the_same_meshes() {
    let service = Service::start_with(&["--workers", "0"]);
    let model = Gltf::triangle();
    let gltf = model.gltf("parts/mesh%20one.bin");
    let zip = glb::zip(&[("folder/scene.gltf", &gltf), ("folder/parts/mesh one.bin", &model.buffer)]);
    let part = |bytes: &[u8], name: &str| Part::bytes(bytes.to_vec()).file_name(name.to_owned());
    let form =
        Form::new().part("file", part(&gltf, "scene.gltf")).part("file", part(&model.buffer, "parts/mesh one.bin"));
    let replies = [
        service.upload("model/gltf-binary", model.glb()).await,
        service.upload("application/zip", zip).await,
        service.send(service.request(Method::POST, "/v1/scenes").multipart(form)).await,
    ];
    let hashes: Vec<_> = replies
        .iter()
        .map(|reply| {
            assert_eq!(reply.status, 201, "{}", reply.text());
            reply.json()["meshes"][0]["hash"].clone()
        })
        .collect();
    assert!(hashes.iter().all(|hash| *hash == hashes[0]), "{hashes:?}");
}

#[tokio::test]
async fn odd_geometry_is_taken_with_a_warning() {
    let service = Service::start();
    let mut flat = Gltf::triangle();
    flat.buffer.copy_within(0..12, 12);
    flat.buffer.copy_within(0..12, 24);
    let points = Gltf::triangle().with("/meshes/0/primitives/0", json!({"attributes": {"POSITION": 0}, "mode": 0}));
    let nothing = Gltf::triangle().with("/scenes/0", json!({"nodes": []}));
    for (name, gltf, warns) in
        [("a triangle without area", flat, false), ("points", points, true), ("no node", nothing, false)]
    {
        let reply = service.upload("model/gltf-binary", gltf.glb()).await;
        assert_eq!(reply.status, 201, "{name}: {}", reply.text());
        let warnings = reply.json()["warnings"].as_array().unwrap().len();
        assert!(warnings > 0 || !warns, "{name} is worth a warning");
        let scene = reply.json()["id"].as_str().unwrap().to_owned();
        let job = service.render(&scene, json!({"width": 16, "height": 16, "spp": 1, "environment": 1.0})).await;
        let shown = picture::png(&service.artifact(&job, "image.png").await);
        assert!(picture::mean(&shown) > 0.1, "{name}: the sky is seen");
    }
}

#[tokio::test]
async fn a_thumbnail_is_made_without_asking() {
    let service = Service::start();
    let scene = service.generated(&["cornell-box"]).await;
    let thumbnail = service
        .until("the thumbnail", async || {
            let reply = service.get(&format!("/v1/scenes/{scene}/thumbnail.png")).await;
            (reply.status == 200).then_some(reply)
        })
        .await;
    assert_eq!(thumbnail.header("content-type"), "image/png");
    assert!(picture::shows_something(&picture::png(&thumbnail.body)));
    let listed = service.get("/v1/scenes").await.json();
    assert!(listed["items"][0]["thumbnail"].as_str().is_some(), "{listed}");
}

#[tokio::test]
async fn meshes_list_the_structures_that_exist() {
    let service = Service::start();
    let scene = service.generated(&["cornell-box"]).await;
    let job = service.render(&scene, json!({"width": 16, "height": 16, "spp": 1, "device": "cpu"})).await;
    let hash = job["metrics"]["cache"][0]["mesh"].as_str().unwrap().to_owned();
    let mesh = service
        .until("a published structure", async || {
            let mesh = service.get(&format!("/v1/meshes/{hash}")).await.json();
            (!mesh["structures"].as_array()?.is_empty()).then_some(mesh)
        })
        .await;
    let structure = &mesh["structures"][0];
    assert!(structure["bytes"].as_u64().unwrap() > 0 && structure["kind"].is_string(), "{mesh}");
}

#[tokio::test]
async fn budgets_of_scenes_can_be_set() {
    let limits = ["--workers", "0", "--scene-limits", "{\"triangles\": 1, \"instances\": 1}"];
    let service = Service::start_with(&limits);
    service.scene(Gltf::triangle().glb()).await;
    let two = Gltf::triangle()
        .with("/scenes/0", json!({"nodes": [0, 1]}))
        .with("/nodes", json!([{"mesh": 0}, {"mesh": 0, "translation": [2, 0, 0]}]));
    for (name, bytes, budget) in
        [("instances", two.glb(), "limit of 1"), ("triangles", generate(&["terrain"]), "limit of 1")]
    {
        let problem = service.upload("model/gltf-binary", bytes).await.problem(422);
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.contains(name) && detail.contains(budget), "{problem}");
    }
    for wrong in ["{\"trinagles\": 1}", "{\"triangles\": -1}", "many"] {
        let output = lightshaft_tests::binary::run(&["serve", "--scene-limits", wrong, "--data", "/tmp/never"]);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
    }
}

#[tokio::test]
async fn a_deleted_scene_is_gone() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let deleted = service.send(service.request(Method::DELETE, &format!("/v1/scenes/{scene}"))).await;
    assert!(matches!(deleted.status, 200 | 204), "{deleted:?}");
    service.get(&format!("/v1/scenes/{scene}")).await.problem(404);
    service.post("/v1/jobs", &json!({"scene": scene})).await.problem(422);
    let again = service.upload("model/gltf-binary", Gltf::triangle().glb()).await;
    assert_eq!(again.status, 201, "it can come back");
}

#[test]
fn the_generator_is_deterministic_by_seed() {
    let pile = |seed: &str| generate(&["pile", "--seed", seed]);
    assert_eq!(pile("7"), pile("7"));
    assert_ne!(pile("7"), pile("8"));
}
