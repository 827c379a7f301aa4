//! Does what the [protocol](crate::protocol) says: HTTP, timers, signals, and one executor on a thread of its own.
//!
//! Every call runs as a task of its own and answers through one channel, so heartbeats go on whatever else is under
//! way, and one loop decides what happens next.

mod identity;
mod inputs;
mod live;
mod log;
mod shutdown;
mod stop;
mod tries;
mod work;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use lightshaft_api::client::{Client, ClientError};
use lightshaft_api::lease::{Heartbeat, LeaseRequest, Release};
use lightshaft_api::settings::DeviceChoice;
use lightshaft_api::worker::{CacheStatus, NewWorker};
use lightshaft_engine::scene::Limits;
use tokio::sync::mpsc::{self, UnboundedSender};
use tokio::time::Instant;

use self::identity::Identity;
use self::shutdown::{Order, Orders};
use self::work::Running;
use crate::cache::{BlobCache, DiskStore, StructureCache};
use crate::executor::{Budgets, Devices, Executor};
use crate::protocol::{CallError, Effect, Input, Protocol, Report, Timer};

/// How long one long poll asks the service to wait for work.
const POLL_WAIT_S: u32 = 25;

/// After the order to leave, a worker that could not give its task back by then leaves all the same.
const LEAVE_DEADLINE: Duration = Duration::from_secs(10);

/// Hashes that one lease request may name.
const WARM_LIMIT: usize = 4096;

/// What a worker is started with.
#[derive(Clone, Debug)]
pub struct WorkerConfig {
    /// Address of the service.
    pub server: String,
    pub name: String,
    pub tags: Vec<String>,
    pub device: DeviceChoice,
    /// Folder for blobs, structures and the worker's id; several workers may share it.
    pub cache_dir: PathBuf,
    pub budgets: CacheBudgets,
    /// After SIGTERM, how long the task in hand may take to finish before it is given back.
    pub drain_timeout: Duration,
    /// Leave when standard input closes: whoever started this process is gone then.
    pub supervised: bool,
}

/// Bytes that a worker may keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CacheBudgets {
    pub structures_memory: u64,
    pub structures_disk: u64,
    pub blobs_disk: u64,
    pub scenes_memory: u64,
}

impl Default for CacheBudgets {
    fn default() -> Self {
        Self { structures_memory: 4 << 30, structures_disk: 20 << 30, blobs_disk: 20 << 30, scenes_memory: 4 << 30 }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    #[error("{0}")]
    Address(ClientError),
    #[error("the cache folder {folder}: {source}")]
    Cache { folder: PathBuf, source: std::io::Error },
    #[error(
        "this worker was started with --device gpu, and no GPU was found: see `lightshaft devices`, or start it with --device auto"
    )]
    NoDevice,
    #[error("{0}")]
    Refused(String),
    #[error("the worker had to leave before its task was given back")]
    Abrupt,
}

/// Works until told to leave by a signal or by the closing of standard input.
///
/// # Errors
/// A wrong address, an unusable cache folder, or a service that refuses this worker. A service that does not answer is
/// no error: it is tried again.
pub async fn run(config: WorkerConfig) -> Result<(), WorkerError> {
    let mut driver = Driver::new(config).await?;
    let (sender, mut inputs) = mpsc::unbounded_channel();
    let mut orders = Orders::new(driver.config.supervised, driver.config.drain_timeout);
    let mut protocol = Protocol::new(uuid::Uuid::new_v4().as_u64_pair().0);
    let mut leave_by: Option<Instant> = None;
    let mut next = Some(Input::Start);
    loop {
        if let Some(input) = next.take() {
            for effect in protocol.step(input) {
                if let Effect::Exit(error) = effect {
                    return error.map_or(Ok(()), |why| Err(WorkerError::Refused(why)));
                }
                driver.carry_out(effect, &sender);
            }
        }
        let due = driver.timers.iter().map(|(&timer, &at)| (at, timer)).min();
        let far = Instant::now() + Duration::from_secs(3600);
        next = tokio::select! {
            Some(input) = inputs.recv() => Some(input),
            () = tokio::time::sleep_until(due.map_or(far, |(at, _)| at)) => due.map(|(_, timer)| {
                driver.timers.remove(&timer);
                Input::Due(timer)
            }),
            order = orders.next() => {
                tracing::info!(?order, busy = protocol.is_busy(), "leaving");
                Some(match order {
                    Order::Drain => {
                        driver.hurry();
                        Input::Drain
                    }
                    Order::Leave => {
                        leave_by.get_or_insert(Instant::now() + LEAVE_DEADLINE);
                        Input::Shutdown
                    }
                })
            }
            () = tokio::time::sleep_until(leave_by.unwrap_or(far)), if leave_by.is_some() => {
                return Err(WorkerError::Abrupt);
            }
        };
    }
}

struct Driver {
    config: WorkerConfig,
    client: Client,
    identity: Identity,
    executor: Arc<Executor>,
    blobs: Arc<BlobCache>,
    registration: NewWorker,
    timers: BTreeMap<Timer, Instant>,
    running: Option<Running>,
}

impl Driver {
    async fn new(config: WorkerConfig) -> Result<Self, WorkerError> {
        let client = Client::new(&config.server).map_err(WorkerError::Address)?;
        let cache_error = |source| WorkerError::Cache { folder: config.cache_dir.clone(), source };
        let identity = Identity::claim(&config.cache_dir, client.base()).map_err(cache_error)?;
        let structures_disk = DiskStore::open(&config.cache_dir.join("structures"), config.budgets.structures_disk);
        let blobs_disk = DiskStore::open(&config.cache_dir.join("blobs"), config.budgets.blobs_disk);
        let structures =
            StructureCache::new(config.budgets.structures_memory, Some(structures_disk.map_err(cache_error)?));
        let blobs = Arc::new(BlobCache::new(blobs_disk.map_err(cache_error)?));
        let budgets = Budgets { scenes_bytes: config.budgets.scenes_memory };
        // The service has held the scene against its limits.
        let executor = Arc::new(Executor::new(structures, Devices::new(config.device), budgets, Limits::NONE));
        // Looking for GPUs loads drivers, which takes its time.
        let lister = Arc::clone(&executor);
        let devices = tokio::task::spawn_blocking(move || lister.devices().list()).await.unwrap_or_default();
        for device in &devices {
            tracing::info!(kind = device.kind.as_str(), name = device.name, "device");
        }
        if devices.is_empty() {
            return Err(WorkerError::NoDevice);
        }
        let registration = NewWorker {
            id: None,
            name: config.name.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            devices,
            tags: config.tags.clone(),
        };
        Ok(Self { config, client, identity, executor, blobs, registration, timers: BTreeMap::new(), running: None })
    }

    fn carry_out(&mut self, effect: Effect, sender: &UnboundedSender<Input>) {
        match effect {
            Effect::Register => self.register(sender.clone()),
            Effect::Poll { worker } => self.poll(worker, sender.clone()),
            Effect::Part { worker } => self.part(worker),
            Effect::Begin(epoch, lease) => {
                let worker = self.identity.id().unwrap_or_default();
                let running = Running::start(epoch, lease, &worker, &self.client, &self.executor, &self.blobs, sender);
                self.running = Some(running);
            }
            Effect::Heartbeat(epoch) => self.heartbeat(epoch, sender.clone()),
            Effect::Stop(epoch) => {
                if let Some(running) = self.running.as_ref().filter(|running| running.epoch == epoch) {
                    running.stop.ask();
                }
            }
            Effect::Report(epoch, report) => self.report(epoch, report, sender.clone()),
            Effect::GiveBack(epoch, token) => {
                let release = Report::Release(Release { cancelled: false });
                send_report(self.client.clone(), epoch, token, release, sender.clone());
            }
            Effect::Arm(timer, after) => {
                self.timers.insert(timer, Instant::now() + after);
            }
            Effect::Disarm(timer) => {
                self.timers.remove(&timer);
            }
            // Ends the loop before it gets here.
            Effect::Exit(_) => {}
        }
    }

    /// The task in hand is the last: what only others would gain from is left undone.
    fn hurry(&self) {
        if let Some(running) = &self.running {
            running.hurry.cancel();
        }
    }

    fn register(&mut self, sender: UnboundedSender<Input>) {
        let client = self.client.clone();
        let identity = self.identity.clone();
        let registration = NewWorker { id: identity.id(), ..self.registration.clone() };
        tokio::spawn(async move {
            let answer = client.register_worker(&registration).await;
            if let Ok(registered) = &answer {
                tracing::info!(worker = registered.id, name = registration.name, "registered");
                if let Err(error) = identity.remember(&registered.id) {
                    tracing::warn!("the worker's id could not be written, so the next start gets a new one: {error}");
                }
            }
            let answer = answer.map(|registered| registered.id).map_err(|error| call_error("register", &error));
            let _ = sender.send(Input::Registered(answer));
        });
    }

    fn poll(&mut self, worker: String, sender: UnboundedSender<Input>) {
        self.running = None;
        let client = self.client.clone();
        let executor = Arc::clone(&self.executor);
        let blobs = Arc::clone(&self.blobs);
        tokio::spawn(async move {
            let request = tokio::task::spawn_blocking(move || {
                let (warm, status) = executor.structures().holdings(WARM_LIMIT);
                let cache = CacheStatus { disk_bytes: status.disk_bytes + blobs.used_bytes(), ..status };
                LeaseRequest { worker, wait_s: POLL_WAIT_S, warm, cache }
            });
            let answer = match request.await {
                Ok(request) => client.lease(&request).await.map_err(|error| call_error("lease", &error)),
                Err(_) => Err(CallError::Unavailable { retry_after: None }),
            };
            let _ = sender.send(Input::Leased(answer.map(|lease| lease.map(Box::new))));
        });
    }

    fn heartbeat(&self, epoch: u64, sender: UnboundedSender<Input>) {
        let Some(running) = &self.running else { return };
        let client = running.client.clone();
        let token = running.token.clone();
        let live = Arc::clone(&running.live);
        let patience = running.beat_patience;
        tokio::spawn(async move {
            let (progress, preview) = live.snapshot();
            let heartbeat =
                Heartbeat { phase: progress.phase, progress: progress.fraction, preview, spp: progress.spp };
            // One lost packet must not keep the next try from getting through in time.
            let answer = match tokio::time::timeout(patience, client.heartbeat(&token, &heartbeat)).await {
                Ok(answer) => answer.map_err(|error| call_error("heartbeat", &error)),
                Err(_) => Err(CallError::Unavailable { retry_after: None }),
            };
            live.note_answer(!matches!(answer, Err(CallError::Unavailable { .. })));
            let _ = sender.send(Input::Beat(epoch, answer));
        });
    }

    fn report(&self, epoch: u64, report: Report, sender: UnboundedSender<Input>) {
        if let Some(running) = &self.running {
            send_report(running.client.clone(), epoch, running.token.clone(), report, sender);
        }
    }

    /// Best effort: a service that does not hear it answers the poll all the same, only later.
    fn part(&self, worker: String) {
        let client = self.client.clone();
        tokio::spawn(async move {
            if let Err(error) = client.part_worker(&worker).await {
                call_error("part", &error);
            }
        });
    }
}

fn send_report(client: Client, epoch: u64, token: String, report: Report, sender: UnboundedSender<Input>) {
    tokio::spawn(async move {
        let (name, answer) = match &report {
            Report::Complete(complete) => ("complete", client.complete(&token, complete).await),
            Report::Fail(fail) => ("fail", client.fail(&token, fail).await),
            Report::Release(release) => ("release", client.release(&token, release).await),
        };
        let answer = answer.map(|_| ()).map_err(|error| call_error(name, &error));
        let _ = sender.send(Input::Reported(epoch, answer));
    });
}

/// What an error means to the protocol. The address stays out of messages: that of a lease holds its secret token.
fn call_error(call: &'static str, error: &ClientError) -> CallError {
    let reaction = match error {
        _ if error.is_transient() => CallError::Unavailable { retry_after: error.retry_after() },
        ClientError::Problem { problem, .. } => match problem.status {
            404 => CallError::Unknown,
            409 | 410 => CallError::Stale,
            _ => CallError::Refused(problem.detail.clone()),
        },
        ClientError::Unexpected { status, .. } => {
            CallError::Refused(format!("it answered {status} in a form that is not this API's"))
        }
        ClientError::Transport { .. }
        | ClientError::Stalled { .. }
        | ClientError::Address { .. }
        | ClientError::File { .. } => CallError::Unavailable { retry_after: None },
    };
    match &reaction {
        CallError::Unavailable { .. } => tracing::warn!(call, status = error.status(), "no good answer; trying again"),
        CallError::Stale => tracing::info!(call, "the lease has ended"),
        CallError::Unknown => tracing::warn!(call, "unknown to the service"),
        CallError::Refused(why) => tracing::error!(call, why, "refused"),
    }
    reaction
}
