//! The worker: leases tasks from the service, renders them with the engine, and keeps what it built for the next.
//!
//! ```text
//! protocol (when to call what, no IO) ◄─► driver (HTTP, timers, signals) ─► executor (one task) ─► engine
//!                                                                              └─► cache (blobs, structures, scenes)
//! ```

pub mod benchmark;
pub mod cache;
pub mod driver;
pub mod estimate;
pub mod executor;
pub mod picture;
pub mod protocol;
pub mod settings;
