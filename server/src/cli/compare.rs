//! `lightshaft compare A B`

use std::path::{Path, PathBuf};

use lightshaft_compare::{Comparison, Image, Options, compare, heat_map};
use serde_json::{Value, json};

use super::error::{CliError, Result};
use super::{Global, output, picture};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The reference: PNG, JPEG, OpenEXR or Radiance .hdr.
    a: PathBuf,
    /// The picture to judge, of the same size.
    b: PathBuf,
    /// Write the FLIP error of every pixel as a picture.
    #[arg(long, value_name = "OUT.png")]
    heat_map: Option<PathBuf>,
    /// Exit with 1 when the root mean square error of linear colour is above this.
    #[arg(long)]
    max_rmse: Option<f64>,
    /// Exit with 1 when the mean FLIP error is above this.
    #[arg(long)]
    max_flip: Option<f64>,
    /// Stops by which both are brightened before FLIP and SSIM.
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    exposure: f32,
    /// Linear difference of a channel up to which a pixel counts as equal.
    #[arg(long, default_value_t = 0.0)]
    tolerance: f32,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<()> {
    let options = Options { exposure: args.exposure, tolerance: args.tolerance, ..Options::default() };
    let (a, b) = (load(&args.a)?, load(&args.b)?);
    let comparison = compare(&a, &b, &options).map_err(|error| CliError::usage(error.to_string()))?;
    if let Some(path) = &args.heat_map {
        write_heat_map(path, &comparison)?;
    }
    let over = args.over_limits(&comparison);
    if global.json {
        let mut value = json!(comparison.report);
        if let Value::Object(fields) = &mut value {
            fields.insert("within_limits".into(), over.is_empty().into());
        }
        output::print_json(&value)?;
    } else {
        print_report(&comparison)?;
    }
    if over.is_empty() { Ok(()) } else { Err(CliError::no(over.join("; "))) }
}

impl Args {
    /// Limits that the comparison is over, in words. A figure that is not a number is over every limit.
    fn over_limits(&self, comparison: &Comparison) -> Vec<String> {
        let report = &comparison.report;
        let limits = [("RMSE", report.differences.rmse, self.max_rmse), ("mean FLIP", report.flip_mean, self.max_flip)];
        let is_over = |found: f64, limit: f64| found.is_nan() || found > limit;
        limits
            .into_iter()
            .filter_map(|(name, found, limit)| Some((name, found, limit?)))
            .filter(|&(_, found, limit)| is_over(found, limit))
            .map(|(name, found, limit)| format!("{name} is {found:.6}, over the limit of {limit}"))
            .collect()
    }
}

fn load(path: &Path) -> Result<Image> {
    let named = |error: String| CliError::usage(format!("{}: {error}", path.display()));
    let bytes = std::fs::read(path).map_err(|error| named(error.to_string()))?;
    let picture = picture::read(&bytes).map_err(named)?;
    Image::new(picture.width as usize, picture.height as usize, picture.rgb).map_err(|error| named(error.to_string()))
}

fn write_heat_map(path: &Path, comparison: &Comparison) -> Result<()> {
    let (width, height) = (comparison.flip.width() as u32, comparison.flip.height() as u32);
    let failed = |error: String| CliError::usage(format!("--heat-map {}: {error}", path.display()));
    let map = image::RgbImage::from_raw(width, height, heat_map(&comparison.flip))
        .ok_or_else(|| failed("the map has another size than the pictures".into()))?;
    map.save_with_format(path, image::ImageFormat::Png).map_err(|error| failed(error.to_string()))
}

fn print_report(comparison: &Comparison) -> Result<()> {
    let Value::Object(fields) = json!(comparison.report) else { return Ok(()) };
    let mut table = output::Table::new(&["figure", "value"]);
    for (name, value) in fields {
        let text = match value.as_f64().filter(|_| value.is_f64()) {
            Some(number) => format!("{number:.6}"),
            None => value.to_string(),
        };
        table.row([name, text]);
    }
    table.print()
}
