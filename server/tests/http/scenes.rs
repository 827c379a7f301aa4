//! `/v1/scenes`

use std::io::Write;
use std::time::{Duration, Instant};

use http::StatusCode;
use lightshaft_api::client::{ScenePart, Upload};
use lightshaft_api::job::{CAMERA_LABEL, JobSummary, TaskWork};
use lightshaft_api::page::Page;
use lightshaft_api::scene::{Scene, SceneSummary};
use lightshaft_api::settings::{CameraChoice, JobSettings, Output};
use serde_json::json;

use crate::harness::{Service, glb, glb_upload, multipart, positions, scratch_file, triangle_document, triangle_glb};

fn zip(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in files {
        archive.start_file(*name, zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(content).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

#[tokio::test]
async fn a_glb_becomes_a_scene_and_the_same_bytes_the_same_scene() {
    let service = Service::start().await;
    let answer = service.upload("model/gltf-binary", triangle_glb(0)).await;
    assert_eq!(answer.status, StatusCode::CREATED);
    let scene: Scene = answer.json();
    assert_eq!(answer.header("location"), format!("/v1/scenes/{}", scene.id));
    assert_eq!(scene.hash, blake3::hash(&triangle_glb(0)).to_hex().to_string());
    let summary = &scene.summary;
    assert_eq!((summary.triangles_total, summary.instances, summary.meshes.len()), (1, 1, 1));
    assert_eq!(summary.cameras[0].name, "front");
    assert_eq!(summary.bounds.unwrap().max, [1.0, 1.0, 0.0]);
    let again = service.upload("model/gltf-binary", triangle_glb(0)).await;
    assert_eq!((again.status, again.json::<Scene>().id), (StatusCode::OK, scene.id.clone()));
    assert_eq!(service.get(&format!("/v1/scenes/{}", scene.id)).await.json::<Scene>(), scene);
    assert_eq!((service.blob_files(), service.staged_files()), (1, 0));
}

#[tokio::test]
async fn zips_and_parts_become_scenes() {
    let service = Service::start().await;
    let document = triangle_document(36, Some("data/mesh.bin")).to_string();
    let files: [(&str, &[u8]); 2] = [("model.gltf", document.as_bytes()), ("data/mesh.bin", &positions(1.0))];
    let zipped = service.upload("application/zip", zip(&files)).await;
    assert_eq!(zipped.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&zipped.body));
    let (content_type, body) = multipart(&files);
    let parts = service.upload(&content_type, body).await;
    assert_eq!(parts.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&parts.body));
    let (zipped, parts): (Scene, Scene) = (zipped.json(), parts.json());
    assert_eq!(parts.name, "model");
    assert_eq!(zipped.summary.meshes[0].hash, parts.summary.meshes[0].hash, "one mesh, however it came");
    let reversed: Vec<_> = files.into_iter().rev().collect();
    let (content_type, body) = multipart(&reversed);
    assert_eq!(service.upload(&content_type, body).await.json::<Scene>().id, parts.id, "the order does not matter");
    let worker = service.worker(&["cpu"]).await;
    service.job(json!({ "scene": parts.id })).await;
    let lease = service.lease(&worker).await.unwrap();
    let paths: Vec<_> = lease.scene.files.iter().map(|file| file.path.as_str()).collect();
    assert_eq!(paths, ["model.gltf", "data/mesh.bin"]);
    let (content_type, body) = multipart(&[("folder/tri.glb", &triangle_glb(0))]);
    let single: Scene = service.upload(&content_type, body).await.json();
    assert_eq!((single.name.as_str(), &single.hash), ("tri", &blake3::hash(&triangle_glb(0)).to_hex().to_string()));
}

#[tokio::test]
async fn the_client_uploads_files() {
    let service = Service::start().await;
    let client = service.listen().await;
    let (dir, path) = scratch_file("tri.glb");
    std::fs::write(&path, triangle_glb(0)).unwrap();
    let (scene, is_new) = client.upload_scene(Upload::file(&path).await.unwrap(), Some("Mine")).await.unwrap();
    assert!(is_new && scene.name == "Mine");
    std::fs::write(dir.path().join("mesh.bin"), positions(2.0)).unwrap();
    std::fs::write(dir.path().join("m.gltf"), triangle_document(36, Some("mesh.bin")).to_string()).unwrap();
    let part = |name: &str| ScenePart { path: name.to_owned(), file: dir.path().join(name) };
    let parts = || Upload::Files(vec![part("m.gltf"), part("mesh.bin")]);
    assert_eq!(client.validate_scene(parts()).await.unwrap().triangles_total, 1);
    let (second, _) = client.upload_scene(parts(), None).await.unwrap();
    let all = client.scenes(Some(1), None).await.unwrap();
    assert_eq!(all.items[0].id, second.id);
    let rest = client.scenes(Some(1), all.next_cursor.as_deref()).await.unwrap();
    assert_eq!((rest.items[0].id.as_str(), rest.next_cursor), (scene.id.as_str(), None));
    client.delete_scene(&scene.id).await.unwrap();
    assert_eq!(client.scene(&scene.id).await.unwrap_err().status(), Some(404));
}

#[tokio::test]
async fn validating_keeps_nothing() {
    let service = Service::start().await;
    let headers = [("content-type", "model/gltf-binary")];
    let path = "/v1/scenes?validate_only=true";
    let answer = service.request(http::Method::POST, path, &headers, triangle_glb(0).into()).await;
    assert_eq!((answer.status, answer.json::<SceneSummary>().triangles_total), (StatusCode::OK, 1));
    assert_eq!((service.blob_files(), service.staged_files()), (0, 0));
    assert!(service.get("/v1/scenes").await.json::<Page<Scene>>().items.is_empty());
    let long = format!("/v1/scenes?name={}", "x".repeat(201));
    let answer = service.request(http::Method::POST, &long, &headers, triangle_glb(0).into()).await;
    assert_eq!(answer.pointers(), ["query/name"]);
}

#[tokio::test]
async fn a_scene_in_use_is_not_deleted_and_its_files_go_with_it() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    let path = format!("/v1/scenes/{scene}");
    let in_use = service.delete(&path).await;
    assert_eq!((in_use.status, in_use.problem().code()), (StatusCode::CONFLICT, "in-use"));
    service.post(&format!("/v1/jobs/{job}/cancel"), json!(null)).await;
    assert_eq!(service.delete(&path).await.status, StatusCode::NO_CONTENT);
    assert_eq!(service.delete(&path).await.status, StatusCode::NOT_FOUND);
    assert_eq!(service.get(&path).await.status, StatusCode::NOT_FOUND);
    assert_eq!(service.blob_files(), 0);
    let retry = service.post(&format!("/v1/jobs/{job}/retry"), json!(null)).await;
    assert_eq!((retry.status, retry.problem().code()), (StatusCode::CONFLICT, "wrong-state"));
    assert_ne!(service.scene(0).await, scene, "uploaded again, it is a new scene");
}

#[tokio::test]
async fn a_new_scene_gets_a_thumbnail() {
    let service = Service::start_with(|config| config.thumbnails = true).await;
    let scene = service.scene(0).await;
    let path = format!("/v1/scenes/{scene}/thumbnail.png");
    assert_eq!(service.get(&path).await.status, StatusCode::NOT_FOUND);
    let jobs: Page<JobSummary> = service.get("/v1/jobs?label.lightshaft.thumbnail=true&automatic=true").await.json();
    assert_eq!((jobs.items.len(), jobs.items[0].priority), (1, -50));
    let worker = service.worker(&["cpu"]).await;
    let lease = service.lease(&worker).await.unwrap();
    let JobSettings::Render(settings) = &lease.settings else { panic!("a thumbnail is rendered") };
    assert_eq!((&lease.work, &settings.outputs), (&TaskWork::Frame, &vec![Output::Png]));
    assert_eq!(settings.environment, None, "the worker sees whether the scene has light of its own");
    service.complete(&lease, "image.png", "a thumbnail").await;
    assert_eq!(service.get(&path).await.body, b"a thumbnail");
    let read: Scene = service.get(&format!("/v1/scenes/{scene}")).await.json();
    assert_eq!(read.thumbnail, Some(path));
}

#[tokio::test]
async fn a_50_megabyte_upload_is_quick() {
    let service = Service::start().await;
    let client = service.listen().await;
    let vertices = 4_200_000u32;
    // Every three in a row make a triangle with an area.
    let vertex = |i: u32| [i as f32, if i % 3 == 1 { 1.0 } else { 0.0 }, 0.0];
    let binary: Vec<u8> = (0..vertices).flat_map(vertex).flat_map(f32::to_le_bytes).collect();
    let mut document = triangle_document(binary.len(), None);
    document["accessors"][0]["count"] = json!(vertices);
    document["accessors"][0]["max"] = json!([vertices - 1, 1, 0]);
    let bytes = glb(&document, &binary);
    let size = bytes.len();
    let started = Instant::now();
    let (scene, _) = client.upload_scene(glb_upload(bytes), None).await.unwrap();
    let elapsed = started.elapsed();
    println!("{} MB and {} triangles in {elapsed:?}", size / 1_000_000, scene.summary.triangles_total);
    // Wanted is 2 s on a machine that does nothing else; the rest is for one that runs many tests.
    assert!(elapsed < Duration::from_secs(6), "{elapsed:?}");
    assert!(size > 50_000_000 && scene.summary.triangles_total == u64::from(vertices / 3));
}

#[tokio::test]
async fn a_scene_of_too_many_meshes_is_refused_and_says_so() {
    let service = Service::start_with(|config| config.limits.scene_meshes = 0).await;
    let refused = service.upload("model/gltf-binary", crate::harness::triangle_glb(0)).await;
    assert_eq!((refused.status, refused.problem().code()), (http::StatusCode::UNPROCESSABLE_ENTITY, "invalid-scene"));
    assert_eq!(refused.pointers(), ["file/meshes"]);
    assert!(refused.problem().detail.contains("1 different meshes are more than the limit of 0"));
    assert_eq!((service.blob_files(), service.staged_files()), (0, 0));
}

#[tokio::test]
async fn what_further_cameras_see_is_rendered_after_the_thumbnail() {
    let service = Service::start_with(|config| config.thumbnails = true).await;
    let mut document = triangle_document(36, None);
    let cameras = document["cameras"].as_array_mut().unwrap();
    let camera = cameras[0].clone();
    cameras.resize(12, camera);
    document["nodes"] = (0..12).map(|camera| json!({ "camera": camera })).chain([json!({ "mesh": 0 })]).collect();
    document["scenes"][0]["nodes"] = (0..13).collect();
    let answer = service.upload("model/gltf-binary", glb(&document, &positions(1.0))).await;
    assert_eq!(answer.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&answer.body));
    let jobs: Page<JobSummary> = service.get("/v1/jobs?automatic=true").await.json();
    let label = |job: &JobSummary| job.labels.get(CAMERA_LABEL).cloned();
    let mut cameras: Vec<String> = jobs.items.iter().filter_map(label).collect();
    cameras.sort();
    assert_eq!(cameras, ["1", "2", "3", "4", "5", "6", "7"], "eight in all, of which the thumbnail shows the first");

    let worker = service.worker(&["cpu"]).await;
    let views = async || {
        let lease = service.lease(&worker).await.unwrap();
        service.complete(&lease, "image.png", "a picture").await;
        let JobSettings::Render(settings) = lease.settings else { panic!("pictures are rendered") };
        settings.camera
    };
    assert_eq!(views().await, None, "the thumbnail comes first");
    assert_eq!(views().await, Some(CameraChoice::Index(1)));
}

#[tokio::test]
async fn a_thumbnail_that_is_missing_is_made_up_for_once() {
    let service = Service::start_with(|config| config.thumbnails = true).await;
    let count = async || {
        let jobs: serde_json::Value = service.get("/v1/jobs?automatic=true").await.json();
        jobs["items"].as_array().unwrap().len()
    };
    let scene = service.scene(0).await;
    assert_eq!(count().await, 1);
    let job = service.app.store.thumbnail_job(&scene).await.unwrap().unwrap();
    service.app.create_missing_thumbnail_jobs().await.unwrap();
    assert_eq!(count().await, 1, "it has one");
    service.post(&format!("/v1/jobs/{job}/cancel"), serde_json::json!(null)).await;
    service.delete(&format!("/v1/jobs/{job}")).await;
    service.app.create_missing_thumbnail_jobs().await.unwrap();
    assert_eq!(count().await, 0, "somebody did not want it");
}
