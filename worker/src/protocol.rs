//! The worker's side of the lease protocol, as a state machine without IO.
//!
//! The driver feeds [`Input`]s and carries out the [`Effect`]s that come back; sockets, threads and clocks stay outside, so every edge of the protocol is a unit test. The table of status codes and reactions
//! stands in `lightshaft_api::lease`.
//!
//! ```text
//!            Registered            Leased(work)            Finished            Reported
//! Registering ──────► Polling ────────────────► Working ───────────► Reporting ────────► Polling
//!      ▲               │   │ 404                 │ stale                                  ▲
//!      └───────────────┼───┘                     └─► Abandoning ── Finished ──────────────┘
//!                      └─► Parting ── its poll is answered ──► gone
//! ```
//!
//! Invariants: at most one task is worked on; a lease that the service took away is never reported on; every call may be
//! repeated, because the service answers a repeated report with the same token in the same way.
//!
//! Only the service knows whether a lease still holds, since the token is the fence and not the time. While it does not
//! answer, the work goes on and heartbeats are tried again; a lease that has run out meanwhile is renewed by the first
//! that gets through, unless the service has given the task away and says so.

use std::time::Duration;

use lightshaft_api::lease::{Complete, Fail, HeartbeatReply, Lease, Release, RetryClass};

#[cfg(test)]
mod tests;

const BACKOFF_FIRST: Duration = Duration::from_millis(500);
const BACKOFF_CAP: Duration = Duration::from_secs(30);
/// Between an empty long poll and the next: only matters when the service answers at once.
const POLL_PAUSE: Duration = Duration::from_millis(100);

/// Heartbeats come no more often than this, whatever the service asks for.
const SHORTEST_PERIOD: Duration = Duration::from_millis(100);

/// How long a worker that leaves waits for the answer to its poll, which may bring a task to be given back.
const PARTING_PATIENCE: Duration = Duration::from_secs(5);

/// Numbers the leases of one process, so that a late answer about an earlier one is recognised.
pub type Epoch = u64;

/// What happened.
#[derive(Debug)]
pub enum Input {
    Start,
    Registered(Result<String, CallError>),
    /// The long poll ended; `None` when there is no work.
    Leased(Result<Option<Box<Lease>>, CallError>),
    Beat(Epoch, Result<HeartbeatReply, CallError>),
    /// The executor has returned.
    Finished(Epoch, Outcome),
    Reported(Epoch, Result<(), CallError>),
    Due(Timer),
    /// Finish the task in hand, then leave.
    Drain,
    /// Give the task in hand back and leave.
    Shutdown,
}

/// How the work on a task ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    Done(Box<Complete>),
    Failed(Fail),
    /// It noticed that it was asked to stop.
    Stopped,
}

/// Why a call to the service gave no good answer.
#[derive(Clone, Debug, PartialEq)]
pub enum CallError {
    /// 404: the service does not know the worker (or the lease).
    Unknown,
    /// 409 or 410: the lease belongs to somebody else by now.
    Stale,
    /// 429, 5xx, or no answer.
    Unavailable { retry_after: Option<Duration> },
    /// Any other status: repeating the call cannot help.
    Refused(String),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Timer {
    /// Repeat the call that failed, or stop waiting for one.
    Retry,
    Heartbeat,
}

/// What the driver is to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    Register,
    /// Long poll for work as the worker of this id.
    Poll {
        worker: String,
    },
    /// Tell the service that this worker takes no more tasks, so that it answers the poll in flight.
    Part {
        worker: String,
    },
    /// Start the executor.
    Begin(Epoch, Box<Lease>),
    Heartbeat(Epoch),
    /// Ask the executor to stop; it still answers with [`Input::Finished`].
    Stop(Epoch),
    Report(Epoch, Report),
    /// Release the lease with this token, for which nothing was begun; answered like a report.
    GiveBack(Epoch, String),
    /// (Re)arms a timer.
    Arm(Timer, Duration),
    Disarm(Timer),
    /// Leave; the message is an error when there is one.
    Exit(Option<String>),
}

#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    Complete(Box<Complete>),
    Fail(Fail),
    Release(Release),
}

#[derive(Debug)]
enum State {
    Registering,
    Polling {
        /// The poll is under way, as against a pause between two.
        in_flight: bool,
    },
    /// Leaving, but the answer to the last poll may still bring a task.
    Parting,
    Working(Work),
    /// Work whose lease is lost: nothing is reported, only the executor's end is awaited.
    Abandoning(Epoch),
    Reporting {
        work: Work,
        report: Report,
    },
    Gone,
}

#[derive(Debug)]
struct Work {
    epoch: Epoch,
    /// A third of the lease's time to live.
    keep_alive: Duration,
    /// Between heartbeats while the work goes on: they carry the progress, and bring the wish to cancel.
    period: Duration,
    beat_in_flight: bool,
    missed_beats: u32,
    /// Told by the service that nothing more will come.
    told_to_drain: bool,
    /// Asked to stop, and what is to be reported then.
    stopping: Option<Report>,
}

/// See the module's documentation.
#[derive(Debug)]
pub struct Protocol {
    state: State,
    worker: Option<String>,
    epoch: Epoch,
    /// Failed calls in a row.
    failures: u32,
    leaving: Option<Leaving>,
    jitter: Jitter,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Leaving {
    WhenDone,
    Now,
}

impl Protocol {
    /// `seed` makes workers that lose the service at one moment come back at different ones.
    pub fn new(seed: u64) -> Self {
        Self { state: State::Registering, worker: None, epoch: 0, failures: 0, leaving: None, jitter: Jitter(seed) }
    }

    /// Whether a task is in hand.
    pub fn is_busy(&self) -> bool {
        matches!(self.state, State::Working(_) | State::Abandoning(_) | State::Reporting { .. })
    }

    pub fn step(&mut self, input: Input) -> Vec<Effect> {
        match input {
            Input::Start => vec![Effect::Register],
            Input::Registered(answer) => self.registered(answer),
            Input::Leased(answer) => self.leased(answer),
            Input::Beat(epoch, answer) => self.beat(epoch, answer),
            Input::Finished(epoch, outcome) => self.finished(epoch, outcome),
            Input::Reported(epoch, answer) => self.reported(epoch, answer),
            Input::Due(Timer::Retry) => self.retry(),
            Input::Due(Timer::Heartbeat) => self.heartbeat_due(),
            Input::Drain => self.leave(Leaving::WhenDone),
            Input::Shutdown => self.leave(Leaving::Now),
        }
    }

    fn registered(&mut self, answer: Result<String, CallError>) -> Vec<Effect> {
        if !matches!(self.state, State::Registering) {
            return vec![];
        }
        match answer {
            Ok(id) => {
                self.worker = Some(id);
                self.failures = 0;
                self.poll()
            }
            Err(CallError::Refused(why)) => self.exit(Some(format!("the service refused this worker: {why}"))),
            Err(error) => self.back_off(&error),
        }
    }

    fn leased(&mut self, answer: Result<Option<Box<Lease>>, CallError>) -> Vec<Effect> {
        match &mut self.state {
            State::Polling { in_flight } => *in_flight = false,
            State::Parting => return self.parted(answer),
            _ => return vec![],
        }
        match answer {
            Ok(None) => {
                self.failures = 0;
                vec![Effect::Arm(Timer::Retry, POLL_PAUSE)]
            }
            Ok(Some(lease)) => self.begin(lease),
            Err(CallError::Unknown) => {
                self.worker = None;
                self.state = State::Registering;
                vec![Effect::Register]
            }
            Err(CallError::Refused(why)) => self.exit(Some(format!("the service refused to lease: {why}"))),
            Err(error) => self.back_off(&error),
        }
    }

    fn begin(&mut self, lease: Box<Lease>) -> Vec<Effect> {
        let work = self.take_on(&lease);
        let (epoch, period) = (work.epoch, work.period);
        self.state = State::Working(work);
        vec![Effect::Begin(epoch, lease), Effect::Arm(Timer::Heartbeat, period)]
    }

    fn take_on(&mut self, lease: &Lease) -> Work {
        self.failures = 0;
        self.epoch += 1;
        let keep_alive = Duration::from_secs(u64::from(lease.ttl_s.max(1))) / 3;
        // A period that the service gets wrong must neither let the lease run out nor flood it.
        let period = Duration::try_from_secs_f64(lease.heartbeat_s).unwrap_or(keep_alive);
        Work {
            epoch: self.epoch,
            keep_alive,
            period: period.clamp(SHORTEST_PERIOD, keep_alive),
            beat_in_flight: false,
            missed_beats: 0,
            told_to_drain: false,
            stopping: None,
        }
    }

    /// The last poll is answered: a task that it brought goes back before anything was done for it.
    fn parted(&mut self, answer: Result<Option<Box<Lease>>, CallError>) -> Vec<Effect> {
        let Ok(Some(lease)) = answer else { return self.exit(None) };
        // Nothing here is worth waiting for a service that does not answer.
        self.leaving = Some(Leaving::Now);
        let report = Report::Release(Release { cancelled: false });
        let work = self.take_on(&lease);
        let effect = Effect::GiveBack(work.epoch, lease.token);
        self.state = State::Reporting { work, report };
        vec![effect]
    }

    fn heartbeat_due(&mut self) -> Vec<Effect> {
        match self.work() {
            Some(work) if !work.beat_in_flight => {
                work.beat_in_flight = true;
                vec![Effect::Heartbeat(work.epoch)]
            }
            _ => vec![],
        }
    }

    fn beat(&mut self, epoch: Epoch, answer: Result<HeartbeatReply, CallError>) -> Vec<Effect> {
        let jitter = self.jitter.next();
        let is_working = matches!(self.state, State::Working(_));
        let Some(work) = self.work().filter(|work| work.epoch == epoch) else { return vec![] };
        work.beat_in_flight = false;
        match answer {
            Ok(reply) => {
                work.missed_beats = 0;
                if reply.drain && !work.told_to_drain {
                    work.told_to_drain = true;
                    tracing::info!("the service drains this worker: nothing comes after the task in hand");
                }
                let period = if is_working { work.period } else { work.keep_alive };
                let mut effects = vec![Effect::Arm(Timer::Heartbeat, period)];
                if reply.cancel && work.stopping.is_none() && is_working {
                    effects.extend(self.stop(Report::Release(Release { cancelled: true })));
                }
                effects
            }
            Err(CallError::Unavailable { retry_after }) => {
                let wait = backoff(work.missed_beats, jitter).min(work.keep_alive).max(retry_after.unwrap_or_default());
                work.missed_beats = work.missed_beats.saturating_add(1);
                vec![Effect::Arm(Timer::Heartbeat, wait)]
            }
            // The executor has ended already, and the answer to the report is the one that counts.
            Err(_) if !is_working => vec![Effect::Disarm(Timer::Heartbeat)],
            Err(CallError::Stale | CallError::Unknown) => self.abandon(),
            Err(CallError::Refused(why)) => {
                let error = format!("the service refused a heartbeat: {why}");
                work.stopping = None;
                self.stop(Report::Fail(Fail { class: RetryClass::Task, error, fatal: false }))
            }
        }
    }

    fn finished(&mut self, epoch: Epoch, outcome: Outcome) -> Vec<Effect> {
        match std::mem::replace(&mut self.state, State::Gone) {
            State::Working(work) if work.epoch == epoch => {
                let report = match (outcome, work.stopping.clone()) {
                    (Outcome::Done(complete), _) => Report::Complete(complete),
                    (_, Some(report)) => report,
                    (Outcome::Failed(fail), None) => Report::Fail(fail),
                    // Nobody asked it to: give the task back rather than keep it.
                    (Outcome::Stopped, None) => Report::Release(Release { cancelled: false }),
                };
                self.failures = 0;
                // Nothing of it changes any more: from now on heartbeats only keep the lease, should reporting take long.
                let keep_alive = Effect::Arm(Timer::Heartbeat, work.keep_alive);
                self.state = State::Reporting { work, report: report.clone() };
                vec![Effect::Report(epoch, report), keep_alive]
            }
            State::Abandoning(abandoned) if abandoned == epoch => self.next(),
            other => {
                self.state = other;
                vec![]
            }
        }
    }

    fn reported(&mut self, epoch: Epoch, answer: Result<(), CallError>) -> Vec<Effect> {
        let State::Reporting { work, report } = &mut self.state else { return vec![] };
        if work.epoch != epoch {
            return vec![];
        }
        match answer {
            Err(CallError::Unavailable { .. }) if self.leaving == Some(Leaving::Now) => {
                tracing::warn!("leaving although the service did not answer; the lease will expire by itself");
                self.next()
            }
            Err(error @ CallError::Unavailable { .. }) => self.back_off(&error),
            // The service does not accept what we have: say so once, so that the task does not wait for the expiry.
            Err(CallError::Refused(why)) if matches!(report, Report::Complete(_)) => {
                *report = Report::Fail(Fail {
                    class: RetryClass::Task,
                    error: format!("the service refused the result: {why}"),
                    fatal: false,
                });
                vec![Effect::Report(epoch, report.clone())]
            }
            Ok(()) | Err(CallError::Stale | CallError::Unknown | CallError::Refused(_)) => self.next(),
        }
    }

    fn retry(&mut self) -> Vec<Effect> {
        match &self.state {
            State::Registering => vec![Effect::Register],
            State::Polling { .. } => self.poll(),
            State::Parting => self.exit(None),
            State::Reporting { work, report } => vec![Effect::Report(work.epoch, report.clone())],
            State::Working(_) | State::Abandoning(_) | State::Gone => vec![],
        }
    }

    fn leave(&mut self, how: Leaving) -> Vec<Effect> {
        if self.leaving != Some(Leaving::Now) {
            self.leaving = Some(how);
        }
        match &self.state {
            State::Polling { in_flight: true } => self.part(),
            State::Registering | State::Polling { in_flight: false } => self.exit(None),
            State::Working(work) if how == Leaving::Now && work.stopping.is_none() => {
                self.stop(Report::Release(Release { cancelled: false }))
            }
            _ => vec![],
        }
    }

    /// The poll in flight may just be bringing a task. Were its answer not waited for, that task would wait for its lease
    /// to run out, and an attempt would be spent on nothing.
    fn part(&mut self) -> Vec<Effect> {
        self.state = State::Parting;
        let worker = self.worker.clone().unwrap_or_default();
        vec![Effect::Part { worker }, Effect::Arm(Timer::Retry, PARTING_PATIENCE)]
    }

    /// Asks the executor to stop; the lease is kept alive until it has.
    fn stop(&mut self, report: Report) -> Vec<Effect> {
        match self.work() {
            Some(work) => {
                work.stopping = Some(report);
                vec![Effect::Stop(work.epoch)]
            }
            None => vec![],
        }
    }

    /// The lease is lost: work on it is a waste, and reporting it would be wrong.
    fn abandon(&mut self) -> Vec<Effect> {
        let mut effects = vec![Effect::Disarm(Timer::Heartbeat)];
        match std::mem::replace(&mut self.state, State::Gone) {
            State::Working(work) => {
                tracing::warn!("the service has taken the task away: the work on it is dropped");
                self.state = State::Abandoning(work.epoch);
                effects.push(Effect::Stop(work.epoch));
            }
            other => self.state = other,
        }
        effects
    }

    /// Done with a lease: on to the next, or out.
    fn next(&mut self) -> Vec<Effect> {
        let mut effects = vec![Effect::Disarm(Timer::Heartbeat), Effect::Disarm(Timer::Retry)];
        self.failures = 0;
        effects.extend(if self.leaving.is_some() { self.exit(None) } else { self.poll() });
        effects
    }

    fn poll(&mut self) -> Vec<Effect> {
        match self.worker.clone() {
            Some(worker) => {
                self.state = State::Polling { in_flight: true };
                vec![Effect::Poll { worker }]
            }
            None => {
                self.state = State::Registering;
                vec![Effect::Register]
            }
        }
    }

    fn exit(&mut self, error: Option<String>) -> Vec<Effect> {
        self.state = State::Gone;
        vec![Effect::Exit(error)]
    }

    fn back_off(&mut self, error: &CallError) -> Vec<Effect> {
        let jitter = self.jitter.next();
        let asked = match error {
            CallError::Unavailable { retry_after } => retry_after.unwrap_or_default(),
            _ => Duration::ZERO,
        };
        let wait = backoff(self.failures, jitter).max(asked);
        self.failures = self.failures.saturating_add(1);
        vec![Effect::Arm(Timer::Retry, wait)]
    }

    /// The lease that is kept alive, if any.
    fn work(&mut self) -> Option<&mut Work> {
        match &mut self.state {
            State::Working(work) | State::Reporting { work, .. } => Some(work),
            _ => None,
        }
    }
}

/// `min(0.5 s * 2^failures, 30 s)`, less up to a half by `jitter` in 0..1.
fn backoff(failures: u32, jitter: f64) -> Duration {
    let full = BACKOFF_FIRST.saturating_mul(1 << failures.min(10)).min(BACKOFF_CAP);
    full.mul_f64(1.0 - 0.5 * jitter)
}

/// SplitMix64 (Steele, Lea and Flood 2014): enough randomness to spread clients, and repeatable in tests.
#[derive(Debug)]
struct Jitter(u64);

impl Jitter {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}
