//! `lightshaft farm report`: a run as JUnit XML for a CI, Markdown for a pull request, HTML for people, JSON for scripts.

mod html;
mod junit;
mod markdown;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use lightshaft_api::client::Client;
use lightshaft_api::farm::Run;

use super::{CliError, Global, Result, find_run, output, status, verdict};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A run's id, or its label for the newest run at it. Exit code 1 when it has finished and is not well.
    run: String,
    #[command(flatten)]
    files: Files,
}

/// Reports that are written to files.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Reports")]
pub(super) struct Files {
    /// Write JUnit XML.
    #[arg(long, value_name = "OUT.xml")]
    junit: Option<PathBuf>,
    /// Write Markdown, for a pull request.
    #[arg(long, value_name = "OUT.md")]
    markdown: Option<PathBuf>,
    /// Write one HTML file with all pictures inside.
    #[arg(long, value_name = "OUT.html")]
    html: Option<PathBuf>,
    /// Write JSON.
    #[arg(long, value_name = "OUT.json")]
    json_file: Option<PathBuf>,
}

/// Without a file: Markdown on standard output, or JSON with `--json`.
pub(super) async fn run(args: &Args, client: &Client, global: &Global) -> Result<()> {
    let run = find_run(client, &args.run).await?;
    args.files.write(&run, client).await?;
    if global.json {
        output::print_json(&run)?;
    } else if args.files.is_empty() {
        output::print(&markdown::report(&run, &status::page(client, &run.summary.id)))?;
    }
    verdict(&run)
}

impl Files {
    fn is_empty(&self) -> bool {
        [&self.junit, &self.markdown, &self.html, &self.json_file].iter().all(|file| file.is_none())
    }

    pub(super) async fn write(&self, run: &Run, client: &Client) -> Result<()> {
        let page = status::page(client, &run.summary.id);
        if let Some(path) = &self.junit {
            put("--junit", path, &junit::report(run, &page))?;
        }
        if let Some(path) = &self.markdown {
            put("--markdown", path, &markdown::report(run, &page))?;
        }
        if let Some(path) = &self.html {
            let pictures = html::pictures(run, client).await?;
            put("--html", path, &html::report(run, &pictures, &page)?)?;
        }
        if let Some(path) = &self.json_file {
            let text = serde_json::to_string_pretty(run)
                .map_err(|error| CliError::system(format!("the run could not be written as JSON: {error}")))?;
            put("--json-file", path, &format!("{text}\n"))?;
        }
        Ok(())
    }
}

fn put(option: &str, path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).map_err(|error| CliError::usage(format!("{option} {}: {error}", path.display())))
}
