//! `lightshaft job download`

use std::path::{Path, PathBuf};

use lightshaft_api::client::Client;
use lightshaft_api::job::Job;

use super::Global;
use crate::cli::error::{CliError, Result};
use crate::cli::output;

pub(crate) async fn run(id: &str, folder: &Path, names: &[String], client: &Client, global: &Global) -> Result<()> {
    let job = client.job(id).await?;
    let written = artifacts(client, &job, folder, names).await?;
    if global.json {
        return output::print_json(&written);
    }
    let lines: String = written.iter().map(|path| format!("{}\n", path.display())).collect();
    output::print(&lines)
}

/// Writes the named artifacts, or all, and answers the paths.
pub(super) async fn artifacts(client: &Client, job: &Job, folder: &Path, names: &[String]) -> Result<Vec<PathBuf>> {
    for name in names {
        if !job.artifacts.iter().any(|artifact| artifact.name == *name) {
            let there: Vec<&str> = job.artifacts.iter().map(|artifact| artifact.name.as_str()).collect();
            return Err(CliError::usage(format!("the job has no artifact `{name}`; it has: {}", there.join(", "))));
        }
    }
    let folder_error = |error| CliError::usage(format!("{}: {error}", folder.display()));
    std::fs::create_dir_all(folder).map_err(folder_error)?;
    let mut written = Vec::new();
    for artifact in &job.artifacts {
        if !names.is_empty() && !names.contains(&artifact.name) {
            continue;
        }
        // The service's names have no separators; whatever it is that answers, nothing is written outside the folder.
        let Some(file) = Path::new(&artifact.name).file_name().filter(|file| *file == artifact.name.as_str()) else {
            return Err(CliError::system(format!("the artifact name `{}` is no file name", artifact.name)));
        };
        let path = folder.join(file);
        client.download_artifact(&job.summary.id, &artifact.name, &path).await?;
        written.push(path);
    }
    Ok(written)
}
