//! `lightshaft farm run`

use std::path::{Path, PathBuf};

use lightshaft_api::client::Client;
use lightshaft_api::farm::{DEFAULT_BASELINE, NewRun, SettingsPatch};
use serde_json::Map;

use super::report::Files;
use super::settings::put_setting;
use super::{Global, Result, bring_suite, follow, pairs, scenes, status, verdict};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    wanted: Wanted,
    /// Wait for the verdicts, and exit with 1 unless all is well. This is what happens when nothing is said.
    #[arg(long, conflicts_with = "detach")]
    wait: bool,
    /// Only start the run.
    #[arg(long)]
    detach: bool,
    /// Repeating the command with the same key within 24 hours gives the run that it began first.
    #[arg(long, value_name = "KEY")]
    idempotency_key: Option<String>,
    #[command(flatten)]
    files: Files,
}

/// Which run: of what, at which label, against what.
#[derive(Debug, clap::Args)]
pub(super) struct Wanted {
    /// The suite's TOML file.
    suite: PathBuf,
    /// What is judged: most often a commit.
    #[arg(long)]
    label: String,
    /// What else is known of it, such as driver=560.35; may be repeated.
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    tags: Vec<String>,
    /// What it is judged against.
    #[arg(long, default_value = DEFAULT_BASELINE)]
    baseline: String,
    /// A setting that goes before those of every case; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Only this case; may be repeated.
    #[arg(long = "case", value_name = "NAME")]
    cases: Vec<String>,
    /// A scene of the suite from elsewhere; may be repeated.
    #[arg(long = "scene", value_name = "NAME=ID|FILE")]
    scenes: Vec<String>,
    /// -100 to 100; higher runs first.
    #[arg(long, default_value_t = 0, allow_hyphen_values = true)]
    priority: i32,
}

impl Wanted {
    /// The run as the service takes it, which has the suite and the scenes then.
    pub(super) async fn bring(&self, client: &Client) -> Result<NewRun> {
        let mut overrides = Map::new();
        for assignment in &self.set {
            put_setting("--set", &mut overrides, assignment)?;
        }
        let given = pairs("--scene", &self.scenes)?;
        let labels = pairs("--tag", &self.tags)?;
        let (suite, known) = bring_suite(client, &self.suite).await?;
        let folder = self.suite.parent().unwrap_or(Path::new(""));
        let scenes = scenes::bring(client, &suite, folder, &given).await?;
        Ok(NewRun {
            labels,
            scenes,
            baseline: self.baseline.clone(),
            overrides: SettingsPatch(overrides),
            cases: self.cases.clone(),
            priority: self.priority,
            ..NewRun::new(known.id, self.label.clone())
        })
    }
}

pub(super) async fn run(args: &Args, client: &Client, global: &Global) -> Result<()> {
    let new = args.wanted.bring(client).await?;
    let run = client.create_run(&new, args.idempotency_key.as_deref()).await?;
    if args.detach {
        return status::print(&run, client, global);
    }
    let run = follow::to_end(client, &run.summary.id).await?;
    args.files.write(&run, client).await?;
    status::print(&run, client, global)?;
    verdict(&run)
}
