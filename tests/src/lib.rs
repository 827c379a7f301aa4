//! What the whole-system tests share: a real service in a process of its own, files to upload, a real browser.
//!
//! Tests talk to the service as a stranger would: HTTP, the command line, signals. Nothing here reaches into the
//! server's memory or database.

pub mod binary;
pub mod browser;
pub mod glb;
pub mod picture;
pub mod process;
pub mod proxy;
pub mod receiver;
pub mod service;

pub use proxy::Proxy;
pub use service::{Reply, Service, Worker};
