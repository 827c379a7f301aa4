//! Uploads that must be refused: with a problem document that says where, without a trace left behind, and without
//! harm to the next good one.

use std::collections::BTreeSet;
use std::io::{Cursor, Write};
use std::path::Path;

use lightshaft_tests::glb::{self, Gltf};
use lightshaft_tests::{Reply, Service};
use reqwest::multipart::{Form, Part};
use serde_json::json;
use tokio::io::AsyncWriteExt;

const GLB: &str = "model/gltf-binary";
const ZIP: &str = "application/zip";

#[tokio::test]
async fn broken_files_are_refused_with_the_place_and_leave_nothing() {
    let service = Service::start_with(&["--no-thumbnails"]);
    service.scene(Gltf::triangle().glb()).await;
    let before = files(&service.data());

    let mut wrong = Vec::new();
    for case in broken_files() {
        let reply = service.upload(case.media_type, case.bytes).await;
        wrong.extend(not_refused(case.name, &reply, case.status, case.mentions));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));

    assert_eq!(files(&service.data()), before, "refused uploads leave no file behind");
    assert_works(&service, 1).await;
}

#[tokio::test]
async fn multipart_uploads_name_the_file_that_is_missing_or_wrong() {
    let service = Service::start();
    let good = Gltf::triangle();
    let part = |bytes: &[u8], name: &str| Part::bytes(bytes.to_vec()).file_name(name.to_owned());
    let cases = [
        ("no buffer", Form::new().part("file", part(&good.gltf("mesh.bin"), "scene.gltf")), "mesh.bin"),
        (
            "a short buffer",
            Form::new()
                .part("file", part(&good.gltf("mesh.bin"), "scene.gltf"))
                .part("file", part(&good.buffer[..20], "mesh.bin")),
            "buffers/0",
        ),
        ("no glTF", Form::new().part("file", part(&good.buffer, "mesh.bin")), "gltf"),
    ];
    for (name, form, mentions) in cases {
        let request = service.request(reqwest::Method::POST, "/v1/scenes").multipart(form);
        assert_eq!(not_refused(name, &service.send(request).await, 422, mentions), None);
    }
    assert_works(&service, 0).await;
}

#[tokio::test]
async fn a_body_that_stops_halfway_is_forgotten() {
    let service = Service::start_with(&["--no-thumbnails"]);
    let before = files(&service.data());
    let address = service.url().trim_start_matches("http://");
    for head in ["content-length: 1000000", "transfer-encoding: chunked"] {
        let mut socket = tokio::net::TcpStream::connect(address).await.unwrap();
        let request = format!("POST /v1/scenes HTTP/1.1\r\nhost: x\r\ncontent-type: {GLB}\r\n{head}\r\n\r\n");
        socket.write_all(request.as_bytes()).await.unwrap();
        let body: &[u8] = if head.ends_with("chunked") { b"10\r\nglTF........" } else { b"glTF................" };
        socket.write_all(body).await.unwrap();
        socket.flush().await.unwrap();
        service.until("what came to be staged", async || (files(&service.data()) != before).then_some(())).await;
        drop(socket);
        service.until("the partial file to go", async || (files(&service.data()) == before).then_some(())).await;
    }
    assert_works(&service, 0).await;
}

#[tokio::test]
async fn twenty_uploads_at_once_make_one_scene_per_content() {
    let service = Service::start();
    let uploads = (0..20).map(|i| {
        // Five contents, four times each.
        let glb = Gltf::triangle().with("/nodes/0", json!({"mesh": 0, "name": format!("content {}", i % 5)})).glb();
        service.upload(GLB, glb)
    });
    let replies = futures::future::join_all(uploads).await;
    assert!(replies.iter().all(|reply| matches!(reply.status, 200 | 201)), "{replies:?}");
    let ids: BTreeSet<String> = replies.iter().map(|reply| reply.json()["id"].to_string()).collect();
    assert_eq!(ids.len(), 5);
    assert_eq!(replies.iter().filter(|reply| reply.status == 201).count(), 5, "each is new once");
    let list = service.get("/v1/scenes").await.json();
    assert_eq!(list["items"].as_array().unwrap().len(), 5);
}

struct Case {
    name: &'static str,
    media_type: &'static str,
    bytes: Vec<u8>,
    status: u16,
    /// In the problem document, so that the reader finds the place.
    mentions: &'static str,
}

fn broken_files() -> Vec<Case> {
    let good = Gltf::triangle();
    let glb = good.glb();
    let case = |name, media_type, bytes, mentions| Case { name, media_type, bytes, status: 422, mentions };
    let broken = |name, gltf: Gltf, mentions| case(name, GLB, gltf.glb(), mentions);

    let mut too_long = glb.clone();
    too_long[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut long_chunk = glb.clone();
    long_chunk[12..16].copy_from_slice(&0x7fff_fff0_u32.to_le_bytes());
    let mut far_index = good.clone();
    far_index.buffer[36..38].copy_from_slice(&900_u16.to_le_bytes());
    let mut nan = good.clone();
    nan.buffer[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut infinite = good.clone();
    infinite.buffer[0..4].copy_from_slice(&f32::INFINITY.to_le_bytes());
    let mut gigapixels = good.clone();
    let png = glb::lying_png(60_000, 60_000);
    gigapixels.document["bufferViews"]
        .as_array_mut()
        .unwrap()
        .push(json!({"buffer": 0, "byteOffset": good.buffer.len(), "byteLength": png.len()}));
    gigapixels.buffer.extend(&png);
    let gigapixels = gigapixels
        .with("/buffers/0/byteLength", json!(good.buffer.len() + png.len()))
        .adding("images", json!([{"bufferView": 2, "mimeType": "image/png"}]))
        .adding("textures", json!([{"source": 0}]))
        .adding("materials", json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]))
        .with("/meshes/0/primitives/0", json!({"attributes": {"POSITION": 0}, "indices": 1, "material": 0}));

    vec![
        case("nothing", GLB, Vec::new(), "file"),
        case("a text", GLB, b"this is no model at all".to_vec(), "file"),
        case("half a file", GLB, glb[..glb.len() / 2].to_vec(), "truncated"),
        case("a header and no more", GLB, glb[..12].to_vec(), "glb"),
        case("a file that says it is longer", GLB, too_long, "truncated"),
        case("a chunk that says it is longer", GLB, long_chunk, "chunk"),
        broken("an index beyond the vertices", far_index, "meshes/0/primitives/0"),
        broken("a NaN position", nan, "meshes/0/primitives/0"),
        broken("an infinite position", infinite, "meshes/0/primitives/0"),
        broken("a huge count", good.clone().with("/accessors/0/count", json!(4_000_000_000_u32)), "accessors/0"),
        broken(
            "a huge count of indices",
            good.clone().with("/accessors/1/count", json!(3_000_000_000_u32)),
            "accessors/1",
        ),
        broken(
            "a view beyond the buffer",
            good.clone().with("/bufferViews/0/byteOffset", json!(4_000_000_000_u32)),
            "bufferViews/0",
        ),
        broken(
            "a buffer longer than the file",
            good.clone().with("/buffers/0/byteLength", json!(1_000_000)),
            "buffers/0",
        ),
        broken(
            "a cycle of nodes",
            good.clone().with("/nodes", json!([{"mesh": 0, "children": [1]}, {"children": [0]}])),
            "nodes/",
        ),
        broken(
            "a node that is its own child",
            good.clone().with("/nodes/0", json!({"mesh": 0, "children": [0]})),
            "nodes/0",
        ),
        broken("a node that is not there", good.clone().with("/scenes/0/nodes/0", json!(7)), "scenes/0"),
        broken("a mesh that is not there", good.clone().with("/nodes/0/mesh", json!(3)), "nodes/0/mesh"),
        broken("glTF 1.0", good.clone().with("/asset/version", json!("1.0")), "1.0"),
        broken(
            "an extension that we lack",
            good.clone()
                .adding("extensionsUsed", json!(["EXT_meshopt_compression"]))
                .adding("extensionsRequired", json!(["EXT_meshopt_compression"])),
            "EXT_meshopt_compression",
        ),
        broken(
            "a buffer elsewhere",
            good.clone().with("/buffers/0", json!({"byteLength": 42, "uri": "../../secret.bin"})),
            "buffers/0",
        ),
        broken(
            "a buffer on the network",
            good.clone().with("/buffers/0", json!({"byteLength": 42, "uri": "http://127.0.0.1/x"})),
            "buffers/0",
        ),
        broken("a picture of gigapixels", gigapixels, "images/0"),
        case("deeply nested JSON", GLB, deeply_nested(), "JSON"),
        case("no zip", ZIP, b"PK\x03\x04 but not really".to_vec(), "zip"),
        case("a zip without a model", ZIP, glb::zip(&[("readme.txt", b"hello")]), "gltf"),
        case("a zip with two models", ZIP, glb::zip(&[("a.gltf", b"{}"), ("b.gltf", b"{}")]), "gltf"),
        case(
            "a zip that climbs",
            ZIP,
            glb::zip(&[("scene.gltf", &good.gltf("../m.bin")), ("../m.bin", &good.buffer)]),
            "../m.bin",
        ),
        case(
            "a zip with an absolute path",
            ZIP,
            glb::zip(&[("scene.gltf", &good.gltf("m.bin")), ("/m.bin", &good.buffer)]),
            "/m.bin",
        ),
        case("a zip that lacks its buffer", ZIP, glb::zip(&[("scene.gltf", &good.gltf("m.bin"))]), "m.bin"),
        case("a zip bomb", ZIP, zip_bomb(&good), "zeros-0.bin"),
        Case {
            name: "a media type that is none of ours",
            media_type: "text/plain",
            bytes: glb,
            status: 415,
            mentions: GLB,
        },
    ]
}

/// 8 GiB of zeros in a few MB.
fn zip_bomb(good: &Gltf) -> Vec<u8> {
    let chunk = vec![0_u8; 64 << 20];
    let block = glb::zip(&[("zeros", &chunk)]);
    let mut block = zip::ZipArchive::new(Cursor::new(block)).unwrap();
    let mut bomb = zip::ZipWriter::new(Cursor::new(Vec::new()));
    bomb.start_file("scene.gltf", zip::write::SimpleFileOptions::default()).unwrap();
    bomb.write_all(&good.gltf("zeros-0.bin")).unwrap();
    for i in 0..128 {
        bomb.raw_copy_file_rename(block.by_index(0).unwrap(), format!("zeros-{i}.bin")).unwrap();
    }
    bomb.finish().unwrap().into_inner()
}

/// A .glb whose JSON is 200,000 arrays within each other.
fn deeply_nested() -> Vec<u8> {
    let depth = 200_000;
    let json = [vec![b'['; depth], vec![b']'; depth]].concat();
    let length = (12 + 8 + json.len()) as u32;
    [
        b"glTF".as_slice(),
        &2_u32.to_le_bytes(),
        &length.to_le_bytes(),
        &(json.len() as u32).to_le_bytes(),
        b"JSON",
        &json,
    ]
    .concat()
}

/// What is wrong with an answer that should be a refusal of this status with this text in it.
fn not_refused(name: &str, reply: &Reply, status: u16, mentions: &str) -> Option<String> {
    if reply.status != status {
        return Some(format!("{name}: {} instead of {status}: {}", reply.status, reply.text()));
    }
    let problem = reply.problem(status).to_string();
    (!problem.to_lowercase().contains(&mentions.to_lowercase()))
        .then(|| format!("{name}: the problem does not mention {mentions}: {problem}"))
}

/// The next good upload and render work, and no half scene is listed.
async fn assert_works(service: &Service, scenes_before: usize) {
    let list = service.get("/v1/scenes").await.json();
    assert_eq!(list["items"].as_array().unwrap().len(), scenes_before, "{list}");
    let glb = Gltf::triangle().with("/nodes/0", json!({"mesh": 0, "name": "good"})).glb();
    let scene = service.scene(glb).await;
    service.render(&scene, json!({"width": 16, "height": 16, "spp": 1})).await;
    assert!(!service.log().contains("panicked"), "nothing panicked");
}

/// Files of the service's data, but for the database's own, a worker's cache and logs.
fn files(data: &Path) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut folders = vec![data.to_owned()];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&folder) else { continue };
        for entry in entries.flatten() {
            let path = entry.path();
            let name = path.strip_prefix(data).unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                folders.push(path);
            } else if !name.contains("sqlite") && !name.contains(".db") && !name.contains("worker") {
                found.insert(name);
            }
        }
    }
    found
}
