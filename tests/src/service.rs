//! A service of its own for one test: `lightshaft serve` on a free port with an empty folder.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use reqwest::header::HeaderMap;
use reqwest::{Method, RequestBuilder};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{binary, process};

/// Longer than anything here takes on two busy cores.
const PATIENCE: Duration = Duration::from_secs(120);

pub struct Service {
    child: Child,
    url: String,
    args: Vec<String>,
    folder: TempDir,
    http: reqwest::Client,
}

/// A worker process that the service did not start.
pub struct Worker(Child);

impl Worker {
    pub fn pid(&self) -> u32 {
        self.0.id()
    }

    /// As the kernel does when memory runs out.
    pub fn kill(&mut self) {
        process::kill_tree(self.pid());
        let _ = self.0.wait();
    }

    /// How it ended, or `None` while it runs.
    ///
    /// # Panics
    /// When the system does not tell.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.0.try_wait().expect("the child can be asked")
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        if self.ended().is_none() {
            self.kill();
        }
    }
}

/// An answer, read to its end.
#[derive(Debug)]
pub struct Reply {
    pub status: u16,
    pub headers: HeaderMap,
    pub body: Vec<u8>,
}

impl Service {
    /// Starts a service with one worker and waits until it listens.
    pub fn start() -> Self {
        Self::start_with(&[])
    }

    /// Starts a service with further arguments to `serve`.
    ///
    /// # Panics
    /// With the log when it does not listen in time.
    pub fn start_with(args: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
        let (child, url) = spawn(folder.path(), "127.0.0.1:0", &args);
        Self { child, url, args, folder, http: reqwest::Client::new() }
    }

    /// Kills the service without warning, its worker with it, and starts it again on the same data and port.
    pub fn kill_and_restart(&mut self) {
        self.kill();
        self.restart();
    }

    /// Kills the service without warning, its worker with it.
    pub fn kill(&mut self) {
        process::kill_tree(self.child.id());
        let _ = self.child.wait();
    }

    /// Starts a service that was killed again, on the same data and port.
    pub fn restart(&mut self) {
        let listen = self.url.trim_start_matches("http://").to_owned();
        let (child, url) = spawn(self.folder.path(), &listen, &self.args);
        self.child = child;
        self.url = url;
        // The old client may hold connections to the dead process.
        self.http = reqwest::Client::new();
    }

    /// Starts a worker of its own, as on another machine, which ends with what this returns.
    ///
    /// # Panics
    /// When it cannot be started.
    pub fn join_worker(&self) -> Worker {
        self.join_worker_through(&self.url, &self.scratch("worker"))
    }

    /// The same, with a cache of its own, and with the service at another address.
    ///
    /// # Panics
    /// When it cannot be started.
    pub fn join_worker_through(&self, url: &str, cache: &Path) -> Worker {
        self.spawn_worker(Command::new(binary::lightshaft()), url, cache)
    }

    /// A worker whose files cannot grow past so many KiB: longer writes fail with `EFBIG`.
    ///
    /// # Panics
    /// When it cannot be started.
    pub fn join_worker_with_small_files(&self, cache: &Path, kib: u32) -> Worker {
        let mut shell = Command::new("bash");
        // Ignored, the signal that comes with the error does not end the process (setrlimit(2)).
        shell.args(["-c", "trap '' XFSZ; ulimit -f $0; exec \"$@\"", &kib.to_string()]).arg(binary::lightshaft());
        self.spawn_worker(shell, &self.url, cache)
    }

    fn spawn_worker(&self, mut program: Command, url: &str, cache: &Path) -> Worker {
        let log = fs::OpenOptions::new().create(true).append(true).open(self.folder.path().join("serve.log"));
        let child = program
            .args(["worker", "--device", "cpu", "--server", url, "--cache"])
            .arg(cache)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log.expect("a file for the log"))
            .spawn();
        Worker(child.expect("the worker starts"))
    }

    pub fn url(&self) -> &str {
        &self.url
    }

    pub fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// A path for a file of the test's own, outside the service's data.
    pub fn scratch(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn log(&self) -> String {
        fs::read_to_string(self.folder.path().join("serve.log")).unwrap_or_default()
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Process id of the worker that `serve` started.
    pub async fn worker_pid(&self) -> u32 {
        self.until("a worker process", async || process::children(self.child.id()).first().copied()).await
    }

    /// Repeats `probe` until it gives something.
    ///
    /// # Panics
    /// When two minutes pass without.
    pub async fn until<T>(&self, what: &str, mut probe: impl AsyncFnMut() -> Option<T>) -> T {
        let start = Instant::now();
        loop {
            if let Some(found) = probe().await {
                return found;
            }
            assert!(start.elapsed() < PATIENCE, "waited {PATIENCE:?} for {what}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    pub fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.http.request(method, format!("{}{path}", self.url))
    }

    pub async fn send(&self, request: RequestBuilder) -> Reply {
        let response = request.send().await.expect("the service answers");
        let (status, headers) = (response.status().as_u16(), response.headers().clone());
        let body = response.bytes().await.expect("the answer ends").to_vec();
        Reply { status, headers, body }
    }

    pub async fn get(&self, path: &str) -> Reply {
        self.send(self.request(Method::GET, path)).await
    }

    pub async fn post(&self, path: &str, body: &Value) -> Reply {
        self.send(self.request(Method::POST, path).json(body)).await
    }

    pub async fn upload(&self, media_type: &str, bytes: Vec<u8>) -> Reply {
        let request = self.request(Method::POST, "/v1/scenes").header("content-type", media_type).body(bytes);
        self.send(request).await
    }

    /// Uploads a .glb that must be good; returns the scene's id.
    pub async fn scene(&self, glb: Vec<u8>) -> String {
        let reply = self.upload("model/gltf-binary", glb).await;
        assert!(matches!(reply.status, 200 | 201), "{reply:?}");
        reply.json()["id"].as_str().expect("a scene has an id").to_owned()
    }

    /// A scene of the generator, by its kind and further arguments.
    pub async fn generated(&self, kind: &[&str]) -> String {
        self.scene(generate(kind)).await
    }

    /// Submits a job that must be accepted; returns its id.
    pub async fn submit(&self, scene: &str, settings: Value) -> String {
        let reply = self.post("/v1/jobs", &json!({"kind": "render", "scene": scene, "settings": settings})).await;
        assert_eq!(reply.status, 201, "{reply:?}");
        reply.json()["id"].as_str().expect("a job has an id").to_owned()
    }

    pub async fn job(&self, id: &str) -> Value {
        let reply = self.get(&format!("/v1/jobs/{id}")).await;
        assert_eq!(reply.status, 200, "{reply:?}");
        reply.json()
    }

    /// Waits until the job is in one of `states`.
    pub async fn job_in(&self, id: &str, states: &[&str]) -> Value {
        self.until(&format!("job {id} to be {states:?}"), async || {
            let job = self.job(id).await;
            states.contains(&job["state"].as_str()?).then_some(job)
        })
        .await
    }

    /// Waits for the end of a job that must succeed.
    pub async fn succeeded(&self, id: &str) -> Value {
        let job = self.job_in(id, &["succeeded", "failed", "cancelled"]).await;
        assert_eq!(job["state"], "succeeded", "{job:#}");
        job
    }

    /// Submits a job and waits for its success.
    pub async fn render(&self, scene: &str, settings: Value) -> Value {
        self.succeeded(&self.submit(scene, settings).await).await
    }

    pub async fn artifact(&self, job: &Value, name: &str) -> Vec<u8> {
        let artifacts = job["artifacts"].as_array().expect("a job lists artifacts");
        let artifact = artifacts.iter().find(|artifact| artifact["name"] == name);
        let href = artifact.unwrap_or_else(|| panic!("{name} among {artifacts:?}"))["href"].as_str().expect("an href");
        let reply = self.get(href).await;
        assert_eq!(reply.status, 200, "{href}");
        reply.body
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        process::kill_tree(self.child.id());
        let _ = self.child.wait();
        if std::thread::panicking() {
            let log = self.log();
            let lines: Vec<&str> = log.lines().collect();
            eprintln!("--- the last lines of the service's log");
            lines[lines.len().saturating_sub(60)..].iter().for_each(|line| eprintln!("{line}"));
        }
    }
}

impl Reply {
    /// # Panics
    /// When the body is not JSON.
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {}", self.text()))
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    /// A header's value, or an empty string.
    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default()
    }

    /// Checks that this is a problem document (RFC 9457) with the status given, and returns it.
    ///
    /// # Panics
    /// When it is anything else.
    pub fn problem(&self, status: u16) -> Value {
        assert_eq!(self.status, status, "{}", self.text());
        assert_eq!(self.header("content-type"), "application/problem+json", "{}", self.text());
        let problem = self.json();
        assert_eq!(problem["status"], status, "{problem}");
        for field in ["type", "title", "detail"] {
            assert!(problem[field].as_str().is_some_and(|text| !text.is_empty()), "{field} of {problem}");
        }
        problem
    }
}

/// The bytes of a generated .glb.
pub fn generate(kind: &[&str]) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.glb");
    let path_text = path.to_str().expect("a UTF-8 path");
    binary::run_ok(&[&["scene", "generate"], kind, &["-o", path_text]].concat());
    fs::read(&path).expect("the generated file")
}

fn spawn(folder: &Path, listen: &str, args: &[String]) -> (Child, String) {
    let (out_path, log_path) = (folder.join("serve.out"), folder.join("serve.log"));
    let out = fs::File::create(&out_path).expect("a file for standard output");
    let log = fs::OpenOptions::new().create(true).append(true).open(&log_path).expect("a file for the log");
    let mut child = Command::new(binary::lightshaft())
        .args(["serve", "--insecure-local", "--listen", listen, "--data"])
        .arg(folder.join("data"))
        .args(args)
        .stdin(Stdio::null())
        .stdout(out)
        .stderr(log)
        .spawn()
        .expect("lightshaft starts");
    let start = Instant::now();
    loop {
        let out = fs::read_to_string(&out_path).unwrap_or_default();
        if let Some(url) = out.lines().find_map(|line| line.strip_prefix("listening on ")) {
            return (child, url.to_owned());
        }
        let log = || fs::read_to_string(&log_path).unwrap_or_default();
        if let Some(status) = child.try_wait().expect("the child can be asked") {
            panic!("serve ended with {status}:\n{}", log());
        }
        if start.elapsed() > PATIENCE {
            process::kill_tree(child.id());
            panic!("serve does not listen:\n{}", log());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}
