use super::*;
use jiff::Timestamp;
use lightshaft_api::job::{Metrics, TaskWork};
use lightshaft_api::lease::LeaseScene;
use lightshaft_api::settings::RenderSettings;

const START: Duration = Duration::ZERO;
const S: Duration = Duration::from_secs(1);

fn lease() -> Box<Lease> {
    Box::new(Lease {
        token: "secret".into(),
        ttl_s: 60,
        heartbeat_s: 20.0,
        expires_at: Timestamp::UNIX_EPOCH,
        job: "j".into(),
        task: "t".into(),
        attempt: "a".into(),
        attempt_number: 1,
        waited_s: 0.0,
        traceparent: String::new(),
        work: TaskWork::Frame,
        settings: RenderSettings::default(),
        scene: LeaseScene { id: "s".into(), name: "s".into(), files: vec![], meshes: vec![] },
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
    assert_eq!(p.step(START, Input::Start), [Effect::Register]);
    assert_eq!(p.step(START, Input::Registered(Ok("w".into()))), [poll()]);
    p
}

fn poll() -> Effect {
    Effect::Poll { worker: "w".into() }
}

/// A worker that got a lease at time 0.
fn working() -> Protocol {
    let mut p = polling();
    let effects = p.step(START, Input::Leased(Ok(Some(lease()))));
    assert_eq!(
        effects,
        [Effect::Begin(1, lease()), Effect::Arm(Timer::Heartbeat, LIVE_PERIOD), Effect::Arm(Timer::Expiry, 60 * S)]
    );
    p
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
    assert_eq!(p.step(S, Input::Leased(Ok(None))), [Effect::Arm(Timer::Retry, POLL_PAUSE)]);
    assert_eq!(p.step(S, Input::Due(Timer::Retry)), [poll()]);
}

#[test]
fn a_finished_task_is_completed_and_the_next_one_asked_for() {
    let mut p = working();
    let report = Report::Complete(complete());
    assert_eq!(p.step(S, Input::Finished(1, Outcome::Done(complete()))), [Effect::Report(1, report)]);
    assert!(p.step(S, Input::Reported(1, Ok(()))).contains(&poll()));
    assert!(!p.is_busy());
}

#[test]
fn a_worker_that_the_service_forgot_registers_anew() {
    let mut p = polling();
    assert_eq!(p.step(S, Input::Leased(Err(CallError::Unknown))), [Effect::Register]);
    let effects = p.step(S, Input::Registered(Ok("w2".into())));
    assert_eq!(effects, [Effect::Poll { worker: "w2".into() }]);
}

#[test]
fn a_refused_registration_ends_the_worker_with_the_reason() {
    let mut p = Protocol::new(1);
    p.step(START, Input::Start);
    let effects = p.step(START, Input::Registered(Err(CallError::Refused("too old".into()))));
    assert!(matches!(&effects[..], [Effect::Exit(Some(why))] if why.contains("too old")));
}

#[test]
fn back_off_doubles_up_to_a_cap_with_jitter_and_starts_afresh_after_an_answer() {
    let mut p = polling();
    for n in 0..12 {
        let effects = p.step(S, Input::Leased(Err(down())));
        let wait = armed(&effects, Timer::Retry).unwrap();
        let full = (BACKOFF_FIRST * 2u32.pow(n)).min(BACKOFF_CAP);
        assert!(wait <= full && wait >= full / 2, "try {n}: {wait:?}");
        assert_eq!(p.step(S, Input::Due(Timer::Retry)), [poll()]);
    }
    p.step(S, Input::Leased(Ok(None)));
    let effects = p.step(S, Input::Leased(Err(down())));
    assert!(armed(&effects, Timer::Retry).unwrap() <= BACKOFF_FIRST);
}

#[test]
fn two_workers_come_back_at_different_moments() {
    let wait = |seed| {
        let mut p = Protocol::new(seed);
        p.step(START, Input::Start);
        armed(&p.step(START, Input::Registered(Err(down()))), Timer::Retry).unwrap()
    };
    assert_ne!(wait(1), wait(2));
}

#[test]
fn retry_after_is_obeyed() {
    let mut p = polling();
    let busy = CallError::Unavailable { retry_after: Some(45 * S) };
    let effects = p.step(S, Input::Leased(Err(busy)));
    assert_eq!(armed(&effects, Timer::Retry), Some(45 * S));
}

#[test]
fn heartbeats_follow_the_period_and_only_one_is_in_flight() {
    let mut p = working();
    assert_eq!(p.step(20 * S, Input::Due(Timer::Heartbeat)), [Effect::Heartbeat(1)]);
    assert_eq!(p.step(25 * S, Input::Due(Timer::Heartbeat)), []);
    let effects = p.step(26 * S, Input::Beat(1, Ok(reply())));
    assert_eq!(armed(&effects, Timer::Heartbeat), Some(LIVE_PERIOD));
    // Counted from when it was sent, not from when the answer came.
    assert_eq!(armed(&effects, Timer::Expiry), Some(44 * S));
}

#[test]
fn a_stale_lease_stops_the_work_and_reports_nothing() {
    for error in [CallError::Stale, CallError::Unknown] {
        let mut p = working();
        p.step(20 * S, Input::Due(Timer::Heartbeat));
        let effects = p.step(20 * S, Input::Beat(1, Err(error)));
        assert!(effects.contains(&Effect::Stop(1)));
        assert!(p.is_busy(), "the executor is still winding down");
        let effects = p.step(21 * S, Input::Finished(1, Outcome::Done(complete())));
        assert!(effects.contains(&poll()));
        assert!(!effects.iter().any(|e| matches!(e, Effect::Report(..))));
    }
}

#[test]
fn a_heartbeat_that_the_service_refuses_fails_the_task() {
    let mut p = working();
    p.step(20 * S, Input::Due(Timer::Heartbeat));
    let refused = CallError::Refused("unknown field".into());
    assert_eq!(p.step(20 * S, Input::Beat(1, Err(refused))), [Effect::Stop(1)]);
    let effects = p.step(21 * S, Input::Finished(1, Outcome::Stopped));
    assert!(matches!(&effects[..], [Effect::Report(1, Report::Fail(f))] if f.error.contains("unknown field")));
}

#[test]
fn without_the_service_work_goes_on_until_the_lease_has_run_out() {
    let mut p = working();
    let mut now = 20 * S;
    loop {
        p.step(now, Input::Due(Timer::Heartbeat));
        let effects = p.step(now, Input::Beat(1, Err(down())));
        assert!(!effects.contains(&Effect::Stop(1)), "stopped at {now:?}");
        now += armed(&effects, Timer::Heartbeat).unwrap();
        if now >= 60 * S {
            break;
        }
    }
    assert!(p.step(60 * S, Input::Due(Timer::Expiry)).contains(&Effect::Stop(1)));
    let effects = p.step(61 * S, Input::Finished(1, Outcome::Stopped));
    assert!(effects.contains(&poll()) && !effects.iter().any(|e| matches!(e, Effect::Report(..))));
}

#[test]
fn a_heartbeat_that_gets_through_late_saves_the_lease() {
    let mut p = working();
    p.step(20 * S, Input::Due(Timer::Heartbeat));
    p.step(40 * S, Input::Beat(1, Err(down())));
    p.step(41 * S, Input::Due(Timer::Heartbeat));
    p.step(42 * S, Input::Beat(1, Ok(reply())));
    // The timer of the first expiry, had the driver not re-armed it.
    assert_eq!(p.step(60 * S, Input::Due(Timer::Expiry)), [Effect::Arm(Timer::Expiry, 31 * S)]);
}

#[test]
fn cancel_stops_the_work_and_releases_it_as_cancelled() {
    let mut p = working();
    p.step(20 * S, Input::Due(Timer::Heartbeat));
    let effects = p.step(20 * S, Input::Beat(1, Ok(HeartbeatReply { cancel: true, ..reply() })));
    assert!(effects.contains(&Effect::Stop(1)));
    // The lease is kept alive meanwhile, and asking twice stops once.
    p.step(40 * S, Input::Due(Timer::Heartbeat));
    let effects = p.step(40 * S, Input::Beat(1, Ok(HeartbeatReply { cancel: true, ..reply() })));
    assert!(!effects.contains(&Effect::Stop(1)));
    let effects = p.step(41 * S, Input::Finished(1, Outcome::Stopped));
    assert_eq!(effects, [Effect::Report(1, Report::Release(Release { cancelled: true }))]);
}

#[test]
fn work_that_was_done_before_the_cancel_reached_it_is_completed() {
    let mut p = working();
    p.step(20 * S, Input::Due(Timer::Heartbeat));
    p.step(20 * S, Input::Beat(1, Ok(HeartbeatReply { cancel: true, ..reply() })));
    let effects = p.step(20 * S, Input::Finished(1, Outcome::Done(complete())));
    assert_eq!(effects, [Effect::Report(1, Report::Complete(complete()))]);
}

#[test]
fn a_failure_after_a_stop_is_a_release() {
    let mut p = working();
    assert_eq!(p.step(S, Input::Shutdown), [Effect::Stop(1)]);
    let fail = Fail { class: RetryClass::Worker, error: "device lost".into(), fatal: false };
    let effects = p.step(2 * S, Input::Finished(1, Outcome::Failed(fail)));
    assert_eq!(effects, [Effect::Report(1, Report::Release(Release { cancelled: false }))]);
}

#[test]
fn drain_finishes_the_task_and_then_leaves() {
    let mut p = working();
    assert_eq!(p.step(S, Input::Drain), []);
    p.step(2 * S, Input::Finished(1, Outcome::Done(complete())));
    assert!(p.step(3 * S, Input::Reported(1, Ok(()))).contains(&Effect::Exit(None)));
}

#[test]
fn a_worker_that_the_service_drains_stays_and_asks_on_since_the_service_may_undo_it() {
    let mut p = working();
    p.step(20 * S, Input::Due(Timer::Heartbeat));
    let effects = p.step(20 * S, Input::Beat(1, Ok(HeartbeatReply { drain: true, ..reply() })));
    assert!(!effects.contains(&Effect::Stop(1)));
    p.step(21 * S, Input::Finished(1, Outcome::Done(complete())));
    assert!(p.step(22 * S, Input::Reported(1, Ok(()))).contains(&poll()));
}

#[test]
fn an_idle_worker_leaves_at_once() {
    assert_eq!(polling().step(S, Input::Drain), [Effect::Exit(None)]);
    assert_eq!(polling().step(S, Input::Shutdown), [Effect::Exit(None)]);
}

#[test]
fn shutdown_releases_as_interrupted_and_leaves() {
    let mut p = working();
    assert_eq!(p.step(S, Input::Drain), []);
    assert_eq!(p.step(2 * S, Input::Shutdown), [Effect::Stop(1)]);
    let effects = p.step(3 * S, Input::Finished(1, Outcome::Stopped));
    assert_eq!(effects, [Effect::Report(1, Report::Release(Release { cancelled: false }))]);
    assert!(p.step(4 * S, Input::Reported(1, Ok(()))).contains(&Effect::Exit(None)));
}

#[test]
fn shutdown_does_not_wait_for_a_service_that_is_gone() {
    let mut p = working();
    p.step(S, Input::Shutdown);
    p.step(2 * S, Input::Finished(1, Outcome::Stopped));
    assert!(p.step(3 * S, Input::Reported(1, Err(down()))).contains(&Effect::Exit(None)));
}

#[test]
fn a_report_is_repeated_until_answered_and_the_lease_kept_alive_meanwhile() {
    let mut p = working();
    let report = Effect::Report(1, Report::Complete(complete()));
    p.step(19 * S, Input::Finished(1, Outcome::Done(complete())));
    let effects = p.step(19 * S, Input::Reported(1, Err(down())));
    assert!(armed(&effects, Timer::Retry).is_some());
    assert_eq!(p.step(20 * S, Input::Due(Timer::Heartbeat)), [Effect::Heartbeat(1)]);
    assert_eq!(p.step(20 * S, Input::Due(Timer::Retry)), std::slice::from_ref(&report));
    p.step(20 * S, Input::Reported(1, Err(down())));
    // Past the expiry as well: the token decides.
    assert_eq!(p.step(61 * S, Input::Due(Timer::Expiry)), []);
    assert_eq!(p.step(90 * S, Input::Due(Timer::Retry)), [report]);
    assert!(p.step(90 * S, Input::Reported(1, Ok(()))).contains(&poll()));
}

#[test]
fn a_report_on_a_stale_lease_is_dropped() {
    let mut p = working();
    p.step(S, Input::Finished(1, Outcome::Done(complete())));
    assert!(p.step(S, Input::Reported(1, Err(CallError::Stale))).contains(&poll()));
}

#[test]
fn a_result_that_the_service_refuses_becomes_a_failure_once() {
    let mut p = working();
    p.step(S, Input::Finished(1, Outcome::Done(complete())));
    let effects = p.step(S, Input::Reported(1, Err(CallError::Refused("no such blob".into()))));
    assert!(matches!(&effects[..], [Effect::Report(1, Report::Fail(f))] if f.error.contains("no such blob")));
    assert!(p.step(S, Input::Reported(1, Err(CallError::Refused("still".into())))).contains(&poll()));
}

#[test]
fn late_answers_about_an_earlier_lease_change_nothing() {
    let mut p = working();
    p.step(S, Input::Finished(1, Outcome::Done(complete())));
    p.step(S, Input::Reported(1, Ok(())));
    p.step(2 * S, Input::Leased(Ok(Some(lease()))));
    assert_eq!(p.step(3 * S, Input::Beat(1, Err(CallError::Stale))), []);
    assert_eq!(p.step(3 * S, Input::Finished(1, Outcome::Stopped)), []);
    assert_eq!(p.step(3 * S, Input::Reported(1, Err(CallError::Stale))), []);
    let effects = p.step(4 * S, Input::Finished(2, Outcome::Done(complete())));
    assert_eq!(effects, [Effect::Report(2, Report::Complete(complete()))]);
}

#[test]
fn a_nonsense_heartbeat_period_neither_loses_the_lease_nor_floods_the_service() {
    for seconds in [f64::NAN, -1.0, 0.0, 1e300] {
        let mut p = polling();
        let odd = Box::new(Lease { heartbeat_s: seconds, ..*lease() });
        let effects = p.step(START, Input::Leased(Ok(Some(odd))));
        let period = armed(&effects, Timer::Heartbeat).unwrap();
        assert!(period >= LIVE_PERIOD / 5 && period <= LIVE_PERIOD, "{seconds}: {period:?}");
    }
}
