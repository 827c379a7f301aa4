//! Commits and work trees, by the `git` that the user has.

use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use crate::cli::error::{CliError, Result};

#[derive(Debug)]
pub(super) struct Repository {
    path: PathBuf,
}

#[derive(Clone, Debug)]
pub(super) struct Commit {
    pub(super) id: String,
    pub(super) subject: String,
}

impl Repository {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let repository = Self { path: path.to_owned() };
        let top = repository.git(&["rev-parse", "--show-toplevel"])?;
        Ok(Self { path: PathBuf::from(top.trim_end()) })
    }

    /// From the good commit to the bad one, along first parents: both are in the list.
    pub(super) fn between(&self, good: &str, bad: &str) -> Result<Vec<Commit>> {
        let good = self.commit(good)?;
        let bad = self.commit(bad)?;
        let log =
            self.git(&["log", "--first-parent", "--reverse", "--format=%H %s", &format!("{}..{}", good.id, bad.id)])?;
        let later = log.lines().filter_map(|line| {
            let (id, subject) = line.split_once(' ').unwrap_or((line, ""));
            (!id.is_empty()).then(|| Commit { id: id.to_owned(), subject: subject.to_owned() })
        });
        let commits: Vec<Commit> = std::iter::once(good).chain(later).collect();
        if commits.len() < 2 {
            return Err(CliError::usage("--bad must come after --good: there is no commit between them"));
        }
        Ok(commits)
    }

    fn commit(&self, name: &str) -> Result<Commit> {
        let id = self.git(&["rev-parse", "--verify", "--quiet", "--end-of-options", &format!("{name}^{{commit}}")]);
        let id = id.map_err(|_| CliError::usage(format!("`{name}` is no commit of {}", self.path.display())))?;
        let subject = self.git(&["log", "-1", "--format=%s", id.trim_end()])?;
        Ok(Commit { id: id.trim_end().to_owned(), subject: subject.trim_end().to_owned() })
    }

    fn git(&self, args: &[&str]) -> Result<String> {
        let output = Command::new("git")
            .arg("-C")
            .arg(&self.path)
            .args(args)
            .output()
            .map_err(|error| CliError::system(format!("git does not start: {error}")))?;
        if !output.status.success() {
            let why = String::from_utf8_lossy(&output.stderr);
            return Err(CliError::usage(format!("{}: {}", self.path.display(), why.trim_end())));
        }
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }

    /// A work tree of its own, which goes with what this returns.
    pub(super) fn work_tree(&self, commit: &Commit) -> Result<WorkTree<'_>> {
        let folder = tempfile::tempdir().map_err(|error| CliError::system(format!("a temporary folder: {error}")))?;
        let path = folder.path().join("tree");
        self.git(&["worktree", "add", "--quiet", "--detach", &path.to_string_lossy(), &commit.id])?;
        Ok(WorkTree { repository: self, folder, path })
    }
}

#[derive(Debug)]
pub(super) struct WorkTree<'a> {
    repository: &'a Repository,
    folder: TempDir,
    pub(super) path: PathBuf,
}

impl WorkTree<'_> {
    /// A file beside the tree, where the commit cannot have one of the same name.
    pub(super) fn beside(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

impl Drop for WorkTree<'_> {
    fn drop(&mut self) {
        // What is left of it is in a temporary folder, and git forgets trees that are gone.
        self.repository.git(&["worktree", "remove", "--force", &self.path.to_string_lossy()]).ok();
    }
}
