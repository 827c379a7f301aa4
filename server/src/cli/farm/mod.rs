//! `lightshaft farm …`: is the picture still right, and is it still as fast?
//!
//! Exit codes say what a script needs to know: 0 all is well, 1 a regression (or a case of which nobody has decided yet), 2
//! wrong usage or input, 3 the service failed.

mod bisect;
mod calibrate;
mod decide;
mod follow;
mod history;
mod report;
mod run;
mod scenes;
mod schedule;
mod status;
mod webhook;
mod words;

use std::collections::BTreeMap;
use std::path::Path;

use lightshaft_api::client::{Client, RunFilter};
use lightshaft_api::farm::{NewSuite, Run, RunKind, RunState, Suite};
use lightshaft_api::problem::FieldError;

use super::error::{CliError, Result};
use super::{Global, block_on, output, scene, settings};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Render every case of a suite at a label, and judge it against a baseline.
    Run(Box<run::Args>),
    /// List runs, or show how one stands.
    Status(status::Args),
    /// Cancel a run with its jobs.
    Cancel(status::CancelArgs),
    /// Tell of a run as Markdown, JUnit XML, HTML or JSON.
    Report(report::Args),
    /// Accept the pictures and times of cases: from now on they are right.
    Approve(decide::Args),
    /// Say that cases are wrong: they stay red whatever their verdicts are.
    Reject(decide::Args),
    /// Take back what a baseline accepts.
    Reset(decide::ResetArgs),
    /// Show a case over its labels.
    History(history::Args),
    /// Repeat what is unchanged, to learn how far its times scatter.
    Calibrate(Box<calibrate::Args>),
    /// Runs that begin by the clock.
    #[command(subcommand)]
    Schedule(schedule::Command),
    /// Addresses that are told of verdicts and decisions.
    #[command(subcommand)]
    Webhook(webhook::Command),
    /// Find the first bad commit by picture or by time, without a service.
    Bisect(bisect::Args),
}

pub(crate) fn run(command: Command, global: &Global) -> Result<()> {
    if let Command::Bisect(args) = &command {
        return bisect::run(args, global);
    }
    let client = global.client()?;
    block_on(async {
        match command {
            Command::Run(args) => run::run(&args, &client, global).await,
            Command::Status(args) => status::run(&args, &client, global).await,
            Command::Cancel(args) => status::cancel(&args, &client, global).await,
            Command::Report(args) => report::run(&args, &client, global).await,
            Command::Approve(args) => decide::approve(&args, &client, global).await,
            Command::Reject(args) => decide::reject(&args, &client, global).await,
            Command::Reset(args) => decide::reset(&args, &client, global).await,
            Command::History(args) => history::run(&args, &client, global).await,
            Command::Calibrate(args) => calibrate::run(&args, &client, global).await,
            Command::Schedule(command) => schedule::run(&command, &client, global).await,
            Command::Webhook(command) => webhook::run(&command, &client, global).await,
            // Needs no service.
            Command::Bisect(args) => bisect::run(&args, global),
        }
    })
}

/// A run by its id, or the newest one at a label.
async fn find_run(client: &Client, wanted: &str) -> Result<Run> {
    match client.run(wanted).await {
        Err(error) if error.status() == Some(404) => {
            let (kind, label) = (Some(RunKind::Check), Some(wanted.to_owned()));
            let filter = RunFilter { kind, label, limit: Some(1), ..RunFilter::default() };
            match client.runs(&filter).await?.items.first() {
                Some(newest) => Ok(client.run(&newest.id).await?),
                None => Err(CliError::usage(format!("no run has the id or the label `{}`", output::printable(wanted)))),
            }
        }
        found => Ok(found?),
    }
}

/// Reads a suite's file, and makes sure that the service has this version of it.
async fn bring_suite(client: &Client, path: &Path) -> Result<(NewSuite, Suite)> {
    let named = |detail: String| CliError::usage(format!("{}: {detail}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| named(error.to_string()))?;
    let suite = NewSuite::from_toml(&text).map_err(|errors| named(listed(&errors)))?;
    suite.resolve().map_err(|errors| named(listed(&errors)))?;
    let known = client.create_suite(&suite).await?;
    Ok((suite, known))
}

fn listed(errors: &[FieldError]) -> String {
    let lines = errors.iter().map(|error| match error.pointer.as_str() {
        "" => error.detail.clone(),
        pointer => format!("{pointer}: {}", error.detail),
    });
    lines.collect::<Vec<_>>().join("\n  ")
}

/// `KEY=VALUE`, given several times.
fn pairs(option: &str, given: &[String]) -> Result<BTreeMap<String, String>> {
    let split = |text: &String| match text.split_once('=') {
        Some((key, value)) if !key.is_empty() => Ok((key.to_owned(), value.to_owned())),
        _ => Err(CliError::usage(format!("{option} {text}: expected KEY=VALUE"))),
    };
    given.iter().map(split).collect()
}

/// Exit code 1 unless a finished run is well.
fn verdict(run: &Run) -> Result<()> {
    let summary = &run.summary;
    let counts = &summary.counts;
    match (summary.state, summary.ok) {
        (RunState::Cancelled, _) => Err(CliError::no(format!("run {} was cancelled", summary.id))),
        (RunState::Finished, Some(false)) => {
            let bad = counts.cases - counts.ok;
            let new = if counts.missing > 0 {
                format!("; {} have no accepted picture yet: lightshaft farm approve {}", counts.missing, summary.id)
            } else {
                String::new()
            };
            Err(CliError::no(format!("{bad} of {} cases do not pass{new}", counts.cases)))
        }
        _ => Ok(()),
    }
}
