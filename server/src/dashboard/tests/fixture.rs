//! An API with a little of everything, for pages to show. Names and errors hold characters that HTML must escape.

use axum::extract::Path;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use lightshaft_api::job::{Job, JobSummary, NewJob};
use lightshaft_api::mesh::Mesh;
use lightshaft_api::page::Page;
use lightshaft_api::queue::Queue;
use lightshaft_api::scene::Scene;
use lightshaft_api::status::Status;
use lightshaft_api::worker::Worker;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use utoipa::OpenApi;

pub(crate) const HASH: &str = "00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff";

fn typed<T: DeserializeOwned>(value: Value) -> T {
    serde_json::from_value(value).expect("the fixture has the shape of the API's types")
}

pub(crate) fn scene(id: &str, name: &str) -> Scene {
    let bounds = json!({ "min": [-1.0, 0.0, -2.5], "max": [1.0, 2.0, 2.5] });
    typed(json!({
        "id": id, "hash": HASH, "name": name, "created_at": "2026-11-22T10:00:00Z", "bytes": 5_321_000,
        "meshes": [
            { "hash": HASH, "name": "body <b>", "triangles": 69_451, "spheres": 0, "instances": 64, "bounds": bounds },
            { "hash": HASH.replace('0', "f"), "name": "", "triangles": 12, "spheres": 3, "instances": 1, "bounds": null },
        ],
        "instances": 65, "triangles_total": 69_463, "triangles_instanced": 4_444_876, "spheres_total": 3,
        "materials": ["skin", "floor"], "textures": 2, "texture_pixels": 8_388_608,
        "cameras": [{ "name": "Front", "kind": "perspective" }, { "name": "Top", "kind": "orthographic" }],
        "lights": [{ "name": "Sun", "kind": "directional" }], "emitters": 2, "bounds": bounds,
        "estimated_bytes": 93_000_000, "warnings": ["mesh 3 \"lines\": 12 lines are skipped"], "thumbnail": (id == "s1").then(|| format!("/v1/scenes/{id}/thumbnail.png")),
    }))
}

/// A job in `state`; finished ones have a picture and metrics.
pub(crate) fn job(id: &str, state: &str) -> Job {
    let done = matches!(state, "succeeded");
    let started = state != "queued";
    let ended = matches!(state, "succeeded" | "failed" | "cancelled");
    let task_state = match state {
        "succeeded" | "cancelled" => state,
        "failed" => "dead",
        "running" => "leased",
        _ => "ready",
    };
    let outcome = if state == "failed" { "task" } else { state };
    let attempt = |number: u32, outcome: &str| {
        json!({
            "id": format!("{id}-a{number}"), "task": format!("{id}-t0"), "number": number, "worker": "w1",
            "worker_name": "render & co", "outcome": outcome, "phase": "render", "started_at": "2026-11-22T10:00:01Z",
            "error": (outcome != "succeeded" && outcome != "running").then_some("no triangle <i>left</i>"),
            "finished_at": (outcome != "running").then_some("2026-11-22T10:00:13.4Z"),
        })
    };
    let artifact = |name: &str, media_type: &str, bytes: u64| {
        json!({ "name": name, "media_type": media_type, "bytes": bytes, "hash": HASH,
            "href": format!("/v1/jobs/{id}/artifacts/{name}") })
    };
    typed(json!({
        "id": id, "kind": "render", "scene": "s1", "scene_name": "64 bunnies <script>", "state": state,
        "paused": false, "cancel_requested": false, "priority": 5,
        "labels": { "suite": "nightly & more", "commit": "1db641f" },
        "progress": if ended { 1.0 } else if started { 0.42 } else { 0.0 },
        "tasks_total": 1, "tasks_done": u32::from(done),
        "error": (state == "failed").then_some("the mesh has no triangle <i>left</i>"),
        "created_at": "2026-11-22T10:00:00Z", "started_at": started.then_some("2026-11-22T10:00:01Z"),
        "finished_at": ended.then_some("2026-11-22T10:00:13.4Z"), "trace_id": "4bf92f3577b34da6a3ce929d0e0e4736",
        "max_attempts": 3,
        "settings": { "camera": "Front", "environment": 0.5, "ground": {}, "aovs": ["depth"],
            "lights": [{ "kind": "spot", "position": [1, 2, 3], "direction": [0, -1, 0] }] },
        "tasks": [{ "id": format!("{id}-t0"), "index": 0, "work": { "kind": "frame" }, "state": task_state,
            "progress": 0.42, "attempt": u32::from(started), "max_attempts": 3 }],
        "attempts": if started { json!([attempt(1, "expired"), attempt(2, outcome)]) } else { json!([]) },
        "artifacts": if done {
            json!([artifact("image.png", "image/png", 412_345), artifact("image.exr", "image/x-exr", 3_912_345),
                artifact("metrics.json", "application/json", 1830)])
        } else { json!([]) },
        "metrics": done.then(metrics),
        "waiting": (state == "queued").then_some("every worker <i>left</i>"),
        "preview": (state == "running").then(|| format!("/v1/jobs/{id}/preview.png")),
    }))
}

fn metrics() -> Value {
    json!({
        "scene_s": 0.31, "build_s": 0.82, "prepare_s": 0.05, "render_s": 10.9, "output_s": 0.12, "total_s": 12.3,
        "rays": { "primary": 4_915_200, "shadow": 9_200_000, "ao": 0, "indirect": 12_345_678 },
        "mrays_per_s": 2.43, "structure_bytes": 9_123_456, "line_space_bytes": 0, "peak_bytes": 312_000_000,
        "device": "AVX2, 2 threads", "device_kind": "cpu", "spp": 16,
        "cache": [{ "mesh": HASH, "structure": "two_level medium", "source": "built", "seconds": 0.82,
            "bytes": 9_123_456 }],
        "versions": { "engine": "0.1.0" }, "warnings": ["a texture is missing"],
    })
}

pub(crate) fn worker(id: &str, state: &str) -> Worker {
    typed(json!({
        "id": id, "name": "render & co", "version": "0.1.0", "tags": ["rack-2"],
        "devices": [
            { "kind": "cpu", "name": "AVX2, 2 threads" },
            { "kind": "gpu", "name": "llvmpipe (LLVM 19.1.7, 256 bits)", "driver": "Mesa 25.0.7", "backend": "Vulkan",
                "device_type": "Cpu" },
        ],
        "state": state, "draining": state == "draining", "registered_at": "2026-11-22T09:00:00Z",
        "last_seen_at": "2026-11-22T10:00:00Z",
        "current": (state == "busy").then(|| json!({ "job": "j-running", "task": "t0" })), "tasks_done": 1234,
        "cache": { "memory_bytes": 312_000_000, "memory_budget_bytes": 1_073_741_824, "disk_bytes": 734_003_200,
            "entries": 17 },
    }))
}

pub(crate) fn mesh() -> Mesh {
    typed(json!({
        "hash": HASH, "triangles": 69_451, "spheres": 0,
        "structures": [{ "kind": "two_level", "parameters": "quality=medium", "builder_version": 1, "bytes": 9_123_456,
            "build_s": 0.82, "built_at": "2026-11-22T10:00:00Z", "blob": HASH, "workers": ["w1"] }],
    }))
}

/// What the service counts, as Prometheus reads it.
pub(crate) const METRICS: &str = "# TYPE lightshaft_structures_total counter
lightshaft_structures_total{source=\"memory\"} 12
lightshaft_structures_total{source=\"disk\"} 3
lightshaft_structures_total{source=\"fetched\"} 1
lightshaft_structures_total{source=\"built\"} 4
";

/// A job that runs, and one that failed twice and waits. Or nothing.
pub(crate) fn queue(is_busy: bool) -> Queue {
    let entry = |job: Job, more: Value| {
        let mut entry = serde_json::to_value(job.summary).expect("JSON");
        entry.as_object_mut().expect("an object").extend(more.as_object().expect("an object").clone());
        entry
    };
    let running = entry(
        job("j-running", "running"),
        json!({ "needs": null, "tasks_ready": 0, "tasks_blocked": 1,
        "waiting": null, "ready_at": null, "failures": 0, "last_error": null, "blocked_workers": [],
        "leases": [{ "task": "t0", "work": { "kind": "frame" }, "worker": "w1", "worker_name": "render & co",
            "attempt": 2, "phase": "render", "expires_at": "2126-11-22T10:00:00Z" }] }),
    );
    let waiting = entry(
        job("j-queued", "queued"),
        json!({ "needs": "a GPU with `<rtx>` in its name", "tasks_ready": 2,
        "tasks_blocked": 0, "waiting": "every worker <i>left</i>", "ready_at": "2026-11-22T10:00:00Z", "failures": 2,
        "last_error": "the driver <i>crashed</i>", "leases": [],
        "blocked_workers": [{ "worker": "w1", "worker_name": "render & co", "failures": 2,
            "until": "2126-11-22T10:00:00Z" }] }),
    );
    let jobs = if is_busy { vec![running, waiting] } else { vec![] };
    typed(json!({ "total": 2 * u64::from(is_busy), "jobs": jobs }))
}

/// Results of two configurations, with everything measured.
fn benchmark_results() -> Value {
    let row = |name: &str, n: u32, speed: f64| {
        json!({ "configuration": name, "acceleration": { "structure": "two_level", "line_space": { "n": n } },
            "unavailable": null, "paper": { "ratio": 2.39 }, "warnings": [],
            "built": { "init_s": 0.5, "structure_bytes": 9_000_000, "structure_nodes": 17, "line_space_bytes": 1_000_000 * n,
                "line_spaces": 3, "cache": [] },
            "timed": { "mrays_per_s": { "lower": 0.9 * speed, "median": speed, "upper": 1.1 * speed },
                "frames_per_s": { "lower": 1.0, "median": 1.0, "upper": 1.0 },
                "ratio": { "value": 1.5, "low": 1.4, "high": 1.6 },
                "rays": { "primary": 1, "shadow": 0, "ao": 0, "indirect": 0 }, "samples": [],
                "per_ray": { "box_tests": 1.0, "triangle_tests": 1.0, "look_ups": 0.0, "empty": 0.0, "opaque": 0.0,
                    "mixed": 0.0, "starts_inside": 0.0, "approximated": 0.0 } },
            "picture": { "rmse": 0.01, "flip": 0.02, "differing_pixels": 7, "heat_map": "h.png", "picture": "p.png" } })
    };
    json!({ "title": "Keul <4.1>", "preset": null, "source": null, "device": "AVX2 <i>", "device_kind": "cpu", "driver": "",
        "versions": {}, "width": 640, "height": 480, "spp": 1, "picture_spp": 4, "seed": 1, "repetitions": 5,
        "min_sample_s": 0.1, "columns": ["init_s", "mrays_per_s"], "total_s": 10.0,
        "scenes": [{ "name": "64 bunnies <script>", "measured": "bunnies", "stand_in": false, "triangles": 69_451,
            "spheres": 0, "instances": 64, "meshes": 1, "comparisons": [{ "effect": null, "title": "primary <rays>",
                "note": "lit <i>well</i>", "reference": "base", "views": ["Front"],
                "rows": [row("base <b>", 5, 2.0), row("large", 10, 3.0)] }] }] })
}

fn schedule() -> Value {
    json!({ "id": "sc1", "name": "nightly <b>", "cron": "30 2 * * 1-5", "paused": false, "next_at": "2126-11-22T02:30:00Z",
        "run": { "suite": "su1", "label": "nightly & more" }, "begun_at": null, "last_run": null,
        "error": "the scene <i>is gone</i>", "created_at": "2026-11-22T10:00:00Z" })
}

fn webhook() -> Value {
    json!({ "id": "w1", "url": "https://chat.example/<b>", "events": ["run.finished"], "suite": "generated & more",
        "created_at": "2026-11-22T10:00:00Z", "waiting": 1, "delivered_at": null, "error": "it answered <i>500</i>" })
}

fn delivery() -> Value {
    let data = json!({ "run": "r1", "suite": "generated", "case": "cornell <b>", "label": "1db641f", "baseline": "main",
        "device_class": "cpu", "image_verdict": "changed", "time_verdict": null, "reason": "pixels <i>differ</i>" });
    json!({ "id": "de1", "state": "waiting", "next_at": "2126-11-22T02:30:00Z",
        "message": { "type": "case.changed", "timestamp": "2026-11-22T10:00:00Z", "data": data },
        "attempts": [{ "at": "2026-11-22T10:00:00Z", "seconds": 0.5, "status": 500, "error": "it answered <i>500</i>" }] })
}

fn farm_artifact(name: &str) -> Value {
    json!({ "name": name, "media_type": if name.ends_with("png") { "image/png" } else { "image/x-exr" }, "bytes": 1234,
        "hash": HASH, "href": format!("/v1/farm/runs/r1/cases/cornell/artifacts/{name}") })
}

fn decision(kind: &str) -> Value {
    json!({ "id": "d1", "kind": kind, "who": "Ada <b>", "why": "meant <i>so</i>", "at": "2026-11-22T10:00:00Z",
        "baseline": "main", "suite": "generated", "case": "cornell", "device_class": "cpu", "run": "r1",
        "label": "1db641f", "pixels": HASH })
}

/// A finished run: a case that changed and is slower, one that somebody approved.
pub(crate) fn run() -> Run {
    let spread = |median: f64| json!({ "samples": 5, "lower_quartile_s": 0.9 * median, "median_s": median, "upper_quartile_s": 1.1 * median });
    let ratio = json!({ "value": 1.4, "low": 1.3, "high": 1.5, "p": 0.01 });
    let artifacts = ["image.png", "image.exr", "heat-map.png", "accepted.png", "accepted.exr"].map(farm_artifact);
    let case = |name: &str, is_ok: bool| {
        json!({
            "name": name, "state": "finished", "ok": is_ok, "scene": "s1", "settings": {}, "repeat": 5,
            "tolerance": "identical", "time_tolerance": { "metric": "render_s", "max_ratio": 1.1 },
            "device_class": "cpu", "worker": "w1",
            "image": { "verdict": if is_ok { "identical" } else { "changed" },
                "reason": (!is_ok).then_some("the pixels differ <i>here</i>"), "pixels": HASH, "source": "exr",
                "accepted": HASH, "z_test": null, "unsteady": false,
                "figures": (!is_ok).then(|| json!({ "rmse": 0.1, "rel_mse": 0.1, "mae": 0.1, "psnr": 30.0, "ssim": 0.9,
                    "flip_mean": 0.07, "flip_p99": 0.3, "max_difference": 0.5, "max_at": [1, 2],
                    "differing_pixels": 70_000, "pixels": 307_200 })) },
            "time": { "verdict": if is_ok { "same" } else { "slower" }, "reason": "slower", "metric": "render_s",
                "samples_s": [1.0, 1.1], "spread": spread(1.4), "baseline": spread(1.0), "ratio": ratio.clone(),
                "limit": 1.1, "noise_floor": 0.02,
                "confirmation": { "state": if is_ok { "not_needed" } else { "confirmed" }, "reason": null, "a_s": [],
                    "b_s": [], "ratio": null } },
            "decision": is_ok.then(|| decision("approved")),
            "versions": {}, "jobs": [{ "job": "j-succeeded", "phase": "sample", "position": 0, "time_s": 1.0 }],
            "artifacts": artifacts,
        })
    };
    typed(json!({
        "id": "r1", "kind": "check", "suite": "su1", "suite_name": "generated", "label": "1db641f <b>",
        "labels": { "driver": "nightly & more" }, "baseline": "main", "state": "finished", "ok": false,
        "counts": { "cases": 2, "finished": 2, "ok": 1, "undecided": 1, "rejected": 0, "identical": 1,
            "within_tolerance": 0, "changed": 1, "missing": 0, "failed": 0, "faster": 0, "same": 1, "slower": 1,
            "too_noisy_to_say": 0 },
        "created_at": "2026-11-22T10:00:00Z", "finished_at": "2026-11-22T10:01:00Z", "scenes": { "box": "s1" },
        "overrides": {}, "priority": 0, "cases": [case("cornell", false), case("teapot", true)],
    }))
}

/// Four runs of a case, the last one slower.
pub(crate) fn history() -> History {
    let point = |number: u32, median: f64| {
        json!({ "run": format!("r{number}"), "label": format!("commit <b> {number}"), "labels": {},
            "at": "2026-11-22T10:00:00Z", "ok": number < 4, "image": "identical",
            "time": if number < 4 { "same" } else { "slower" }, "confirmation": "not_needed", "pixels": HASH,
            "metric": "render_s", "median_s": median, "lower_quartile_s": 0.95 * median,
            "upper_quartile_s": 1.05 * median, "picture": "/v1/farm/runs/r1/cases/cornell/artifacts/image.png" })
    };
    typed(json!({
        "suite": "generated", "case": "cornell", "device_class": "cpu", "device_classes": ["cpu", "gpu: nightly & more"],
        "baseline": "main", "points": [point(1, 1.0), point(2, 1.02), point(3, 0.99), point(4, 1.5)],
        "change_points": [3], "noise_floor": 0.03,
        "pictures": [{ "pixels": HASH, "source": "exr", "artifacts": [farm_artifact("image.png")], "decision": "d1",
            "label": "1db641f", "accepted_at": "2026-11-22T10:00:00Z" }],
        "decisions": [decision("approved")],
    }))
}

pub(crate) fn status(scenes: u64) -> Status {
    typed(json!({
        "state": "active", "version": "0.1.0", "uptime_s": 4000.0,
        "jobs": { "queued": 3, "running": 1, "succeeded": 1204, "failed": 2, "cancelled": 0 },
        "tasks_ready": 3, "tasks_leased": 1, "workers": { "idle": 0, "busy": 1, "draining": 0, "gone": 1 },
        "scenes": scenes, "blob_bytes": 12_345_678_901_u64,
    }))
}

#[derive(OpenApi)]
#[openapi(
    info(title = "Lightshaft", description = "Renders `glTF` scenes."),
    components(schemas(NewJob, Job, Scene, Worker, Mesh, Status, Event, Problem))
)]
struct Document;

use lightshaft_api::event::Event;
use lightshaft_api::farm::{Decision, History, Run, Schedule, SuiteSummary, Webhook, WebhookDelivery};
use lightshaft_api::problem::Problem;

fn document() -> Value {
    let mut document: Value = typed(serde_json::to_value(Document::openapi()).expect("a document"));
    document["paths"] = json!({
        "/v1/jobs": { "post": { "tags": ["jobs"], "operationId": "create_job", "summary": "Submits a job.",
            "parameters": [{ "name": "validate_only", "in": "query", "schema": { "type": "boolean" },
                "description": "Only says what is wrong." }],
            "requestBody": { "content": { "application/json": { "schema": { "$ref": "#/components/schemas/NewJob" } } } },
            "responses": { "201": { "description": "The job.",
                "content": { "application/json": { "schema": { "$ref": "#/components/schemas/Job" } } } } } } },
        "/v1/scenes/{id}": { "get": { "tags": ["scenes"], "operationId": "get_scene", "summary": "One scene.",
            "parameters": [{ "name": "id", "in": "path", "required": true, "schema": { "type": "string" } }],
            "responses": { "200": { "description": "The scene." } } } },
    });
    document
}

const STATES: [&str; 5] = ["queued", "running", "succeeded", "failed", "cancelled"];

fn unknown(what: &str, id: &str) -> Response {
    let problem = json!({ "type": "/problems/not-found", "title": "Not found", "status": 404,
        "detail": format!("there is no {what} {id}") });
    let media_type = [(header::CONTENT_TYPE, "application/problem+json")];
    (StatusCode::NOT_FOUND, media_type, problem.to_string()).into_response()
}

fn page<T>(items: Vec<T>, next: Option<&str>) -> Json<Page<T>> {
    Json(Page { items, next_cursor: next.map(str::to_owned) })
}

/// The API. Without `scenes`, one in which nothing has happened yet.
pub(crate) fn api(scenes: bool) -> Router {
    let all = move || if scenes { vec![scene("s1", "64 bunnies <script>"), scene("s2", "Teapot")] } else { vec![] };
    let jobs = move || -> Vec<JobSummary> {
        let ids = STATES.iter().filter(|_| scenes);
        ids.map(|state| job(&format!("j-{state}"), state).summary).collect()
    };
    Router::new()
        .route("/v1/status", get(move || async move { Json(status(u64::from(scenes) * 2)) }))
        .route("/v1/jobs", get(move || async move { page(jobs(), scenes.then_some("next/1")) }))
        .route(
            "/v1/jobs/{id}",
            get(|Path(id): Path<String>| async move {
                match STATES.iter().find(|state| id == format!("j-{state}")) {
                    Some(state) => Json(job(&id, state)).into_response(),
                    None => unknown("job", &id),
                }
            }),
        )
        .route("/v1/scenes", get(move || async move { page(all(), None) }))
        .route(
            "/v1/scenes/{id}",
            get(|Path(id): Path<String>| async move {
                match id.as_str() {
                    "s1" => Json(scene("s1", "64 bunnies <script>")).into_response(),
                    _ => unknown("scene", &id),
                }
            }),
        )
        .route(
            "/v1/workers",
            get(move || async move {
                page(if scenes { vec![worker("w1", "busy"), worker("w0", "gone")] } else { vec![] }, None)
            }),
        )
        .route("/v1/queue", get(move || async move { Json(queue(scenes)) }))
        .route("/v1/jobs/{id}/artifacts/results.json", get(|| async { Json(benchmark_results()) }))
        .route("/metrics", get(|| async { METRICS }))
        .route(
            "/v1/meshes",
            get(move || async move { page(if scenes { vec![mesh()] } else { vec![] }, scenes.then_some(HASH)) }),
        )
        .route(
            "/v1/meshes/{hash}",
            get(|Path(hash): Path<String>| async move {
                if hash == HASH { Json(mesh()).into_response() } else { unknown("mesh", &hash) }
            }),
        )
        .route(
            "/v1/farm/runs",
            get(move || async move { page(if scenes { vec![run().summary] } else { vec![] }, scenes.then_some("next/1")) }),
        )
        .route(
            "/v1/farm/runs/{id}",
            get(|Path(id): Path<String>| async move {
                if id == "r1" { Json(run()).into_response() } else { unknown("run", &id) }
            }),
        )
        .route("/v1/farm/history", get(|| async { Json(history()) }))
        .route(
            "/v1/farm/decisions",
            get(move || async move {
                let decisions: Vec<Decision> = if scenes { vec![typed(decision("rejected"))] } else { vec![] };
                page(decisions, None)
            }),
        )
        .route(
            "/v1/farm/schedules",
            get(move || async move {
                let schedules: Vec<Schedule> = if scenes { vec![typed(schedule())] } else { vec![] };
                page(schedules, None)
            }),
        )
        .route(
            "/v1/farm/webhooks",
            get(move || async move {
                let webhooks: Vec<Webhook> = if scenes { vec![typed(webhook())] } else { vec![] };
                page(webhooks, None)
            }),
        )
        .route(
            "/v1/farm/webhooks/{id}",
            get(|Path(id): Path<String>| async move {
                if id == "w1" { Json(webhook()).into_response() } else { unknown("webhook", &id) }
            }),
        )
        .route(
            "/v1/farm/webhooks/{id}/deliveries",
            get(|| async { page(vec![typed::<WebhookDelivery>(delivery())], Some("next/1")) }),
        )
        .route(
            "/v1/farm/suites/{id}",
            get(|| async {
                Json(json!({ "id": "su1", "name": "generated", "description": "", "hash": HASH, "cases": [],
                    "scenes": { "box <b>": { "file": null, "generate": "cornell-box" } },
                    "created_at": "2026-11-22T10:00:00Z" }))
            }),
        )
        .route(
            "/v1/farm/suites",
            get(move || async move {
                let suite: SuiteSummary = typed(json!({ "id": "su1", "name": "generated", "description": "all <b>scenes</b>",
                    "hash": HASH, "cases": 2, "created_at": "2026-11-22T10:00:00Z" }));
                page(if scenes { vec![suite] } else { vec![] }, None)
            }),
        )
        .route("/openapi.json", get(|| async { Json(document()) }))
}
