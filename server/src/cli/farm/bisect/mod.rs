//! `lightshaft farm bisect`: the first commit that is bad by picture or by time.
//!
//! Like `git bisect run`, but the command does not say what is good: it makes a picture, or takes its time, and both are
//! judged against what the good commit makes. Every commit is checked out in a work tree of its own, so that the user's
//! stays as it is; times are taken in turns with the good commit's, so that other load does not count.

mod judge;
mod repository;
mod search;

use std::path::PathBuf;

use lightshaft_compare::timing::Interval;
use serde::Serialize;

use super::{CliError, Global, Result, output};
use judge::Judge;
use repository::Repository;
use search::{Outcome, first_bad};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A commit that is good.
    #[arg(long, value_name = "COMMIT")]
    good: String,
    /// A commit that is bad.
    #[arg(long, default_value = "HEAD", value_name = "COMMIT")]
    bad: String,
    /// picture: the command writes one to $LIGHTSHAFT_PICTURE. time: how long the command takes, or the seconds that it
    /// writes to $LIGHTSHAFT_SECONDS.
    #[arg(long, value_enum)]
    by: By,
    /// The repository.
    #[arg(long, default_value = ".", value_name = "DIR")]
    repository: PathBuf,
    /// Run by sh once in each commit first, and not timed: to build, for instance. $LIGHTSHAFT_COMMIT names the commit here, too.
    #[arg(long, value_name = "COMMAND")]
    prepare: Option<String>,
    /// Judge pictures against this one instead of the good commit's.
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Ending of the picture's file: png or exr.
    #[arg(long, default_value = "png", value_parser = ["png", "exr"])]
    format: String,
    /// A picture is good up to this mean FLIP error. Without a limit, no pixel may differ.
    #[arg(long)]
    max_flip: Option<f64>,
    /// A picture is good up to this root mean square error of linear colour.
    #[arg(long)]
    max_rmse: Option<f64>,
    /// A commit is slow when it certainly takes more than this many times as long as the good one.
    #[arg(long, default_value_t = 1.1, value_parser = parse_ratio)]
    max_ratio: f64,
    /// How often each side is timed, after one time that does not count.
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u32).range(5..=1000))]
    repeat: u32,
    /// What is run in each commit. Exit code 125: this commit cannot be judged.
    #[arg(last = true, required = true)]
    command: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum By {
    Picture,
    Time,
}

/// What is known of a commit that was tried.
#[derive(Clone, Debug, Serialize)]
struct Trial {
    commit: String,
    subject: String,
    /// `good`, `bad` or `skipped`.
    verdict: &'static str,
    /// In words.
    reason: String,
    /// Of the picture.
    #[serde(skip_serializing_if = "Option::is_none")]
    flip_mean: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rmse: Option<f64>,
    /// Of the time to the good commit's.
    #[serde(skip_serializing_if = "Option::is_none")]
    ratio: Option<Ratio>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Ratio {
    value: f64,
    low: f64,
    high: f64,
}

impl From<Interval> for Ratio {
    fn from(interval: Interval) -> Self {
        Self { value: interval.value, low: interval.low, high: interval.high }
    }
}

#[derive(Debug, Serialize)]
struct Found<'a> {
    /// Null when the bad commit is no worse than the good one.
    first_bad: Option<&'a Trial>,
    /// Commits before it that could not be judged: it may be one of these.
    suspects: Vec<String>,
    trials: &'a [Trial],
}

pub(super) fn run(args: &Args, global: &Global) -> Result<()> {
    let repository = Repository::open(&args.repository)?;
    let commits = repository.between(&args.good, &args.bad)?;
    let mut judge = Judge::new(args, &repository, &commits[0])?;
    let mut trials: Vec<Trial> = Vec::new();
    let outcome = first_bad::<CliError>(commits.len(), |i| {
        let trial = judge.trial(&commits[i])?;
        eprintln!("{}", output::printable(&format!("{}: {} {}", trial.verdict, short(&trial), trial.reason)));
        let verdict = match trial.verdict {
            "good" => search::Verdict::Good,
            "bad" => search::Verdict::Bad,
            _ => search::Verdict::Skipped,
        };
        trials.push(trial);
        Ok(verdict)
    })?;
    let (first, suspects) = match outcome {
        Outcome::NoneIsBad => (None, Vec::new()),
        Outcome::Found { first, suspects } => (Some(first), suspects),
    };
    let of_commit = |i: usize| trials.iter().find(|trial| trial.commit == commits[i].id);
    let found = Found {
        first_bad: first.and_then(of_commit),
        suspects: suspects.into_iter().map(|i| commits[i].id.clone()).collect(),
        trials: &trials,
    };
    report(&found, global)
}

/// Exit code 1 when there is a bad commit.
fn report(found: &Found<'_>, global: &Global) -> Result<()> {
    if global.json {
        output::print_json(found)?;
    }
    let Some(first) = found.first_bad else {
        return if global.json { Ok(()) } else { output::print("the bad commit is no worse than the good one\n") };
    };
    let mut text = format!("{} is the first bad commit: {}", short(first), first.reason);
    if !found.suspects.is_empty() {
        let names: Vec<&str> = found.suspects.iter().map(|commit| &commit[..commit.len().min(12)]).collect();
        text.push_str(&format!("; or one of these, which cannot be judged: {}", names.join(", ")));
    }
    Err(CliError::no(output::printable(&text)))
}

fn short(trial: &Trial) -> String {
    format!("{} ({})", &trial.commit[..trial.commit.len().min(12)], trial.subject)
}

fn parse_ratio(text: &str) -> std::result::Result<f64, String> {
    let ratio: f64 = text.parse().map_err(|_| "must be a number".to_owned())?;
    if ratio >= 1.0 && ratio.is_finite() { Ok(ratio) } else { Err("must be 1 or more".to_owned()) }
}
