//! Logs and metrics of the process.

use std::io::IsTerminal;
use std::sync::OnceLock;

use metrics::{Unit, describe_counter, describe_gauge, describe_histogram};
use metrics_exporter_prometheus::{BuildError, Matcher, PrometheusBuilder, PrometheusHandle};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::util::TryInitError;
use tracing_subscriber::{Layer, layer::SubscriberExt, util::SubscriberInitExt};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One object a line, for collectors.
    Json,
}

#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    #[error("the log filter `{filter}` is wrong: {source} (expected something like info,lightshaft_server=debug)")]
    Filter { filter: String, source: tracing_subscriber::filter::ParseError },
    #[error("logging was set up before: {0}")]
    Twice(#[from] TryInitError),
}

/// Sends logs to standard error. Once per process.
pub fn init(format: LogFormat, filter: &str) -> Result<(), TelemetryError> {
    let filter =
        EnvFilter::try_new(filter).map_err(|source| TelemetryError::Filter { filter: filter.to_owned(), source })?;
    let layer =
        tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_ansi(std::io::stderr().is_terminal());
    let layer = match format {
        LogFormat::Text => layer.boxed(),
        LogFormat::Json => layer.json().flatten_event(true).boxed(),
    };
    tracing_subscriber::registry().with(layer.with_filter(filter)).try_init()?;
    Ok(())
}

/// Every series of `/metrics`: name, type, unit, what it is. Tests compare this list with what is recorded.
pub const SERIES: &[(&str, Kind, Unit, &str)] = &[
    ("lightshaft_http_requests_total", Kind::Counter, Unit::Count, "Requests by method, route and status"),
    ("lightshaft_http_request_seconds", Kind::Histogram, Unit::Seconds, "Time to the head of the answer"),
    ("lightshaft_jobs", Kind::Gauge, Unit::Count, "Jobs by state"),
    ("lightshaft_tasks", Kind::Gauge, Unit::Count, "Tasks by state: the depth of the queue"),
    ("lightshaft_workers", Kind::Gauge, Unit::Count, "Workers by state"),
    ("lightshaft_scenes", Kind::Gauge, Unit::Count, "Scenes"),
    ("lightshaft_blob_bytes", Kind::Gauge, Unit::Bytes, "Bytes in the blob store"),
    ("lightshaft_uptime_seconds", Kind::Gauge, Unit::Seconds, "Time since the start"),
    ("lightshaft_lease_wait_seconds", Kind::Histogram, Unit::Seconds, "From a task being ready to its lease"),
    ("lightshaft_attempts_total", Kind::Counter, Unit::Count, "Ended attempts by outcome"),
    ("lightshaft_lease_expiries_total", Kind::Counter, Unit::Count, "Leases that ran out"),
    ("lightshaft_fenced_reports_total", Kind::Counter, Unit::Count, "Reports refused because their lease had ended"),
    ("lightshaft_structures_total", Kind::Counter, Unit::Count, "Structures by source: built, memory, disk, fetched"),
    ("lightshaft_scene_imports_total", Kind::Counter, Unit::Count, "Scene imports by result"),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Counter,
    Gauge,
    Histogram,
}

const BUCKETS_S: &[f64] =
    &[0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0];

/// Installs the process's recorder of metrics, once; later calls give the same.
pub fn metrics() -> Result<PrometheusHandle, BuildError> {
    static HANDLE: OnceLock<PrometheusHandle> = OnceLock::new();
    if let Some(handle) = HANDLE.get() {
        return Ok(handle.clone());
    }
    let recorder = PrometheusBuilder::new()
        .set_buckets_for_metric(Matcher::Suffix("_seconds".to_owned()), BUCKETS_S)?
        .build_recorder();
    let handle = HANDLE.get_or_init(|| {
        let handle = recorder.handle();
        // Another recorder, set by whoever embeds the service, is left alone.
        if metrics::set_global_recorder(recorder).is_ok() {
            describe();
        }
        handle
    });
    Ok(handle.clone())
}

fn describe() {
    for &(name, kind, unit, text) in SERIES {
        match kind {
            Kind::Counter => describe_counter!(name, unit, text),
            Kind::Gauge => describe_gauge!(name, unit, text),
            Kind::Histogram => describe_histogram!(name, unit, text),
        }
    }
}
