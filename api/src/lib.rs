//! Wire types of the Lightshaft HTTP API: ids, units, settings, problem details, and the typed client.
//!
//! JSON is `snake_case`; times are RFC 3339 in UTC; sizes are in bytes and durations in seconds unless a name says
//! otherwise. Types that come from outside deny unknown fields, so that a misspelt setting is an error with a name.

pub mod benchmark;
pub mod blob;
pub mod client;
pub mod compare;
pub mod estimate;
pub mod event;
pub mod farm;
pub mod job;
pub mod lease;
pub mod mesh;
pub mod page;
pub mod problem;
pub mod queue;
pub mod read;
pub mod scene;
pub mod settings;
pub mod status;
pub mod worker;
