//! `lightshaft farm approve|reject|reset`: what people decide, with who and why.

use lightshaft_api::client::Client;
use lightshaft_api::farm::{BaselineReset, DEFAULT_BASELINE, Decision, Decisions};

use super::{CliError, Global, Result, find_run, output};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A run's id, or its label for the newest run at it.
    run: String,
    /// Names of cases.
    #[arg(required_unless_present = "all", conflicts_with = "all")]
    cases: Vec<String>,
    /// Every finished case that does not pass and of which nobody has decided.
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    note: Note,
}

#[derive(Debug, clap::Args)]
pub(crate) struct ResetArgs {
    /// Name of the suite.
    suite: String,
    /// Name of a case; all of the suite when left out.
    case: Option<String>,
    #[arg(long, default_value = DEFAULT_BASELINE)]
    baseline: String,
    /// Only for this class of devices.
    #[arg(long)]
    device_class: Option<String>,
    #[command(flatten)]
    note: Note,
}

#[derive(Debug, clap::Args)]
struct Note {
    /// Who decides.
    #[arg(long, env = "LIGHTSHAFT_WHO", value_name = "NAME")]
    who: String,
    /// Why; people will ask.
    #[arg(long, default_value = "", value_name = "TEXT", hide_default_value = true)]
    why: String,
}

impl Args {
    fn decisions(&self) -> Decisions {
        Decisions { who: self.note.who.clone(), why: self.note.why.clone(), cases: self.cases.clone() }
    }
}

pub(super) async fn approve(args: &Args, client: &Client, global: &Global) -> Result<()> {
    let run = find_run(client, &args.run).await?.summary.id;
    print(&client.approve_cases(&run, &args.decisions()).await?.items, global)
}

pub(super) async fn reject(args: &Args, client: &Client, global: &Global) -> Result<()> {
    let run = find_run(client, &args.run).await?.summary.id;
    print(&client.reject_cases(&run, &args.decisions()).await?.items, global)
}

pub(super) async fn reset(args: &ResetArgs, client: &Client, global: &Global) -> Result<()> {
    if args.note.why.trim().is_empty() {
        return Err(CliError::usage("--why is missing: whoever finds the baseline empty will want to know"));
    }
    let reset = BaselineReset {
        who: args.note.who.clone(),
        why: args.note.why.clone(),
        suite: args.suite.clone(),
        case: args.case.clone(),
        device_class: args.device_class.clone(),
    };
    print(&[client.reset_baseline(&args.baseline, &reset).await?], global)
}

fn print(decisions: &[Decision], global: &Global) -> Result<()> {
    if global.json {
        return output::print_json(&decisions);
    }
    let mut table = output::Table::new(&["decision", "case", "device class", "baseline", "who", "why"]);
    for decision in decisions {
        table.row([
            decision.kind.as_str().to_owned(),
            decision.case.clone().unwrap_or_else(|| "all".to_owned()),
            decision.device_class.clone().unwrap_or_else(|| "all".to_owned()),
            decision.baseline.clone(),
            decision.who.clone(),
            decision.why.clone(),
        ]);
    }
    table.print()
}
