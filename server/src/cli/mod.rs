//! The command line: one file per subcommand.
//!
//! Exit codes: 0 good, 1 the answer is no (a failed job, a comparison over its limit), 2 wrong usage or input, 3 service
//! or system failure. With `--json` a command prints one JSON value on standard output; messages go to standard error.

mod bench;
mod compare;
mod completions;
mod devices;
mod error;
mod farm;
mod job;
mod logging;
mod openapi;
mod output;
mod progress;
mod render;
mod scene;
mod serve;
mod settings;
mod supervisor;
mod worker;
mod workers;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use lightshaft_api::client::Client;

use error::{CliError, Result};
use logging::LogFormat;

/// Renders glTF scenes: as a service with a queue of jobs, as a worker of one, or right here.
#[derive(Debug, Parser)]
#[command(name = "lightshaft", version, max_term_width = 100)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Args)]
struct Global {
    /// Print one JSON value on standard output.
    #[arg(long, global = true)]
    json: bool,
    /// Address of the service.
    #[arg(long, global = true, env = "LIGHTSHAFT_SERVER", default_value = "http://127.0.0.1:8080", value_name = "URL")]
    server: String,
    /// Form of log lines on standard error. LIGHTSHAFT_LOG sets what is logged, such as `info` or `lightshaft_worker=debug`.
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the service, with workers of its own.
    Serve(serve::Args),
    /// Run a worker for a service.
    Worker(worker::Args),
    /// Upload, generate and inspect scenes.
    #[command(subcommand)]
    Scene(scene::Command),
    /// Submit, follow and fetch jobs.
    #[command(subcommand)]
    Job(job::Command),
    /// Run suites of cases against what was accepted, and decide of what changed.
    #[command(subcommand)]
    Farm(farm::Command),
    /// List and drain the workers of a service.
    #[command(subcommand)]
    Workers(workers::Command),
    /// Render a scene file here, without a service.
    Render(Box<render::Args>),
    /// Time spatial structures against each other, without a service: tables of the papers, or one's own.
    Bench(Box<bench::Args>),
    /// Compare two pictures.
    Compare(compare::Args),
    /// List the devices of this machine.
    Devices,
    /// Print shell completions.
    Completions(completions::Args),
    /// Print the OpenAPI document of the service.
    Openapi,
}

pub(crate) fn main() -> ExitCode {
    let cli = Cli::parse();
    let is_daemon = matches!(cli.command, Command::Serve(_) | Command::Worker(_));
    let logging = logging::init(cli.global.log_format, if is_daemon { "info" } else { "warn" });
    match logging.and_then(|()| run(cli)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            error.print();
            ExitCode::from(error.code())
        }
    }
}

fn run(cli: Cli) -> Result<()> {
    let global = &cli.global;
    match cli.command {
        Command::Serve(args) => block_on(serve::run(args, global)),
        Command::Worker(args) => block_on(worker::run(args, global)),
        Command::Scene(command) => scene::run(command, global),
        Command::Job(command) => block_on(job::run(command, global)),
        Command::Farm(command) => farm::run(command, global),
        Command::Workers(command) => block_on(workers::run(command, global)),
        Command::Render(args) => render::run(&args, global),
        Command::Bench(args) => bench::run(&args, global),
        Command::Compare(args) => compare::run(&args, global),
        Command::Devices => devices::run(global),
        Command::Completions(args) => completions::run(&args),
        Command::Openapi => openapi::run(),
    }
}

impl Global {
    fn client(&self) -> Result<Client> {
        Ok(Client::new(&self.server)?)
    }
}

fn block_on<T>(future: impl Future<Output = Result<T>>) -> Result<T> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| CliError::system(format!("the runtime did not start: {error}")))?
        .block_on(future)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_of_the_command_line_is_sound() {
        Cli::command().debug_assert();
    }

    #[test]
    fn global_options_stand_before_and_after_the_subcommand() {
        for line in ["lightshaft --json devices", "lightshaft devices --json"] {
            assert!(Cli::try_parse_from(line.split(' ')).unwrap().global.json, "{line}");
        }
    }

    #[test]
    fn wrong_usage_is_an_error_of_clap() {
        for line in [
            "lightshaft",
            "lightshaft render",
            "lightshaft render a.glb",
            "lightshaft bench",
            "lightshaft job submit",
            "lightshaft job list --limit 0",
            "lightshaft scene list --limit 0",
            "lightshaft farm run suite.toml",
            "lightshaft farm run suite.toml --label x --wait --detach",
            "lightshaft farm approve r --who Ada",
            "lightshaft farm bisect --good a --by picture",
            "lightshaft no",
        ] {
            assert!(Cli::try_parse_from(line.split(' ')).is_err(), "{line}");
        }
    }

    #[test]
    fn the_commands_of_the_contract_parse() {
        for line in [
            "lightshaft serve --listen 127.0.0.1:0 --data d --workers 1 --insecure-local",
            "lightshaft worker --server http://127.0.0.1:1 --device cpu --cache c",
            "lightshaft render a.glb -o a.png --width 64 --height 48 --spp 16 --seed 1 --integrator path --max-bounces 4 \
             --device auto --acceleration {} --camera 0 --environment 1 --metrics m.json",
            "lightshaft compare a.png b.png --json --heat-map h.png --max-rmse 0.1 --max-flip 0.1",
            "lightshaft bench keul-4.1 --scenes d --device cpu --repeat 5 --json out.json",
            "lightshaft bench own.json --scene a.glb --csv o.csv --markdown o.md --heat-maps d",
            "lightshaft bench --list --json",
            "lightshaft scene upload a.glb",
            "lightshaft scene list",
            "lightshaft scene show s",
            "lightshaft scene generate demo -o demo.glb",
            "lightshaft scene generate pile --seed 3 --count 10",
            "lightshaft scene validate a.glb",
            "lightshaft scene delete s",
            "lightshaft job submit s --setting width=64 --wait --output out",
            "lightshaft job submit --a j/image.png --b k --setting max_flip=0.1 --wait",
            "lightshaft job watch j",
            "lightshaft job list --state running",
            "lightshaft job show j",
            "lightshaft job cancel j",
            "lightshaft job retry j",
            "lightshaft job delete j",
            "lightshaft job priority j -5",
            "lightshaft job pause j",
            "lightshaft job resume j",
            "lightshaft job download j -o out",
            "lightshaft job log j",
            "lightshaft farm run suite.toml --label 3f2a91c --baseline main --wait --set spp=4 --tag driver=560",
            "lightshaft farm run suite.toml --label x --detach --case a --scene s=id --junit j.xml --html r.html --markdown r.md",
            "lightshaft farm status",
            "lightshaft farm status r",
            "lightshaft farm report r --html r.html",
            "lightshaft farm approve r a b --who Ada --why better",
            "lightshaft farm reject r --all --who Ada",
            "lightshaft farm reset s c --who Ada --why machine",
            "lightshaft farm history s c",
            "lightshaft farm calibrate suite.toml --label x --times 5",
            "lightshaft farm bisect --good a --bad b --by picture --max-flip 0.01 -- ./render.sh",
            "lightshaft farm bisect --good a --by time --max-ratio 1.2 --prepare make -- ./render.sh --fast",
            "lightshaft workers list",
            "lightshaft workers show w",
            "lightshaft workers drain w",
            "lightshaft workers undrain w",
            "lightshaft workers forget w",
            "lightshaft devices --json",
            "lightshaft completions bash",
            "lightshaft openapi",
        ] {
            let words = line.split_whitespace();
            assert!(Cli::try_parse_from(words).is_ok(), "{line}");
        }
    }
}
