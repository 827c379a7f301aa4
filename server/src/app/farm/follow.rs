//! Takes running runs further, case by case: makes jobs, follows them, judges what they left.
//!
//! A chore without memory: each look begins from what the store holds, and each step is one guarded transaction that also
//! makes the step's jobs. So a service that is killed between any two goes on where it was.
//!
//! The first job of a case goes to any worker, warms up and is not timed; all others demand the worker that did it, since
//! only times of one machine can be compared. Should that worker leave, the case begins anew.

use std::collections::BTreeMap;

use lightshaft_api::farm::{
    CaseState, Confirmation, ConfirmationState, FarmJobPhase, ImageResult, ImageVerdict, RunKind, TimeMetric,
    TimeResult,
};
use lightshaft_api::job::{Artifact, AttemptOutcome, Job, JobState, Metrics};
use lightshaft_api::settings::RenderSettings;
use lightshaft_api::worker::WorkerState;
use lightshaft_compare::timing;
use uuid::Uuid;

use super::super::App;
use super::super::jobs::DEFAULT_MAX_ATTEMPTS;
use super::runs::medians_of_runs;
use crate::error::ApiResult;
use crate::farm::{CONFIRMATION_PAIRS, JudgedTime, confirm, judge_time, not_judged, passes, unconfirmable};
use crate::queue::plan;
use crate::store::{BaselineKey, CaseJob, CaseStep, JobRecord, OpenCase, Reference, ReferenceTimes, Step};
use crate::web::context;

/// How often a case may begin anew because its worker left.
const MOST_GENERATIONS: u32 = 3;
/// Accepted runs whose times count, the newest first.
const MOST_ACCEPTED_TIMES: usize = 5;

/// A case's jobs as they are now.
enum Jobs {
    /// Some are unfinished; how long those took that have ended since the last look.
    Open {
        times_s: Vec<(String, f64)>,
    },
    Succeeded {
        times_s: Vec<(String, f64)>,
    },
    /// One failed, was cancelled or deleted: why.
    Failed(String),
}

impl App {
    /// Takes every open case one step further. What fails at one of them does not keep the others.
    pub async fn follow_farm(&self) -> ApiResult<()> {
        for case in self.store.open_cases().await? {
            if let Err(error) = self.follow_case(&case).await {
                tracing::error!(run.id = %case.run, error = %error, "a case of the farm could not be taken further");
            }
        }
        Ok(())
    }

    async fn follow_case(&self, case: &OpenCase) -> ApiResult<()> {
        let Some(step) = self.next_step(case).await? else { return Ok(()) };
        {
            // What nothing else names any more (somebody deleted the job) counts as put now, until the step has named it.
            let _in_use = self.blob_use.read().await;
            for artifact in &step.artifacts {
                self.blobs.touch(&artifact.hash).await.map_err(crate::error::ApiError::internal)?;
            }
        }
        match self.store.step_case(case, &step, self.now()).await? {
            Step::Done => {
                if step.state == Some(CaseState::Finished) {
                    tracing::info!(run.id = %case.run, ok = step.ok, "a case of the farm has its verdict");
                }
                self.changed();
            }
            Step::Overtaken => {}
            Step::SceneGone => {
                self.store.step_case(case, &failed("its scene was deleted"), self.now()).await?;
                self.changed();
            }
        }
        Ok(())
    }

    async fn next_step(&self, case: &OpenCase) -> ApiResult<Option<CaseStep>> {
        if case.jobs.is_empty() {
            let (phase, position) =
                if has_warm_up(case) { (FarmJobPhase::WarmUp, 0) } else { (FarmJobPhase::Sample, 0) };
            let jobs = vec![case_job(case, phase, position, None)];
            return Ok(Some(CaseStep { jobs, ..CaseStep::default() }));
        }
        let found = self.look_at_jobs(case).await?;
        match (case.state, found) {
            (CaseState::Confirming, Jobs::Failed(why)) => {
                let why = format!("the re-run failed: {why}");
                Ok(Some(finish_confirmation(case, |suspected| unconfirmable(suspected, &why))))
            }
            (CaseState::Confirming, Jobs::Succeeded { times_s }) => Ok(Some(confirmed(case, times_s))),
            (_, Jobs::Failed(why)) => Ok(Some(failed(&why))),
            (_, Jobs::Succeeded { times_s }) => self.after_jobs(case, times_s).await.map(Some),
            (state, Jobs::Open { times_s }) => {
                if self.has_lost_worker(case).await? {
                    return Ok(Some(after_loss(case, state)));
                }
                Ok((!times_s.is_empty()).then(|| CaseStep { times_s, ..CaseStep::default() }))
            }
        }
    }

    async fn look_at_jobs(&self, case: &OpenCase) -> ApiResult<Jobs> {
        let mut times_s = Vec::new();
        let mut is_open = false;
        for farm_job in case.jobs.iter().filter(|job| job.time_s.is_none()) {
            match self.store.job_state(&farm_job.job).await? {
                Some(JobState::Queued | JobState::Running) => is_open = true,
                Some(JobState::Succeeded) => {
                    let job = self.store.job(&farm_job.job).await?;
                    let metrics = job.and_then(|job| job.metrics).unwrap_or_default();
                    times_s.push((farm_job.job.clone(), time_of(case.case.time_tolerance.metric(), &metrics)));
                }
                Some(JobState::Failed) => {
                    let job = self.store.job(&farm_job.job).await?;
                    let why = job.and_then(|job| job.summary.error).unwrap_or_default();
                    return Ok(Jobs::Failed(format!("job {} failed: {why}", farm_job.job)));
                }
                Some(JobState::Cancelled) => return Ok(Jobs::Failed(format!("job {} was cancelled", farm_job.job))),
                None => return Ok(Jobs::Failed(format!("job {} was deleted", farm_job.job))),
            }
        }
        Ok(if is_open { Jobs::Open { times_s } } else { Jobs::Succeeded { times_s } })
    }

    /// All jobs there are have succeeded: the samples follow the first job, and the verdict the samples.
    async fn after_jobs(&self, case: &OpenCase, times_s: Vec<(String, f64)>) -> ApiResult<CaseStep> {
        let mut step = CaseStep { times_s, ..CaseStep::default() };
        if case.worker.is_none()
            && let Some(job) = self.store.job(&case.jobs[0].job).await?
        {
            let metrics = job.metrics.clone().unwrap_or_default();
            step.device_class = Some(case.case.device_class.clone().unwrap_or_else(|| device_class(&metrics)));
            step.worker = only_worker(&job);
            step.versions = Some(metrics.versions);
        }
        let worker = step.worker.as_ref().or(case.worker.as_ref());
        let made = case.jobs.iter().filter(|job| job.phase == FarmJobPhase::Sample).count() as u32;
        let wanted = case.case.repeat * case.times;
        if made < wanted {
            step.jobs = (made..wanted).map(|i| case_job(case, FarmJobPhase::Sample, i, worker.cloned())).collect();
            return Ok(step);
        }
        self.judge(case, step).await
    }

    async fn judge(&self, case: &OpenCase, mut step: CaseStep) -> ApiResult<CaseStep> {
        let class = step.device_class.clone().or_else(|| case.case.device_class.clone()).unwrap_or_default();
        let key = BaselineKey {
            baseline: case.baseline.clone(),
            suite_name: case.suite_name.clone(),
            case: case.case.name.clone(),
            device_class: class,
        };
        let is_check = case.kind == RunKind::Check;
        let reference = if is_check { self.store.reference(&key).await? } else { Reference::default() };
        let mut samples: Vec<Vec<Artifact>> = Vec::new();
        for job in case.jobs.iter().filter(|job| job.phase == FarmJobPhase::Sample) {
            samples.push(self.store.artifacts(&job.job).await?);
        }
        let Some(found) = self.judge_pictures(&case.case.tolerance, &samples, &reference.pictures).await? else {
            return Ok(CaseStep { times_s: step.times_s, ..failed("its jobs left no picture") });
        };
        step.artifacts = found.artifacts;
        let mut image = found.judged.result;
        let times = phase_times(case, &step.times_s, FarmJobPhase::Sample);
        if !is_check {
            return Ok(calibrated(case, step, image, times));
        }
        if image.unsteady {
            let detail = "repetitions with the same seed gave different pixels";
            image.reason = Some(image.reason.map_or_else(|| detail.to_owned(), |reason| format!("{reason}; {detail}")));
        }
        let JudgedTime { result: time, is_suspected } = judge_times(case, &reference, times);
        if is_suspected {
            return self.suspect(case, step, image, time, &reference).await;
        }
        Ok(finished(step, image, Some(time)))
    }

    /// A slow-down is confirmed before it counts: both sides in turns, or the reason why they cannot be.
    async fn suspect(
        &self,
        case: &OpenCase,
        mut step: CaseStep,
        image: ImageResult,
        time: TimeResult,
        reference: &Reference,
    ) -> ApiResult<CaseStep> {
        let worker = step.worker.clone().or_else(|| case.worker.clone());
        let versions = step.versions.as_ref().unwrap_or(&case.versions);
        let (worker, accepted) = match self.confirmable(case, worker, versions, reference).await? {
            Ok(found) => found,
            Err(why) => return Ok(finished(step, image, Some(unconfirmable(time, &why)))),
        };
        for position in 0..=CONFIRMATION_PAIRS {
            let a = job_record(case, &accepted.scene, accepted.settings.clone(), Some(worker.clone()));
            step.jobs.push(CaseJob {
                phase: FarmJobPhase::A,
                position,
                job: labelled(a, case, FarmJobPhase::A, position),
            });
            step.jobs.push(case_job(case, FarmJobPhase::B, position, Some(worker.clone())));
        }
        let confirmation = Confirmation {
            state: ConfirmationState::Running,
            reason: Some(format!("against `{}`, in turns", accepted.label)),
            ..Confirmation::default()
        };
        step.state = Some(CaseState::Confirming);
        step.image = Some(image);
        step.time = Some(TimeResult { confirmation, ..time });
        Ok(step)
    }

    /// The worker for the re-run and what the baseline's side renders, or why there can be none.
    async fn confirmable<'a>(
        &self,
        case: &OpenCase,
        worker: Option<String>,
        versions: &BTreeMap<String, String>,
        reference: &'a Reference,
    ) -> ApiResult<Result<(String, &'a ReferenceTimes), String>> {
        let metric = case.case.time_tolerance.metric();
        let Some(accepted) = reference.times.iter().find(|times| times.metric == metric) else {
            return Ok(Err("the baseline has no times of this metric".to_owned()));
        };
        let Some(worker) = worker else {
            return Ok(Err("it was rendered by several workers at once".to_owned()));
        };
        if self.store.scene(&accepted.scene).await?.is_none() {
            return Ok(Err(format!("the scene of the baseline's run `{}` was deleted", accepted.label)));
        }
        if accepted.versions != *versions {
            let detail = format!(
                "what rendered the baseline's run `{}` is gone: {}",
                accepted.label,
                differing(&accepted.versions, versions)
            );
            return Ok(Err(detail));
        }
        Ok(Ok((worker, accepted)))
    }

    /// Whether jobs wait for a worker that is not there any more.
    async fn has_lost_worker(&self, case: &OpenCase) -> ApiResult<bool> {
        let Some(id) = &case.worker else { return Ok(false) };
        match self.store.worker(id).await? {
            Some(_) => Ok(self.worker(id).await?.state == WorkerState::Gone),
            None => Ok(true),
        }
    }
}

fn has_warm_up(case: &OpenCase) -> bool {
    case.case.repeat * case.times > 1
}

fn case_job(case: &OpenCase, phase: FarmJobPhase, position: u32, worker: Option<String>) -> CaseJob {
    let mut settings = case.case.settings.clone();
    if phase == FarmJobPhase::Sample && case.case.tolerance.z_test().is_some() {
        settings.seed = settings.seed.wrapping_add(position);
    }
    let job = job_record(case, &case.case.scene, settings, worker);
    CaseJob { phase, position, job: labelled(job, case, phase, position) }
}

fn job_record(case: &OpenCase, scene: &str, settings: RenderSettings, worker: Option<String>) -> JobRecord {
    let settings = settings.into();
    JobRecord {
        id: Uuid::now_v7().to_string(),
        scene: scene.to_owned(),
        priority: case.priority,
        max_attempts: DEFAULT_MAX_ATTEMPTS,
        labels: BTreeMap::new(),
        tasks: plan(&settings),
        settings,
        trace_id: context::trace_id(),
        automatic: None,
        worker,
    }
}

fn labelled(job: JobRecord, case: &OpenCase, phase: FarmJobPhase, position: u32) -> JobRecord {
    let labels = BTreeMap::from([
        ("farm_run".to_owned(), case.run.clone()),
        ("farm_case".to_owned(), case.case.name.clone()),
        ("farm_phase".to_owned(), phase.as_str().to_owned()),
        ("farm_repetition".to_owned(), position.to_string()),
    ]);
    JobRecord { labels, ..job }
}

fn time_of(metric: TimeMetric, metrics: &Metrics) -> f64 {
    match metric {
        TimeMetric::RenderS => metrics.render_s,
        TimeMetric::BuildS => metrics.build_s,
        TimeMetric::PrepareS => metrics.prepare_s,
        TimeMetric::TotalS => metrics.total_s,
    }
}

/// What baselines know a device by, where the suite does not say.
fn device_class(metrics: &Metrics) -> String {
    format!("{}: {}", metrics.device_kind, metrics.device)
}

/// The one worker whose attempts made the picture; `None` when several did.
fn only_worker(job: &Job) -> Option<String> {
    let mut workers = job.attempts.iter().filter(|one| one.outcome == AttemptOutcome::Succeeded).map(|one| &one.worker);
    let first = workers.next()?;
    workers.all(|worker| worker == first).then(|| first.clone())
}

/// Seconds of a phase's jobs in their order, of which some may have ended just now.
fn phase_times(case: &OpenCase, just_now: &[(String, f64)], phase: FarmJobPhase) -> Vec<f64> {
    let mut times: Vec<(u32, f64)> = case
        .jobs
        .iter()
        .filter(|job| job.phase == phase)
        .filter_map(|job| {
            let found = just_now.iter().find(|(id, _)| *id == job.job).map(|(_, seconds)| *seconds);
            Some((job.position, job.time_s.or(found)?))
        })
        .collect();
    times.sort_by_key(|(position, _)| *position);
    times.into_iter().map(|(_, seconds)| seconds).collect()
}

fn judge_times(case: &OpenCase, reference: &Reference, samples: Vec<f64>) -> JudgedTime {
    let metric = case.case.time_tolerance.metric();
    let of_metric = reference.times.iter().filter(|times| times.metric == metric).take(MOST_ACCEPTED_TIMES);
    let baseline: Vec<f64> = of_metric.flat_map(|times| times.samples_s.iter().copied()).collect();
    let floor = reference.noise_floors.iter().find(|(of, _)| *of == metric).map(|(_, floor)| *floor);
    judge_time(&case.case.time_tolerance, samples, &baseline, floor)
}

fn finished(step: CaseStep, image: ImageResult, time: Option<TimeResult>) -> CaseStep {
    CaseStep {
        state: Some(CaseState::Finished),
        ok: Some(passes(&image, time.as_ref())),
        image: Some(image),
        time,
        ..step
    }
}

fn failed(why: &str) -> CaseStep {
    let image = ImageResult {
        verdict: ImageVerdict::Failed,
        reason: Some(why.to_owned()),
        pixels: None,
        source: None,
        accepted: None,
        figures: None,
        z_test: None,
        unsteady: false,
    };
    finished(CaseStep::default(), image, None)
}

/// A calibration judges nothing: it is well when every job was.
fn calibrated(case: &OpenCase, step: CaseStep, image: ImageResult, times: Vec<f64>) -> CaseStep {
    let metric = case.case.time_tolerance.metric();
    let floor = timing::noise_floor(&medians_of_runs(&times, case.case.repeat));
    let image = ImageResult { verdict: ImageVerdict::Identical, reason: None, accepted: image.pixels.clone(), ..image };
    let time = not_judged(metric, times, "a calibration judges nothing");
    CaseStep {
        ok: Some(true),
        noise_floor: floor.map(|floor| (metric, floor)),
        ..finished(step, image, Some(TimeResult { noise_floor: floor, ..time }))
    }
}

/// The verdict of a case that was being confirmed.
fn finish_confirmation(case: &OpenCase, conclude: impl FnOnce(TimeResult) -> TimeResult) -> CaseStep {
    match (case.image.clone(), case.time.clone()) {
        (Some(image), Some(suspected)) => finished(CaseStep::default(), image, Some(conclude(suspected))),
        _ => failed("what was to be confirmed is not known any more"),
    }
}

fn confirmed(case: &OpenCase, times_s: Vec<(String, f64)>) -> CaseStep {
    // The first of each side warmed up.
    let timed = |phase| phase_times(case, &times_s, phase).split_off(1);
    let (a, b) = (timed(FarmJobPhase::A), timed(FarmJobPhase::B));
    CaseStep { times_s, ..finish_confirmation(case, |suspected| confirm(suspected, a, b)) }
}

/// Its worker has left: samples begin anew on another one, as often as they may.
fn after_loss(case: &OpenCase, state: CaseState) -> CaseStep {
    let why = "the worker that rendered it has left";
    if state == CaseState::Confirming {
        return finish_confirmation(case, |suspected| unconfirmable(suspected, why));
    }
    if case.generation + 1 >= MOST_GENERATIONS {
        return failed(&format!("{why}, {MOST_GENERATIONS} times"));
    }
    CaseStep { begins_anew: true, ..CaseStep::default() }
}

/// Names of versions that are not the same.
fn differing(before: &BTreeMap<String, String>, now: &BTreeMap<String, String>) -> String {
    let names = before.keys().chain(now.keys().filter(|name| !before.contains_key(*name)));
    let of = |versions: &BTreeMap<String, String>, name: &str| {
        versions.get(name).cloned().unwrap_or_else(|| "none".to_owned())
    };
    let changed = names.filter(|name| before.get(*name) != now.get(*name));
    let told = changed.map(|name| format!("{name} was {}, is {}", of(before, name), of(now, name)));
    told.collect::<Vec<_>>().join(", ")
}
