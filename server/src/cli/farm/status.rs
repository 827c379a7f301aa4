//! `lightshaft farm status` and `cancel`

use lightshaft_api::client::{Client, RunFilter};
use lightshaft_api::farm::{Run, RunSummary};

use super::words::{self, Standing};
use super::{Global, Result, find_run, output, verdict};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A run's id, or its label for the newest run at it. Exit code 1 when it has finished and is not well.
    run: Option<String>,
    /// Only runs of this suite.
    #[arg(long)]
    suite: Option<String>,
    /// At most so many.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=200))]
    limit: u32,
}

#[derive(Debug, clap::Args)]
pub(crate) struct CancelArgs {
    /// A run's id, or its label for the newest run at it.
    run: String,
}

pub(super) async fn cancel(args: &CancelArgs, client: &Client, global: &Global) -> Result<()> {
    let run = find_run(client, &args.run).await?.summary.id;
    print(&client.cancel_run(&run).await?, client, global)
}

pub(super) async fn run(args: &Args, client: &Client, global: &Global) -> Result<()> {
    if let Some(wanted) = &args.run {
        let run = find_run(client, wanted).await?;
        print(&run, client, global)?;
        return verdict(&run);
    }
    let filter = RunFilter { suite: args.suite.clone(), limit: Some(args.limit), ..RunFilter::default() };
    let runs = client.runs(&filter).await?.items;
    if global.json { output::print_json(&runs) } else { list(&runs) }
}

fn list(runs: &[RunSummary]) -> Result<()> {
    let mut table = output::Table::new(&["id", "suite", "label", "baseline", "state", "well", "created"]);
    for run in runs {
        table.row([
            run.id.clone(),
            run.suite_name.clone(),
            run.label.clone(),
            run.baseline.clone(),
            run.state.as_str().to_owned(),
            format!("{} of {}", run.counts.ok, run.counts.cases),
            format!("{:.0}", run.created_at),
        ]);
    }
    table.print()
}

/// A run with a line for each case, or as JSON.
pub(super) fn print(run: &Run, client: &Client, global: &Global) -> Result<()> {
    if global.json {
        return output::print_json(run);
    }
    let summary = &run.summary;
    let mut table = output::Table::new(&["case", "stands", "picture", "time", "figures"]);
    for case in &run.cases {
        table.row([
            case.name.clone(),
            Standing::of(case).as_str().to_owned(),
            words::image(case),
            words::time(case),
            words::figures(case),
        ]);
    }
    table.print()?;
    let head = format!(
        "\nrun {} of {} at {}: {}, {} of {} cases are well\n{}\n",
        summary.id,
        summary.suite_name,
        summary.label,
        summary.state.as_str(),
        summary.counts.ok,
        summary.counts.cases,
        page(client, &summary.id),
    );
    let lines: String = head.lines().map(|line| output::printable(line) + "\n").collect();
    output::print(&lines)
}

/// Where people see a run.
pub(super) fn page(client: &Client, run: &str) -> String {
    client.url(&format!("farm/runs/{run}"))
}
