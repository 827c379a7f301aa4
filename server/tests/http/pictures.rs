//! Layers of pictures, and `/v1/compare`.

use axum::body::Body;
use http::{Method, StatusCode};
use lightshaft_api::compare::{Compared, PictureLayerKind, PictureLayers, PixelValues};
use lightshaft_api::lease::{Complete, NewArtifact};
use lightshaft_engine::device::Region;
use lightshaft_engine::film::{AovBuffers, AovLayer, encode_exr};
use lightshaft_engine::settings::Aov;
use serde_json::{Value, json};

use crate::harness::{Answer, Service};

const WIDTH: u32 = 24;
const HEIGHT: u32 = 20;

/// A ramp of the brightness `scale`, with depth and ids of which the first pixel has none.
fn exr(scale: f32) -> Vec<u8> {
    let count = (WIDTH * HEIGHT) as usize;
    let radiance: Vec<[f32; 3]> = (0..count).map(|i| [scale * i as f32 / count as f32, 0.25, 0.5]).collect();
    let region = Region { x: 0, y: 0, width: WIDTH, height: HEIGHT };
    let mut aovs = AovBuffers::new(region, &[Aov::Depth, Aov::InstanceId]);
    for (_, layer) in &mut aovs.layers {
        match layer {
            AovLayer::Scalar(values) => values[1..].fill(2.0 * scale),
            AovLayer::Integer(values) => values[1..].fill(7),
            AovLayer::Vector(_) => {}
        }
    }
    encode_exr(WIDTH, HEIGHT, &radiance, Some(&aovs), &[]).unwrap()
}

fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(width, height, image::Rgb([200, 100, 50]))
        .write_to(&mut bytes, image::ImageFormat::Png)
        .unwrap();
    bytes.into_inner()
}

async fn put(service: &Service, bytes: Vec<u8>) -> String {
    let answer = service.request(Method::POST, "/v1/blobs", &[], Body::from(bytes)).await;
    assert_eq!(answer.status, StatusCode::CREATED);
    answer.json::<Value>()["hash"].as_str().unwrap().to_owned()
}

/// A finished job with these files.
async fn job_with(service: &Service, files: &[(&str, Vec<u8>)]) -> String {
    let scene = service.scene(0).await;
    let job = service.job(json!({ "scene": scene })).await.summary.id;
    let worker = service.worker(&["cpu"]).await;
    let lease = service.lease(&worker).await.unwrap();
    let mut artifacts = Vec::new();
    for (name, bytes) in files {
        let blob = put(service, bytes.clone()).await;
        let media_type = if name.ends_with("exr") { "image/x-exr" } else { "image/png" }.to_owned();
        artifacts.push(NewArtifact { name: (*name).to_owned(), media_type, bytes: bytes.len() as u64, blob });
    }
    let report = Complete { artifacts, metrics: Default::default() };
    let answer = service.report(&lease, "complete", serde_json::to_value(report).unwrap()).await;
    assert!(answer.status.is_success(), "{}", String::from_utf8_lossy(&answer.body));
    job
}

/// A body with these parts, some of them files.
async fn upload(service: &Service, parts: &[(&str, &[u8])]) -> Answer {
    let mut body = Vec::new();
    for (name, content) in parts {
        body.extend(format!("--x\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n").bytes());
        body.extend(*content);
        body.extend(b"\r\n");
    }
    body.extend(b"--x--\r\n");
    let headers = [("content-type", "multipart/form-data; boundary=x")];
    service.request(Method::POST, "/v1/compare", &headers, Body::from(body)).await
}

#[tokio::test]
async fn a_jobs_picture_tells_its_layers_their_pixels_and_one_pixel() {
    let service = Service::start().await;
    let job = job_with(&service, &[("image.exr", exr(1.0))]).await;
    let base = format!("/v1/jobs/{job}/artifacts/image.exr");
    let found: PictureLayers = service.get(&format!("{base}/layers")).await.json();
    assert_eq!((found.width, found.height, found.display_referred), (WIDTH, HEIGHT, false));
    let names: Vec<_> = found.layers.iter().map(|layer| (layer.name.as_str(), layer.kind)).collect();
    use PictureLayerKind::{Color, Integer, Scalar};
    assert_eq!(names, [("color", Color), ("depth", Scalar), ("instance_id", Integer)]);
    let depth = &found.layers[1];
    assert_eq!((depth.minimum, depth.maximum, depth.non_finite), (Some(2.0), Some(2.0), 1));
    assert_eq!(depth.href, format!("{base}/layers/depth"));

    let half = service.get(&format!("{base}/layers/color?format=f16")).await;
    let header = |name: &str| half.header(name).to_owned();
    let described = ["picture-width", "picture-height", "picture-channels", "picture-format"].map(header);
    assert_eq!(described, ["24", "20", "3", "f16"]);
    assert_eq!(half.body.len(), 24 * 20 * 3 * 2);
    assert_eq!(half.body[2..6], [0x00, 0x34, 0x00, 0x38], "0.25 and 0.5");
    let ids = service.get(&format!("{base}/layers/instance_id")).await;
    assert_eq!((ids.header("picture-format"), &ids.body[..8]), ("u32", [255, 255, 255, 255, 7, 0, 0, 0].as_slice()));
    let again =
        service.get_with(&depth.href, &[("if-none-match", service.get(&depth.href).await.header("etag"))]).await;
    assert_eq!((again.status, again.body.len()), (StatusCode::NOT_MODIFIED, 0));

    let pixel: PixelValues = service.get(&format!("{base}/pixel?x=0&y=0")).await.json();
    let values: Vec<_> = pixel.layers.into_iter().map(|layer| layer.values).collect();
    assert_eq!(values, [vec![Some(0.0), Some(0.25), Some(0.5)], vec![None], vec![None]]);

    let wrong = service.get(&format!("{base}/pixel?x=24&y=0")).await;
    assert_eq!((wrong.status, wrong.pointers()), (StatusCode::BAD_REQUEST, vec!["query/x".to_owned()]));
    assert_eq!(service.get(&format!("{base}/layers/gamma")).await.status, StatusCode::NOT_FOUND);
    assert_eq!(service.get(&format!("{base}/layers/depth?format=u32")).await.pointers(), ["query/format"]);
    assert_eq!(service.get(&format!("/v1/jobs/{job}/artifacts/none.exr/layers")).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn what_is_no_picture_has_no_layers() {
    let service = Service::start().await;
    let hash = put(&service, b"no picture".to_vec()).await;
    let answer = service.get(&format!("/v1/blobs/{hash}/layers")).await;
    assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY);
    assert!(answer.problem().detail.contains("expected PNG"), "{}", answer.problem().detail);
    let display: PictureLayers =
        service.get(&format!("/v1/blobs/{}/layers", put(&service, png(3, 2)).await)).await.json();
    assert_eq!((display.width, display.display_referred, display.layers.len()), (3, true, 1));
}

#[tokio::test]
async fn jobs_are_compared_with_limits_and_pictures_that_have_addresses_of_their_own() {
    let service = Service::start().await;
    let (a, b) = (job_with(&service, &[("image.exr", exr(1.0)), ("image.png", png(24, 20))]).await, exr(1.5));
    let blob = put(&service, b.clone()).await;
    let wanted = json!({ "a": { "job": a }, "b": { "blob": blob }, "max_rmse": 0.01, "max_flip": 1.0 });
    let answer = service.post("/v1/compare", wanted).await;
    assert_eq!(answer.status, StatusCode::OK, "{}", String::from_utf8_lossy(&answer.body));
    let value: Value = answer.json();
    let found: Compared = answer.json();
    assert_eq!(
        (found.a.hash.as_str(), found.b.hash.as_str()),
        (blake3::hash(&exr(1.0)).to_hex().as_str(), blob.as_str())
    );
    assert!(value["rmse"].as_f64().unwrap() > 0.1, "the figures lie beside the pictures: {value}");
    assert_eq!((found.report.pixels, found.report.differing_pixels), (480, 479));
    assert!(!found.report.passed && found.report.over_limits.len() == 1, "{:?}", found.report.over_limits);

    for (address, media_type) in [(&found.heat_map, "image/png"), (&found.difference, "image/png")] {
        let picture = service.get(address).await;
        assert_eq!((picture.status, picture.header("content-type")), (StatusCode::OK, media_type));
        assert!(picture.header("cache-control").contains("immutable"));
        let again = service.get_with(address, &[("if-none-match", picture.header("etag"))]).await;
        assert_eq!(again.status, StatusCode::NOT_MODIFIED);
    }
    let decoded = |answer: Answer| image::load_from_memory(&answer.body).unwrap().into_rgb8();
    let difference = decoded(service.get(&found.difference).await);
    assert_eq!(difference.dimensions(), (WIDTH, HEIGHT));
    let bare = service.get(&format!("{}&scale=false", found.heat_map)).await;
    assert_ne!(bare.header("etag"), service.get(&found.heat_map).await.header("etag"));
    let (map, bare) = (decoded(service.get(&found.heat_map).await), decoded(bare));
    assert_eq!(bare.dimensions(), (WIDTH, HEIGHT));
    assert!(map.width() > WIDTH && map.height() > HEIGHT, "a scale bar stands beside it");
    let corner = image::imageops::crop_imm(&map, 0, 0, WIDTH, HEIGHT).to_image();
    assert_eq!(corner, bare, "the map itself is found in the corner");
    // Another service that has the same files answers the same addresses with the same bytes.
    let other = Service::start().await;
    put(&other, exr(1.0)).await;
    put(&other, b).await;
    assert_eq!(other.get(&found.heat_map).await.body, service.get(&found.heat_map).await.body);

    let depth =
        json!({ "a": { "job": a, "layer": "depth" }, "b": { "blob": blob, "layer": "depth" }, "tolerance": 0.5 });
    let depth: Compared = service.post("/v1/compare", depth).await.json();
    assert_eq!(
        (depth.report.max_difference, depth.report.differing_pixels, depth.report.non_finite_pixels),
        (1.0, 479, 1)
    );
    assert!(depth.heat_map.contains("a_layer=depth") && depth.report.passed);
    assert_eq!(service.get(&depth.heat_map).await.status, StatusCode::OK);
}

#[tokio::test]
async fn hdr_flip_sees_what_a_display_clips() {
    let service = Service::start().await;
    let lit = |brightness: f32| {
        let mut pixels = vec![[0.2; 3]; (WIDTH * HEIGHT) as usize];
        pixels[100..140].fill([brightness; 3]);
        encode_exr(WIDTH, HEIGHT, &pixels, None, &[]).unwrap()
    };
    let (a, b) = (put(&service, lit(20.0)).await, put(&service, lit(60.0)).await);
    let request = |more: Value| {
        let mut body = json!({ "a": { "blob": a }, "b": { "blob": b } });
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        service.post("/v1/compare", body)
    };
    let plain: Compared = request(json!({ "max_flip": 0.0 })).await.json();
    assert!(plain.report.passed && plain.report.hdr_flip.is_none(), "{:?}", plain.report);
    let hdr: Compared = request(json!({ "hdr": true })).await.json();
    let found = hdr.report.hdr_flip.unwrap();
    assert!(found.mean > 0.01 && found.p99 > 0.1 && found.exposures >= 7, "{found:?}");
    assert!(hdr.heat_map.ends_with("&hdr=true") && !hdr.difference.contains("hdr"), "{}", hdr.heat_map);
    let (hdr_map, map) = (service.get(&hdr.heat_map).await, service.get(&plain.heat_map).await);
    assert!(
        hdr_map.status == StatusCode::OK && hdr_map.body != map.body && hdr_map.header("etag") != map.header("etag")
    );
    let limited: Compared = request(json!({ "max_hdr_flip": 0.005 })).await.json();
    assert!(!limited.report.passed && limited.report.over_limits[0].starts_with("mean HDR-FLIP"));

    assert_eq!(request(json!({ "max_hdr_flip": -1 })).await.pointers(), ["/max_hdr_flip"]);
    let shown = put(&service, png(WIDTH, HEIGHT)).await;
    let answer = request(json!({ "b": { "blob": shown }, "hdr": true })).await;
    assert_eq!((answer.status, answer.pointers()), (StatusCode::UNPROCESSABLE_ENTITY, vec!["/hdr".to_owned()]));
    let address = format!("/v1/compare/{a}/{shown}/heat-map.png?hdr=true");
    assert_eq!(service.get(&address).await.pointers(), ["query/hdr"]);
}

#[tokio::test]
async fn uploads_are_compared_with_each_other_and_with_what_is_here() {
    let service = Service::start().await;
    let both = upload(&service, &[("a", &exr(1.0)), ("b", &exr(1.0))]).await;
    assert_eq!(both.status, StatusCode::OK, "{}", String::from_utf8_lossy(&both.body));
    let both: Compared = both.json();
    assert_eq!((both.report.rmse, both.report.flip_mean, both.report.passed), (0.0, 0.0, true));
    assert_eq!(service.get(&both.heat_map).await.status, StatusCode::OK, "uploads stay for the pictures");

    let request = json!({ "a": { "blob": both.a.hash }, "b": { "layer": "instance_id" } });
    let mixed = upload(&service, &[("request", request.to_string().as_bytes()), ("b", &exr(2.0))]).await;
    let mixed: Compared = mixed.json();
    assert_eq!(mixed.b.layer, "instance_id");
    assert_eq!(service.staged_files(), 0);
}

#[tokio::test]
async fn wrong_comparisons_name_every_field() {
    let service = Service::start().await;
    let job = job_with(&service, &[("image.png", png(24, 20))]).await;
    let (picture, text) = (put(&service, exr(1.0)).await, put(&service, b"text".to_vec()).await);
    let missing = "0".repeat(64);
    let cases = [
        (json!({}), vec!["/a", "/b"]),
        (
            json!({ "a": { "job": "nope" }, "b": { "job": job, "artifact": "image.exr" } }),
            vec!["/a/job", "/b/artifact"],
        ),
        (json!({ "a": { "blob": "xyz" }, "b": { "blob": missing } }), vec!["/a/blob", "/b/blob"]),
        (json!({ "a": { "blob": picture, "job": job }, "b": { "blob": picture } }), vec!["/a/blob"]),
        (json!({ "a": { "blob": picture }, "b": { "blob": text } }), vec!["/b"]),
        (json!({ "a": { "blob": picture, "layer": "gamma" }, "b": { "blob": picture } }), vec!["/a/layer"]),
        (json!({ "a": { "blob": picture }, "b": { "blob": put(&service, png(8, 8)).await } }), vec!["/b"]),
        (
            json!({ "a": { "blob": picture }, "b": { "blob": picture }, "exposure": 99, "tolerance": -1, "max_rmse": -0.5 }),
            vec!["/exposure", "/tolerance", "/max_rmse"],
        ),
        (json!({ "a": { "blob": picture }, "b": { "blob": picture }, "max_rsme": 1 }), vec!["/max_rsme"]),
    ];
    for (body, pointers) in cases {
        let answer = service.post("/v1/compare", body.clone()).await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{body}");
        assert_eq!(answer.pointers(), pointers, "{body}");
    }
    let size = service
        .post("/v1/compare", json!({ "a": { "blob": picture }, "b": { "blob": put(&service, png(8, 8)).await } }));
    assert!(size.await.problem().detail.ends_with("has 8 x 8 pixels, but the reference has 24 x 20"));
    for address in [
        format!("/v1/compare/{picture}/nope/heat-map.png"),
        format!("/v1/compare/{picture}/{picture}/heat-map.png?exposure=NaN"),
        format!("/v1/compare/{picture}/{picture}/difference.png?gain=0"),
    ] {
        assert_eq!(service.get(&address).await.status, StatusCode::BAD_REQUEST, "{address}");
    }
    assert_eq!(
        service.get(&format!("/v1/compare/{picture}/{missing}/heat-map.png")).await.status,
        StatusCode::NOT_FOUND
    );
}

#[tokio::test]
async fn uploads_have_budgets() {
    let service = Service::start_with(|config| {
        config.limits.picture_bytes = 500_000;
        config.limits.compare_pixels = 1 << 20;
    })
    .await;
    // Small as a file, 25 million pixels when decoded.
    let mut bomb = std::io::Cursor::new(Vec::new());
    image::GrayImage::new(5000, 5000).write_to(&mut bomb, image::ImageFormat::Png).unwrap();
    let bomb = bomb.into_inner();
    assert!(bomb.len() < 500_000);
    let answer = upload(&service, &[("a", &bomb), ("b", &bomb)]).await;
    assert_eq!((answer.status, answer.pointers()), (StatusCode::UNPROCESSABLE_ENTITY, vec!["/a".to_owned()]));
    assert!(answer.problem().detail.contains("5000 x 5000 pixels"), "{}", answer.problem().detail);

    let large = vec![0; 500_001];
    let answer = upload(&service, &[("a", &large), ("b", &png(4, 4))]).await;
    assert_eq!(answer.status, StatusCode::PAYLOAD_TOO_LARGE);
    let answer = upload(&service, &[("a", &png(4, 4)), ("c", &png(4, 4))]).await;
    assert_eq!(answer.status, StatusCode::BAD_REQUEST);
    assert_eq!(service.staged_files(), 0);
    let torn = service
        .request(
            Method::POST,
            "/v1/compare",
            &[("content-type", "multipart/form-data; boundary=x")],
            Body::from("--x\r\nnonsense"),
        )
        .await;
    assert_eq!(torn.status, StatusCode::BAD_REQUEST);
}
