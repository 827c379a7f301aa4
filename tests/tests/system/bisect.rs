//! `lightshaft farm bisect` on repositories of a few commits.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use lightshaft_tests::binary;
use serde_json::Value;
use tempfile::TempDir;

/// A repository in which each commit has another content of one file, `setting`.
struct Repository {
    folder: TempDir,
    commits: Vec<String>,
}

impl Repository {
    fn new(settings: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut repository = Self { folder, commits: Vec::new() };
        repository.git(&["init", "--quiet"]);
        for (i, setting) in settings.iter().enumerate() {
            std::fs::write(repository.path().join("setting"), setting).unwrap();
            repository.git(&["add", "."]);
            repository.git(&["commit", "--quiet", "--allow-empty", "-m", &format!("change {i}")]);
            let id = repository.git(&["rev-parse", "HEAD"]);
            repository.commits.push(id.trim().to_owned());
        }
        repository
    }

    fn path(&self) -> PathBuf {
        self.folder.path().to_owned()
    }

    fn git(&self, args: &[&str]) -> String {
        let identity = ["-c", "user.name=t", "-c", "user.email=t@example.org", "-c", "commit.gpgsign=false"];
        let output = Command::new("git").arg("-C").arg(self.folder.path()).args(identity).args(args).output().unwrap();
        assert!(output.status.success(), "git {args:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// Bisects from the first commit to the last with a command for sh.
    fn bisect(&self, options: &[&str], script: &str) -> Output {
        let folder = self.path();
        let args = ["--json", "farm", "bisect", "--repository", folder.to_str().unwrap(), "--good", &self.commits[0]];
        let command = ["--", "sh", "-c", script];
        binary::run(&[&args[..], options, &command[..]].concat())
    }

    /// Whether only the user's own work tree is left.
    fn is_tidy(&self) -> bool {
        self.git(&["worktree", "list"]).lines().count() == 1 && self.git(&["status", "--porcelain"]).is_empty()
    }
}

fn found(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)))
}

fn scene(folder: &Path) -> String {
    let path = folder.join("box.glb").to_str().unwrap().to_owned();
    binary::run_ok(&["scene", "generate", "cornell-box", "-o", &path]);
    path
}

fn render(scene: &str) -> String {
    let lightshaft = binary::lightshaft().display();
    format!(
        "'{lightshaft}' render '{scene}' -o \"$LIGHTSHAFT_PICTURE\" --width 32 --height 32 --spp 1 --device cpu \
         --exposure \"$(cat setting)\""
    )
}

#[test]
fn the_commit_that_changed_the_picture_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let repository = Repository::new(&["0", "0.0", "-0.001", "0", "1.5", "1.6", "1.4"]);
    let script = render(&scene(folder.path()));
    let output = repository.bisect(&["--by", "picture", "--max-flip", "0.02"], &script);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let found = found(&output);
    assert_eq!(found["first_bad"]["commit"], repository.commits[4], "{found:#}");
    assert_eq!(found["first_bad"]["subject"], "change 4");
    assert!(found["first_bad"]["flip_mean"].as_f64().unwrap() > 0.02);
    let trials = found["trials"].as_array().unwrap();
    assert!(trials.len() <= 4, "a bisection asks of few: {trials:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("is the first bad commit"));
    assert!(repository.is_tidy());
}

#[test]
fn without_limits_no_pixel_may_differ_and_commits_may_be_passed_by() {
    let folder = tempfile::tempdir().unwrap();
    let repository = Repository::new(&["0", "0.0", "broken", "broken", "0.5", "0.5"]);
    let script = format!("grep -q broken setting && exit 125; {}", render(&scene(folder.path())));
    let output = repository.bisect(&["--by", "picture"], &script);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let found = found(&output);
    assert_eq!(found["first_bad"]["commit"], repository.commits[4], "{found:#}");
    assert_eq!(found["suspects"], serde_json::json!([repository.commits[2], repository.commits[3]]));
    let alike = Repository::new(&["0", "0.0", "0"]);
    let output = alike.bisect(&["--by", "picture"], &render(&scene(folder.path())));
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(self::found(&output)["first_bad"].is_null());
}

/// Seconds that scatter by a few percent from round to round, but the same for everybody; some commits take longer.
const NOISY: &str = "n=$(cat \"$0\" 2>/dev/null || echo 0); echo $((n + 1)) >\"$0\"; \
                     awk -v base=\"$(cat setting)\" -v n=\"$n\" 'BEGIN { print base * (1 + (n * 7 % 11) / 200) }' >\"$LIGHTSHAFT_SECONDS\"";

#[test]
fn the_commit_that_made_it_slower_is_found_through_noise() {
    let folder = tempfile::tempdir().unwrap();
    let counter = folder.path().join("rounds").display().to_string();
    let script = NOISY.replace("$0", &counter);
    let repository = Repository::new(&["1.00", "1.01", "1.00", "1.02", "1.01", "1.40", "1.41", "1.40"]);
    let output = repository.bisect(&["--by", "time", "--max-ratio", "1.15", "--prepare", "test -f setting"], &script);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let found = found(&output);
    assert_eq!(found["first_bad"]["commit"], repository.commits[5], "{found:#}");
    assert!(found["first_bad"]["ratio"]["low"].as_f64().unwrap() > 1.15);
    let same = Repository::new(&["1.00", "1.01", "1.02"]);
    let output = same.bisect(&["--by", "time"], &script);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn what_cannot_be_bisected_is_told() {
    let repository = Repository::new(&["1", "2"]);
    let told = |output: Output, code: i32, words: &str| {
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{stderr}");
        assert!(stderr.contains(words), "{words}: {stderr}");
    };
    told(repository.bisect(&["--by", "picture"], "true"), 2, "wrote no picture");
    told(repository.bisect(&["--by", "time"], "exit 3"), 3, "failed at");
    told(repository.bisect(&["--by", "time"], "echo soon >\"$LIGHTSHAFT_SECONDS\""), 2, "no number of seconds");
    told(repository.bisect(&["--by", "time", "--bad", "no-such"], "true"), 2, "is no commit of");
    let first = repository.commits[0].clone();
    told(repository.bisect(&["--by", "time", "--bad", &first], "true"), 2, "no commit between");
    assert!(repository.is_tidy());
}
