//! Leases: who gets what, and what each ending of a lease does.

use lightshaft_api::job::{AttemptOutcome, JobState, Phase, TaskState};
use lightshaft_api::lease::RetryClass;
use lightshaft_api::settings::{DeviceChoice, Split};

use tokio::task::JoinSet;

use super::{Farm, TTL, new_worker, picture};
use crate::store::{Claim, Claimed, Close};

pub(super) async fn a_task_is_leased_to_one_worker_only(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let (one, two) = (farm.worker().await, farm.worker().await);
    assert_eq!(farm.claim(&one).await.unwrap().task.job, job);
    assert!(farm.claim(&two).await.is_none());
}

pub(super) async fn many_workers_at_once_never_get_the_same_task(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    for _ in 0..40 {
        farm.job(&scene).await;
    }
    let mut workers = Vec::new();
    for _ in 0..8 {
        workers.push(farm.worker().await);
    }
    let mut claims = JoinSet::new();
    for worker in workers {
        let farm = farm.clone();
        claims.spawn(async move {
            let mut tasks = Vec::new();
            while let Some(held) = farm.claim(&worker).await {
                assert_eq!(farm.complete(&held).await, Close::Closed(AttemptOutcome::Succeeded));
                tasks.push(held.task.task);
            }
            tasks
        });
    }
    let mut all = claims.join_all().await.concat();
    assert_eq!(all.len(), 40);
    all.sort();
    all.dedup();
    assert_eq!(all.len(), 40);
}

pub(super) async fn tasks_go_out_by_priority_then_age(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let worker = farm.worker().await;
    let first = farm.job(&scene).await;
    let second = farm.job(&scene).await;
    let urgent = farm.job_with(&scene, |job| job.priority = 10).await;
    let mut order = Vec::new();
    while let Some(held) = farm.claim(&worker).await {
        order.push(held.task.job);
    }
    assert_eq!(order, [urgent, first, second]);
}

pub(super) async fn a_changed_priority_takes_effect_on_waiting_tasks(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let worker = farm.worker().await;
    let _first = farm.job(&scene).await;
    let second = farm.job(&scene).await;
    farm.store.patch_job(&second, Some(5), None, farm.now()).await.unwrap();
    assert_eq!(farm.claim(&worker).await.unwrap().task.job, second);
}

pub(super) async fn paused_jobs_are_passed_over(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let worker = farm.worker().await;
    let job = farm.job(&scene).await;
    farm.store.patch_job(&job, None, Some(true), farm.now()).await.unwrap();
    assert!(farm.claim(&worker).await.is_none());
    farm.store.patch_job(&job, None, Some(false), farm.now()).await.unwrap();
    assert!(farm.claim(&worker).await.is_some());
}

pub(super) async fn gpu_jobs_go_to_workers_with_a_gpu(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job_with(&scene, |job| picture(job).device = DeviceChoice::Gpu).await;
    let (cpu, gpu) = (farm.worker().await, farm.worker_with(&["cpu", "llvmpipe"]).await);
    assert!(farm.claim(&cpu).await.is_none());
    assert!(farm.claim(&gpu).await.is_some());
}

pub(super) async fn cpu_jobs_go_to_workers_with_a_cpu(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job_with(&scene, |job| picture(job).device = DeviceChoice::Cpu).await;
    let (gpu, cpu) = (farm.worker_with(&["llvmpipe"]).await, farm.worker().await);
    assert!(farm.claim(&gpu).await.is_none());
    assert!(farm.claim(&cpu).await.is_some());
}

pub(super) async fn an_adapter_is_matched_by_part_of_its_name(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job_with(&scene, |job| {
        picture(job).device = DeviceChoice::Gpu;
        picture(job).adapter = Some("RTX 40".to_owned());
    })
    .await;
    let (other, wanted) = (farm.worker_with(&["llvmpipe"]).await, farm.worker_with(&["NVIDIA rtx 4090"]).await);
    assert!(farm.claim(&other).await.is_none());
    assert!(farm.claim(&wanted).await.is_some());
}

pub(super) async fn a_warm_worker_gets_the_scene_it_holds(farm: &Farm) {
    let ((old, _), (warm, mesh)) = (farm.scene().await, farm.scene().await);
    let old_job = farm.job(&old).await;
    let warm_job = farm.job(&warm).await;
    let worker = farm.worker().await;
    let held = farm.claim_warm(&worker, &[&mesh]).await.unwrap();
    assert_eq!(held.task.job, warm_job);
    let newer = farm.job(&warm).await;
    farm.wait(crate::queue::WARM_PATIENCE_MS + 1);
    let newest = farm.job(&warm).await;
    assert_eq!(farm.claim_warm(&worker, &[&mesh]).await.unwrap().task.job, newer, "both are old: the warm one");
    assert_eq!(farm.claim_warm(&worker, &[&mesh]).await.unwrap().task.job, old_job, "it has waited long enough");
    assert_eq!(farm.claim_warm(&worker, &[&mesh]).await.unwrap().task.job, newest);
}

pub(super) async fn a_draining_worker_gets_nothing(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job(&scene).await;
    let worker = farm.worker().await;
    assert!(farm.store.set_draining(&worker, true).await.unwrap());
    assert!(farm.claim(&worker).await.is_none());
    assert!(farm.store.set_draining(&worker, false).await.unwrap());
    assert!(farm.claim(&worker).await.is_some());
    assert!(!farm.store.set_draining("nobody", true).await.unwrap());
}

pub(super) async fn an_unknown_worker_is_told_so(farm: &Farm) {
    let claim = Claim {
        worker: "nobody".to_owned(),
        token: "t".to_owned(),
        attempt: "a".to_owned(),
        now: farm.now(),
        expires_at: farm.now() + TTL,
        warm: Vec::new(),
    };
    assert!(matches!(farm.store.claim(&claim).await.unwrap(), Claimed::UnknownWorker));
}

pub(super) async fn a_lease_is_renewed_until_it_is_taken_away(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    let renew = || farm.store.renew(&held.token, Phase::Render, 0.5, farm.now() + TTL);
    farm.wait(TTL - 1);
    assert!(renew().await.unwrap());
    farm.wait(10 * TTL);
    assert!(renew().await.unwrap(), "late, but it is still this worker's");
    assert!(farm.store.expire_leases(farm.now()).await.unwrap().is_empty());
    let state = farm.store.lease(&held.token).await.unwrap().unwrap();
    assert_eq!((state.phase, state.outcome), (Some(Phase::Render), AttemptOutcome::Running));
    farm.wait(TTL);
    assert_eq!(farm.store.expire_leases(farm.now()).await.unwrap()[0].attempt, state.attempt);
    assert!(!renew().await.unwrap(), "the task is free for others");
}

pub(super) async fn a_look_tells_what_a_claim_would_find(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let (cpu, gpu) = (farm.worker().await, farm.worker_with(&["cpu", "Radeon RX"]).await);
    let look = async |worker: &str| farm.store.has_task_for(worker, farm.now()).await.unwrap();
    assert_eq!(look("nobody").await, None);
    assert_eq!((look(&cpu).await, look(&gpu).await), (Some(false), Some(false)));
    let demanding = farm
        .job_with(&scene, |job| {
            picture(job).device = DeviceChoice::Gpu;
            picture(job).adapter = Some("radeon".to_owned());
        })
        .await;
    assert_eq!((look(&cpu).await, look(&gpu).await), (Some(false), Some(true)));
    farm.store.patch_job(&demanding, None, Some(true), farm.now()).await.unwrap();
    assert_eq!(look(&gpu).await, Some(false), "paused");
    farm.store.patch_job(&demanding, None, Some(false), farm.now()).await.unwrap();
    farm.store.set_draining(&gpu, true).await.unwrap();
    assert_eq!(look(&gpu).await, Some(false), "draining");
    farm.store.set_draining(&gpu, false).await.unwrap();
    let held = farm.claim(&gpu).await.unwrap();
    farm.fail(&held, RetryClass::Worker).await;
    assert_eq!((look(&gpu).await, farm.claim(&gpu).await.is_some()), (Some(false), false), "a moment for its driver");
}

pub(super) async fn poison_is_twice_in_a_row(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| job.max_attempts = 20).await;
    let worker = farm.worker().await;
    let lose = async || {
        let held = farm.claim(&worker).await.unwrap();
        farm.store.renew(&held.token, Phase::Render, 0.1, farm.now() + TTL).await.unwrap();
        farm.wait(TTL);
        farm.store.expire_leases(farm.now()).await.unwrap()[0].again
    };
    assert!(lose().await);
    let between = farm.claim(&worker).await.unwrap();
    farm.fail(&between, RetryClass::Task).await;
    assert!(lose().await, "between the two it got on");
    assert!(!lose().await);
    assert_eq!(farm.task_states(&job).await, [TaskState::Dead]);
}

pub(super) async fn progress_only_falls_when_a_task_starts_anew(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| picture(job).split = Some(Split::Tiles([2, 1]))).await;
    let worker = farm.worker().await;
    let progress = async || {
        let progress = farm.store.task_progress(&job).await.unwrap();
        assert_eq!(farm.read(&job).await.summary.progress, progress.of_job(|_| None));
        progress
    };
    let (left, right) = (farm.claim(&worker).await.unwrap(), farm.claim(&worker).await.unwrap());
    let renew = async |held: &super::Held, fraction| {
        let until = farm.now() + TTL;
        assert!(farm.store.renew(&held.token, Phase::Render, fraction, until).await.unwrap());
    };
    renew(&left, 0.6).await;
    renew(&left, 0.3).await;
    let begun = progress().await;
    assert_eq!((begun.tasks, begun.settled), (3, 0.0));
    assert_eq!((begun.leased[&left.task.task], begun.leased[&right.task.task]), (0.6, 0.0));
    assert_eq!(begun.of_job(|task| (task == left.task.task).then_some(0.9)), 0.3, "what is live may be further");
    assert_eq!(begun.of_job(|_| Some(0.1)), (0.6 + 0.1) / 3.0, "but is not further back");

    farm.complete(&left).await;
    assert_eq!(progress().await.of_job(|_| None), 1.0 / 3.0);
    farm.fail(&right, RetryClass::Task).await;
    farm.store.note_progress(&right.token, 0.9).await.unwrap();
    assert_eq!(progress().await.of_job(|_| None), 1.0 / 3.0, "the lease has ended");
    let again = farm.claim(&worker).await.unwrap();
    farm.store.note_progress(&again.token, 0.5).await.unwrap();
    farm.store.cancel_job(&job, farm.now()).await.unwrap();
    farm.store.release(&again.token, true, farm.now()).await.unwrap();
    assert_eq!(progress().await.of_job(|_| None), 0.5, "a cancelled job stays where it was");
}

pub(super) async fn complete_counts_once(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    assert_eq!(farm.complete(&held).await, Close::Closed(AttemptOutcome::Succeeded));
    assert_eq!(farm.complete(&held).await, Close::Already(AttemptOutcome::Succeeded));
    let job = farm.read(&job).await;
    assert_eq!((job.summary.state, job.artifacts.len()), (JobState::Succeeded, 1));
    assert_eq!(job.metrics.unwrap().render_s, 1.0);
    assert_eq!(farm.store.worker(&worker).await.unwrap().unwrap().tasks_done, 1);
}

pub(super) async fn complete_of_an_unknown_lease_is_ignored(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job(&scene).await;
    let worker = farm.worker().await;
    let mut held = farm.claim(&worker).await.unwrap();
    held.token = "forged".to_owned();
    assert_eq!(farm.complete(&held).await, Close::Unknown);
    assert_eq!(farm.fail(&held, RetryClass::Task).await, Close::Unknown);
}

pub(super) async fn complete_after_expiry_changes_nothing(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let (slow, quick) = (farm.worker().await, farm.worker().await);
    let stale = farm.claim(&slow).await.unwrap();
    farm.wait(TTL);
    assert_eq!(farm.store.expire_leases(farm.now()).await.unwrap().len(), 1);
    assert_eq!(farm.complete(&stale).await, Close::Already(AttemptOutcome::Expired));
    let held = farm.claim(&quick).await.unwrap();
    assert_eq!(farm.complete(&stale).await, Close::Already(AttemptOutcome::Expired), "now it would free a live task");
    assert_eq!(farm.state(&job).await, JobState::Running);
    assert_eq!(farm.complete(&held).await, Close::Closed(AttemptOutcome::Succeeded));
    let artifacts = farm.store.artifacts(&job).await.unwrap();
    assert_eq!(artifacts.len(), 1);
    assert!(artifacts[0].hash.contains(&held.token));
}

pub(super) async fn complete_after_failure_changes_nothing(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    farm.fail_for_good(&held).await;
    assert_eq!(farm.complete(&held).await, Close::Already(AttemptOutcome::Task));
    assert_eq!(farm.fail_for_good(&held).await, Close::Already(AttemptOutcome::Task));
    let job = farm.read(&job).await;
    assert_eq!((job.summary.state, job.artifacts.len()), (JobState::Failed, 0));
    assert_eq!(job.summary.error.as_deref(), Some("bad scene"));
}

pub(super) async fn complete_beats_a_cancellation_that_was_not_seen(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    farm.store.cancel_job(&job, farm.now()).await.unwrap();
    assert_eq!(farm.complete(&held).await, Close::Closed(AttemptOutcome::Succeeded));
    assert_eq!(farm.state(&job).await, JobState::Succeeded, "the picture is there: why throw it away");
}

pub(super) async fn a_failed_task_avoids_the_worker_for_a_while(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job(&scene).await;
    let (bad, good) = (farm.worker().await, farm.worker().await);
    let held = farm.claim(&bad).await.unwrap();
    farm.fail(&held, RetryClass::Worker).await;
    farm.wait(1);
    assert!(farm.claim(&bad).await.is_none());
    let held = farm.claim(&good).await.unwrap();
    farm.store.release(&held.token, false, farm.now()).await.unwrap();
    farm.wait(crate::queue::WORKER_PATIENCE_MS);
    assert!(farm.claim(&bad).await.is_some(), "the other one had its chance");
}

pub(super) async fn two_worker_failures_block_the_worker_from_the_job(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job_with(&scene, |job| picture(job).split = Some(Split::Tiles([4, 1]))).await;
    let (worker, _other) = (farm.worker().await, farm.worker().await);
    for _ in 0..2 {
        let held = farm.claim(&worker).await.unwrap();
        farm.fail(&held, RetryClass::Worker).await;
    }
    assert!(farm.claim(&worker).await.is_none());
    let other = farm.job(&scene).await;
    assert_eq!(farm.claim(&worker).await.unwrap().task.job, other, "only from that job");
    farm.wait(crate::queue::BLOCK_MS);
    assert!(farm.claim(&worker).await.is_some());
}

pub(super) async fn the_last_worker_that_could_do_it_gets_every_attempt(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| picture(job).device = DeviceChoice::Gpu).await;
    let worker = farm.worker_with(&["gpu"]).await;
    // None of these could: without a GPU, draining, removed, not heard of for long.
    let (_cpu, draining, removed) =
        (farm.worker().await, farm.worker_with(&["gpu"]).await, farm.worker_with(&["gpu"]).await);
    farm.store.set_draining(&draining, true).await.unwrap();
    farm.store.remove_worker(&removed, farm.now()).await.unwrap();
    let _gone = farm.worker_with(&["gpu"]).await;
    farm.wait(crate::queue::GONE_AFTER_MS);
    for _ in 0..3 {
        let held = farm.claim(&worker).await.expect("it is the only one left");
        farm.fail(&held, RetryClass::Worker).await;
        farm.wait(crate::queue::WORKER_PAUSE_MS - 1);
        assert!(farm.claim(&worker).await.is_none(), "a moment for its driver");
        farm.wait(1);
    }
    assert_eq!(farm.task_states(&job).await, [TaskState::Dead]);
    assert_eq!(farm.read(&job).await.summary.error.as_deref(), Some("Worker"));
}

pub(super) async fn blocked_workers_are_free_again_once_all_are_blocked(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| job.max_attempts = 6).await;
    let workers = [farm.worker().await, farm.worker().await];
    let mut tried = Vec::new();
    while farm.state(&job).await != JobState::Failed {
        assert!(tried.len() < 6, "attempts are limited");
        for (i, worker) in workers.iter().enumerate() {
            if let Some(held) = farm.claim(worker).await {
                tried.push(i);
                farm.fail(&held, RetryClass::Worker).await;
            }
        }
        farm.wait(crate::queue::WORKER_PAUSE_MS);
        for worker in &workers {
            farm.store.touch_worker(worker, farm.now()).await.unwrap();
        }
        assert!(farm.now() < 1_800_000_000_000 + crate::queue::BLOCK_MS, "it must not wait for the end of a block");
    }
    assert_eq!(tried[..4].iter().filter(|&&i| i == 0).count(), 2, "both had their two tries: {tried:?}");
}

pub(super) async fn a_transient_failure_waits(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    farm.fail(&held, RetryClass::Transient).await;
    farm.wait(9_999);
    assert!(farm.claim(&worker).await.is_none());
    assert!(!farm.store.has_task_for(&worker, farm.now()).await.unwrap().unwrap());
    farm.wait(1);
    assert!(farm.store.has_task_for(&worker, farm.now()).await.unwrap().unwrap());
    assert_eq!(farm.claim(&worker).await.unwrap().task.number, 2);
}

pub(super) async fn attempts_are_used_up(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let worker = farm.worker().await;
    for _ in 0..3 {
        let held = farm.claim(&worker).await.unwrap();
        farm.fail(&held, RetryClass::Task).await;
    }
    assert!(farm.claim(&worker).await.is_none());
    assert_eq!(farm.task_states(&job).await, [TaskState::Dead]);
    let job = farm.read(&job).await;
    assert_eq!((job.summary.state, job.attempts.len()), (JobState::Failed, 3), "every attempt stays to be seen");
}

pub(super) async fn a_fatal_failure_cancels_the_siblings(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| picture(job).split = Some(Split::Tiles([3, 1]))).await;
    let worker = farm.worker().await;
    let (bad, running) = (farm.claim(&worker).await.unwrap(), farm.claim(&worker).await.unwrap());
    farm.fail_for_good(&bad).await;
    use TaskState::{Cancelled, Failed, Leased};
    assert_eq!(farm.task_states(&job).await, [Failed, Leased, Cancelled, Cancelled]);
    assert_eq!(farm.state(&job).await, JobState::Running, "one still has to stop");
    assert!(farm.store.lease(&running.token).await.unwrap().unwrap().cancel_requested);
    farm.store.release(&running.token, true, farm.now()).await.unwrap();
    assert_eq!(farm.state(&job).await, JobState::Failed);
}

pub(super) async fn expired_tasks_are_rescued_in_batches(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let worker = farm.worker().await;
    for _ in 0..150 {
        farm.job(&scene).await;
        farm.claim(&worker).await.unwrap();
    }
    farm.wait(TTL);
    let mut sizes = Vec::new();
    loop {
        let batch = farm.store.expire_leases(farm.now()).await.unwrap();
        sizes.push(batch.len());
        if batch.is_empty() {
            break;
        }
    }
    assert_eq!(sizes, [100, 50, 0]);
    assert!(farm.claim(&worker).await.is_some());
}

pub(super) async fn a_task_that_kills_its_workers_dies(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| job.max_attempts = 20).await;
    let worker = farm.worker().await;
    for last in [false, true] {
        let held = farm.claim(&worker).await.unwrap();
        farm.store.renew(&held.token, Phase::Structures, 0.1, farm.now() + TTL).await.unwrap();
        farm.wait(TTL);
        let expired = farm.store.expire_leases(farm.now()).await.unwrap();
        assert_eq!(expired[0].again, !last);
    }
    assert_eq!(farm.task_states(&job).await, [TaskState::Dead]);
    assert!(farm.read(&job).await.summary.error.unwrap().contains("structures"));
}

pub(super) async fn a_worker_that_registers_anew_has_lost_its_lease(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job(&scene).await;
    let worker = farm.worker().await;
    let lost = farm.claim(&worker).await.unwrap();
    let expired = farm.store.register_worker(&worker, &new_worker(&["cpu"]), farm.now()).await.unwrap();
    assert_eq!((expired.len(), &expired[0].task), (1, &lost.task.task));
    assert_eq!(farm.complete(&lost).await, Close::Already(AttemptOutcome::Expired));
    assert_eq!(farm.claim(&worker).await.unwrap().task.number, 2, "at once, not after the lease's time");
    let error = farm.read(&lost.task.job).await.attempts[0].error.clone().unwrap();
    assert!(error.contains("started anew") && !error.contains("heartbeat"), "{error}");
}

pub(super) async fn a_cancelled_task_is_released_as_cancelled(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    farm.store.cancel_job(&job, farm.now()).await.unwrap();
    let close = farm.store.release(&held.token, true, farm.now()).await.unwrap();
    assert_eq!(close, Close::Closed(AttemptOutcome::Cancelled));
    assert_eq!(farm.state(&job).await, JobState::Cancelled);
}

pub(super) async fn a_release_without_cancellation_gives_the_task_back(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    let worker = farm.worker().await;
    for cancelled in [false, true] {
        let held = farm.claim(&worker).await.unwrap();
        let close = farm.store.release(&held.token, cancelled, farm.now()).await.unwrap();
        assert_eq!(close, Close::Closed(AttemptOutcome::Interrupted), "a worker cannot cancel by itself");
        assert_eq!(farm.state(&job).await, JobState::Queued);
    }
    assert_eq!(farm.read(&job).await.tasks[0].attempt, 0);
}
