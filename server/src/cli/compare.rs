//! `lightshaft compare A B`

use std::path::{Path, PathBuf};

use lightshaft_api::compare::CompareReport;
use lightshaft_compare::Options;
use lightshaft_engine::film::COLOR;
use lightshaft_worker::picture::compare::{Bounds, Pixels, heat_map_png, layers, report};
use serde_json::{Value, json};

use super::error::{CliError, Result};
use super::{Global, output};

/// Pixels of the largest picture that is read: 16384 x 16384.
const MAX_PIXELS: u64 = 1 << 28;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The reference: PNG, JPEG, OpenEXR or Radiance .hdr.
    a: PathBuf,
    /// The picture to judge, of the same size.
    b: PathBuf,
    /// Which layer of OpenEXR files: `depth`, `shading_normal`, `instance_id` and so on.
    #[arg(long, default_value = COLOR)]
    layer: String,
    /// Write the FLIP error of every pixel as a picture (magma: 0 is black, 1 pale yellow), with a scale bar to its right.
    #[arg(long, value_name = "OUT.png")]
    heat_map: Option<PathBuf>,
    /// Exit with 1 when the root mean square error is above this; of linear colour, or in the layer's units.
    #[arg(long)]
    max_rmse: Option<f64>,
    /// Exit with 1 when the mean FLIP error is above this.
    #[arg(long)]
    max_flip: Option<f64>,
    /// Compare by HDR-FLIP too, and draw that: the error at the exposure that shows it best. Of linear colour only.
    #[arg(long)]
    hdr: bool,
    /// Exit with 1 when the mean HDR-FLIP error is above this; as if `--hdr` were given.
    #[arg(long)]
    max_hdr_flip: Option<f64>,
    /// Stops by which both are brightened before FLIP and SSIM.
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    exposure: f32,
    /// Difference of a channel up to which a pixel counts as equal.
    #[arg(long, default_value_t = 0.0)]
    tolerance: f32,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<()> {
    let options = Options { exposure: args.exposure, tolerance: args.tolerance, ..Options::default() };
    let (a, b) = (load(&args.a, &args.layer)?, load(&args.b, &args.layer)?);
    let hdr = args.hdr || args.max_hdr_flip.is_some();
    let outcome = layers(&a, &b, &options, hdr).map_err(|error| CliError::usage(error.to_string()))?;
    if let Some(path) = &args.heat_map {
        let failed = |error: String| CliError::usage(format!("--heat-map {}: {error}", path.display()));
        let png = heat_map_png(&outcome.error_map).map_err(|error| failed(error.to_string()))?;
        std::fs::write(path, png).map_err(|error| failed(error.to_string()))?;
    }
    let bounds = Bounds { max_rmse: args.max_rmse, max_flip: args.max_flip, max_hdr_flip: args.max_hdr_flip };
    let report = report(&outcome.figures, bounds);
    if global.json {
        output::print_json(&json!(report))?;
    } else {
        print_report(&report)?;
    }
    if report.passed { Ok(()) } else { Err(CliError::no(report.over_limits.join("; "))) }
}

fn load(path: &Path, layer: &str) -> Result<Pixels> {
    let named = |error: String| CliError::usage(format!("{}: {error}", path.display()));
    let bytes = std::fs::read(path).map_err(|error| named(error.to_string()))?;
    Pixels::read(&bytes, layer, MAX_PIXELS).map_err(|error| named(error.to_string()))
}

fn print_report(report: &CompareReport) -> Result<()> {
    let Value::Object(fields) = json!(report) else { return Ok(()) };
    let mut table = output::Table::new(&["figure", "value"]);
    for (name, value) in fields {
        match value {
            Value::Array(_) | Value::Null => {}
            Value::Object(parts) => {
                parts.into_iter().for_each(|(part, value)| table.row([format!("{name}.{part}"), shown(&value)]));
            }
            value => table.row([name, shown(&value)]),
        }
    }
    table.print()
}

fn shown(value: &Value) -> String {
    match value.as_f64().filter(|_| value.is_f64()) {
        Some(number) => format!("{number:.6}"),
        None => value.to_string(),
    }
}
