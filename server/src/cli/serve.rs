//! `lightshaft serve`

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use lightshaft_api::settings::DeviceChoice;
use lightshaft_engine::scene::Limits as SceneLimits;
use lightshaft_server::app::Stop;
use lightshaft_server::{Config, ServeError};
use tokio::sync::oneshot;

use super::error::{CliError, Result};
use super::supervisor::Supervisor;
use super::worker::parse_device;
use super::{Global, output};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Address to listen on; port 0 picks a free one.
    #[arg(long, default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Folder of the database and the blobs; made when it is not there.
    #[arg(long, default_value = "lightshaft-data", value_name = "DIR")]
    data: PathBuf,
    /// Worker processes to start; 0 when all workers join from elsewhere.
    #[arg(long, default_value_t = 1)]
    workers: u32,
    /// Which devices these workers may use.
    #[arg(long, value_parser = parse_device, default_value = "auto", value_name = "auto|cpu|gpu")]
    device: DeviceChoice,
    /// Allow an address that other machines reach, although there is no access control.
    #[arg(long)]
    insecure_local: bool,
    /// Seconds that a worker may be silent before its task goes to another.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=3600), value_name = "SECONDS")]
    lease_ttl_s: u64,
    /// Seconds that a job waits for a worker with the device that it demands while all workers lack it. Then it fails.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(0..=604_800), value_name = "SECONDS")]
    device_grace_s: u64,
    /// Do not render small pictures of every new scene and of what its cameras see.
    #[arg(long)]
    no_thumbnails: bool,
    /// Days that finished jobs are kept with their pictures and logs. [default: for good]
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=36_500), value_name = "DAYS")]
    keep_jobs_days: Option<u64>,
    /// Runs of each suite of the farm that are kept with their pictures; accepted pictures always are. [default: all]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000), value_name = "RUNS")]
    keep_runs: Option<u32>,
    /// Let webhooks be addresses of this machine and of private networks. With --insecure-local they may be anyway.
    #[arg(long)]
    webhook_allow_private: bool,
    /// Megabytes of the largest upload of a scene.
    #[arg(long, default_value_t = 2048, value_name = "MB")]
    max_scene_mb: u64,
    /// Budgets of one scene that differ from the defaults, such as {"triangles": 1000000, "instances": 10000}; docs/SCENES.md
    /// lists them.
    #[arg(long, value_parser = parse_limits, default_value = "{}", hide_default_value = true, value_name = "JSON")]
    scene_limits: SceneLimits,
}

pub(crate) async fn run(args: Args, global: &Global) -> Result<()> {
    let mut config = Config::new(args.listen, args.data.clone());
    config.insecure_local = args.insecure_local;
    config.lease_ttl = Duration::from_secs(args.lease_ttl_s);
    config.device_grace = Duration::from_secs(args.device_grace_s);
    config.thumbnails = !args.no_thumbnails;
    config.keep_jobs = args.keep_jobs_days.map(|days| Duration::from_secs(days * 24 * 3600));
    config.keep_runs = args.keep_runs;
    config.webhook_allow_private = args.webhook_allow_private || args.insecure_local;
    config.limits.scene_bytes = args.max_scene_mb.saturating_mul(1 << 20);
    config.limits.import = args.scene_limits.clone();
    // What may be uploaded may also be read.
    config.limits.import.input_bytes = config.limits.import.input_bytes.max(config.limits.scene_bytes);

    let signal = stop_signal()?;
    let stop = Stop::default();
    let (ready, listening) = oneshot::channel();
    let mut service = tokio::spawn(lightshaft_server::serve(config, stop.clone(), ready));
    let address = match listening.await {
        Ok(address) => address,
        // It ended before it listened, and says why.
        Err(_) => return finish(service.await),
    };
    output::print(&format!("listening on http://{address}\n"))?;
    let supervisor = Supervisor::start(own_program()?, args.worker_arguments(address, global));
    let early = tokio::select! {
        result = &mut service => Some(result),
        () = signal => None,
    };
    tracing::info!("stopping");
    // Nothing new from now on; then the workers, while there is still a service that takes their tasks back.
    stop.draining.cancel();
    let stopped = tokio::task::spawn_blocking(move || supervisor.stop()).await;
    if stopped.is_err() {
        tracing::error!("the supervisor of the workers had died");
    }
    stop.shutdown.cancel();
    finish(match early {
        Some(result) => result,
        None => service.await,
    })
}

impl Args {
    fn worker_arguments(&self, address: SocketAddr, global: &Global) -> Vec<Vec<String>> {
        let device = match self.device {
            DeviceChoice::Auto => "auto",
            DeviceChoice::Cpu => "cpu",
            DeviceChoice::Gpu => "gpu",
        };
        let cache = self.data.join("worker-cache");
        (1..=self.workers)
            .map(|number| {
                vec![
                    "worker".to_owned(),
                    "--supervised".to_owned(),
                    format!("--server=http://{}", reachable(address)),
                    format!("--device={device}"),
                    format!("--cache={}", cache.display()),
                    format!("--name=local-{number}"),
                    format!("--log-format={}", global.log_format.name()),
                ]
            })
            .collect()
    }
}

fn parse_limits(text: &str) -> std::result::Result<SceneLimits, String> {
    serde_json::from_str(text).map_err(|error| error.to_string())
}

fn own_program() -> Result<PathBuf> {
    std::env::current_exe().map_err(|error| CliError::system(format!("this program's own path: {error}")))
}

/// The loopback address where the service listens on every address.
fn reachable(address: SocketAddr) -> SocketAddr {
    let ip = match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    SocketAddr::new(ip, address.port())
}

/// SIGINT or SIGTERM. Registered at once, so that none is missed while the service starts.
#[cfg(unix)]
fn stop_signal() -> Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let failed = |error| CliError::system(format!("signals cannot be received: {error}"));
    let mut interrupt = signal(SignalKind::interrupt()).map_err(failed)?;
    let mut terminate = signal(SignalKind::terminate()).map_err(failed)?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    })
}

#[cfg(not(unix))]
fn stop_signal() -> Result<impl Future<Output = ()>> {
    Ok(async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    })
}

fn finish(result: std::result::Result<std::result::Result<(), ServeError>, tokio::task::JoinError>) -> Result<()> {
    match result {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error @ ServeError::NotLoopback(_))) => Err(CliError::usage(error.to_string())),
        Ok(Err(error)) => Err(CliError::system(error.to_string())),
        Err(error) => Err(CliError::system(format!("the service died: {error}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn local_workers_reach_a_service_that_listens_everywhere() {
        let reached = |address: &str| reachable(address.parse().unwrap()).to_string();
        assert_eq!(reached("0.0.0.0:80"), "127.0.0.1:80");
        assert_eq!(reached("[::]:80"), "[::1]:80");
        assert_eq!(reached("192.168.1.2:80"), "192.168.1.2:80");
    }
}
