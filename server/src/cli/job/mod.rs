//! `lightshaft job …`

mod download;
mod submit;
mod watch;

use std::collections::BTreeMap;
use std::path::PathBuf;

use lightshaft_api::client::{Client, JobFilter};
use lightshaft_api::job::{CacheReport, Job, JobPatch, JobState, JobSummary};
use lightshaft_api::settings::JobSettings;
use serde_json::json;

use super::error::{CliError, Result};
use super::{Global, output};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Submit a render, a benchmark or a build of an uploaded scene, or of a file.
    Submit(Box<submit::Args>),
    /// Follow a job to its end; exit code 1 unless it succeeds.
    Watch { job: String },
    /// List jobs, newest first.
    List {
        /// queued, running, succeeded, failed or cancelled.
        #[arg(long, value_parser = parse_state)]
        state: Option<JobState>,
        /// Only jobs of this scene.
        #[arg(long)]
        scene: Option<String>,
        /// Only jobs with this label; may be repeated.
        #[arg(long = "label", value_name = "KEY=VALUE")]
        labels: Vec<String>,
        /// At most so many.
        #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..))]
        limit: u32,
    },
    /// Show one job.
    Show { job: String },
    /// Cancel a job.
    Cancel { job: String },
    /// Try a failed or cancelled job again.
    Retry { job: String },
    /// Change how soon a job's tasks run.
    Priority {
        job: String,
        /// -100 to 100; higher runs first.
        #[arg(allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-100..=100))]
        priority: i32,
    },
    /// Keep a job's tasks from being leased; running ones go on.
    Pause { job: String },
    /// Let a paused job go on.
    Resume { job: String },
    /// Delete a finished job with its pictures and logs.
    Delete { job: String },
    /// Write a job's artifacts into a folder.
    Download {
        job: String,
        /// Made when it is not there.
        #[arg(short, long, default_value = ".", value_name = "DIR")]
        output: PathBuf,
        /// Only these artifacts.
        names: Vec<String>,
    },
    /// Print a job's log.
    Log {
        job: String,
        /// Only this attempt.
        #[arg(long)]
        attempt: Option<String>,
    },
}

pub(crate) async fn run(command: Command, global: &Global) -> Result<()> {
    let client = global.client()?;
    match command {
        Command::Submit(args) => submit::run(&args, &client, global).await,
        Command::Watch { job } => watch::run(&job, &client, global).await,
        Command::List { state, scene, labels, limit } => {
            let filter = JobFilter { state, scene, labels: parse_labels(&labels)?, ..JobFilter::default() };
            list(&client, filter, limit, global).await
        }
        Command::Show { job } => print_job(&client.job(&job).await?, global),
        Command::Cancel { job } => print_job(&client.cancel_job(&job).await?, global),
        Command::Retry { job } => print_job(&client.retry_job(&job).await?, global),
        Command::Priority { job, priority } => {
            patch(&client, &job, JobPatch { priority: Some(priority), ..JobPatch::default() }, global).await
        }
        Command::Pause { job } => {
            patch(&client, &job, JobPatch { paused: Some(true), ..JobPatch::default() }, global).await
        }
        Command::Resume { job } => {
            patch(&client, &job, JobPatch { paused: Some(false), ..JobPatch::default() }, global).await
        }
        Command::Delete { job } => {
            client.delete_job(&job).await?;
            if global.json { output::print_json(&json!({ "deleted": job })) } else { Ok(()) }
        }
        Command::Download { job, output, names } => download::run(&job, &output, &names, &client, global).await,
        Command::Log { job, attempt } => {
            let log = client.job_log(&job, attempt.as_deref()).await?;
            if global.json {
                let lines: Vec<&str> = log.lines().collect();
                return output::print_json(&lines);
            }
            let lines: String = log.lines().map(|line| output::printable(line) + "\n").collect();
            output::print(&lines)
        }
    }
}

async fn patch(client: &Client, job: &str, patch: JobPatch, global: &Global) -> Result<()> {
    print_job(&client.patch_job(job, &patch).await?, global)
}

fn parse_state(text: &str) -> std::result::Result<JobState, String> {
    JobState::from_name(text).ok_or_else(|| {
        let names: Vec<&str> = JobState::ALL.iter().map(|state| state.as_str()).collect();
        format!("must be one of {}", names.join(", "))
    })
}

/// `KEY=VALUE` each.
fn parse_labels(labels: &[String]) -> Result<BTreeMap<String, String>> {
    let parse = |label: &String| {
        let (key, value) =
            label.split_once('=').ok_or_else(|| CliError::usage(format!("--label {label}: expected KEY=VALUE")))?;
        Ok((key.to_owned(), value.to_owned()))
    };
    labels.iter().map(parse).collect()
}

/// Follows the pages until there are `limit` jobs.
async fn list(client: &Client, mut filter: JobFilter, limit: u32, global: &Global) -> Result<()> {
    let mut jobs: Vec<JobSummary> = Vec::new();
    loop {
        filter.limit = Some((limit - jobs.len() as u32).min(100));
        let page = client.jobs(&filter).await?;
        jobs.extend(page.items);
        filter.cursor = page.next_cursor;
        if filter.cursor.is_none() || jobs.len() as u32 >= limit {
            break;
        }
    }
    if global.json {
        return output::print_json(&jobs);
    }
    let mut table = output::Table::new(&["id", "kind", "state", "progress", "scene", "created"]);
    for job in jobs {
        let state = if job.paused { format!("{} (paused)", job.state.as_str()) } else { job.state.as_str().to_owned() };
        let progress = format!("{:.0} %", job.progress * 100.0);
        table.row([
            job.id,
            job.kind.as_str().to_owned(),
            state,
            progress,
            job.scene_name,
            format!("{:.0}", job.created_at),
        ]);
    }
    table.print()
}

fn print_job(job: &Job, global: &Global) -> Result<()> {
    if global.json {
        return output::print_json(job);
    }
    output::print(&describe(job))
}

fn describe(job: &Job) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    let s = &job.summary;
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<11}{}", output::printable(&value));
    };
    line("job", s.id.clone());
    line("state", format!("{}, {:.0} %", s.state.as_str(), s.progress * 100.0));
    line("scene", format!("{} ({})", s.scene_name, s.scene));
    if let Some(waiting) = &job.waiting {
        line("waiting", waiting.clone());
    }
    if let Some(error) = &s.error {
        line("error", error.clone());
    }
    match &job.settings {
        JobSettings::Render(p) => {
            line("picture", format!("{}x{}, {} spp, {:?}", p.width, p.height, p.spp, p.integrator).to_lowercase());
        }
        JobSettings::Benchmark(b) => line("benchmark", b.describe()),
        JobSettings::Build(b) => line("build", b.acceleration.describe()),
        JobSettings::Compare(c) => line("comparing", c.describe()),
    }
    for (key, value) in &s.labels {
        line("label", format!("{key}={value}"));
    }
    for attempt in &job.attempts {
        let error = attempt.error.as_deref().map(|error| format!(": {error}")).unwrap_or_default();
        line("attempt", format!("{} on {}: {}{error}", attempt.number, attempt.worker_name, attempt.outcome.as_str()));
    }
    if let Some(m) = &job.metrics {
        line("device", m.device.clone());
        line("time", format!("{:.2} s, of it structures {:.2} and render {:.2}", m.total_s, m.build_s, m.render_s));
        line("rays", format!("{} ({:.2} MRays/s)", output::count(m.rays.total()), m.mrays_per_s));
        if matches!(job.settings, JobSettings::Build(_)) {
            for made in &m.cache {
                let on = made.built_on.map(|on| format!(" on {}", on.as_str())).unwrap_or_default();
                let (from, size) = (made.source.as_str(), output::bytes(made.bytes));
                let CacheReport { mesh, structure, seconds, .. } = made;
                line("structure", format!("{mesh} {structure}: {from}{on}, {seconds:.3} s, {size}"));
            }
        }
        for warning in &m.warnings {
            line("warning", warning.clone());
        }
    }
    for artifact in &job.artifacts {
        line("artifact", format!("{} ({})", artifact.name, output::bytes(artifact.bytes)));
    }
    text
}
