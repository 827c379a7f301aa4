//! `lightshaft job submit`

use std::path::{Path, PathBuf};

use lightshaft_api::client::Client;
use lightshaft_api::job::{JobKind, NewJob};
use serde_json::json;

use super::{Global, download, parse_labels, print_job, watch};
use crate::cli::error::Result;
use crate::cli::settings::SettingsArgs;
use crate::cli::{output, scene};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Id of an uploaded scene, or a file that is uploaded first.
    scene: String,
    /// render, benchmark or build; the settings of the last two come from --settings and --setting.
    #[arg(long, default_value = "render", value_parser = parse_kind)]
    kind: JobKind,
    /// Submit this table of benchmarks: see `lightshaft bench --list`.
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// -100 to 100; higher runs first.
    #[arg(long, default_value_t = 0, allow_hyphen_values = true)]
    priority: i32,
    /// May be repeated.
    #[arg(long = "label", value_name = "KEY=VALUE")]
    labels: Vec<String>,
    /// Attempts at each task.
    #[arg(long)]
    max_attempts: Option<u32>,
    /// Repeating the command with the same key gives the same job.
    #[arg(long, value_name = "KEY")]
    idempotency_key: Option<String>,
    /// Only check the job, and print it with every default filled in.
    #[arg(long, conflicts_with = "wait")]
    validate_only: bool,
    /// Follow the job to its end; exit code 1 unless it succeeds.
    #[arg(long)]
    wait: bool,
    /// Then write its artifacts into this folder.
    #[arg(short, long, value_name = "DIR", requires = "wait")]
    output: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArgs,
}

fn parse_kind(name: &str) -> std::result::Result<JobKind, String> {
    JobKind::from_name(name).ok_or_else(|| "must be render, benchmark or build".to_owned())
}

pub(crate) async fn run(args: &Args, client: &Client, global: &Global) -> Result<()> {
    let kind = if args.preset.is_some() { JobKind::Benchmark } else { args.kind };
    let mut chosen = args.settings.read()?;
    if let Some(path) = chosen.environment_file.clone() {
        let blob = client.store_blob_file(&path).await?;
        chosen.set_environment_map(&blob.hash);
    }
    if let Some(preset) = &args.preset {
        chosen.set("preset", json!(preset));
    }
    let settings = chosen.finish_as(kind)?;
    let path = Path::new(&args.scene);
    let scene = if path.is_file() { scene::upload(client, path, None).await?.0.id } else { args.scene.clone() };
    let job = NewJob {
        kind,
        scene,
        priority: args.priority,
        labels: parse_labels(&args.labels)?,
        max_attempts: args.max_attempts,
        settings,
    };
    if args.validate_only {
        return output::print_json(&client.validate_job(&job).await?);
    }
    let job = client.create_job(&job, args.idempotency_key.as_deref()).await?;
    if !args.wait {
        return print_job(&job, global);
    }
    let id = job.summary.id;
    let job = watch::follow(client, &id).await?;
    if let Some(folder) = &args.output {
        download::artifacts(client, &job, folder, &[]).await?;
    }
    print_job(&job, global)?;
    watch::verdict(&job)
}
