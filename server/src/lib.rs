//! The Lightshaft service: an HTTP API over a job queue, a content-addressed blob store and a SQLite database.
//!
//! ```text
//! routes (HTTP)  ─►  app (one function per operation)  ─►  store (SQL), blob (files), queue (rules without IO)
//!                                                      ◄─  reconcile (chores by timer)
//! ```

pub mod config;
pub mod dashboard;

use std::net::SocketAddr;

pub use config::{Config, Limits};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

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
    #[error("the service stopped: {0}")]
    Stopped(std::io::Error),
}

/// Runs the service until `shutdown` is cancelled. `ready` gets the bound address once requests are answered.
pub async fn serve(
    config: Config,
    shutdown: CancellationToken,
    ready: oneshot::Sender<SocketAddr>,
) -> Result<(), ServeError> {
    if !config.listen.ip().is_loopback() && !config.insecure_local {
        return Err(ServeError::NotLoopback(config.listen));
    }
    let listen_error = |source| ServeError::Listen { address: config.listen, source };
    let listener = TcpListener::bind(config.listen).await.map_err(listen_error)?;
    let address = listener.local_addr().map_err(listen_error)?;
    // Nobody may be waiting for the address.
    ready.send(address).ok();
    axum::serve(listener, axum::Router::new())
        .with_graceful_shutdown(shutdown.cancelled_owned())
        .await
        .map_err(ServeError::Stopped)
}
