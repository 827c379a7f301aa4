//! `/queue`: what waits, in the order of its turn, and why each waits.

use askama::Template;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lightshaft_api::page::Page as List;
use lightshaft_api::queue::{Queue, QueuedJob};
use lightshaft_api::worker::{Worker, WorkerState};

use super::client::Api;
use super::filters::{self, human_seconds};
use super::page::{Page, PageError};

/// How far one press of a button moves a job.
const STEP: i32 = 10;
const PRIORITIES: std::ops::RangeInclusive<i32> = -100..=100;

#[derive(Template)]
#[template(path = "queue.html")]
struct QueuePage {
    here: &'static str,
    turns: Vec<Turn>,
    total: u64,
    workers: Vec<Worker>,
}

/// A job with its place.
struct Turn {
    /// From 1, among those that wait; `None` for what runs or is paused.
    place: Option<usize>,
    job: QueuedJob,
}

impl QueuePage {
    /// Whether no unfinished job is left out.
    fn is_whole(&self) -> bool {
        self.turns.len() as u64 >= self.total
    }
}

impl Turn {
    /// Priority after a press of the button that raises it, where that is another one.
    fn raised(&self) -> Option<i32> {
        self.moved(STEP)
    }

    /// The same of the button that lowers it.
    fn lowered(&self) -> Option<i32> {
        self.moved(-STEP)
    }

    fn moved(&self, step: i32) -> Option<i32> {
        let now = self.job.summary.priority;
        Some((now + step).clamp(*PRIORITIES.start(), *PRIORITIES.end())).filter(|&moved| moved != now)
    }

    /// Until the first of its tasks may run again, where that is ahead.
    fn pause(&self) -> Option<String> {
        self.job.ready_at.as_ref().and_then(left)
    }

    fn is_running(&self) -> bool {
        !self.job.leases.is_empty()
    }
}

/// From now to a time that is ahead.
fn left(until: &Timestamp) -> Option<String> {
    let seconds = until.duration_since(Timestamp::now()).as_secs_f64();
    (seconds > 0.0).then(|| human_seconds(seconds))
}

/// How long a lease still holds.
fn expires(until: &Timestamp) -> String {
    left(until).map_or_else(|| "expired".to_owned(), |left| format!("expires in {left} unless renewed"))
}

fn turns(jobs: Vec<QueuedJob>) -> Vec<Turn> {
    let mut waiting = 0;
    let place = |job: &QueuedJob| {
        (job.leases.is_empty() && !job.summary.paused).then(|| {
            waiting += 1;
            waiting
        })
    };
    let places: Vec<Option<usize>> = jobs.iter().map(place).collect();
    places.into_iter().zip(jobs).map(|(place, job)| Turn { place, job }).collect()
}

pub(super) async fn show(api: Api) -> Result<Response, PageError> {
    let queue: Queue = api.get("/v1/queue?limit=100").await?;
    let workers: List<Worker> = api.get("/v1/workers").await?;
    let page = QueuePage {
        here: "queue",
        turns: turns(queue.jobs),
        total: queue.total,
        workers: workers.items.into_iter().filter(|worker| worker.state != WorkerState::Gone).collect(),
    };
    Ok(Page(page).into_response())
}

#[cfg(test)]
mod tests {
    use super::super::tests::fixture;
    use super::*;

    #[test]
    fn places_count_what_waits_and_steps_stay_within_bounds() {
        let mut jobs = fixture::queue(true).jobs;
        let mut paused = jobs[1].clone();
        paused.summary.paused = true;
        jobs.push(jobs[1].clone());
        jobs.insert(1, paused);
        let mut turns = turns(jobs);
        let places: Vec<Option<usize>> = turns.iter().map(|turn| turn.place).collect();
        assert_eq!(places, [None, None, Some(1), Some(2)], "one runs, one is paused");
        let mut moves = |priority: i32| {
            turns[0].job.summary.priority = priority;
            [turns[0].raised(), turns[0].lowered()]
        };
        assert_eq!(moves(5), [Some(15), Some(-5)]);
        assert_eq!(moves(95), [Some(100), Some(85)]);
        assert_eq!(moves(-100), [Some(-90), None]);
    }
}
