//! Runs and calibrations: made, read, cancelled.

use std::collections::{BTreeMap, BTreeSet};

use lightshaft_api::farm::{
    Calibration, CalibrationCase, NewCalibration, NewRun, Run, RunCase, RunKind, RunState, RunSummary, SettingsPatch,
    Suite, SuiteTestCase,
};
use lightshaft_api::job::{JobKind, NewJob};
use lightshaft_api::problem::{FieldError, escape_pointer};
use lightshaft_api::read::from_value;
use lightshaft_api::settings::RenderSettings;
use lightshaft_compare::timing;
use serde_json::{Map, Value};
use uuid::Uuid;

use super::super::App;
use super::super::jobs::key_reused;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::store::{CaseRecord, Creation, Idempotency, PageRequest, RunQuery, RunRecord};

/// Wrong fields that one answer names at most: a suite may have a thousand cases.
const MOST_ERRORS: usize = 32;

/// Runs deleted in one go.
const DELETE_BATCH: u32 = 100;

/// What a run makes of a suite.
struct Wanted<'a> {
    scenes: &'a BTreeMap<String, String>,
    overrides: &'a SettingsPatch,
    /// All when empty.
    cases: &'a [String],
    priority: i32,
}

impl App {
    /// A run, and whether this call began it.
    pub async fn create_run(&self, new: &NewRun, key: Option<&str>) -> ApiResult<(Run, bool)> {
        let idempotency = key.map(|key| self.idempotency(key, new)).transpose()?;
        // A repeated request is answered before anything is checked: a scene may be gone by now.
        if let Some(idempotency) = &idempotency
            && let Some(creation) = self.store.repeated_run(idempotency).await?
        {
            return self.begun(creation, "").await;
        }
        let wanted =
            Wanted { scenes: &new.scenes, overrides: &new.overrides, cases: &new.cases, priority: new.priority };
        let (suite, cases) = self.check_run(&new.suite, &wanted, new.validate()).await?;
        let record = RunRecord {
            id: Uuid::now_v7().to_string(),
            kind: RunKind::Check,
            suite: suite.id,
            suite_name: suite.name,
            label: new.label.clone(),
            labels: new.labels.clone(),
            baseline: new.baseline.clone(),
            scenes: new.scenes.clone(),
            overrides: new.overrides.clone(),
            priority: new.priority,
            times: 1,
            cases,
        };
        self.begin_run(&record, idempotency.as_ref()).await
    }

    pub async fn create_calibration(&self, new: &NewCalibration) -> ApiResult<Calibration> {
        let wanted =
            Wanted { scenes: &new.scenes, overrides: &new.overrides, cases: &new.cases, priority: new.priority };
        let (suite, cases) = self.check_run(&new.suite, &wanted, new.validate()).await?;
        let record = RunRecord {
            id: Uuid::now_v7().to_string(),
            kind: RunKind::Calibration,
            suite: suite.id,
            suite_name: suite.name,
            label: new.label.clone(),
            labels: new.labels.clone(),
            baseline: lightshaft_api::farm::DEFAULT_BASELINE.to_owned(),
            scenes: new.scenes.clone(),
            overrides: new.overrides.clone(),
            priority: new.priority,
            times: new.times,
            cases,
        };
        self.begin_run(&record, None).await?;
        self.calibration(&record.id).await
    }

    /// Everything that is wrong with a run.
    pub(super) async fn run_errors(&self, new: &NewRun) -> ApiResult<Vec<FieldError>> {
        let wanted =
            Wanted { scenes: &new.scenes, overrides: &new.overrides, cases: &new.cases, priority: new.priority };
        Ok(self.try_run(&new.suite, &wanted, new.validate()).await?.err().unwrap_or_default())
    }

    async fn begin_run(&self, record: &RunRecord, idempotency: Option<&Idempotency>) -> ApiResult<(Run, bool)> {
        let creation = self.store.create_run(record, idempotency, self.now()).await?;
        if creation == Creation::Created {
            tracing::info!(run.id = %record.id, kind = record.kind.as_str(), cases = record.cases.len(), "farm run begun");
            self.changed();
        }
        self.begun(creation, &record.id).await
    }

    async fn begun(&self, creation: Creation, id: &str) -> ApiResult<(Run, bool)> {
        match creation {
            Creation::Created => Ok((self.run(id).await?, true)),
            Creation::Repeated(id) => Ok((self.run(&id).await?, false)),
            Creation::KeyReused => Err(key_reused("run")),
            Creation::UnknownScene => Err(ApiError::new(Code::WrongState, "a scene was deleted meanwhile")),
        }
    }

    pub async fn run(&self, id: &str) -> ApiResult<Run> {
        self.store.run(id).await?.ok_or_else(|| ApiError::not_found("run", id))
    }

    pub async fn runs(&self, query: &RunQuery, page: &PageRequest) -> ApiResult<Vec<RunSummary>> {
        Ok(self.store.runs(query, page).await?)
    }

    pub async fn cancel_run(&self, id: &str) -> ApiResult<Run> {
        match self.store.cancel_run(id, self.now()).await? {
            None => Err(ApiError::not_found("run", id)),
            Some(RunState::Finished | RunState::Running) => {
                Err(ApiError::new(Code::WrongState, "the run has finished: only running ones can be cancelled"))
            }
            Some(RunState::Cancelled) => {
                self.changed();
                self.run(id).await
            }
        }
    }

    /// Deletes runs beyond those that are kept of each suite, at most a batch; returns how many.
    pub async fn delete_old_runs(&self) -> ApiResult<usize> {
        let Some(keep) = self.config.keep_runs else { return Ok(0) };
        let old = self.store.old_runs(keep, DELETE_BATCH).await?;
        for id in &old {
            let blobs = self.store.delete_run(id).await?;
            tracing::info!(run.id = %id, "farm run deleted");
            self.discard(blobs);
        }
        Ok(old.len())
    }

    pub async fn calibration(&self, id: &str) -> ApiResult<Calibration> {
        let times = self.store.calibration_times(id).await?.ok_or_else(|| ApiError::not_found("calibration", id))?;
        let Run { summary, cases, .. } = self.run(id).await?;
        Ok(Calibration {
            id: summary.id,
            suite: summary.suite,
            suite_name: summary.suite_name,
            label: summary.label,
            labels: summary.labels,
            times,
            state: summary.state,
            cases: cases.into_iter().map(calibrated).collect(),
            created_at: summary.created_at,
            finished_at: summary.finished_at,
        })
    }

    async fn check_run(
        &self,
        suite: &str,
        wanted: &Wanted<'_>,
        errors: Vec<FieldError>,
    ) -> ApiResult<(Suite, Vec<CaseRecord>)> {
        self.check_running()?;
        self.try_run(suite, wanted, errors).await?.map_err(ApiError::fields)
    }

    /// The suite and the cases of a run, with scenes found and settings checked; or what is wrong with them.
    async fn try_run(
        &self,
        suite: &str,
        wanted: &Wanted<'_>,
        mut errors: Vec<FieldError>,
    ) -> ApiResult<Result<(Suite, Vec<CaseRecord>), Vec<FieldError>>> {
        let Some(suite) = self.store.suite(suite).await? else {
            errors.push(FieldError::new("/suite", "there is no such suite"));
            return Ok(Err(errors));
        };
        let names: BTreeSet<&str> = suite.cases.iter().map(|case| case.name.as_str()).collect();
        for (i, name) in wanted.cases.iter().enumerate().filter(|(_, name)| !names.contains(name.as_str())) {
            errors.push(FieldError::new(format!("/cases/{i}"), format!("the suite has no case `{name}`")));
        }
        let used: BTreeSet<&str> = suite.cases.iter().map(|case| case.scene.as_str()).collect();
        for name in wanted.scenes.keys().filter(|name| !used.contains(name.as_str())) {
            let detail = "no case of the suite uses a scene of this name";
            errors.push(FieldError::new(format!("/scenes/{}", escape_pointer(name)), detail));
        }
        let mut records = Vec::new();
        let chosen = |case: &&SuiteTestCase| wanted.cases.is_empty() || wanted.cases.contains(&case.name);
        for case in suite.cases.iter().filter(chosen) {
            records.extend(self.check_case(case, wanted, &mut errors).await?);
            if errors.len() >= MOST_ERRORS {
                break;
            }
        }
        Ok(if errors.is_empty() { Ok((suite, records)) } else { Err(errors) })
    }

    async fn check_case(
        &self,
        case: &SuiteTestCase,
        wanted: &Wanted<'_>,
        errors: &mut Vec<FieldError>,
    ) -> ApiResult<Option<CaseRecord>> {
        let mut complain = |pointer: String, detail: String| {
            if !errors.iter().any(|known| known.pointer == pointer) {
                errors.push(FieldError::new(pointer, detail));
            }
        };
        let mapped = wanted.scenes.get(&case.scene);
        let id = mapped.unwrap_or(&case.scene);
        let scene = match self.store.scene(id).await? {
            Some(scene) => Some(scene),
            None => self.store.scene_by_hash(id).await?,
        };
        let Some(scene) = scene else {
            let pointer = format!("/scenes/{}", escape_pointer(&case.scene));
            let detail = match mapped {
                Some(_) => "there is no such scene".to_owned(),
                None => format!("must be the id of a scene: case `{}` needs it", case.name),
            };
            complain(pointer, detail);
            return Ok(None);
        };
        let settings = match with_overrides(&case.settings, wanted.overrides)? {
            Ok(settings) => settings,
            Err(wrong) => {
                wrong.into_iter().for_each(|error| complain(format!("/overrides{}", error.pointer), error.detail));
                return Ok(None);
            }
        };
        let job = new_job(&scene.id, &settings, wanted.priority);
        let wrong = self.job_errors(&job).await?;
        if settings.time_limit_s.is_some() {
            complain(
                "/overrides/time_limit_s".to_owned(),
                "must be null: what is compared must have all its samples".to_owned(),
            );
        }
        for error in wrong.iter().filter(|error| error.pointer != "/priority") {
            let field = error.pointer.trim_start_matches("/settings");
            let overridden = field.split('/').nth(1).is_some_and(|name| wanted.overrides.0.contains_key(name));
            let below = if overridden { "/overrides" } else { "/suite" };
            complain(format!("{below}{field}"), format!("{} (case `{}`)", error.detail, case.name));
        }
        let record = CaseRecord {
            name: case.name.clone(),
            scene: scene.id,
            settings,
            device_class: case.device_class.clone(),
            repeat: case.repeat,
            tolerance: case.image.clone(),
            time_tolerance: case.time.clone(),
        };
        Ok(wrong.is_empty().then_some(record))
    }
}

fn new_job(scene: &str, settings: &RenderSettings, priority: i32) -> NewJob {
    NewJob {
        kind: JobKind::Render,
        scene: scene.to_owned(),
        priority,
        labels: BTreeMap::new(),
        max_attempts: None,
        settings: settings.clone().into(),
    }
}

/// The settings with the overrides in front, or which of these are wrong.
fn with_overrides(
    settings: &RenderSettings,
    overrides: &SettingsPatch,
) -> ApiResult<Result<RenderSettings, Vec<FieldError>>> {
    if overrides.is_empty() {
        return Ok(Ok(settings.clone()));
    }
    let fields: Map<String, Value> = match serde_json::to_value(settings).map_err(ApiError::internal)? {
        Value::Object(fields) => fields,
        _ => Map::new(),
    };
    let mut fields = fields;
    overrides.apply(&mut fields);
    Ok(from_value(Value::Object(fields)))
}

/// What a case of a calibration says of noise.
fn calibrated(case: RunCase) -> CalibrationCase {
    let samples = case.time.as_ref().map(|time| time.samples_s.clone()).unwrap_or_default();
    let medians = medians_of_runs(&samples, case.repeat);
    CalibrationCase {
        metric: case.time_tolerance.metric(),
        noise_floor: timing::noise_floor(&medians),
        medians_s: medians,
        steady: case.image.filter(|_| case.tolerance.z_test().is_none()).map(|image| !image.unsteady),
        case: case.name,
        device_class: case.device_class,
    }
}

/// The median of each run of `repeat` samples.
pub(super) fn medians_of_runs(samples: &[f64], repeat: u32) -> Vec<f64> {
    samples.chunks_exact(repeat.max(1) as usize).filter_map(timing::median).collect()
}
