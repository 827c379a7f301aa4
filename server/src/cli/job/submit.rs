//! `lightshaft job submit`

use std::path::{Path, PathBuf};

use lightshaft_api::blob::is_hash;
use lightshaft_api::client::Client;
use lightshaft_api::job::{JobKind, NewJob};
use serde_json::{Value, json};

use super::{Global, download, parse_labels, print_job, watch};
use crate::cli::error::{CliError, Result};
use crate::cli::settings::SettingsArgs;
use crate::cli::{output, scene};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Id of an uploaded scene, or a file that is uploaded first. Of --kind compare it may be left out: then it is that of the
    /// job whose picture is compared.
    #[arg(required_unless_present_any = ["a", "kind"])]
    scene: Option<String>,
    /// render, benchmark, build or compare; the settings of all but the first come from --settings and --setting.
    #[arg(long, default_value = "render", value_parser = parse_kind)]
    kind: JobKind,
    /// Submit this table of benchmarks: see `lightshaft bench --list`.
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Compare with this: a job, a job's artifact (JOB/NAME), or a blob by its hash. As if --kind compare were given.
    #[arg(long, value_name = "PICTURE", requires = "b")]
    a: Option<String>,
    /// Compare this with --a.
    #[arg(long, value_name = "PICTURE", requires = "a")]
    b: Option<String>,
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
    JobKind::from_name(name).ok_or_else(|| "must be render, benchmark, build or compare".to_owned())
}

/// A job, an artifact of one, or a blob.
fn to_choice(picture: &str) -> Value {
    match picture.split_once('/') {
        Some((job, artifact)) => json!({ "job": job, "artifact": artifact }),
        None if is_hash(picture) => json!({ "blob": picture }),
        None => json!({ "job": picture }),
    }
}

pub(crate) async fn run(args: &Args, client: &Client, global: &Global) -> Result<()> {
    let kind = match (&args.preset, &args.a) {
        (Some(_), _) => JobKind::Benchmark,
        (None, Some(_)) => JobKind::Compare,
        (None, None) => args.kind,
    };
    let mut chosen = args.settings.read()?;
    if let Some(path) = chosen.environment_file.clone() {
        let blob = client.store_blob_file(&path).await?;
        chosen.set_environment_map(&blob.hash);
    }
    if let Some(preset) = &args.preset {
        chosen.set("preset", json!(preset));
    }
    for (side, picture) in [("a", &args.a), ("b", &args.b)] {
        if let Some(picture) = picture {
            chosen.set(side, to_choice(picture));
        }
    }
    let settings = chosen.finish_as(kind)?;
    let scene = match &args.scene {
        Some(file) if Path::new(file).is_file() => scene::upload(client, Path::new(file), None).await?.0.id,
        Some(id) => id.clone(),
        None if kind == JobKind::Compare => String::new(),
        None => return Err(CliError::usage(format!("SCENE: a job of kind {} needs one", kind.as_str()))),
    };
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
