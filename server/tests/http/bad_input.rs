//! Uploads that are wrong in every way we know: a problem that says where, nothing left behind, and the next good
//! request works.

use axum::body::Body;
use bytes::Bytes;
use http::StatusCode;
use serde_json::{Value, json};

use crate::harness::{Answer, Service, glb, multipart, positions, triangle_document, triangle_glb};

/// Nothing of the upload is left, and the service still takes a good one.
async fn assert_unharmed(service: &Service, answer: &Answer, name: &str) {
    assert!(answer.status.is_client_error(), "{name}: {} {}", answer.status, String::from_utf8_lossy(&answer.body));
    let problem = answer.problem();
    assert!(!problem.detail.is_empty(), "{name}");
    assert_eq!((service.blob_files(), service.staged_files()), (0, 0), "{name}");
}

fn changed(change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let mut document = triangle_document(36, None);
    change(&mut document);
    glb(&document, &positions(1.0))
}

#[tokio::test]
async fn broken_scenes_are_refused_with_their_place() {
    let service = Service::start().await;
    let good = triangle_glb(0);
    let with_length = |length: u32| {
        let mut bytes = good.clone();
        bytes[8..12].copy_from_slice(&length.to_le_bytes());
        bytes
    };
    let nan = {
        let mut bytes = positions(1.0);
        bytes[0..4].copy_from_slice(&f32::NAN.to_le_bytes());
        glb(&triangle_document(36, None), &bytes)
    };
    let cases: Vec<(&str, Vec<u8>)> = vec![
        ("empty", Vec::new()),
        ("truncated header", good[..10].to_vec()),
        ("truncated json", good[..40].to_vec()),
        ("truncated binary", good[..good.len() - 8].to_vec()),
        ("lying about its length", with_length(u32::MAX)),
        ("shorter than it is", with_length(20)),
        ("version 1", changed(|document| document["asset"]["version"] = json!("1.0"))),
        ("unknown required extension", changed(|document| document["extensionsRequired"] = json!(["EXT_magic"]))),
        ("a huge count", changed(|document| document["accessors"][0]["count"] = json!(4_000_000_000u64))),
        ("an index out of range", changed(|document| document["nodes"][0]["mesh"] = json!(7))),
        ("a cycle of nodes", changed(|document| document["nodes"][0]["children"] = json!([0]))),
        ("a missing buffer", changed(|document| document["buffers"][0]["uri"] = json!("none.bin"))),
        ("a buffer outside", changed(|document| document["buffers"][0]["uri"] = json!("../../etc/passwd"))),
        ("not a number", nan),
    ];
    for (name, bytes) in cases {
        let answer = service.upload("model/gltf-binary", bytes).await;
        assert_unharmed(&service, &answer, name).await;
        assert_eq!(answer.problem().code(), "invalid-scene", "{name}");
        assert!(answer.pointers()[0].starts_with("file"), "{name}: {:?}", answer.pointers());
    }
    service.scene(0).await;
}

#[tokio::test]
async fn wrong_content_types_are_refused_with_those_accepted() {
    let service = Service::start().await;
    for content_type in ["text/plain", "application/octet-stream", "image/png", ""] {
        let answer = service.upload(content_type, triangle_glb(0)).await;
        assert_unharmed(&service, &answer, content_type).await;
        assert_eq!(answer.status, StatusCode::UNSUPPORTED_MEDIA_TYPE);
        assert!(answer.problem().detail.contains("model/gltf-binary"), "{}", answer.problem().detail);
    }
    let lie = service.upload("application/zip", triangle_glb(0)).await;
    assert_eq!(lie.status, StatusCode::UNSUPPORTED_MEDIA_TYPE);
    assert!(lie.problem().detail.contains("but the content is model/gltf-binary"));
}

#[tokio::test]
async fn broken_multipart_bodies_are_refused() {
    let service = Service::start().await;
    let document = triangle_document(36, Some("mesh.bin")).to_string();
    let bin = positions(1.0);
    let (content_type, good) = multipart(&[("m.gltf", document.as_bytes()), ("mesh.bin", &bin)]);
    let cases = [
        ("no boundary", "multipart/form-data".to_owned(), good.clone()),
        ("cut", content_type.clone(), good[..good.len() - 20].to_vec()),
        ("no end", content_type.clone(), good[..good.len() - 11].to_vec()),
        ("no files", content_type.clone(), b"--limit--\r\n".to_vec()),
        ("a missing file", content_type.clone(), multipart(&[("m.gltf", document.as_bytes()), ("x.bin", &bin)]).1),
        (
            "a path upwards",
            content_type.clone(),
            multipart(&[("m.gltf", document.as_bytes()), ("../mesh.bin", &bin)]).1,
        ),
        ("two of a name", content_type.clone(), {
            multipart(&[("m.gltf", document.as_bytes()), ("mesh.bin", &bin), ("mesh.bin", &bin)]).1
        }),
        ("no glTF", content_type.clone(), multipart(&[("a.bin", &bin), ("b.bin", &bin)]).1),
    ];
    for (name, content_type, body) in cases {
        let answer = service.upload(&content_type, body).await;
        assert_unharmed(&service, &answer, name).await;
    }
    assert_eq!(service.upload(&content_type, good).await.status, StatusCode::CREATED);
}

#[tokio::test]
async fn broken_zips_are_refused() {
    let service = Service::start().await;
    for (name, bytes) in
        [("only the magic", b"PK\x03\x04".to_vec()), ("garbage", [b"PK\x03\x04".as_slice(), &[7; 500]].concat())]
    {
        let answer = service.upload("application/zip", bytes).await;
        assert_unharmed(&service, &answer, name).await;
        assert_eq!(answer.problem().code(), "invalid-scene", "{name}");
    }
}

#[tokio::test]
async fn scenes_have_budgets() {
    let service = Service::start_with(|config| {
        config.limits.scene_bytes = 5000;
        config.limits.scene_files = 2;
        config.limits.import.triangles = 0;
    })
    .await;
    let large = service.upload("model/gltf-binary", vec![b'x'; 5001]).await;
    assert_eq!((large.status, large.problem().code()), (StatusCode::PAYLOAD_TOO_LARGE, "too-large"));
    let part = vec![b'x'; 3000];
    let (content_type, body) = multipart(&[("a", &part), ("b", &part)]);
    let large = service.upload(&content_type, Body::from_stream(pieces(body))).await;
    assert_eq!(large.status, StatusCode::PAYLOAD_TOO_LARGE);
    let (content_type, body) = multipart(&[("a", b"1"), ("b", b"2"), ("c", b"3")]);
    assert_eq!(service.upload(&content_type, body).await.status, StatusCode::PAYLOAD_TOO_LARGE);
    let triangles = service.upload("model/gltf-binary", triangle_glb(0)).await;
    assert_unharmed(&service, &triangles, "too many triangles").await;
    assert_eq!(triangles.problem().code(), "invalid-scene");
}

fn pieces(body: Vec<u8>) -> impl futures::Stream<Item = std::io::Result<Bytes>> {
    futures::stream::iter(body.chunks(100).map(|piece| Ok(Bytes::copy_from_slice(piece))).collect::<Vec<_>>())
}

#[tokio::test]
async fn an_upload_that_stops_half_way_leaves_nothing() {
    let service = Service::start().await;
    let half = Bytes::from(triangle_glb(0)).slice(..60);
    let cut = futures::stream::iter([Ok(half), Err(std::io::Error::other("cut"))]);
    let answer = service.upload("model/gltf-binary", Body::from_stream(cut)).await;
    assert_unharmed(&service, &answer, "cut").await;
    assert_eq!(answer.problem().code(), "incomplete-body");
    service.scene(0).await;
}

#[tokio::test]
async fn twenty_uploads_at_once_all_come_through() {
    let service = Service::start().await;
    let client = service.listen().await;
    let uploads = (0..20).map(|i| {
        let client = client.clone();
        // Each scene twice: whoever comes second gets the same one.
        async move { client.upload_scene(crate::harness::glb_upload(triangle_glb(i / 2)), None).await }
    });
    let mut scenes = Vec::new();
    for result in futures::future::join_all(uploads).await {
        scenes.push(result.unwrap().0.id);
    }
    scenes.sort();
    scenes.dedup();
    assert_eq!((scenes.len(), service.blob_files(), service.staged_files()), (10, 10, 0));
}
