//! The service from outside, one module per part of the API: every endpoint, and every class of error.

mod bad_input;
mod blobs;
mod errors;
mod events;
mod farm;
mod harness;
mod jobs;
mod kinds;
mod leases;
mod openapi;
mod pictures;
mod scenes;
mod service;
mod workers;
