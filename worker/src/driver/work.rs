//! One leased task, from its lease to what the protocol is told of its end.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use lightshaft_api::client::{Client, ClientError};
use lightshaft_api::lease::{Complete, Fail, Lease, NewArtifact, RetryClass};
use lightshaft_api::settings::JobSettings;
use tokio::runtime::Handle;
use tokio::sync::mpsc::UnboundedSender;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::inputs::{Kept, LeasedInputs};
use super::live::Live;
use super::stop::Stop;
use super::tries::Tries;
use crate::benchmark::BenchmarkOutputs;
use crate::cache::BlobCache;
use crate::executor::{Artifact, Executor, Outputs, TaskError, compare};
use crate::protocol::{Epoch, Input, Outcome};

/// How long the report of a task waits for the structures that it has built to arrive at the service: whoever sees the
/// task done finds them then. Longer uploads go on beside the next task.
const STRUCTURES_PATIENCE: Duration = Duration::from_secs(10);

const MAX_ERROR_CHARS: usize = 4000;

const SHORTEST_BEAT_PATIENCE: Duration = Duration::from_secs(2);

/// How long a task's end waits for its last log lines to arrive.
const LOG_PATIENCE: Duration = Duration::from_secs(3);

/// The task in hand, as the driver sees it.
pub(super) struct Running {
    pub(super) epoch: Epoch,
    /// The fence: must not get into logs.
    pub(super) token: String,
    /// How long a heartbeat may wait for its answer.
    pub(super) beat_patience: Duration,
    /// Carries on the trace of the job.
    pub(super) client: Client,
    pub(super) live: Arc<Live>,
    pub(super) stop: Arc<Stop>,
    /// No task comes after this one.
    pub(super) hurry: CancellationToken,
}

impl Running {
    /// Starts the work; its end comes as [`Input::Finished`].
    pub(super) fn start(
        epoch: Epoch,
        lease: Box<Lease>,
        worker: &str,
        client: &Client,
        executor: &Arc<Executor>,
        blobs: &Arc<BlobCache>,
        sender: &UnboundedSender<Input>,
    ) -> Self {
        let client = client.with_traceparent(lease.traceparent.clone());
        let live = Arc::new(Live::default());
        let (stop, hurry) = (Arc::new(Stop::default()), CancellationToken::new());
        let span = tracing::info_span!(
            "task",
            job.id = lease.job,
            task.id = lease.task,
            attempt = lease.attempt_number,
            worker.id = worker,
            trace.id = lease.traceparent.split('-').nth(1).unwrap_or_default(),
        );
        let token = lease.token.clone();
        let beat_patience = Duration::from_secs(lease.ttl_s.into()).max(SHORTEST_BEAT_PATIENCE) / 2;
        let work = Work {
            lease: Arc::from(lease),
            client: client.clone(),
            live: Arc::clone(&live),
            stop: Arc::clone(&stop),
            hurry: hurry.clone(),
            executor: Arc::clone(executor),
            blobs: Arc::clone(blobs),
        };
        let sender = sender.clone();
        tokio::spawn(
            async move {
                let outcome = work.run().await;
                let _ = sender.send(Input::Finished(epoch, outcome));
            }
            .instrument(span),
        );
        Self { epoch, token, beat_patience, client, live, stop, hurry }
    }
}

struct Work {
    lease: Arc<Lease>,
    client: Client,
    live: Arc<Live>,
    stop: Arc<Stop>,
    hurry: CancellationToken,
    executor: Arc<Executor>,
    blobs: Arc<BlobCache>,
}

impl Work {
    async fn run(&self) -> Outcome {
        tracing::info!(work = ?self.lease.work, "task started");
        let name = crate::executor::name_of(&self.lease.work);
        self.live.log.push(format!("attempt {} at {name} begins", self.lease.attempt_number));
        let beside = async {
            tokio::join!(
                Arc::clone(&self.live).upload_previews(self.client.clone()),
                self.live.log.ship(&self.client, &self.lease.token),
            )
        };
        let outcome = tokio::select! {
            outcome = self.work() => outcome,
            _ = beside => Outcome::Stopped,
        };
        match &outcome {
            Outcome::Done(complete) => {
                tracing::info!(total_s = complete.metrics.total_s, render_s = complete.metrics.render_s, "task done");
            }
            Outcome::Failed(fail) => {
                self.live.log.push(format!("failed: {}", fail.error));
                tracing::warn!(class = ?fail.class, "task failed");
            }
            Outcome::Stopped => {
                self.live.log.push("stopped before its end, as asked".to_owned());
                tracing::info!("task stopped");
            }
        }
        let flush = self.live.log.flush(&self.client, &self.lease.token);
        if tokio::time::timeout(LOG_PATIENCE, flush).await.is_err() {
            tracing::warn!("the last log lines did not arrive");
        }
        outcome
    }

    async fn work(&self) -> Outcome {
        let result = match self.execute().await {
            Ok(outputs) => self.upload(outputs).await,
            Err(error) => Err(error),
        };
        match result {
            Ok(complete) => Outcome::Done(Box::new(complete)),
            Err(TaskError::Stopped) => Outcome::Stopped,
            Err(TaskError::Failed { class, fatal, message }) => {
                // A message may quote what a file holds; the service takes no more than 16 KiB.
                let error = message.chars().take(MAX_ERROR_CHARS).collect();
                Outcome::Failed(Fail { class, error, fatal })
            }
        }
    }

    /// Renders on a thread where blocking is allowed. A panic is an error of the task like any other.
    async fn execute(&self) -> Result<Outputs, TaskError> {
        let inputs = LeasedInputs {
            lease: Arc::clone(&self.lease),
            client: self.client.clone(),
            blobs: Arc::clone(&self.blobs),
            live: Arc::clone(&self.live),
            stop: Arc::clone(&self.stop),
            runtime: Handle::current(),
            kept: Kept::default(),
        };
        let (lease, live) = (Arc::clone(&self.lease), Arc::clone(&self.live));
        let (executor, stop) = (Arc::clone(&self.executor), Arc::clone(&self.stop));
        let span = tracing::Span::current();
        let rendering = tokio::task::spawn_blocking(move || {
            let _in_task = span.enter();
            let run = || execute(&executor, &lease, &inputs, &live, &stop);
            let result = std::panic::catch_unwind(AssertUnwindSafe(run));
            (result, inputs.take_uploads())
        });
        let panicked = || TaskError::Failed {
            class: RetryClass::Task,
            fatal: false,
            message: "internal error while rendering; the worker's log has the details".into(),
        };
        let Ok((result, uploads)) = rendering.await else { return Err(panicked()) };
        let outputs = result.map_err(|_| panicked())??;
        self.finish_structures(uploads).await;
        Ok(outputs)
    }

    /// Structures serve other workers, and later jobs: neither a worker that leaves nor a task that is not wanted any more
    /// waits for them.
    async fn finish_structures(&self, mut uploads: JoinSet<()>) {
        let finished = async { while uploads.join_next().await.is_some() {} };
        tokio::select! {
            () = finished => {}
            () = self.stop.asked() => uploads.abort_all(),
            () = self.hurry.cancelled() => uploads.abort_all(),
            () = tokio::time::sleep(STRUCTURES_PATIENCE) => uploads.detach_all(),
        }
    }

    /// Outputs go to the blob store before the task is completed: a late upload harms nothing.
    async fn upload(&self, outputs: Outputs) -> Result<Complete, TaskError> {
        let started = std::time::Instant::now();
        let mut artifacts = Vec::with_capacity(outputs.artifacts.len());
        for artifact in outputs.artifacts {
            artifacts.push(self.upload_one(artifact).await?);
        }
        let mut metrics = outputs.metrics;
        let seconds = started.elapsed().as_secs_f64();
        metrics.output_s += seconds;
        metrics.total_s += seconds;
        Ok(Complete { artifacts, metrics })
    }

    async fn upload_one(&self, artifact: Artifact) -> Result<NewArtifact, TaskError> {
        let body = bytes::Bytes::from(artifact.bytes);
        let hash = blake3::hash(&body).to_hex().to_string();
        let mut tries = Tries::new(&self.live, &self.stop);
        loop {
            let put = tokio::select! {
                put = self.client.put_blob(&hash, body.clone()) => put,
                () = self.stop.asked() => return Err(TaskError::Stopped),
            };
            match put {
                Ok(_) => break,
                Err(error) if tries.again(&error).await? => {}
                Err(error) => return Err(upload_error(&artifact.name, &error)),
            }
        }
        Ok(NewArtifact {
            name: artifact.name.to_string(),
            media_type: artifact.media_type.to_owned(),
            bytes: body.len() as u64,
            blob: hash,
        })
    }
}

fn execute(
    executor: &Executor,
    lease: &Lease,
    inputs: &LeasedInputs,
    live: &Live,
    stop: &Stop,
) -> Result<Outputs, TaskError> {
    match &lease.settings {
        JobSettings::Render(settings) => executor.run(&lease.work, settings, inputs, live, stop.flag()),
        JobSettings::Build(settings) => executor.build(settings, inputs, live, stop.flag()),
        JobSettings::Compare(request) => {
            let read = |hash: &str| {
                let path = inputs.blob(hash)?;
                std::fs::read(path).map_err(|error| TaskError::worker(format!("blob {hash} cannot be read: {error}")))
            };
            compare(request, lease.waited_s, read, live, stop.flag())
        }
        JobSettings::Benchmark(settings) => {
            let BenchmarkOutputs { artifacts, mut metrics, .. } =
                executor.benchmark(settings, inputs, live, stop.flag())?;
            metrics.queue_s = Some(lease.waited_s);
            Ok(Outputs { artifacts, metrics })
        }
    }
}

/// What could not be stored may be later. What the service refuses, such as a file over its limit, it will refuse again;
/// only other bytes than were sent (422) are an accident of the way.
fn upload_error(name: &str, error: &ClientError) -> TaskError {
    match error {
        ClientError::Problem { problem, .. } if !error.is_transient() && problem.status != 422 => TaskError::Failed {
            class: RetryClass::Task,
            fatal: false,
            message: format!("the service refused {name}: {}", problem.detail),
        },
        ClientError::Problem { problem, .. } => {
            TaskError::transient(format!("{name} could not be stored: {}", problem.detail))
        }
        _ => TaskError::transient(format!("{name} could not be uploaded")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upload_that_fails_is_tried_elsewhere_unless_it_is_refused() {
        let class = |status: u16| {
            let problem = lightshaft_api::problem::Problem {
                status,
                detail: "why".into(),
                ..serde_json::from_str(r#"{"type":"t","title":"t","status":0,"detail":""}"#).unwrap()
            };
            let error = ClientError::Problem { problem: Box::new(problem), retry_after: None };
            match upload_error("image.png", &error) {
                TaskError::Failed { class, fatal: false, message } if message.contains("why") => class,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!([507, 503, 429, 422].map(class), [RetryClass::Transient; 4]);
        assert_eq!([413, 400].map(class), [RetryClass::Task; 2]);
    }
}
