//! A service without a socket, with a clock that stands still; and one with a socket where that matters.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use http::{HeaderMap, Method, Request, StatusCode};
use http_body_util::BodyExt;
use lightshaft_api::client::{Client, Upload};
use lightshaft_api::job::{Job, NewJob};
use lightshaft_api::lease::{Complete, Lease, LeaseRequest, NewArtifact};
use lightshaft_api::problem::Problem;
use lightshaft_api::worker::{Device, DeviceKind, NewWorker};
use lightshaft_server::app::{App, Shared, Stop};
use lightshaft_server::blob::BlobStore;
use lightshaft_server::clock::ManualClock;
use lightshaft_server::routes;
use lightshaft_server::store::sqlite::SqliteStore;
use lightshaft_server::{Config, telemetry};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use tower::ServiceExt;

pub(crate) struct Service {
    pub(crate) app: Shared,
    pub(crate) clock: Arc<ManualClock>,
    router: Router,
    dir: tempfile::TempDir,
}

pub(crate) struct Answer {
    pub(crate) status: StatusCode,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn json<T: DeserializeOwned>(&self) -> T {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&self.body)))
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }

    /// The problem document, after checking that it is one.
    pub(crate) fn problem(&self) -> Problem {
        assert_eq!(self.header("content-type"), "application/problem+json", "{}", String::from_utf8_lossy(&self.body));
        let problem: Problem = self.json();
        assert_eq!(problem.status, self.status.as_u16());
        assert_eq!(problem.request_id.as_deref(), Some(self.header("x-request-id")));
        assert_eq!(problem.kind, format!("/problems/{}", problem.code));
        assert_eq!(problem.instance, Some(format!("/requests/{}", self.header("x-request-id"))));
        problem
    }

    pub(crate) fn pointers(&self) -> Vec<String> {
        self.problem().errors.into_iter().map(|error| error.pointer).collect()
    }
}

impl Service {
    pub(crate) async fn start() -> Self {
        Self::start_with(|_| {}).await
    }

    pub(crate) async fn start_with(configure: impl FnOnce(&mut Config)) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut config = Config::new(SocketAddr::from(([127, 0, 0, 1], 0)), dir.path().to_owned());
        config.thumbnails = false;
        configure(&mut config);
        telemetry::metrics().unwrap();
        let store = Arc::new(SqliteStore::open(&dir.path().join("lightshaft.db")).await.unwrap());
        let blobs = BlobStore::open(dir.path()).await.unwrap();
        let clock = Arc::new(ManualClock::new(1_800_000_000_000));
        let app = App::new(config, store, blobs, clock.clone(), Stop::default()).await.unwrap();
        Self { router: routes::router(app.clone()), app, clock, dir }
    }

    pub(crate) fn staged_files(&self) -> usize {
        std::fs::read_dir(self.dir.path().join("staging")).unwrap().count()
    }

    pub(crate) fn blob_files(&self) -> usize {
        fn count(dir: &Path) -> usize {
            let entries = std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path());
            entries.map(|path| if path.is_dir() { count(&path) } else { 1 }).sum()
        }
        count(&self.dir.path().join("blobs"))
    }

    pub(crate) fn log_files(&self) -> usize {
        std::fs::read_dir(self.dir.path().join("logs")).unwrap().count()
    }

    /// Makes a blob one that was put at this time.
    pub(crate) fn write_blob_at(&self, hash: &str, ms: i64) {
        let path = self.dir.path().join("blobs").join(&hash[..2]).join(&hash[2..4]).join(hash);
        let time = std::time::UNIX_EPOCH + std::time::Duration::from_millis(ms.unsigned_abs());
        std::fs::File::options().append(true).open(path).unwrap().set_modified(time).unwrap();
    }

    /// Also listens on a socket; returns a client of it.
    pub(crate) async fn listen(&self) -> Client {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let shutdown = self.app.shutdown.clone();
        let server = axum::serve(listener, self.router.clone()).with_graceful_shutdown(shutdown.cancelled_owned());
        tokio::spawn(server.into_future());
        Client::new(&format!("http://{address}")).unwrap()
    }

    pub(crate) async fn send(&self, request: Request<Body>) -> Answer {
        let response = self.router.clone().oneshot(request).await.unwrap();
        let (parts, body) = response.into_parts();
        let body = body.collect().await.unwrap().to_bytes().to_vec();
        Answer { status: parts.status, headers: parts.headers, body }
    }

    pub(crate) async fn get(&self, path: &str) -> Answer {
        self.get_with(path, &[]).await
    }

    pub(crate) async fn get_with(&self, path: &str, headers: &[(&str, &str)]) -> Answer {
        self.request(Method::GET, path, headers, Body::empty()).await
    }

    pub(crate) async fn delete(&self, path: &str) -> Answer {
        self.request(Method::DELETE, path, &[], Body::empty()).await
    }

    pub(crate) async fn post(&self, path: &str, body: Value) -> Answer {
        let json = [("content-type", "application/json")];
        self.request(Method::POST, path, &json, Body::from(body.to_string())).await
    }

    pub(crate) async fn patch(&self, path: &str, body: Value) -> Answer {
        let json = [("content-type", "application/json")];
        self.request(Method::PATCH, path, &json, Body::from(body.to_string())).await
    }

    pub(crate) async fn request(&self, method: Method, path: &str, headers: &[(&str, &str)], body: Body) -> Answer {
        let mut request = Request::builder().method(method).uri(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        self.send(request.body(body).unwrap()).await
    }

    pub(crate) async fn upload(&self, media_type: &str, body: impl Into<Body>) -> Answer {
        self.request(Method::POST, "/v1/scenes", &[("content-type", media_type)], body.into()).await
    }

    /// Uploads a scene of its own for each number; returns its id.
    pub(crate) async fn scene(&self, number: u32) -> String {
        let answer = self.upload("model/gltf-binary", triangle_glb(number)).await;
        assert_eq!(answer.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&answer.body));
        answer.json::<Value>()["id"].as_str().unwrap().to_owned()
    }

    pub(crate) async fn job(&self, body: Value) -> Job {
        let answer = self.post("/v1/jobs", body).await;
        assert_eq!(answer.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&answer.body));
        answer.json()
    }

    pub(crate) async fn read_job(&self, id: &str) -> Job {
        self.get(&format!("/v1/jobs/{id}")).await.json()
    }

    /// Registers a worker with these devices; returns its id.
    pub(crate) async fn worker(&self, devices: &[&str]) -> String {
        let answer = self.post("/v1/workers", serde_json::to_value(new_worker(devices)).unwrap()).await;
        assert_eq!(answer.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&answer.body));
        answer.json::<Value>()["id"].as_str().unwrap().to_owned()
    }

    pub(crate) async fn lease(&self, worker: &str) -> Option<Lease> {
        self.lease_warm(worker, &[]).await
    }

    pub(crate) async fn lease_warm(&self, worker: &str, warm: &[String]) -> Option<Lease> {
        let answer = self.post("/v1/leases", json!({ "worker": worker, "warm": warm })).await;
        match answer.status {
            StatusCode::NO_CONTENT => None,
            StatusCode::OK => Some(answer.json()),
            status => panic!("{status}: {}", String::from_utf8_lossy(&answer.body)),
        }
    }

    pub(crate) async fn report(&self, lease: &Lease, what: &str, body: Value) -> Answer {
        self.post(&format!("/v1/leases/{}/{what}", lease.token), body).await
    }

    /// Stores an artifact of this content and completes the task with it.
    pub(crate) async fn complete(&self, lease: &Lease, name: &str, content: &'static str) -> Answer {
        let blob = self.store_blob(content).await;
        let media_type = "image/png".to_owned();
        let artifact = NewArtifact { name: name.to_owned(), media_type, bytes: content.len() as u64, blob };
        let report = Complete { artifacts: vec![artifact], metrics: Default::default() };
        self.report(lease, "complete", serde_json::to_value(report).unwrap()).await
    }

    pub(crate) async fn store_blob(&self, content: &'static str) -> String {
        let answer = self.request(Method::POST, "/v1/blobs", &[], Body::from(content)).await;
        assert_eq!(answer.status, StatusCode::CREATED);
        answer.json::<Value>()["hash"].as_str().unwrap().to_owned()
    }
}

pub(crate) fn new_worker(devices: &[&str]) -> NewWorker {
    let kind = |name: &str| if name == "cpu" { DeviceKind::Cpu } else { DeviceKind::Gpu };
    NewWorker::new("worker", "1", devices.iter().map(|name| Device::named(kind(name), name)).collect())
}

pub(crate) fn new_job(scene: &str) -> NewJob {
    serde_json::from_value(json!({ "scene": scene })).unwrap()
}

pub(crate) fn lease_request(worker: &str, wait_s: u32) -> LeaseRequest {
    LeaseRequest { worker: worker.to_owned(), wait_s, warm: Vec::new(), cache: Default::default() }
}

pub(crate) fn glb_upload(bytes: Vec<u8>) -> Upload {
    let length = bytes.len() as u64;
    Upload::Glb(bytes.into(), Some(length))
}

/// A path below a fresh folder.
pub(crate) fn scratch_file(name: &str) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    (dir, path)
}

/// One triangle, of another size for each number, with a camera called `front`.
pub(crate) fn triangle_glb(number: u32) -> Vec<u8> {
    let size = 1.0 + number as f32;
    glb(&triangle_document(36, None), &positions(size))
}

pub(crate) fn positions(size: f32) -> Vec<u8> {
    [0.0, 0.0, 0.0, size, 0.0, 0.0, 0.0, size, 0.0].iter().flat_map(|value: &f32| value.to_le_bytes()).collect()
}

pub(crate) fn triangle_document(bytes: usize, uri: Option<&str>) -> Value {
    let mut buffer = json!({ "byteLength": bytes });
    if let Some(uri) = uri {
        buffer["uri"] = uri.into();
    }
    json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0, 1] }],
        "nodes": [{ "mesh": 0 }, { "camera": 0, "translation": [0, 0, 5] }],
        "cameras": [{ "name": "front", "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1 } }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{
            "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [9, 9, 0],
        }],
        "bufferViews": [{ "buffer": 0, "byteLength": bytes }],
        "buffers": [buffer],
    })
}

/// Binary glTF (glTF 2.0, section 4).
pub(crate) fn glb(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bin = binary.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let total = 12 + 8 + text.len() + 8 + bin.len();
    let mut bytes = Vec::with_capacity(total);
    bytes.extend(b"glTF");
    for word in [2, total as u32, text.len() as u32] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(b"JSON");
    bytes.extend(text);
    bytes.extend((bin.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(bin);
    bytes
}

/// A multipart body of files under their names; returns its content type and itself.
pub(crate) fn multipart(files: &[(&str, &[u8])]) -> (String, Vec<u8>) {
    let mut body = Vec::new();
    for (name, content) in files {
        body.extend(
            format!("--limit\r\nContent-Disposition: form-data; name=\"file\"; filename=\"{name}\"\r\n\r\n").bytes(),
        );
        body.extend(*content);
        body.extend(b"\r\n");
    }
    body.extend(b"--limit--\r\n");
    ("multipart/form-data; boundary=limit".to_owned(), body)
}
