//! `/v1/farm`, with a worker whose pictures and times are what the settings say.

mod baselines;
mod runs;
mod schedules;
mod suites;
mod times;
mod webhooks;

use std::collections::BTreeMap;
use std::io::Cursor;

use axum::body::Body;
use http::{Method, StatusCode};
use lightshaft_api::farm::{Calibration, DecisionNote, FarmJobPhase, Run, RunCase, RunState, Suite};
use lightshaft_api::job::Metrics;
use lightshaft_api::lease::{Complete, Lease, NewArtifact};
use lightshaft_api::settings::{JobSettings, RenderSettings};
use lightshaft_server::Config;
use serde_json::{Value, json};

use crate::harness::{Answer, Service};

/// A service with a scene, a suite of one case, and a worker that obeys [`Rendered`].
pub(crate) struct Farm {
    pub(crate) service: Service,
    pub(crate) scene: String,
    pub(crate) worker: String,
}

/// What the worker makes of a job.
pub(crate) struct Rendered {
    grey: u8,
    render_s: f64,
    build: String,
}

/// A picture as grey as `exposure` says, in a tenth of a second for each sample.
pub(crate) fn honest(settings: &RenderSettings, _: Option<FarmJobPhase>) -> Rendered {
    Rendered {
        grey: (100.0 + settings.exposure) as u8,
        render_s: 0.1 * f64::from(settings.spp),
        build: "one".to_owned(),
    }
}

pub(crate) const SUITE: &str = r#"
    name = "small"
    [scenes.triangle]
    file = "triangle.glb"
    [defaults.settings]
    width = 8
    height = 8
    spp = 4
    outputs = ["png"]
    [[case]]
    name = "plain"
    scene = "triangle"
    image = { max_rmse = 0.02 }
"#;

impl Farm {
    pub(crate) async fn start() -> Self {
        Self::start_with(|_| {}).await
    }

    pub(crate) async fn start_with(configure: impl FnOnce(&mut Config)) -> Self {
        let service = Service::start_with(configure).await;
        let scene = service.scene(0).await;
        let worker = service.worker(&["cpu"]).await;
        Self { service, scene, worker }
    }

    pub(crate) async fn post_toml(&self, text: &str) -> Answer {
        let toml = [("content-type", "application/toml")];
        self.service.request(Method::POST, "/v1/farm/suites", &toml, Body::from(text.to_owned())).await
    }

    pub(crate) async fn suite(&self, text: &str) -> String {
        let answer = self.post_toml(text).await;
        assert!(answer.status.is_success(), "{}", String::from_utf8_lossy(&answer.body));
        answer.json::<Suite>().id
    }

    pub(crate) async fn begin(&self, label: &str, more: Value) -> Run {
        let suite = self.suite(SUITE).await;
        self.begin_of(&suite, label, more).await
    }

    pub(crate) async fn begin_of(&self, suite: &str, label: &str, more: Value) -> Run {
        let mut body = json!({ "suite": suite, "label": label, "scenes": { "triangle": self.scene } });
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        let answer = self.service.post("/v1/farm/runs", body).await;
        assert_eq!(answer.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&answer.body));
        let run: Run = answer.json();
        assert_eq!(answer.header("location"), format!("/v1/farm/runs/{}", run.summary.id));
        run
    }

    pub(crate) async fn read(&self, run: &str) -> Run {
        self.service.get(&format!("/v1/farm/runs/{run}")).await.json()
    }

    /// A run with these overrides, worked off by the honest worker.
    pub(crate) async fn run(&self, label: &str, overrides: Value) -> Run {
        let run = self.begin(label, json!({ "overrides": overrides })).await;
        self.work_off(&run.summary.id, honest).await
    }

    /// Renders what there is to do until the run has ended.
    pub(crate) async fn work_off(
        &self,
        run: &str,
        render: impl Fn(&RenderSettings, Option<FarmJobPhase>) -> Rendered,
    ) -> Run {
        for _ in 0..50 {
            self.service.app.follow_farm().await.unwrap();
            while let Some(lease) = self.service.lease(&self.worker).await {
                self.complete(&lease, &render).await;
            }
            let run = self.read(run).await;
            if run.summary.state != RunState::Running {
                return run;
            }
        }
        panic!("the run does not end: {:#?}", self.read(run).await);
    }

    async fn complete(&self, lease: &Lease, render: &impl Fn(&RenderSettings, Option<FarmJobPhase>) -> Rendered) {
        let JobSettings::Render(settings) = &lease.settings else { panic!("{:?}", lease.settings) };
        let job = self.service.read_job(&lease.job).await;
        let phase = job.summary.labels.get("farm_phase").and_then(|name| FarmJobPhase::from_name(name));
        let rendered = render(settings, phase);
        let png = png(rendered.grey);
        let stored = self.service.request(Method::POST, "/v1/blobs", &[], Body::from(png.clone())).await;
        let artifact = NewArtifact {
            name: "image.png".to_owned(),
            media_type: "image/png".to_owned(),
            bytes: png.len() as u64,
            blob: stored.json::<Value>()["hash"].as_str().unwrap().to_owned(),
        };
        let metrics = Metrics {
            render_s: rendered.render_s,
            device: "AVX2".to_owned(),
            device_kind: "cpu".to_owned(),
            versions: BTreeMap::from([("build".to_owned(), rendered.build)]),
            ..Metrics::default()
        };
        let report = Complete { artifacts: vec![artifact], metrics };
        let answer = self.service.report(lease, "complete", serde_json::to_value(report).unwrap()).await;
        assert_eq!(answer.status, StatusCode::OK, "{}", String::from_utf8_lossy(&answer.body));
    }

    pub(crate) async fn decide(&self, run: &Run, case: &str, what: &str) -> Answer {
        let note = DecisionNote { who: "Ada".to_owned(), why: "as intended".to_owned() };
        let path = format!("/v1/farm/runs/{}/cases/{case}/{what}", run.summary.id);
        self.service.post(&path, json!(note)).await
    }

    /// A run whose picture and times are accepted.
    pub(crate) async fn baseline(&self) -> Run {
        let run = self.run("base", json!({})).await;
        assert_eq!(self.decide(&run, "plain", "approve").await.status, StatusCode::OK);
        run
    }

    pub(crate) async fn calibrate(
        &self,
        times: u32,
        render: impl Fn(&RenderSettings, Option<FarmJobPhase>) -> Rendered,
    ) -> Calibration {
        let suite = self.suite(SUITE).await;
        let body = json!({ "suite": suite, "label": "base", "times": times, "scenes": { "triangle": self.scene } });
        let answer = self.service.post("/v1/farm/calibrations", body).await;
        assert_eq!(answer.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&answer.body));
        let id = answer.json::<Calibration>().id;
        self.work_off(&id, render).await;
        self.service.get(&format!("/v1/farm/calibrations/{id}")).await.json()
    }
}

fn png(grey: u8) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image::RgbImage::from_pixel(8, 8, image::Rgb([grey; 3])).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// The one case of a run.
pub(crate) fn only(run: &Run) -> &RunCase {
    assert_eq!(run.cases.len(), 1);
    &run.cases[0]
}
