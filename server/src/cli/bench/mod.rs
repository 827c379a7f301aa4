//! `lightshaft bench PRESET|FILE.json`: benchmarks without a service.

mod scenes;

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use lightshaft_api::benchmark::BenchmarkResults;
use lightshaft_api::read;
use lightshaft_api::settings::{BenchmarkPreset, BenchmarkSettings, DeviceChoice};
use lightshaft_engine::scene::Limits;
use lightshaft_worker::benchmark::{BenchmarkOutputs, load, report};
use lightshaft_worker::cache::StructureCache;
use lightshaft_worker::executor::{self, Budgets, Devices, Executor, Observer, TaskError};
use serde_json::{Map, Value, json};

use super::error::{CliError, Result};
use super::progress::Progress;
use super::{Global, output};
use scenes::{LocalScenes, SceneArgs};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A table of Keul's work, see --list; or a JSON file of benchmark settings as the API takes them.
    #[arg(value_name = "PRESET|FILE.json", required_unless_present = "list")]
    benchmark: Option<String>,
    /// With --json: write the results there, and the tables to standard output.
    #[arg(value_name = "OUT.json")]
    json_file: Option<String>,
    /// List the presets.
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    scenes: SceneArgs,
    /// auto, cpu or gpu.
    #[arg(long)]
    device: Option<String>,
    /// Part of the GPU's name.
    #[arg(long)]
    adapter: Option<String>,
    /// Rounds in which each configuration is timed once.
    #[arg(long, value_name = "N")]
    repeat: Option<u32>,
    /// Pixels.
    #[arg(long)]
    width: Option<u32>,
    /// Pixels.
    #[arg(long)]
    height: Option<u32>,
    /// Samples per pixel of a timed frame.
    #[arg(long)]
    spp: Option<u32>,
    /// Samples per pixel of the pictures that are compared.
    #[arg(long)]
    picture_spp: Option<u32>,
    #[arg(long)]
    seed: Option<u32>,
    /// Seconds that one time lasts at least.
    #[arg(long, value_name = "SECONDS")]
    min_sample_s: Option<f64>,
    /// Write every figure as CSV.
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    /// Write the tables as Markdown.
    #[arg(long, value_name = "OUT.md")]
    markdown: Option<PathBuf>,
    /// Write pictures and their FLIP heat maps into a folder.
    #[arg(long, value_name = "DIR")]
    heat_maps: Option<PathBuf>,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<()> {
    if args.list {
        return list(global);
    }
    let (benchmark, json_file) = args.names(global)?;
    let settings = args.settings(&benchmark)?;
    let scenes = args.scenes.find(settings.preset)?;
    let executor = Executor::new(
        StructureCache::new(0, None),
        Devices::new(DeviceChoice::Auto),
        Budgets { scenes_bytes: 0 },
        Limits { input_bytes: u64::MAX, ..Limits::default() },
    );
    let outputs = measure(&executor, &settings, &scenes)?;
    args.write(&outputs)?;
    if let Some(path) = &json_file {
        let text = serde_json::to_vec_pretty(&outputs.results)
            .map_err(|error| CliError::system(format!("the results could not be written as JSON: {error}")))?;
        write_file(path, &text)?;
    }
    if global.json && json_file.is_none() {
        output::print_json(&outputs.results)
    } else {
        print_tables(&outputs.results)
    }
}

fn measure(executor: &Executor, settings: &BenchmarkSettings, scenes: &LocalScenes) -> Result<BenchmarkOutputs> {
    let watcher = Watcher { progress: Progress::new(), at: Mutex::new(String::new()) };
    executor.benchmark(settings, scenes, &watcher, &AtomicBool::new(false)).map_err(|error| {
        let message = output::printable(&error.to_string());
        match error {
            TaskError::Failed { fatal: true, .. } => CliError::usage(message),
            TaskError::Failed { .. } | TaskError::Stopped => CliError::system(message),
        }
    })
}

impl Args {
    /// What to measure, and where `--json` goes. `--json OUT` may stand before the benchmark's name as well as behind it.
    fn names(&self, global: &Global) -> Result<(String, Option<PathBuf>)> {
        let first = self.benchmark.clone().unwrap_or_default();
        let Some(second) = self.json_file.clone() else { return Ok((first, None)) };
        if !global.json {
            return Err(CliError::usage(format!("{second}: one benchmark at a time; the second name is for --json")));
        }
        let is_benchmark = |name: &str| BenchmarkPreset::from_name(name).is_some() || Path::new(name).is_file();
        let swapped = BenchmarkPreset::from_name(&second).is_some() || (!is_benchmark(&first) && is_benchmark(&second));
        Ok(if swapped { (second, Some(first.into())) } else { (first, Some(second.into())) })
    }

    fn settings(&self, benchmark: &str) -> Result<BenchmarkSettings> {
        let mut json = match BenchmarkPreset::from_name(benchmark) {
            Some(preset) => Map::from_iter([("preset".to_owned(), json!(preset))]),
            None => read_file(Path::new(benchmark))?,
        };
        let mut put = |key: &str, value: Option<Value>| {
            if let Some(value) = value {
                json.insert(key.to_owned(), value);
            }
        };
        put("device", self.device.clone().map(Value::from));
        put("adapter", self.adapter.clone().map(Value::from));
        put("repetitions", self.repeat.map(Value::from));
        put("width", self.width.map(Value::from));
        put("height", self.height.map(Value::from));
        put("spp", self.spp.map(Value::from));
        put("picture_spp", self.picture_spp.map(Value::from));
        put("seed", self.seed.map(Value::from));
        put("min_sample_s", self.min_sample_s.map(Value::from));
        let settings: BenchmarkSettings =
            read::from_value(Value::Object(json)).map_err(|errors| CliError::fields(&errors, "/"))?;
        let errors = settings.validate("");
        if !errors.is_empty() {
            return Err(CliError::fields(&errors, "/"));
        }
        if !settings.scenes.is_empty() {
            return Err(CliError::usage("scenes: ids are of a service; here scenes are files, given by --scene"));
        }
        Ok(settings)
    }

    fn write(&self, outputs: &BenchmarkOutputs) -> Result<()> {
        if let Some(path) = &self.csv {
            write_file(path, report::csv(&outputs.results).as_bytes())?;
        }
        if let Some(path) = &self.markdown {
            write_file(path, report::markdown(&outputs.results).as_bytes())?;
        }
        if let Some(folder) = &self.heat_maps {
            std::fs::create_dir_all(folder)
                .map_err(|error| CliError::usage(format!("--heat-maps {}: {error}", folder.display())))?;
            for artifact in outputs.artifacts.iter().filter(|artifact| artifact.media_type == "image/png") {
                write_file(&folder.join(&*artifact.name), &artifact.bytes)?;
            }
        }
        Ok(())
    }
}

fn read_file(path: &Path) -> Result<Map<String, Value>> {
    let shown = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| {
        let presets: Vec<&str> = BenchmarkPreset::ALL.iter().map(|preset| preset.as_str()).collect();
        CliError::usage(format!("{shown}: no preset ({}), and no file: {error}", presets.join(", ")))
    })?;
    serde_json::from_str(&text)
        .map_err(|error| CliError::usage(format!("{shown}: not a JSON object of benchmark settings: {error}")))
}

fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).map_err(|error| CliError::usage(format!("{}: {error}", path.display())))
}

fn list(global: &Global) -> Result<()> {
    let mut table = output::Table::new(&["preset", "contents", "scenes"]);
    let mut all = Vec::new();
    for preset in BenchmarkPreset::ALL {
        let contents = load(preset).map_err(CliError::system)?;
        let scenes: Vec<&str> = contents.scenes.iter().map(|scene| scene.name.as_str()).collect();
        all.push(json!({ "preset": preset, "title": contents.title, "source": contents.source, "scenes": scenes }));
        table.row([preset.as_str().to_owned(), contents.title.clone(), scenes.join(", ")]);
    }
    if global.json { output::print_json(&all) } else { table.print() }
}

fn print_tables(results: &BenchmarkResults) -> Result<()> {
    output::print(&format!("{}\n", output::printable(&results.title)))?;
    for line in report::preamble(results) {
        output::print(&format!("{}\n", output::printable(&line)))?;
    }
    for table in report::tables(results) {
        output::print(&format!("\n{}\n", output::printable(&table.title)))?;
        for note in &table.notes {
            output::print(&format!("  {}\n", output::printable(note)))?;
        }
        let mut rows = output::Table::new(&table.headings);
        table.rows.into_iter().for_each(|row| rows.row(row));
        rows.print()?;
    }
    Ok(())
}

/// Shows how far it is.
struct Watcher {
    progress: Progress,
    /// Scene and comparison.
    at: Mutex<String>,
}

impl Observer for Watcher {
    fn progress(&self, progress: executor::Progress) {
        let at = self.at.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone();
        self.progress.set(progress.fraction, format!("{at} ({})", progress.phase.as_str()));
    }

    fn log(&self, line: String) {
        if line.starts_with("warning: ") {
            self.progress.say(&output::printable(&line));
        } else {
            *self.at.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = output::printable(&line);
        }
    }

    fn wants_preview(&self) -> bool {
        false
    }

    fn preview(&self, _png: Vec<u8>) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
        #[arg(long)]
        json: bool,
    }

    fn line(text: &str) -> (Args, Global) {
        let line = Line::try_parse_from(format!("x {text}").split_whitespace()).unwrap();
        let log_format = super::super::logging::LogFormat::Text;
        (line.args, Global { json: line.json, server: String::new(), log_format })
    }

    #[test]
    fn the_file_of_json_stands_before_or_behind_the_preset() {
        let names = |text: &str| {
            let (args, global) = line(text);
            args.names(&global)
        };
        let expected = ("keul-4.1".to_owned(), Some(PathBuf::from("out.json")));
        assert_eq!(names("keul-4.1 --json out.json").unwrap(), expected);
        assert_eq!(names("--json out.json keul-4.1").unwrap(), expected);
        assert_eq!(names("keul-4.1 --json").unwrap(), ("keul-4.1".to_owned(), None));
        assert_eq!(names("keul-4.1 out.json").unwrap_err().code(), 2);
    }

    #[test]
    fn options_reach_the_settings_and_mistakes_are_named() {
        let settings = |text: &str| {
            let (args, _) = line(text);
            args.settings(args.benchmark.as_ref().unwrap())
        };
        let s = settings("keul-5.1 --repeat 5 --device cpu --width 64 --min-sample-s 0.02").unwrap();
        assert_eq!((s.preset, s.repetitions, s.width), (Some(BenchmarkPreset::Keul51), 5, Some(64)));
        let error = |text: &str| format!("{:?}", settings(text).unwrap_err());
        assert!(error("keul-5.1 --repeat 1").contains("repetitions: must be 3 to 1000"));
        assert!(error("keul-5.1 --device tpu").contains("unknown variant `tpu`"));
        assert!(error("keul-9.9").contains("no preset (keul-4.1, "));
    }
}
