//! The typed HTTP client (reqwest).
