//! `lightshaft worker`

use std::path::PathBuf;
use std::time::Duration;

use lightshaft_api::settings::DeviceChoice;
use lightshaft_worker::driver::{self, CacheBudgets, WorkerConfig, WorkerError};

use super::Global;
use super::error::{CliError, Result};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Which devices may be used.
    #[arg(long, value_parser = parse_device, default_value = "auto", value_name = "auto|cpu|gpu")]
    device: DeviceChoice,
    /// Folder for scenes and structures; several workers may share it. [default: lightshaft-cache in the user's cache
    /// folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// What the service shows this worker as. [default: the machine's name]
    #[arg(long)]
    name: Option<String>,
    /// Labels, separated by commas.
    #[arg(long, value_delimiter = ',')]
    tags: Vec<String>,
    /// Megabytes of memory for structures.
    #[arg(long, default_value_t = 4096, value_name = "MB")]
    structure_memory_mb: u64,
    /// Megabytes of disk for structures, and again as much for scenes.
    #[arg(long, default_value_t = 20_480, value_name = "MB")]
    cache_disk_mb: u64,
    /// Seconds that the task in hand may take to finish after SIGTERM, before it is given back.
    #[arg(long, default_value_t = 30, value_name = "SECONDS")]
    drain_timeout_s: u64,
    /// Leave when standard input closes.
    #[arg(long, hide = true)]
    supervised: bool,
}

pub(crate) async fn run(args: Args, global: &Global) -> Result<()> {
    let mb = |megabytes: u64| megabytes.saturating_mul(1 << 20);
    let config = WorkerConfig {
        server: global.server.clone(),
        name: args.name.unwrap_or_else(machine_name),
        tags: args.tags,
        device: args.device,
        cache_dir: args.cache.unwrap_or_else(default_cache),
        budgets: CacheBudgets {
            structures_memory: mb(args.structure_memory_mb),
            structures_disk: mb(args.cache_disk_mb),
            blobs_disk: mb(args.cache_disk_mb),
            ..CacheBudgets::default()
        },
        drain_timeout: Duration::from_secs(args.drain_timeout_s),
        supervised: args.supervised,
    };
    driver::run(config).await.map_err(|error| match error {
        WorkerError::Address(error) => error.into(),
        WorkerError::Cache { .. } | WorkerError::NoDevice | WorkerError::Refused(_) | WorkerError::Abrupt => {
            CliError::system(error.to_string())
        }
    })
}

pub(crate) fn parse_device(text: &str) -> std::result::Result<DeviceChoice, String> {
    match text {
        "auto" => Ok(DeviceChoice::Auto),
        "cpu" => Ok(DeviceChoice::Cpu),
        "gpu" => Ok(DeviceChoice::Gpu),
        _ => Err("must be auto, cpu or gpu".into()),
    }
}

fn machine_name() -> String {
    let from_system = || std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let from_environment = || std::env::var("HOSTNAME").or_else(|_| std::env::var("COMPUTERNAME")).ok();
    let name = from_system().or_else(from_environment).unwrap_or_default();
    let name = name.trim();
    if name.is_empty() { "worker".into() } else { name.into() }
}

/// As the XDG base directory specification has it, or the system's folder for temporary files.
fn default_cache() -> PathBuf {
    let xdg = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from).filter(|path| path.is_absolute());
    let home = || std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".cache"));
    xdg.or_else(home).unwrap_or_else(std::env::temp_dir).join("lightshaft-cache")
}
