//! `lightshaft farm calibrate`

use std::path::{Path, PathBuf};

use lightshaft_api::client::Client;
use lightshaft_api::farm::{Calibration, NewCalibration, RunState, SettingsPatch};
use serde_json::Map;

use super::settings::put_setting;
use super::words::seconds;
use super::{CliError, Global, Result, bring_suite, follow, output, pairs, scenes};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The suite's TOML file.
    suite: PathBuf,
    /// What is unchanged: most often a commit.
    #[arg(long)]
    label: String,
    /// How many runs of each case, 3 to 50.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(3..=50))]
    times: u32,
    /// Only start it.
    #[arg(long)]
    detach: bool,
    /// A setting that goes before those of every case; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Only this case; may be repeated.
    #[arg(long = "case", value_name = "NAME")]
    cases: Vec<String>,
    /// A scene of the suite from elsewhere; may be repeated.
    #[arg(long = "scene", value_name = "NAME=ID|FILE")]
    scenes: Vec<String>,
}

pub(super) async fn run(args: &Args, client: &Client, global: &Global) -> Result<()> {
    let mut overrides = Map::new();
    for assignment in &args.set {
        put_setting("--set", &mut overrides, assignment)?;
    }
    let given = pairs("--scene", &args.scenes)?;
    let (suite, known) = bring_suite(client, &args.suite).await?;
    let folder = args.suite.parent().unwrap_or(Path::new(""));
    let new = NewCalibration {
        suite: known.id,
        label: args.label.clone(),
        labels: Default::default(),
        times: args.times,
        scenes: scenes::bring(client, &suite, folder, &given).await?,
        overrides: SettingsPatch(overrides),
        cases: args.cases.clone(),
        priority: 0,
    };
    let mut calibration = client.create_calibration(&new).await?;
    if !args.detach {
        follow::to_end(client, &calibration.id).await?;
        calibration = client.calibration(&calibration.id).await?;
    }
    if global.json {
        output::print_json(&calibration)?
    } else {
        print(&calibration)?
    }
    if calibration.state == RunState::Cancelled {
        return Err(CliError::no(format!("calibration {} was cancelled", calibration.id)));
    }
    Ok(())
}

fn print(calibration: &Calibration) -> Result<()> {
    let mut table = output::Table::new(&["case", "device class", "runs", "times", "noise floor", "pictures"]);
    for case in &calibration.cases {
        let range = case.medians_s.iter().copied().fold(None, |range: Option<(f64, f64)>, s| {
            Some(range.map_or((s, s), |(least, most)| (least.min(s), most.max(s))))
        });
        table.row([
            case.case.clone(),
            case.device_class.clone().unwrap_or_default(),
            case.medians_s.len().to_string(),
            range.map(|(least, most)| format!("{} to {}", seconds(least), seconds(most))).unwrap_or_default(),
            case.noise_floor.map(|floor| format!("{:.1} %", 100.0 * floor)).unwrap_or_default(),
            match case.steady {
                Some(true) => "all the same",
                Some(false) => "not all the same",
                None => "",
            }
            .to_owned(),
        ]);
    }
    table.print()?;
    let head = format!("calibration {} at {}: {}", calibration.id, calibration.label, calibration.state.as_str());
    output::print(&format!("\n{}\n", output::printable(&head)))
}
