//! Log lines on standard error.

use lightshaft_server::telemetry;

use super::error::{CliError, Result};

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum LogFormat {
    Text,
    Json,
}

impl LogFormat {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Json => "json",
        }
    }
}

/// `LIGHTSHAFT_LOG` overrides `default_level`.
pub(crate) fn init(format: LogFormat, default_level: &str) -> Result<()> {
    // Drivers and libraries speak up from warnings on.
    let ours = ["lightshaft", "lightshaft_server", "lightshaft_worker"];
    let ours = ours.map(|name| format!("{name}={default_level}")).join(",");
    let filter = std::env::var("LIGHTSHAFT_LOG").unwrap_or_else(|_| format!("warn,{ours}"));
    let format = match format {
        LogFormat::Text => telemetry::LogFormat::Text,
        LogFormat::Json => telemetry::LogFormat::Json,
    };
    telemetry::init(format, &filter).map_err(|error| CliError::usage(format!("LIGHTSHAFT_LOG: {error}")))
}
