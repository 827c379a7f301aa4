//! `lightshaft workers …`: the workers that a service knows.

use lightshaft_api::worker::{Worker, WorkerState};
use serde_json::json;

use super::Global;
use super::error::Result;
use super::output;

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// List workers with their devices and caches.
    List,
    /// Show one worker.
    Show { worker: String },
    /// Let a worker finish what it has, and lease it no more.
    Drain { worker: String },
    /// Lease to a drained worker again.
    Undrain { worker: String },
    /// Forget a worker that has nothing leased. One that still runs registers anew when it starts again.
    Forget { worker: String },
}

pub(crate) async fn run(command: Command, global: &Global) -> Result<()> {
    let client = global.client()?;
    match command {
        Command::List => list(&client.workers().await?.items, global),
        Command::Show { worker } => show(&client.worker(&worker).await?, global),
        Command::Drain { worker } => show(&client.drain_worker(&worker).await?, global),
        Command::Undrain { worker } => show(&client.undrain_worker(&worker).await?, global),
        Command::Forget { worker } => {
            client.remove_worker(&worker).await?;
            if global.json { output::print_json(&json!({ "forgotten": worker })) } else { Ok(()) }
        }
    }
}

fn list(workers: &[Worker], global: &Global) -> Result<()> {
    if global.json {
        return output::print_json(&workers);
    }
    let mut table = output::Table::new(&["id", "name", "state", "devices", "cache", "tasks"]);
    for worker in workers {
        table.row([
            worker.id.clone(),
            worker.name.clone(),
            state(worker),
            devices(worker, " + "),
            output::bytes(worker.cache.memory_bytes),
            output::count(worker.tasks_done),
        ]);
    }
    table.print()
}

fn show(worker: &Worker, global: &Global) -> Result<()> {
    if global.json {
        return output::print_json(worker);
    }
    output::print(&describe(worker))
}

fn describe(worker: &Worker) -> String {
    let cache = &worker.cache;
    let mut rows = vec![
        ("id", worker.id.clone()),
        ("name", worker.name.clone()),
        ("version", worker.version.clone()),
        ("state", state(worker)),
        ("devices", devices(worker, "\n            ")),
        ("registered", format!("{:.0}", worker.registered_at)),
        ("last seen", format!("{:.0}", worker.last_seen_at)),
        ("tasks done", output::count(worker.tasks_done)),
        (
            "cache",
            format!(
                "{} structures: {} of {} in memory, {} on disk",
                output::count(cache.entries),
                output::bytes(cache.memory_bytes),
                output::bytes(cache.memory_budget_bytes),
                output::bytes(cache.disk_bytes)
            ),
        ),
    ];
    if !worker.tags.is_empty() {
        rows.push(("tags", output::printable(&worker.tags.join(", "))));
    }
    if let Some(current) = &worker.current {
        rows.push(("job", current.job.clone()));
    }
    rows.into_iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect()
}

/// A worker that is busy or gone may be draining as well.
fn state(worker: &Worker) -> String {
    let state = worker.state.as_str();
    if worker.draining && worker.state != WorkerState::Draining { format!("{state}, draining") } else { state.into() }
}

fn devices(worker: &Worker, between: &str) -> String {
    let name = |device: &lightshaft_api::worker::Device| {
        output::printable(&format!("{}: {}", device.kind.as_str(), device.name))
    };
    worker.devices.iter().map(name).collect::<Vec<_>>().join(between)
}
