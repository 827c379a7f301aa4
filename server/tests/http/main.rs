//! The service from outside, one module per part of the API: every endpoint, and every class of error.

mod harness;
mod leases;
