//! What is good: a picture like the good commit's, or a time that is not certainly longer.

use std::path::PathBuf;
use std::process::Command;
use std::time::Instant;

use lightshaft_compare::Options;
use lightshaft_compare::timing::grouped_median;
use lightshaft_engine::film::COLOR;
use lightshaft_worker::picture::compare::{Bounds, Pixels, layers, report};

use super::repository::{Commit, Repository, WorkTree};
use super::{Args, By, Trial};
use crate::cli::error::{CliError, Result};

/// The exit code by which a command says that this commit cannot be judged, as for `git bisect run`.
const SKIP: i32 = 125;
/// Pixels of the largest picture that is read.
const MAX_PIXELS: u64 = 1 << 28;

pub(super) struct Judge<'a> {
    args: &'a Args,
    repository: &'a Repository,
    good: Good<'a>,
}

enum Good<'a> {
    Picture(Box<Pixels>),
    /// Kept, for times are taken in turns.
    Time(WorkTree<'a>, &'a Commit),
}

/// What a command did that ended as it should.
enum Ran {
    InTime(f64),
    Skipped,
}

impl<'a> Judge<'a> {
    pub(super) fn new(args: &'a Args, repository: &'a Repository, good: &'a Commit) -> Result<Self> {
        let good = match (args.by, &args.reference) {
            (By::Picture, Some(path)) => Good::Picture(Box::new(read(path)?)),
            (By::Picture, None) => {
                let tree = repository.work_tree(good)?;
                prepare(args, &tree, good)?;
                match picture(args, &tree, good)? {
                    Some(picture) => Good::Picture(Box::new(picture)),
                    None => return Err(skipped_good(good)),
                }
            }
            (By::Time, Some(_)) => return Err(CliError::usage("--reference is a picture: it goes with --by picture")),
            (By::Time, None) => {
                let tree = repository.work_tree(good)?;
                if let Ran::Skipped = prepare(args, &tree, good)? {
                    return Err(skipped_good(good));
                }
                Good::Time(tree, good)
            }
        };
        Ok(Self { args, repository, good })
    }

    pub(super) fn trial(&mut self, commit: &Commit) -> Result<Trial> {
        let tree = self.repository.work_tree(commit)?;
        if let Ran::Skipped = prepare(self.args, &tree, commit)? {
            return Ok(skipped(commit));
        }
        match &self.good {
            Good::Picture(good) => self.by_picture(good, &tree, commit),
            Good::Time(good_tree, good) => self.by_time(good_tree, good, &tree, commit),
        }
    }

    fn by_picture(&self, good: &Pixels, tree: &WorkTree<'_>, commit: &Commit) -> Result<Trial> {
        let Some(found) = picture(self.args, tree, commit)? else { return Ok(skipped(commit)) };
        let outcome = match layers(good, &found, &Options::default(), false) {
            Ok(outcome) => outcome,
            Err(error) => return Ok(trial(commit, false, error.to_string())),
        };
        let bounds = Bounds { max_rmse: self.args.max_rmse, max_flip: self.args.max_flip, max_hdr_flip: None };
        let report = report(&outcome.figures, bounds);
        let has_limits = bounds.max_rmse.is_some() || bounds.max_flip.is_some();
        let differing = report.differing_pixels;
        let reason = match (has_limits, differing) {
            (_, 0) => "no pixel differs".to_owned(),
            (true, _) if report.passed => format!("mean FLIP {:.4}, within the limits", report.flip_mean),
            (true, _) => report.over_limits.join("; "),
            (false, n) => format!("{n} pixels differ, mean FLIP {:.4}", report.flip_mean),
        };
        let is_good = if has_limits { report.passed } else { differing == 0 };
        Ok(Trial { flip_mean: Some(report.flip_mean), rmse: Some(report.rmse), ..trial(commit, is_good, reason) })
    }

    fn by_time(&self, good_tree: &WorkTree<'_>, good: &Commit, tree: &WorkTree<'_>, commit: &Commit) -> Result<Trial> {
        let (mut reference, mut found) = (Vec::new(), Vec::new());
        for round in 0..=self.args.repeat {
            for (tree, commit, samples) in [(good_tree, good, &mut reference), (tree, commit, &mut found)] {
                match execute(self.args, tree, commit)? {
                    // The first is to warm up.
                    Ran::InTime(seconds) if round > 0 => samples.push(seconds),
                    Ran::InTime(_) => {}
                    Ran::Skipped => return Ok(skipped(commit)),
                }
            }
        }
        // Of each pair: what changes slowly (clocks, heat, other load) changes both.
        let ratios: Vec<f64> = reference.iter().zip(&found).map(|(reference, found)| found / reference).collect();
        let is_usable = ratios.iter().all(|ratio| ratio.is_finite() && *ratio > 0.0);
        let Some(ratio) = grouped_median(&[ratios]).filter(|_| is_usable) else {
            return Err(CliError::usage("the command's times must be more than 0"));
        };
        let is_good = ratio.low <= self.args.max_ratio;
        let reason = format!(
            "takes {:.3} times as long (95 %: {:.3} to {:.3}); {} may be",
            ratio.value, ratio.low, ratio.high, self.args.max_ratio
        );
        Ok(Trial { ratio: Some(ratio.into()), ..trial(commit, is_good, reason) })
    }
}

fn trial(commit: &Commit, is_good: bool, reason: String) -> Trial {
    Trial {
        commit: commit.id.clone(),
        subject: commit.subject.clone(),
        verdict: if is_good { "good" } else { "bad" },
        reason,
        flip_mean: None,
        rmse: None,
        ratio: None,
    }
}

fn skipped(commit: &Commit) -> Trial {
    Trial { verdict: "skipped", ..trial(commit, true, format!("the command ended with {SKIP}")) }
}

fn skipped_good(good: &Commit) -> CliError {
    CliError::usage(format!("--good {}: the command ended with {SKIP}, so there is nothing to judge by", good.id))
}

fn prepare(args: &Args, tree: &WorkTree<'_>, commit: &Commit) -> Result<Ran> {
    let Some(line) = &args.prepare else { return Ok(Ran::InTime(0.0)) };
    let mut shell = Command::new("sh");
    shell.args(["-c", line]);
    start(shell, "--prepare", tree, commit)
}

fn execute(args: &Args, tree: &WorkTree<'_>, commit: &Commit) -> Result<Ran> {
    let [program, rest @ ..] = args.command.as_slice() else { return Err(CliError::usage("no command is given")) };
    let told = tree.beside("seconds");
    std::fs::remove_file(&told).ok();
    let mut command = Command::new(program);
    command.args(rest).env("LIGHTSHAFT_SECONDS", &told).env("LIGHTSHAFT_PICTURE", picture_path(args, tree));
    let ran = start(command, program, tree, commit)?;
    let (Ran::InTime(_), Ok(text)) = (&ran, std::fs::read_to_string(&told)) else { return Ok(ran) };
    let seconds = text.trim().parse::<f64>().ok().filter(|seconds| seconds.is_finite());
    let wrong = || CliError::usage(format!("{program} wrote no number of seconds to $LIGHTSHAFT_SECONDS"));
    seconds.map(Ran::InTime).ok_or_else(wrong)
}

/// Runs a command in the work tree to its end. What it prints goes to standard error: standard output is ours.
fn start(mut command: Command, name: &str, tree: &WorkTree<'_>, commit: &Commit) -> Result<Ran> {
    let begun = Instant::now();
    let status = command
        .current_dir(&tree.path)
        .env("LIGHTSHAFT_COMMIT", &commit.id)
        .stdin(std::process::Stdio::null())
        .stdout(std::io::stderr())
        .status()
        .map_err(|error| CliError::usage(format!("{name} does not start: {error}")))?;
    match status.code() {
        Some(0) => Ok(Ran::InTime(begun.elapsed().as_secs_f64())),
        Some(SKIP) => Ok(Ran::Skipped),
        _ => {
            let advice = format!("exit with {SKIP} where a commit cannot be judged");
            Err(CliError::system(format!("{name} failed at {} with {status}: {advice}", commit.id)))
        }
    }
}

fn picture(args: &Args, tree: &WorkTree<'_>, commit: &Commit) -> Result<Option<Pixels>> {
    let path = picture_path(args, tree);
    match execute(args, tree, commit)? {
        Ran::Skipped => Ok(None),
        Ran::InTime(_) if !path.is_file() => {
            Err(CliError::usage(format!("the command wrote no picture to $LIGHTSHAFT_PICTURE at {}", commit.id)))
        }
        Ran::InTime(_) => read(&path).map(Some),
    }
}

fn picture_path(args: &Args, tree: &WorkTree<'_>) -> PathBuf {
    tree.beside(&format!("picture.{}", args.format))
}

fn read(path: &std::path::Path) -> Result<Pixels> {
    let named = |error: String| CliError::usage(format!("{}: {error}", path.display()));
    let bytes = std::fs::read(path).map_err(|error| named(error.to_string()))?;
    Pixels::read(&bytes, COLOR, MAX_PIXELS).map_err(|error| named(error.to_string()))
}
