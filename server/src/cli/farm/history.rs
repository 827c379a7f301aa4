//! `lightshaft farm history`

use lightshaft_api::client::{Client, HistoryQuery};
use lightshaft_api::farm::History;

use super::words::seconds;
use super::{Global, Result, output};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Name of the suite.
    suite: String,
    /// Name of the case.
    case: String,
    /// Whose times and pictures; those of the newest run when left out.
    #[arg(long)]
    device_class: Option<String>,
    #[arg(long)]
    baseline: Option<String>,
}

pub(super) async fn run(args: &Args, client: &Client, global: &Global) -> Result<()> {
    let wanted = HistoryQuery {
        suite: args.suite.clone(),
        case: args.case.clone(),
        device_class: args.device_class.clone(),
        baseline: args.baseline.clone(),
    };
    let history = client.history(&wanted).await?;
    if global.json { output::print_json(&history) } else { print(&history) }
}

fn print(history: &History) -> Result<()> {
    let mut table = output::Table::new(&["at", "label", "picture", "time", "median", "quartiles", ""]);
    for (i, point) in history.points.iter().enumerate() {
        let quartiles = match (point.lower_quartile_s, point.upper_quartile_s) {
            (Some(lower), Some(upper)) => format!("{} to {}", seconds(lower), seconds(upper)),
            _ => String::new(),
        };
        let is_change = history.change_points.iter().any(|&change| change as usize == i);
        table.row([
            format!("{:.0}", point.at),
            point.label.clone(),
            point.image.as_str().replace('_', " "),
            point.time.map(|time| time.as_str().replace('_', " ")).unwrap_or_default(),
            point.median_s.map(seconds).unwrap_or_default(),
            quartiles,
            if is_change { "another level from here on" } else { "" }.to_owned(),
        ]);
    }
    table.print()?;
    let noise = history.noise_floor.map_or_else(
        || "no noise floor yet: lightshaft farm calibrate".to_owned(),
        |floor| format!("noise floor {:.1} %", 100.0 * floor),
    );
    let pictures = history.pictures.len();
    let text = format!("{} on {}: {pictures} accepted pictures, {noise}", history.case, history.device_class);
    output::print(&format!("\n{}\n", output::printable(&text)))
}
