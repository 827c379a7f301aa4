use super::*;
use jiff::Timestamp;
use lightshaft_api::job::{Metrics, TaskWork};
use lightshaft_api::lease::LeaseScene;
use lightshaft_api::settings::JobSettings;

const S: Duration = Duration::from_secs(1);

fn lease() -> Box<Lease> {
    Box::new(Lease {
        token: "secret".into(),
        ttl_s: 60,
        heartbeat_s: 0.5,
        expires_at: Timestamp::UNIX_EPOCH,
        job: "j".into(),
        task: "t".into(),
        attempt: "a".into(),
        attempt_number: 1,
        waited_s: 0.0,
        traceparent: String::new(),
        work: TaskWork::Frame,
        settings: JobSettings::default(),
        scene: LeaseScene { id: "s".into(), name: "s".into(), files: vec![], meshes: vec![] },
        more_scenes: vec![],
        parts: vec![],
    })
}

fn complete() -> Box<Complete> {
    Box::new(Complete { artifacts: vec![], metrics: Metrics::default() })
}

fn reply() -> HeartbeatReply {
    HeartbeatReply { expires_at: Timestamp::UNIX_EPOCH, cancel: false, drain: false }
}

fn down() -> CallError {
    CallError::Unavailable { retry_after: None }
}

fn polling() -> Protocol {
    let mut p = Protocol::new(7);
    assert_eq!(p.step(Input::Start), [Effect::Register]);
    assert_eq!(p.step(Input::Registered(Ok("w".into()))), [poll()]);
    p
}

fn poll() -> Effect {
    Effect::Poll { worker: "w".into() }
}

/// A worker that got a lease.
fn working() -> Protocol {
    let mut p = polling();
    let effects = p.step(Input::Leased(Ok(Some(lease()))));
    assert_eq!(effects, [Effect::Begin(1, lease()), Effect::Arm(Timer::Heartbeat, S / 2)]);
    p
}

/// A report, and heartbeats that from now on only keep the lease.
fn ends_with(report: Report) -> [Effect; 2] {
    [Effect::Report(1, report), Effect::Arm(Timer::Heartbeat, 20 * S)]
}

fn armed(effects: &[Effect], timer: Timer) -> Option<Duration> {
    effects.iter().find_map(|e| match e {
        Effect::Arm(t, after) if *t == timer => Some(*after),
        _ => None,
    })
}

#[test]
fn an_empty_poll_is_repeated() {
    let mut p = polling();
    assert_eq!(p.step(Input::Leased(Ok(None))), [Effect::Arm(Timer::Retry, POLL_PAUSE)]);
    assert_eq!(p.step(Input::Due(Timer::Retry)), [poll()]);
}

#[test]
fn a_finished_task_is_completed_and_the_next_one_asked_for() {
    let mut p = working();
    let report = Report::Complete(complete());
    assert_eq!(p.step(Input::Finished(1, Outcome::Done(complete()))), ends_with(report));
    assert!(p.step(Input::Reported(1, Ok(()))).contains(&poll()));
    assert!(!p.is_busy());
}

#[test]
fn a_worker_that_the_service_forgot_registers_anew() {
    let mut p = polling();
    assert_eq!(p.step(Input::Leased(Err(CallError::Unknown))), [Effect::Register]);
    let effects = p.step(Input::Registered(Ok("w2".into())));
    assert_eq!(effects, [Effect::Poll { worker: "w2".into() }]);
}

#[test]
fn a_refused_registration_ends_the_worker_with_the_reason() {
    let mut p = Protocol::new(1);
    p.step(Input::Start);
    let effects = p.step(Input::Registered(Err(CallError::Refused("too old".into()))));
    assert!(matches!(&effects[..], [Effect::Exit(Some(why))] if why.contains("too old")));
}

#[test]
fn back_off_doubles_up_to_a_cap_with_jitter_and_starts_afresh_after_an_answer() {
    let mut p = polling();
    for n in 0..12 {
        let effects = p.step(Input::Leased(Err(down())));
        let wait = armed(&effects, Timer::Retry).unwrap();
        let full = (BACKOFF_FIRST * 2u32.pow(n)).min(BACKOFF_CAP);
        assert!(wait <= full && wait >= full / 2, "try {n}: {wait:?}");
        assert_eq!(p.step(Input::Due(Timer::Retry)), [poll()]);
    }
    p.step(Input::Leased(Ok(None)));
    let effects = p.step(Input::Leased(Err(down())));
    assert!(armed(&effects, Timer::Retry).unwrap() <= BACKOFF_FIRST);
}

#[test]
fn two_workers_come_back_at_different_moments() {
    let wait = |seed| {
        let mut p = Protocol::new(seed);
        p.step(Input::Start);
        armed(&p.step(Input::Registered(Err(down()))), Timer::Retry).unwrap()
    };
    assert_ne!(wait(1), wait(2));
}

#[test]
fn retry_after_is_obeyed() {
    let mut p = polling();
    let busy = CallError::Unavailable { retry_after: Some(45 * S) };
    let effects = p.step(Input::Leased(Err(busy)));
    assert_eq!(armed(&effects, Timer::Retry), Some(45 * S));
}

#[test]
fn heartbeats_follow_the_service_s_period_and_only_one_is_in_flight() {
    let mut p = working();
    assert_eq!(p.step(Input::Due(Timer::Heartbeat)), [Effect::Heartbeat(1)]);
    assert_eq!(p.step(Input::Due(Timer::Heartbeat)), []);
    assert_eq!(p.step(Input::Beat(1, Ok(reply()))), [Effect::Arm(Timer::Heartbeat, S / 2)]);
    assert_eq!(p.step(Input::Due(Timer::Heartbeat)), [Effect::Heartbeat(1)]);
}

#[test]
fn a_stale_lease_stops_the_work_and_reports_nothing() {
    for error in [CallError::Stale, CallError::Unknown] {
        let mut p = working();
        p.step(Input::Due(Timer::Heartbeat));
        let effects = p.step(Input::Beat(1, Err(error)));
        assert!(effects.contains(&Effect::Stop(1)));
        assert!(p.is_busy(), "the executor is still winding down");
        let effects = p.step(Input::Finished(1, Outcome::Done(complete())));
        assert!(effects.contains(&poll()));
        assert!(!effects.iter().any(|e| matches!(e, Effect::Report(..))));
    }
}

#[test]
fn a_heartbeat_that_the_service_refuses_fails_the_task() {
    let mut p = working();
    p.step(Input::Due(Timer::Heartbeat));
    let refused = CallError::Refused("unknown field".into());
    assert_eq!(p.step(Input::Beat(1, Err(refused))), [Effect::Stop(1)]);
    let effects = p.step(Input::Finished(1, Outcome::Stopped));
    assert!(matches!(&effects[0], Effect::Report(1, Report::Fail(f)) if f.error.contains("unknown field")));
}

#[test]
fn without_the_service_the_work_goes_on_however_long_and_heartbeats_are_tried_within_the_time_to_live() {
    let mut p = working();
    let mut away = Duration::ZERO;
    while away < 600 * S {
        assert_eq!(p.step(Input::Due(Timer::Heartbeat)), [Effect::Heartbeat(1)], "after {away:?}");
        let effects = p.step(Input::Beat(1, Err(down())));
        let wait = armed(&effects, Timer::Heartbeat).unwrap();
        assert!(effects.len() == 1 && wait <= 20 * S, "after {away:?}: {effects:?}");
        away += wait;
    }
    // The service is back, and nobody has taken the lease away meanwhile.
    p.step(Input::Due(Timer::Heartbeat));
    assert_eq!(p.step(Input::Beat(1, Ok(reply()))), [Effect::Arm(Timer::Heartbeat, S / 2)]);
    let effects = p.step(Input::Finished(1, Outcome::Done(complete())));
    assert!(effects.contains(&Effect::Report(1, Report::Complete(complete()))));
}

#[test]
fn after_an_outage_only_the_service_s_word_makes_a_worker_drop_its_work() {
    let mut p = working();
    for _ in 0..50 {
        p.step(Input::Due(Timer::Heartbeat));
        p.step(Input::Beat(1, Err(down())));
    }
    p.step(Input::Due(Timer::Heartbeat));
    assert!(p.step(Input::Beat(1, Err(CallError::Stale))).contains(&Effect::Stop(1)));
    let effects = p.step(Input::Finished(1, Outcome::Stopped));
    assert!(effects.contains(&poll()) && !effects.iter().any(|e| matches!(e, Effect::Report(..))));
}

#[test]
fn cancel_stops_the_work_and_releases_it_as_cancelled() {
    let mut p = working();
    p.step(Input::Due(Timer::Heartbeat));
    let effects = p.step(Input::Beat(1, Ok(HeartbeatReply { cancel: true, ..reply() })));
    assert!(effects.contains(&Effect::Stop(1)));
    // The lease is kept alive meanwhile, and asking twice stops once.
    p.step(Input::Due(Timer::Heartbeat));
    let effects = p.step(Input::Beat(1, Ok(HeartbeatReply { cancel: true, ..reply() })));
    assert!(!effects.contains(&Effect::Stop(1)));
    let effects = p.step(Input::Finished(1, Outcome::Stopped));
    assert_eq!(effects, ends_with(Report::Release(Release { cancelled: true })));
}

#[test]
fn work_that_was_done_before_the_cancel_reached_it_is_completed() {
    let mut p = working();
    p.step(Input::Due(Timer::Heartbeat));
    p.step(Input::Beat(1, Ok(HeartbeatReply { cancel: true, ..reply() })));
    let effects = p.step(Input::Finished(1, Outcome::Done(complete())));
    assert_eq!(effects, ends_with(Report::Complete(complete())));
}

#[test]
fn a_failure_after_a_stop_is_a_release() {
    let mut p = working();
    assert_eq!(p.step(Input::Shutdown), [Effect::Stop(1)]);
    let fail = Fail { class: RetryClass::Worker, error: "device lost".into(), fatal: false };
    let effects = p.step(Input::Finished(1, Outcome::Failed(fail)));
    assert_eq!(effects, ends_with(Report::Release(Release { cancelled: false })));
}

#[test]
fn drain_finishes_the_task_and_then_leaves() {
    let mut p = working();
    assert_eq!(p.step(Input::Drain), []);
    p.step(Input::Finished(1, Outcome::Done(complete())));
    assert!(p.step(Input::Reported(1, Ok(()))).contains(&Effect::Exit(None)));
}

#[test]
fn a_worker_that_the_service_drains_stays_and_asks_on_since_the_service_may_undo_it() {
    let mut p = working();
    p.step(Input::Due(Timer::Heartbeat));
    let effects = p.step(Input::Beat(1, Ok(HeartbeatReply { drain: true, ..reply() })));
    assert!(!effects.contains(&Effect::Stop(1)));
    p.step(Input::Finished(1, Outcome::Done(complete())));
    assert!(p.step(Input::Reported(1, Ok(()))).contains(&poll()));
}

#[test]
fn an_idle_worker_that_leaves_says_so_and_awaits_the_answer_to_its_poll() {
    for order in [Input::Drain, Input::Shutdown] {
        let mut p = polling();
        let patience = Effect::Arm(Timer::Retry, PARTING_PATIENCE);
        assert_eq!(p.step(order), [Effect::Part { worker: "w".into() }, patience]);
        assert_eq!(p.step(Input::Shutdown), [], "it is leaving already");
        assert_eq!(p.step(Input::Leased(Ok(None))), [Effect::Exit(None)]);
    }
}

#[test]
fn a_task_that_comes_while_the_worker_leaves_goes_back_before_it_is_begun() {
    let mut p = polling();
    p.step(Input::Drain);
    assert_eq!(p.step(Input::Leased(Ok(Some(lease())))), [Effect::GiveBack(1, "secret".into())]);
    let mut other = polling();
    other.step(Input::Drain);
    other.step(Input::Leased(Ok(Some(lease()))));
    for (mut p, answer) in [(p, Ok(())), (other, Err(down()))] {
        assert!(p.step(Input::Reported(1, answer)).contains(&Effect::Exit(None)));
    }
}

#[test]
fn a_worker_that_leaves_does_not_wait_for_ever_for_its_poll() {
    let mut p = polling();
    p.step(Input::Drain);
    assert_eq!(p.step(Input::Due(Timer::Retry)), [Effect::Exit(None)]);
    let mut p = polling();
    p.step(Input::Drain);
    assert_eq!(p.step(Input::Leased(Err(down()))), [Effect::Exit(None)]);
    // Between two polls there is nothing to wait for.
    let mut p = polling();
    p.step(Input::Leased(Ok(None)));
    assert_eq!(p.step(Input::Drain), [Effect::Exit(None)]);
}

#[test]
fn shutdown_releases_as_interrupted_and_leaves() {
    let mut p = working();
    assert_eq!(p.step(Input::Drain), []);
    assert_eq!(p.step(Input::Shutdown), [Effect::Stop(1)]);
    let effects = p.step(Input::Finished(1, Outcome::Stopped));
    assert_eq!(effects, ends_with(Report::Release(Release { cancelled: false })));
    assert!(p.step(Input::Reported(1, Ok(()))).contains(&Effect::Exit(None)));
}

#[test]
fn shutdown_does_not_wait_for_a_service_that_is_gone() {
    let mut p = working();
    p.step(Input::Shutdown);
    p.step(Input::Finished(1, Outcome::Stopped));
    assert!(p.step(Input::Reported(1, Err(down()))).contains(&Effect::Exit(None)));
}

#[test]
fn a_report_is_repeated_until_answered_and_the_lease_kept_alive_meanwhile() {
    let mut p = working();
    let report = Effect::Report(1, Report::Complete(complete()));
    p.step(Input::Finished(1, Outcome::Done(complete())));
    for _ in 0..20 {
        let effects = p.step(Input::Reported(1, Err(down())));
        assert!(armed(&effects, Timer::Retry).is_some());
        assert_eq!(p.step(Input::Due(Timer::Heartbeat)), [Effect::Heartbeat(1)]);
        assert_eq!(p.step(Input::Beat(1, Ok(reply()))), [Effect::Arm(Timer::Heartbeat, 20 * S)]);
        assert_eq!(p.step(Input::Due(Timer::Retry)), std::slice::from_ref(&report));
    }
    assert!(p.step(Input::Reported(1, Ok(()))).contains(&poll()));
}

#[test]
fn a_heartbeat_that_the_report_overtakes_changes_nothing() {
    let mut p = working();
    p.step(Input::Due(Timer::Heartbeat));
    p.step(Input::Finished(1, Outcome::Done(complete())));
    assert_eq!(p.step(Input::Beat(1, Err(CallError::Stale))), [Effect::Disarm(Timer::Heartbeat)]);
    assert!(p.step(Input::Reported(1, Ok(()))).contains(&poll()));
}

#[test]
fn a_report_on_a_stale_lease_is_dropped() {
    let mut p = working();
    p.step(Input::Finished(1, Outcome::Done(complete())));
    assert!(p.step(Input::Reported(1, Err(CallError::Stale))).contains(&poll()));
}

#[test]
fn a_result_that_the_service_refuses_becomes_a_failure_once() {
    let mut p = working();
    p.step(Input::Finished(1, Outcome::Done(complete())));
    let effects = p.step(Input::Reported(1, Err(CallError::Refused("no such blob".into()))));
    assert!(matches!(&effects[..], [Effect::Report(1, Report::Fail(f))] if f.error.contains("no such blob")));
    assert!(p.step(Input::Reported(1, Err(CallError::Refused("still".into())))).contains(&poll()));
}

#[test]
fn late_answers_about_an_earlier_lease_change_nothing() {
    let mut p = working();
    p.step(Input::Finished(1, Outcome::Done(complete())));
    p.step(Input::Reported(1, Ok(())));
    p.step(Input::Leased(Ok(Some(lease()))));
    assert_eq!(p.step(Input::Beat(1, Err(CallError::Stale))), []);
    assert_eq!(p.step(Input::Finished(1, Outcome::Stopped)), []);
    assert_eq!(p.step(Input::Reported(1, Err(CallError::Stale))), []);
    let effects = p.step(Input::Finished(2, Outcome::Done(complete())));
    assert_eq!(effects[0], Effect::Report(2, Report::Complete(complete())));
}

#[test]
fn a_nonsense_heartbeat_period_neither_loses_the_lease_nor_floods_the_service() {
    for (seconds, expected) in [(f64::NAN, 20 * S), (-1.0, 20 * S), (0.0, S / 10), (1e300, 20 * S), (5.0, 5 * S)] {
        let mut p = polling();
        let odd = Box::new(Lease { heartbeat_s: seconds, ..*lease() });
        let effects = p.step(Input::Leased(Ok(Some(odd))));
        assert_eq!(armed(&effects, Timer::Heartbeat), Some(expected), "{seconds}");
    }
}
