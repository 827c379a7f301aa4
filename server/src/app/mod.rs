//! What the service does, one function per operation; routes and the dashboard both call these.

mod blobs;
mod demand;
mod events;
pub mod import;
mod jobs;
mod leases;
mod live;
mod logs;
mod scenes;
mod status;
mod workers;

use std::sync::Arc;
use std::time::Instant;

use lightshaft_api::event::Event;
use tokio::sync::{RwLock, Semaphore, broadcast, watch};
use tokio_util::sync::CancellationToken;

use self::demand::RollCall;
pub use self::events::EventStream;
pub use self::jobs::{Created, KEY_LIFETIME_MS, THUMBNAIL_LABEL, is_label_key};
use self::live::Live;
use self::logs::Logs;
pub use self::scenes::Uploaded;
use crate::blob::BlobStore;
use crate::clock::Clock;
use crate::config::Config;
use crate::error::{ApiError, ApiResult};
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
    pub shutdown: CancellationToken,
    live: Live,
    roll: RollCall,
    logs: Logs,
    imports: Semaphore,
    /// Read while blobs get a name and then a user, written while unused ones are deleted.
    blob_use: RwLock<()>,
    /// Counts up with every change of the store.
    changes: watch::Sender<u64>,
    progress: broadcast::Sender<Event>,
    started: Instant,
}

pub type Shared = Arc<App>;

impl App {
    pub async fn new(
        config: Config,
        store: Arc<dyn Store>,
        blobs: BlobStore,
        clock: Arc<dyn Clock>,
        shutdown: CancellationToken,
    ) -> std::io::Result<Shared> {
        let logs = Logs::open(&config.data_dir.join("logs")).await?;
        Ok(Arc::new(Self {
            imports: Semaphore::new(config.limits.concurrent_imports.max(1)),
            roll: RollCall::new(clock.now()),
            config,
            store,
            blobs,
            clock,
            shutdown,
            live: Live::default(),
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

    /// Refuses new work while the service shuts down.
    fn check_running(&self) -> ApiResult<()> {
        if self.shutdown.is_cancelled() {
            return Err(ApiError::new(Code::ShuttingDown, "the service is shutting down: ask again in a few seconds"));
        }
        Ok(())
    }
}
