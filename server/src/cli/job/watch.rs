//! `lightshaft job watch`: a job's events until its end, through restarts of the service.

use std::time::Duration;

use futures::StreamExt;
use lightshaft_api::client::Client;
use lightshaft_api::event::{Event, EventKind};
use lightshaft_api::job::{Job, JobState};

use super::{Global, print_job};
use crate::cli::error::{CliError, Result};
use crate::cli::progress::Progress;

/// How long the service may be away before watching is given up.
const PATIENCE: u32 = 30;
const RECONNECT_PAUSE: Duration = Duration::from_secs(1);

pub(crate) async fn run(id: &str, client: &Client, global: &Global) -> Result<()> {
    let job = follow(client, id).await?;
    print_job(&job, global)?;
    verdict(&job)
}

/// Shows progress until the job has ended, and answers its end.
pub(super) async fn follow(client: &Client, id: &str) -> Result<Job> {
    let progress = Progress::new();
    // Events of several workers may come out of order; only a task that is tried again takes the job back.
    let mut furthest = 0.0;
    let mut last_event = None;
    let mut failures = 0;
    loop {
        let mut pause = RECONNECT_PAUSE;
        let stream = async {
            let mut events = client.job_events(id, last_event).await?;
            while let Some(event) = events.next().await {
                let event = event?;
                failures = 0;
                last_event = event.id.or(last_event);
                show(&progress, &mut furthest, &event);
                if event.kind.ends_job() {
                    break;
                }
            }
            // Whether it has ended, the job itself says: it may have been retried since.
            client.job(id).await
        };
        match stream.await {
            Ok(job) if job.summary.state.is_final() => return Ok(job),
            Ok(_) => {}
            Err(error) if error.is_transient() && failures < PATIENCE => {
                failures += 1;
                pause = pause.max(error.retry_after().unwrap_or_default());
                progress.set(furthest, "waiting for the service".into());
            }
            Err(error) => return Err(error.into()),
        }
        tokio::time::sleep(pause).await;
    }
}

fn show(progress: &Progress, furthest: &mut f64, event: &Event) {
    match event.kind {
        EventKind::JobProgress => {
            *furthest = event.data["job_progress"].as_f64().unwrap_or(0.0).max(*furthest);
            let phase = event.data["phase"].as_str().unwrap_or_default();
            let spp = event.data["spp"].as_u64().filter(|&spp| spp > 0);
            progress.set(*furthest, spp.map_or_else(|| phase.to_owned(), |spp| format!("{phase}, {spp} spp")));
        }
        EventKind::TaskRetried | EventKind::TaskExpired => {
            *furthest = 0.0;
            let why = event.data["error"].as_str().unwrap_or("the worker was lost");
            progress.say(&crate::cli::output::printable(&format!("a task will be tried again: {why}")));
        }
        _ => {}
    }
}

/// Exit code 1 for a job that has not succeeded.
pub(super) fn verdict(job: &Job) -> Result<()> {
    let summary = &job.summary;
    match summary.state {
        JobState::Succeeded => Ok(()),
        JobState::Failed => {
            let why = summary.error.as_deref().unwrap_or("no reason was given");
            Err(CliError::no(format!("job {} failed: {}", summary.id, crate::cli::output::printable(why))))
        }
        JobState::Cancelled => Err(CliError::no(format!("job {} was cancelled", summary.id))),
        JobState::Queued | JobState::Running => Err(CliError::system(format!("job {} has not ended", summary.id))),
    }
}
