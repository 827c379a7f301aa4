//! The Lightshaft service: an HTTP API over a job queue, a content-addressed blob store and a SQLite database.
//!
//! ```text
//! routes (HTTP)  ─►  app (one function per operation)  ─►  store (SQL), blob (files), queue (rules without IO)
//!                          ▲
//!                     reconcile (chores by timer)
//! ```

pub mod app;
pub mod blob;
pub mod clock;
pub mod config;
pub mod dashboard;
pub mod error;
pub mod farm;
mod lock;
mod messenger;
pub mod problems;
pub mod queue;
pub mod reconcile;
pub mod routes;
pub mod store;
pub mod telemetry;
pub mod web;

use std::future::IntoFuture;
use std::net::SocketAddr;
use std::sync::Arc;

use app::{App, Stop};
use blob::{BlobError, BlobStore};
use clock::SystemClock;
pub use config::{Config, Limits};
use lock::FolderLock;
use store::StoreError;
use store::sqlite::SqliteStore;
use tokio::net::TcpListener;
use tokio::sync::oneshot;

/// Why a service could not start, or stopped by itself.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error(
        "{0} can be reached from other machines, and the service has no access control: listen on a loopback address \
         such as 127.0.0.1:8080, or allow it with --insecure-local on a network that you trust"
    )]
    NotLoopback(SocketAddr),
    #[error("cannot listen on {address}: {source}")]
    Listen { address: SocketAddr, source: std::io::Error },
    #[error("cannot use the folder {path}: {source}")]
    Data { path: String, source: std::io::Error },
    #[error(
        "the folder {0} is in use by another `lightshaft serve`: stop that one, or give this one a folder of its own by --data"
    )]
    InUse(String),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Blobs(#[from] BlobError),
    #[error("cannot set up metrics: {0}")]
    Metrics(#[from] metrics_exporter_prometheus::BuildError),
    #[error("the service stopped: {0}")]
    Stopped(std::io::Error),
}

/// Runs the service until it is told to stop. `ready` gets the bound address once requests are answered.
///
/// Draining makes the service unready and stops leasing, while workers still bring what they have. The shutdown then
/// ends event streams and chores, and waits for requests in progress, at most until the deadline.
pub async fn serve(config: Config, stop: Stop, ready: oneshot::Sender<SocketAddr>) -> Result<(), ServeError> {
    if !config.listen.ip().is_loopback() && !config.insecure_local {
        return Err(ServeError::NotLoopback(config.listen));
    }
    telemetry::metrics()?;
    let data_error = |source| ServeError::Data { path: config.data_dir.display().to_string(), source };
    tokio::fs::create_dir_all(&config.data_dir).await.map_err(data_error)?;
    let _lock = FolderLock::take(&config.data_dir)
        .map_err(data_error)?
        .ok_or_else(|| ServeError::InUse(config.data_dir.display().to_string()))?;
    let store = Arc::new(SqliteStore::open(&config.data_dir.join("lightshaft.db")).await?);
    let blobs = BlobStore::open(&config.data_dir).await?;
    let listen_error = |source| ServeError::Listen { address: config.listen, source };
    let listener = TcpListener::bind(config.listen).await.map_err(listen_error)?;
    let address = listener.local_addr().map_err(listen_error)?;
    let deadline = config.shutdown_deadline;
    let shutdown = stop.shutdown.clone();
    let app = App::new(config.clone(), store.clone(), blobs, Arc::new(SystemClock), stop).await.map_err(data_error)?;
    let mut chores = reconcile::spawn(&app);
    tracing::info!(%address, "serving");
    // Nobody may be waiting for the address.
    ready.send(address).ok();
    let server = axum::serve(listener, routes::router(app)).with_graceful_shutdown(shutdown.clone().cancelled_owned());
    let too_late = async {
        shutdown.cancelled().await;
        tokio::time::sleep(deadline).await;
    };
    let result = tokio::select! {
        result = server.into_future() => result.map_err(ServeError::Stopped),
        () = too_late => {
            tracing::warn!(deadline_s = deadline.as_secs_f64(), "requests were still in progress at the deadline");
            Ok(())
        }
    };
    shutdown.cancel();
    while chores.join_next().await.is_some() {}
    store.close().await;
    tracing::info!("stopped");
    result
}
