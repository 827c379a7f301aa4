//! `/v1/blobs`, and files in general: ETags and ranges.

use axum::body::Body;
use http::{Method, StatusCode};
use serde_json::{Value, json};

use crate::harness::{Service, scratch_file};

#[tokio::test]
async fn a_blob_is_stored_under_its_hash_only() {
    let service = Service::start().await;
    let hash = blake3::hash(b"content").to_hex().to_string();
    let path = format!("/v1/blobs/{hash}");
    for _ in 0..2 {
        let put = service.request(Method::PUT, &path, &[], Body::from("content")).await;
        assert_eq!((put.status, put.json::<Value>()), (StatusCode::OK, json!({ "hash": hash, "bytes": 7 })));
    }
    let wrong = service.request(Method::PUT, &path, &[], Body::from("other")).await;
    assert_eq!((wrong.status, wrong.problem().code()), (StatusCode::UNPROCESSABLE_ENTITY, "hash-mismatch"));
    let no_hash = service.request(Method::PUT, "/v1/blobs/xyz", &[], Body::from("other")).await;
    assert_eq!(no_hash.pointers(), ["path/hash"]);
    assert_eq!((service.blob_files(), service.staged_files()), (1, 0));
    assert_eq!(service.get(&path).await.body, b"content");
    let unknown = service.get(&format!("/v1/blobs/{}", "0".repeat(64))).await;
    assert_eq!((unknown.status, unknown.problem().code()), (StatusCode::NOT_FOUND, "not-found"));
}

#[tokio::test]
async fn blobs_answer_conditions_and_ranges() {
    let service = Service::start().await;
    let hash = service.store_blob("0123456789").await;
    let path = format!("/v1/blobs/{hash}");
    let etag = format!("\"{hash}\"");
    let whole = service.get(&path).await;
    assert_eq!((whole.header("etag"), whole.header("accept-ranges")), (etag.as_str(), "bytes"));
    assert!(whole.header("cache-control").contains("immutable"));
    assert_eq!(whole.header("x-content-type-options"), "nosniff");
    let head = service.request(Method::HEAD, &path, &[], Body::empty()).await;
    assert_eq!((head.status, head.header("content-length"), head.body.len()), (StatusCode::OK, "10", 0));
    let unchanged = service.get_with(&path, &[("if-none-match", &format!("\"x\", W/{etag}"))]).await;
    assert_eq!((unchanged.status, unchanged.body.len()), (StatusCode::NOT_MODIFIED, 0));
    let part = service.get_with(&path, &[("range", "bytes=2-4")]).await;
    assert_eq!((part.status, part.body.as_slice()), (StatusCode::PARTIAL_CONTENT, b"234".as_slice()));
    assert_eq!((part.header("content-range"), part.header("content-length")), ("bytes 2-4/10", "3"));
    let outside = service.get_with(&path, &[("range", "bytes=10-")]).await;
    assert_eq!((outside.status, outside.header("content-range")), (StatusCode::RANGE_NOT_SATISFIABLE, "bytes */10"));
    assert_eq!(outside.problem().code(), "range-not-satisfiable");
    let other = service.get_with(&path, &[("range", "bytes=2-4"), ("if-range", "\"old\"")]).await;
    assert_eq!((other.status, other.body.len()), (StatusCode::OK, 10));
}

#[tokio::test]
async fn missing_blobs_are_told() {
    let service = Service::start().await;
    let here = service.store_blob("here").await;
    let gone = "0".repeat(64);
    let answer = service.post("/v1/blobs:missing", json!({ "hashes": [here, gone] })).await;
    assert_eq!(answer.json::<Value>(), json!({ "missing": [gone] }));
    let wrong = service.post("/v1/blobs:missing", json!({ "hashes": [here, "x"] })).await;
    assert_eq!(wrong.pointers(), ["/hashes/1"]);
}

#[tokio::test]
async fn blobs_have_a_budget() {
    let service = Service::start_with(|config| config.limits.blob_bytes = 10).await;
    let announced = [("content-length", "11")];
    for headers in [&announced[..], &[]] {
        let answer = service.request(Method::POST, "/v1/blobs", headers, Body::from("12345678901")).await;
        assert_eq!((answer.status, answer.problem().code()), (StatusCode::PAYLOAD_TOO_LARGE, "too-large"));
    }
    assert_eq!((service.blob_files(), service.staged_files()), (0, 0));
}

#[tokio::test]
async fn unused_blobs_are_swept_and_used_ones_kept() {
    let service = Service::start().await;
    service.scene(0).await;
    service.store_blob("unused").await;
    assert_eq!(service.blob_files(), 2);
    let long_ago = jiff::Timestamp::now() - jiff::SignedDuration::from_hours(1);
    assert_eq!(service.app.sweep_blobs(long_ago).await.unwrap(), 0);
    let soon = jiff::Timestamp::now() + jiff::SignedDuration::from_hours(1);
    assert_eq!(service.app.sweep_blobs(soon).await.unwrap(), 1);
    assert_eq!(service.blob_files(), 1);
}

#[tokio::test]
async fn the_client_streams_files_both_ways() {
    let service = Service::start().await;
    let client = service.listen().await;
    let (_dir, path) = scratch_file("big.bin");
    let content: Vec<u8> = (0..3_000_000u32).map(|i| (i * 7) as u8).collect();
    std::fs::write(&path, &content).unwrap();
    let stored = client.store_blob_file(&path).await.unwrap();
    assert_eq!(stored.bytes, content.len() as u64);
    assert!(client.missing_blobs(vec![stored.hash.clone()]).await.unwrap().is_empty());
    let copy = path.with_extension("copy");
    assert_eq!(client.download_blob(&stored.hash, &copy).await.unwrap(), stored.bytes);
    assert!(std::fs::read(&copy).unwrap() == content);
    let error = client.put_blob(&"0".repeat(64), content).await.unwrap_err();
    assert_eq!(error.problem().unwrap().code(), "hash-mismatch");
}

#[tokio::test]
async fn structures_of_many_meshes_are_found_by_one_call() {
    let service = Service::start().await;
    let mut meshes = Vec::new();
    for number in 0..3 {
        let scene = service.scene(number).await;
        let scene: Value = service.get(&format!("/v1/scenes/{scene}")).await.json();
        meshes.push(scene["meshes"][0]["hash"].as_str().unwrap().to_owned());
    }
    let blob = service.store_blob("structure").await;
    let kind = json!({ "kind": "bvh", "parameters": "p", "builder_version": 3 });
    let mut structure = kind.clone();
    structure
        .as_object_mut()
        .unwrap()
        .extend(json!({ "bytes": 9, "build_s": 0.1, "blob": blob }).as_object().unwrap().clone());
    for mesh in &meshes[..2] {
        let added = service.post(&format!("/v1/meshes/{mesh}/structures"), structure.clone()).await;
        assert_eq!(added.status, StatusCode::OK);
    }
    let find = async |meshes: Value| {
        let mut wanted = kind.clone();
        wanted["meshes"] = meshes;
        service.post("/v1/meshes:structures", wanted).await
    };
    let found = find(json!(meshes)).await;
    assert_eq!(found.json::<Value>()["blobs"], json!({ &meshes[0]: blob, &meshes[1]: blob }));
    assert_eq!(find(json!(["x"])).await.pointers(), ["/meshes/0"]);
    assert_eq!(find(json!(vec!["x"; 4097])).await.pointers(), ["/meshes"]);
}
