//! Streams of events. The database is what they read; wake-ups only say that it is worth a look. So nothing is lost
//! between a reader's backlog and what happens while it reads.

use std::collections::VecDeque;

use lightshaft_api::event::Event;
use lightshaft_api::job::JobState;
use tokio::sync::{broadcast, watch};

use super::{App, Shared};
use crate::error::{ApiError, ApiResult};

const BATCH: u32 = 256;

/// Events of one job or of all, from a place on.
pub struct EventStream {
    app: Shared,
    job: Option<String>,
    last: i64,
    backlog: VecDeque<Event>,
    changes: watch::Receiver<u64>,
    progress: broadcast::Receiver<Event>,
}

impl EventStream {
    /// Of a job from its beginning, of all jobs from now, or after `last_event_id`.
    pub async fn open(app: Shared, job: Option<String>, last_event_id: Option<i64>) -> ApiResult<Self> {
        if let Some(job) = &job {
            app.store.job_state(job).await?.ok_or_else(|| ApiError::not_found("job", job))?;
        }
        let last = match (last_event_id, &job) {
            (Some(id), _) => id,
            (None, Some(_)) => 0,
            (None, None) => app.store.last_event().await?,
        };
        let (changes, progress) = (app.changes.subscribe(), app.progress.subscribe());
        Ok(Self { app, job, last, backlog: VecDeque::new(), changes, progress })
    }

    /// The next event; `None` after a job's end, and when the service shuts down.
    pub async fn next(&mut self) -> ApiResult<Option<Event>> {
        loop {
            if let Some(event) = self.backlog.pop_front() {
                self.last = event.id.unwrap_or(self.last);
                return Ok(Some(event));
            }
            self.changes.borrow_and_update();
            let ended = self.job_has_ended().await?;
            self.backlog = self.app.store.events_after(self.last, self.job.as_deref(), BATCH).await?.into();
            if !self.backlog.is_empty() {
                continue;
            }
            if ended {
                return Ok(None);
            }
            if let Some(event) = self.wait().await {
                return Ok(Some(event));
            }
            if self.app.shutdown.is_cancelled() {
                return Ok(None);
            }
        }
    }

    /// Until the database may hold something new, or else until this stream's jobs make progress: that is the event.
    async fn wait(&mut self) -> Option<Event> {
        loop {
            tokio::select! {
                biased;
                () = self.app.shutdown.cancelled() => return None,
                // The sender is the app's, and lives as long as this does.
                _ = self.changes.changed() => return None,
                event = self.progress.recv() => match event {
                    Ok(event) if self.job.as_ref().is_none_or(|job| *job == event.job) => return Some(event),
                    Ok(_) | Err(broadcast::error::RecvError::Lagged(_)) => {}
                    Err(broadcast::error::RecvError::Closed) => return None,
                },
            }
        }
    }

    async fn job_has_ended(&self) -> ApiResult<bool> {
        match &self.job {
            Some(job) => Ok(self.app.store.job_state(job).await?.is_none_or(JobState::is_final)),
            None => Ok(false),
        }
    }
}

impl App {
    /// Tells of something that is not kept.
    pub(super) fn tell_progress(&self, event: Event) {
        // Nobody may be listening.
        self.progress.send(event).ok();
    }
}
