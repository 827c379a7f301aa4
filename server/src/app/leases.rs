//! The worker protocol (see `lightshaft_api::lease`): lease, heartbeat, and the reports that end a lease.

use std::collections::HashSet;
use std::time::Duration;

use lightshaft_api::blob::is_hash;
use lightshaft_api::event::{Event, EventKind};
use lightshaft_api::job::AttemptOutcome;
use lightshaft_api::lease::{
    Complete, Fail, Heartbeat, HeartbeatReply, Lease, LeaseClosed, LeaseRequest, LogAccepted, LogChunk, NewArtifact,
    Release,
};
use lightshaft_api::problem::FieldError;
use metrics::{counter, histogram};
use serde_json::json;
use tokio::time::Instant;
use uuid::Uuid;

use super::App;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::queue::Millis;
use crate::store::{Claim, Claimed, ClaimedTask, Close, Completed, LeaseState};
use crate::web::context::traceparent;

/// How often running tasks are to be heard of: people watch their progress, and a wish to cancel goes with the answer.
/// Short leases need a heartbeat even more often, at a third of their time to live.
const LIVE_PERIOD: Duration = Duration::from_millis(500);

/// Tasks become ready by time alone, too: a waiting worker looks again this often.
const POLL_PERIOD: Duration = Duration::from_secs(1);

impl App {
    /// Waits for a task, up to `wait_s`.
    pub async fn lease(&self, request: LeaseRequest) -> ApiResult<Option<Lease>> {
        self.check_running()?;
        validate_request(&request)?;
        let deadline = Instant::now() + Duration::from_secs(request.wait_s.into());
        let mut changes = self.changes.subscribe();
        let mut has_told = false;
        loop {
            changes.borrow_and_update();
            let offered = self.store.has_task_for(&request.worker, self.now()).await?;
            // Of a worker that there is not, nothing is kept.
            let offered = offered.ok_or_else(|| ApiError::not_found("worker", &request.worker))?;
            self.sign_of_life(&request.worker).await;
            if !has_told {
                self.live.poll(&request.worker, request.cache.clone(), request.warm.clone());
                has_told = true;
            }
            if self.live.has_parted(&request.worker) {
                return Ok(None);
            }
            if offered && let Some(lease) = self.claim(&request).await? {
                return Ok(Some(lease));
            }
            if Instant::now() >= deadline {
                return Ok(None);
            }
            let pause = tokio::time::sleep_until(deadline.min(Instant::now() + POLL_PERIOD));
            tokio::select! {
                () = self.draining.cancelled() => return Ok(None),
                _ = changes.changed() => {}
                () = pause => {}
            }
        }
    }

    async fn claim(&self, request: &LeaseRequest) -> ApiResult<Option<Lease>> {
        let now = self.now();
        let claim = Claim {
            worker: request.worker.clone(),
            token: Uuid::new_v4().simple().to_string(),
            attempt: Uuid::now_v7().to_string(),
            now,
            expires_at: now + self.ttl_ms(),
            warm: request.warm.clone(),
        };
        let task = match self.store.claim(&claim).await? {
            Claimed::UnknownWorker => return Err(ApiError::not_found("worker", &request.worker)),
            Claimed::Nothing => return Ok(None),
            Claimed::Task(task) => *task,
        };
        histogram!("lightshaft_lease_wait_seconds").record(task.waited_ms as f64 / 1000.0);
        tracing::info!(
            job.id = %task.job, task.id = %task.task, attempt = task.number, worker.id = %claim.worker,
            trace.id = %task.trace_id, waited_ms = task.waited_ms, "task leased"
        );
        self.changed();
        self.to_lease(claim, task).map(Some)
    }

    fn to_lease(&self, claim: Claim, task: ClaimedTask) -> ApiResult<Lease> {
        let ttl_s = u32::try_from(self.config.lease_ttl.as_secs()).unwrap_or(u32::MAX).max(1);
        Ok(Lease {
            token: claim.token,
            ttl_s,
            heartbeat_s: LIVE_PERIOD.min(self.config.lease_ttl / 3).as_secs_f64(),
            expires_at: timestamp(claim.expires_at)?,
            job: task.job,
            task: task.task,
            attempt: claim.attempt,
            attempt_number: task.number,
            waited_s: task.waited_ms.max(0) as f64 / 1000.0,
            traceparent: traceparent(&task.trace_id),
            work: task.work,
            settings: task.settings,
            scene: task.scene,
            more_scenes: task.more_scenes,
            parts: task.parts,
        })
    }

    /// Keeps a lease. Most heartbeats only change what is in memory: the lease is written anew when a sixth of its
    /// time is gone or the phase has changed.
    pub async fn heartbeat(&self, token: &str, heartbeat: &Heartbeat) -> ApiResult<HeartbeatReply> {
        let state = self.held(token, Code::LeaseEnded).await?;
        if !heartbeat.progress.is_finite() {
            return Err(ApiError::fields(vec![FieldError::new("/progress", "must be 0 to 1")]));
        }
        let beat = {
            let _in_use = self.blob_use.read().await;
            self.check_preview(heartbeat).await?;
            self.live.beat(&state, heartbeat)
        };
        self.discard(beat.old_preview);
        let now = self.now();
        self.sign_of_life(&state.worker).await;
        let renewed_ago = now + self.ttl_ms() - state.expires_at;
        let mut expires_at = state.expires_at;
        // A first beat always renews: should the lease have ended meanwhile, what was just noted of it must go.
        if beat.is_first || renewed_ago > self.ttl_ms() / 6 || state.phase != Some(heartbeat.phase) {
            expires_at = now + self.ttl_ms();
            let progress = heartbeat.progress.clamp(0.0, 1.0);
            if !self.store.renew(token, heartbeat.phase, progress, expires_at).await? {
                self.end_attempt(&state.attempt).await;
                return Err(lease_ended(Code::LeaseEnded));
            }
        }
        self.show_progress(&state, heartbeat, beat.new_preview).await?;
        Ok(HeartbeatReply {
            expires_at: timestamp(expires_at)?,
            cancel: state.cancel_requested,
            drain: state.draining || self.draining.is_cancelled(),
        })
    }

    async fn check_preview(&self, heartbeat: &Heartbeat) -> ApiResult<()> {
        let Some(preview) = &heartbeat.preview else { return Ok(()) };
        match self.blobs.size(preview).await.map_err(ApiError::internal)? {
            Some(_) => Ok(()),
            None => Err(ApiError::fields(vec![FieldError::new("/preview", "is not in the blob store: put it first")])),
        }
    }

    async fn show_progress(&self, state: &LeaseState, heartbeat: &Heartbeat, new_preview: bool) -> ApiResult<()> {
        let running = self.live.tasks();
        let job_progress = self.store.task_progress(&state.job).await?.of_job(|task| Some(running.get(task)?.progress));
        let event = |kind, data| -> ApiResult<Event> {
            Ok(Event { id: None, at: timestamp(self.now())?, job: state.job.clone(), kind, data })
        };
        let progress = json!({
            "task": state.task, "progress": heartbeat.progress, "job_progress": job_progress,
            "phase": heartbeat.phase, "spp": heartbeat.spp,
        });
        self.tell_progress(event(EventKind::JobProgress, progress)?);
        if new_preview {
            let href = format!("/v1/jobs/{}/preview.png", state.job);
            self.tell_progress(event(EventKind::JobPreview, json!({ "task": state.task, "href": href }))?);
        }
        Ok(())
    }

    pub async fn append_log(&self, token: &str, chunk: &LogChunk) -> ApiResult<LogAccepted> {
        let state = self.held(token, Code::StaleLease).await?;
        let next_sequence = self.logs.append(&state.attempt, chunk).await.map_err(ApiError::internal)?;
        Ok(LogAccepted { next_sequence })
    }

    pub async fn complete(&self, token: &str, report: &Complete) -> ApiResult<LeaseClosed> {
        let state = self.known(token).await?;
        let in_use = self.blob_use.read().await;
        // Whoever has lost the lease is told that, whatever it brings.
        if state.outcome == AttemptOutcome::Running {
            let errors = self.check_artifacts(&report.artifacts).await?;
            if !errors.is_empty() {
                return Err(ApiError::fields(errors));
            }
        }
        let Completed { close, freed } = self.store.complete(token, report, self.now()).await?;
        drop(in_use);
        self.discard(freed);
        if matches!(close, Close::Closed(_)) {
            for cache in &report.metrics.cache {
                counter!("lightshaft_structures_total", "source" => cache.source.as_str()).increment(1);
            }
        }
        self.close(&state, close, |outcome| outcome == AttemptOutcome::Succeeded).await
    }

    pub async fn fail(&self, token: &str, report: &Fail) -> ApiResult<LeaseClosed> {
        let state = self.known(token).await?;
        if state.outcome == AttemptOutcome::Running && report.error.len() > 16 << 10 {
            return Err(ApiError::fields(vec![FieldError::new("/error", "must have at most 16384 bytes")]));
        }
        self.keep_progress(token, &state).await?;
        let jitter = rand::random_range(-1.0..=1.0);
        let close = self.store.fail(token, report, jitter, self.now()).await?;
        let expected = report.class.outcome();
        self.close(&state, close, |outcome| outcome == expected || outcome == AttemptOutcome::Cancelled).await
    }

    pub async fn release(&self, token: &str, report: &Release) -> ApiResult<LeaseClosed> {
        let state = self.known(token).await?;
        self.keep_progress(token, &state).await?;
        let close = self.store.release(token, report.cancelled, self.now()).await?;
        let released = |outcome| matches!(outcome, AttemptOutcome::Interrupted | AttemptOutcome::Cancelled);
        self.close(&state, close, released).await
    }

    /// Before a lease ends without success: how far it got is known only here.
    async fn keep_progress(&self, token: &str, state: &LeaseState) -> ApiResult<()> {
        if let Some(progress) = self.live.progress_of(&state.attempt) {
            self.store.note_progress(token, progress).await?;
        }
        Ok(())
    }

    /// A repeated report is answered like the first; any other report on an ended lease is stale. Once a lease is
    /// closed, nothing here can fail any more: the answer stands, and whoever waits is woken.
    async fn close(
        &self,
        state: &LeaseState,
        close: Close,
        is_repeat: impl Fn(AttemptOutcome) -> bool,
    ) -> ApiResult<LeaseClosed> {
        let outcome = match close {
            Close::Unknown => return Err(unknown_lease()),
            Close::Already(outcome) if is_repeat(outcome) => outcome,
            Close::Already(_) => {
                counter!("lightshaft_fenced_reports_total").increment(1);
                return Err(lease_ended(Code::StaleLease));
            }
            Close::Closed(outcome) => {
                self.changed();
                counter!("lightshaft_attempts_total", "outcome" => outcome.as_str()).increment(1);
                tracing::info!(
                    job.id = %state.job, task.id = %state.task, attempt.id = %state.attempt,
                    worker.id = %state.worker, outcome = outcome.as_str(), "attempt ended"
                );
                self.sign_of_life(&state.worker).await;
                self.end_attempt(&state.attempt).await;
                outcome
            }
        };
        Ok(LeaseClosed { outcome })
    }

    /// Ends leases that ran out; returns how many.
    pub async fn expire_leases(&self) -> ApiResult<usize> {
        let expired = self.store.expire_leases(self.now()).await?;
        for lease in &expired {
            tracing::warn!(
                job.id = %lease.job, task.id = %lease.task, worker.id = %lease.worker, again = lease.again,
                "lease expired"
            );
            counter!("lightshaft_lease_expiries_total").increment(1);
            counter!("lightshaft_attempts_total", "outcome" => AttemptOutcome::Expired.as_str()).increment(1);
            self.end_attempt(&lease.attempt).await;
        }
        if !expired.is_empty() {
            self.changed();
        }
        Ok(expired.len())
    }

    /// Forgets what is kept only while an attempt runs.
    pub(super) async fn end_attempt(&self, attempt: &str) {
        self.discard(self.live.end_attempt(attempt));
        self.logs.close(attempt).await;
    }

    async fn known(&self, token: &str) -> ApiResult<LeaseState> {
        self.store.lease(token).await?.ok_or_else(unknown_lease)
    }

    /// The token is the fence, not the time: a lease that has run out is still held until somebody takes it away.
    async fn held(&self, token: &str, ended: Code) -> ApiResult<LeaseState> {
        let state = self.known(token).await?;
        if state.outcome != AttemptOutcome::Running {
            // A heartbeat that its own worker's report has overtaken is none of somebody who lost the lease.
            if state.outcome == AttemptOutcome::Expired {
                counter!("lightshaft_fenced_reports_total").increment(1);
            }
            return Err(lease_ended(ended));
        }
        Ok(state)
    }

    async fn sign_of_life(&self, worker: &str) {
        if self.live.seen(worker, self.now())
            && let Err(error) = self.store.touch_worker(worker, self.now()).await
        {
            tracing::error!(worker.id = %worker, error = %error, "a sign of life was not written down");
        }
    }

    fn ttl_ms(&self) -> Millis {
        Millis::try_from(self.config.lease_ttl.as_millis()).unwrap_or(Millis::MAX)
    }

    async fn check_artifacts(&self, artifacts: &[NewArtifact]) -> ApiResult<Vec<FieldError>> {
        let mut errors = Vec::new();
        let mut names = HashSet::new();
        if artifacts.len() > 1000 {
            errors.push(FieldError::new("/artifacts", "must be at most 1000 artifacts"));
        }
        for (i, artifact) in artifacts.iter().enumerate().take(1000) {
            let mut wrong = |field: &str, detail: &str| {
                errors.push(FieldError::new(format!("/artifacts/{i}/{field}"), detail));
            };
            if !is_artifact_name(&artifact.name) {
                wrong("name", "must be 1 to 128 letters, digits, `.`, `_` and `-`, not beginning with `.`");
            }
            if !names.insert(&artifact.name) {
                wrong("name", "is named twice");
            }
            if !is_media_type(&artifact.media_type) {
                wrong("media_type", "must be a media type such as image/png");
            }
            match self.blobs.size(&artifact.blob).await.map_err(ApiError::internal)? {
                None => wrong("blob", "is not in the blob store: put it first"),
                Some(size) if size != artifact.bytes => wrong("bytes", "is not the blob's length"),
                Some(_) => {}
            }
        }
        Ok(errors)
    }
}

fn validate_request(request: &LeaseRequest) -> ApiResult<()> {
    let mut errors = Vec::new();
    if request.wait_s > 30 {
        errors.push(FieldError::new("/wait_s", "must be 0 to 30"));
    }
    if request.warm.len() > 4096 {
        errors.push(FieldError::new("/warm", "must be at most 4096 hashes"));
    } else if let Some(i) = request.warm.iter().position(|hash| !is_hash(hash)) {
        errors.push(FieldError::new(format!("/warm/{i}"), "must be 64 lower-case hex digits"));
    }
    if errors.is_empty() { Ok(()) } else { Err(ApiError::fields(errors)) }
}

fn is_artifact_name(name: &str) -> bool {
    (1..=128).contains(&name.len())
        && !name.starts_with('.')
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b"._-".contains(&b))
}

fn is_media_type(text: &str) -> bool {
    let is_token =
        |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_alphanumeric() || b".+-".contains(&b));
    text.len() <= 127 && text.split_once('/').is_some_and(|(kind, subtype)| is_token(kind) && is_token(subtype))
}

fn unknown_lease() -> ApiError {
    // The token is a secret, even a wrong one.
    ApiError::new(Code::NotFound, "there is no lease with this token")
}

fn lease_ended(code: Code) -> ApiError {
    ApiError::new(code, "the lease has ended: the task is no longer this worker's; drop the work")
}

pub(super) fn timestamp(ms: Millis) -> ApiResult<jiff::Timestamp> {
    jiff::Timestamp::from_millisecond(ms).map_err(ApiError::internal)
}
