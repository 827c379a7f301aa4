//! What the service does, one function per operation; routes and the dashboard both call these.

mod blobs;
mod compare;
mod demand;
mod estimate;
mod events;
mod farm;
mod garbage;
pub mod import;
mod jobs;
mod leases;
mod live;
mod logs;
mod multipart;
mod pictures;
mod queue;
mod scenes;
mod status;
mod workers;

use std::sync::Arc;
use std::time::Instant;

use lightshaft_api::event::Event;
use tokio::sync::{RwLock, Semaphore, broadcast, watch};
use tokio_util::sync::CancellationToken;

use self::compare::Comparisons;
pub use self::compare::{ComparisonKey, UploadedPictures};
use self::demand::RollCall;
pub use self::events::EventStream;
use self::garbage::Discarded;
pub use self::jobs::{Created, KEY_LIFETIME_MS, THUMBNAIL_LABEL, is_label_key};
use self::live::Live;
pub use self::logs::LogStream;
use self::logs::Logs;
pub use self::pictures::RawLayer;
pub use self::scenes::Uploaded;
use crate::blob::BlobStore;
use crate::clock::Clock;
use crate::config::Config;
use crate::error::{ApiError, ApiResult};
use crate::messenger::Messenger;
use crate::problems::Code;
use crate::queue::Millis;
use crate::store::Store;

/// Progress that a slow reader of events may miss: it is not kept anyway.
const PROGRESS_BACKLOG: usize = 256;

/// The service's parts, shared by all requests.
pub struct App {
    pub config: Config,
    pub store: Arc<dyn Store>,
    pub blobs: BlobStore,
    pub clock: Arc<dyn Clock>,
    /// Cancelled first: no new work is taken, but workers may still bring what they have.
    pub draining: CancellationToken,
    /// Cancelled last: streams and chores end. Cancels `draining`, too.
    pub shutdown: CancellationToken,
    live: Live,
    discarded: Discarded,
    roll: RollCall,
    logs: Logs,
    imports: Arc<Semaphore>,
    /// Decoding and comparing pictures takes memory: few at a time.
    picture_turns: Semaphore,
    comparisons: Comparisons,
    /// Read while blobs get a name and then a user, written while unused ones are deleted.
    blob_use: RwLock<()>,
    /// Counts up with every change of the store.
    changes: watch::Sender<u64>,
    progress: broadcast::Sender<Event>,
    /// Sends what webhooks are told.
    messenger: Messenger,
    started: Instant,
}

pub type Shared = Arc<App>;

/// How a service is stopped.
#[derive(Clone, Debug)]
pub struct Stop {
    /// Not ready any more: no new work is taken, but workers may still bring what they have.
    pub draining: CancellationToken,
    /// The end; implies `draining`.
    pub shutdown: CancellationToken,
}

impl Default for Stop {
    fn default() -> Self {
        let shutdown = CancellationToken::new();
        Self { draining: shutdown.child_token(), shutdown }
    }
}

impl App {
    pub async fn new(
        config: Config,
        store: Arc<dyn Store>,
        blobs: BlobStore,
        clock: Arc<dyn Clock>,
        stop: Stop,
    ) -> std::io::Result<Shared> {
        let logs = Logs::open(&config.data_dir.join("logs")).await?;
        Ok(Arc::new(Self {
            imports: Arc::new(Semaphore::new(config.limits.concurrent_imports.max(1))),
            picture_turns: Semaphore::new(config.limits.concurrent_pictures.max(1)),
            comparisons: Comparisons::default(),
            roll: RollCall::new(clock.now()),
            messenger: Messenger::new(config.webhook_allow_private),
            config,
            store,
            blobs,
            clock,
            draining: stop.draining,
            shutdown: stop.shutdown,
            live: Live::default(),
            discarded: Discarded::default(),
            logs,
            blob_use: RwLock::new(()),
            changes: watch::Sender::new(0),
            progress: broadcast::Sender::new(PROGRESS_BACKLOG),
            started: Instant::now(),
        }))
    }

    pub fn now(&self) -> Millis {
        self.clock.now()
    }

    /// Wakes whoever waits for work or for events. To be called after every change that makes either.
    pub fn changed(&self) {
        self.changes.send_modify(|count| *count += 1);
    }

    /// Refuses new work while the service stops.
    fn check_running(&self) -> ApiResult<()> {
        if self.draining.is_cancelled() {
            return Err(ApiError::new(Code::ShuttingDown, "the service is shutting down: ask again in a few seconds"));
        }
        Ok(())
    }
}
