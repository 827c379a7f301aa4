//! The regression farm with real workers: baseline, harmless change, broken shading, slow-down, approval.

use lightshaft_tests::{Service, picture};
use reqwest::Method;
use serde_json::{Value, json};

const SUITE: &str = r#"
    name = "still life"
    [scenes.demo]
    generate = "demo"
    [[case]]
    name = "path"
    scene = "demo"
    device = "cpu"
    settings = { width = 48, height = 36, spp = 16 }
    image = { max_flip = 0.3 }
    # Other tests keep the machine busy: only what takes several times as long is slower.
    time = { max_ratio = 3 }
"#;

/// A service with a worker, the demo scene, and a suite of one case.
pub(crate) struct Farm {
    pub(crate) service: Service,
    suite: String,
    scene: String,
}

impl Farm {
    pub(crate) async fn start(suite: &str) -> Self {
        let service = Service::start_with(&["--no-thumbnails"]);
        let scene = service.generated(&["demo"]).await;
        let request = service.request(Method::POST, "/v1/farm/suites").header("content-type", "application/toml");
        let reply = service.send(request.body(suite.to_owned())).await;
        assert_eq!(reply.status, 201, "{}", reply.text());
        let suite = reply.json()["id"].as_str().expect("a suite has an id").to_owned();
        Self { service, suite, scene }
    }

    pub(crate) async fn begin(&self, label: &str, overrides: &Value) -> String {
        self.begin_at("/v1/farm/runs", label, &json!({ "overrides": overrides })).await
    }

    pub(crate) async fn begin_at(&self, path: &str, label: &str, more: &Value) -> String {
        let mut body = json!({ "suite": self.suite, "label": label, "scenes": { "demo": self.scene } });
        let fields = body.as_object_mut().expect("an object");
        fields.extend(more.as_object().expect("an object").clone());
        let reply = self.service.post(path, &body).await;
        assert_eq!(reply.status, 201, "{}", reply.text());
        reply.json()["id"].as_str().expect("a run has an id").to_owned()
    }

    pub(crate) async fn finished(&self, run: &str) -> Value {
        self.service
            .until("the run to finish", async || {
                let run = self.service.get(&format!("/v1/farm/runs/{run}")).await.json();
                (run["state"] == "finished").then_some(run)
            })
            .await
    }

    pub(crate) async fn run(&self, label: &str, overrides: Value) -> Value {
        self.finished(&self.begin(label, &overrides).await).await
    }

    pub(crate) async fn approve(&self, run: &Value, why: &str) {
        let path = format!("/v1/farm/runs/{}/approve", run["id"].as_str().expect("an id"));
        let reply = self.service.post(&path, &json!({ "who": "Ada", "why": why })).await;
        assert_eq!(reply.status, 200, "{}", reply.text());
        assert_eq!(reply.json()["items"].as_array().map(Vec::len), Some(1), "{}", reply.text());
    }
}

#[tokio::test]
async fn what_breaks_is_found_and_what_is_meant_is_approved() {
    let farm = Farm::start(SUITE).await;
    let base = farm.run("base", json!({})).await;
    assert_eq!((&base["ok"], &base["cases"][0]["image"]["verdict"]), (&json!(false), &json!("missing")), "{base:#}");
    farm.approve(&base, "first pictures").await;

    let same = farm.run("unchanged", json!({})).await;
    assert_eq!((&same["ok"], &same["cases"][0]["image"]["verdict"]), (&json!(true), &json!("identical")), "{same:#}");

    let harmless = farm.run("another seed", json!({ "seed": 2 })).await;
    let image = &harmless["cases"][0]["image"];
    assert_eq!((&harmless["ok"], &image["verdict"]), (&json!(true), &json!("within_tolerance")), "{harmless:#}");

    let broken = farm.run("no bounces", json!({ "max_bounces": 0 })).await;
    let case = &broken["cases"][0];
    assert_eq!((&broken["ok"], &case["image"]["verdict"]), (&json!(false), &json!("changed")), "{broken:#}");
    assert!(case["image"]["reason"].as_str().is_some_and(|reason| reason.contains("mean FLIP")), "{case:#}");
    let artifacts = case["artifacts"].as_array().expect("pictures");
    for name in ["accepted.png", "difference.png", "heat-map.png", "image.png"] {
        let artifact = artifacts.iter().find(|artifact| artifact["name"] == name).expect(name);
        let shown = picture::png(&farm.service.get(artifact["href"].as_str().expect("an address")).await.body);
        if name == "heat-map.png" {
            assert!(shown.width() > 48 && shown.height() > 36, "a scale bar stands beside the map");
        } else {
            assert_eq!((shown.width(), shown.height()), (48, 36), "{name}");
        }
        assert!(picture::shows_something(&shown), "{name}");
    }

    let coarse = json!({ "acceleration": { "structure": "grid", "resolution": 48 } });
    let slow = farm.run("coarse grid", coarse.clone()).await;
    let time = &slow["cases"][0]["time"];
    assert_eq!((&slow["ok"], &time["verdict"]), (&json!(false), &json!("slower")), "{time:#}");
    assert_eq!(time["confirmation"]["state"], "confirmed", "{time:#}");
    assert!(time["confirmation"]["ratio"]["value"].as_f64().is_some_and(|ratio| ratio > 3.0), "{time:#}");

    farm.approve(&slow, "smaller structures are worth it").await;
    let green = farm.run("coarse grid, again", coarse).await;
    assert_eq!(green["ok"], true, "{green:#}");

    let history = farm.service.get("/v1/farm/history?suite=still%20life&case=path").await.json();
    assert_eq!(history["points"].as_array().map(Vec::len), Some(6), "{history:#}");
    let decisions: Vec<&Value> =
        history["decisions"].as_array().expect("decisions").iter().map(|one| &one["why"]).collect();
    assert_eq!(decisions, ["smaller structures are worth it", "first pictures"]);
}

#[tokio::test]
async fn a_run_goes_on_after_the_service_was_killed() {
    let mut farm = Farm::start(SUITE).await;
    let run = farm.begin("base", &json!({ "spp": 256 })).await;
    farm.service
        .until("a sample to be made", async || {
            let run = farm.service.get(&format!("/v1/farm/runs/{run}")).await.json();
            run["cases"][0]["jobs"].as_array().filter(|jobs| jobs.len() > 1).map(|_| ())
        })
        .await;
    farm.service.kill_and_restart();
    let ended = farm.finished(&run).await;
    let jobs = ended["cases"][0]["jobs"].as_array().expect("jobs");
    assert_eq!((jobs.len(), &ended["cases"][0]["image"]["verdict"]), (4, &json!("missing")), "{ended:#}");
    assert!(jobs.iter().all(|job| job["time_s"].as_f64().is_some_and(|seconds| seconds > 0.0)), "{ended:#}");
}
