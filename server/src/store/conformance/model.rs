//! Random histories of a small farm, checked after every step against what must always hold.

use std::collections::HashMap;

use lightshaft_api::job::{AttemptOutcome, JobState, Phase, TaskState};
use lightshaft_api::lease::RetryClass;
use lightshaft_api::settings::Split;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;

use super::{Farm, Held, TTL, picture};
use crate::queue::{TaskCounts, job_state};
use crate::store::Close;

#[derive(Clone, Debug)]
enum Step {
    Submit { parts: u32 },
    Claim { worker: usize },
    Renew { lease: usize, phase: Phase },
    Complete { lease: usize },
    Fail { lease: usize, class: RetryClass },
    Release { lease: usize },
    Cancel { job: usize },
    Retry { job: usize },
    Reregister { worker: usize },
    Wait { ms: i64 },
    Reap,
}

fn step() -> impl Strategy<Value = Step> {
    let index = 0usize..64;
    let class = prop::sample::select(vec![RetryClass::Worker, RetryClass::Task, RetryClass::Transient]);
    let phase = prop::sample::select(vec![Phase::Fetch, Phase::Render]);
    prop_oneof![
        2 => (1u32..4).prop_map(|parts| Step::Submit { parts }),
        8 => index.clone().prop_map(|worker| Step::Claim { worker }),
        3 => (index.clone(), phase).prop_map(|(lease, phase)| Step::Renew { lease, phase }),
        5 => index.clone().prop_map(|lease| Step::Complete { lease }),
        3 => (index.clone(), class).prop_map(|(lease, class)| Step::Fail { lease, class }),
        1 => index.clone().prop_map(|lease| Step::Release { lease }),
        1 => index.clone().prop_map(|job| Step::Cancel { job }),
        1 => index.clone().prop_map(|job| Step::Retry { job }),
        1 => index.prop_map(|worker| Step::Reregister { worker }),
        3 => prop::sample::select(vec![1_000i64, 20_000, TTL]).prop_map(|ms| Step::Wait { ms }),
        2 => Just(Step::Reap),
    ]
}

/// What the history has shown from outside.
#[derive(Default)]
struct Seen {
    jobs: Vec<String>,
    leases: Vec<Held>,
    /// Per task: reports that were taken as its success.
    completions: HashMap<String, u32>,
    ended: HashMap<String, AttemptOutcome>,
}

impl Seen {
    fn note(&mut self, held: &Held, close: Close) {
        match close {
            Close::Closed(outcome) => {
                let before = self.ended.insert(held.token.clone(), outcome);
                assert_eq!(before, None, "a lease ends once");
                if outcome == AttemptOutcome::Succeeded {
                    *self.completions.entry(held.task.task.clone()).or_default() += 1;
                }
            }
            Close::Already(outcome) => {
                let before = self.ended.get(&held.token).copied().unwrap_or(AttemptOutcome::Expired);
                assert_eq!(before, outcome, "an ended lease stays as it ended");
            }
            Close::Unknown => panic!("a lease was forgotten"),
        }
    }
}

pub(super) async fn random_histories_keep_every_promise(farm: &Farm) {
    let mut runner = TestRunner::deterministic();
    let (scene, _) = farm.scene().await;
    let workers = [farm.worker().await, farm.worker().await, farm.worker().await];
    for _ in 0..12 {
        let history = prop::collection::vec(step(), 60).new_tree(&mut runner).unwrap().current();
        let mut seen = Seen::default();
        for step in history {
            apply(farm, &scene, &workers, &mut seen, step).await;
            check(farm, &seen).await;
        }
        for job in &seen.jobs {
            farm.store.cancel_job(job, farm.now()).await.unwrap();
        }
    }
}

async fn apply(farm: &Farm, scene: &str, workers: &[String], seen: &mut Seen, step: Step) {
    let pick = |index: usize, len: usize| (len > 0).then(|| index % len);
    match step {
        Step::Submit { parts } => {
            let split = (parts > 1).then_some(Split::Tiles([parts, 1]));
            seen.jobs.push(farm.job_with(scene, |job| picture(job).split = split).await);
        }
        Step::Claim { worker } => {
            if let Some(held) = farm.claim(&workers[worker % workers.len()]).await {
                seen.leases.push(held);
            }
        }
        Step::Renew { lease, phase } => {
            let Some(i) = pick(lease, seen.leases.len()) else { return };
            let token = &seen.leases[i].token;
            let renewed = farm.store.renew(token, phase, 0.5, farm.now() + TTL).await.unwrap();
            assert!(!renewed || !seen.ended.contains_key(token), "an ended lease was renewed");
        }
        Step::Complete { lease } => {
            let Some(i) = pick(lease, seen.leases.len()) else { return };
            let held = seen.leases[i].clone();
            seen.note(&held, farm.complete(&held).await);
        }
        Step::Fail { lease, class } => {
            let Some(i) = pick(lease, seen.leases.len()) else { return };
            let held = seen.leases[i].clone();
            seen.note(&held, farm.fail(&held, class).await);
        }
        Step::Release { lease } => {
            let Some(i) = pick(lease, seen.leases.len()) else { return };
            let held = seen.leases[i].clone();
            let close = farm.store.release(&held.token, false, farm.now()).await.unwrap();
            seen.note(&held, close);
        }
        Step::Cancel { job } => {
            let Some(i) = pick(job, seen.jobs.len()) else { return };
            farm.store.cancel_job(&seen.jobs[i], farm.now()).await.unwrap();
        }
        Step::Retry { job } => {
            let Some(i) = pick(job, seen.jobs.len()) else { return };
            farm.store.retry_job(&seen.jobs[i], farm.now()).await.unwrap();
        }
        Step::Reregister { worker } => {
            let worker = &workers[worker % workers.len()];
            farm.store.register_worker(worker, &super::new_worker(&["cpu"]), farm.now()).await.unwrap();
        }
        Step::Wait { ms } => farm.wait(ms),
        Step::Reap => {
            farm.store.expire_leases(farm.now()).await.unwrap();
        }
    }
}

async fn check(farm: &Farm, seen: &Seen) {
    for id in &seen.jobs {
        let job = farm.read(id).await;
        let mut counts = TaskCounts::default();
        for task in &job.tasks {
            let running =
                job.attempts.iter().filter(|a| a.task == task.id && a.outcome == AttemptOutcome::Running).count();
            assert_eq!(running, usize::from(task.state == TaskState::Leased), "one attempt runs exactly while leased");
            let completions = seen.completions.get(&task.id).copied().unwrap_or(0);
            assert_eq!(completions, u32::from(task.state == TaskState::Succeeded), "success is counted once");
            let attempts = job.attempts.iter().filter(|a| a.task == task.id).count();
            assert!(task.attempt as usize <= attempts && task.attempt <= task.max_attempts);
            let count = match task.state {
                TaskState::Blocked => &mut counts.blocked,
                TaskState::Ready => &mut counts.ready,
                TaskState::Leased => &mut counts.leased,
                TaskState::Succeeded => &mut counts.succeeded,
                TaskState::Failed => &mut counts.failed,
                TaskState::Cancelled => &mut counts.cancelled,
                TaskState::Dead => &mut counts.dead,
            };
            *count += 1;
        }
        assert_eq!(job.summary.state, job_state(&counts), "the job's state is that of its tasks");
        assert_eq!(job.summary.finished_at.is_some(), job.summary.state.is_final());
        assert_eq!(job.summary.state == JobState::Succeeded, job.metrics.is_some());
    }
}
