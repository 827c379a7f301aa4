//! The `lightshaft` binary under test.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// The binary, brought up to date by cargo first (in this test's own profile), so that no test runs a stale one.
pub fn lightshaft() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| {
        let test = std::env::current_exe().expect("a test knows its own path");
        let mut profile_dir = test.parent().expect("a program lies in a folder").to_owned();
        if profile_dir.ends_with("deps") {
            profile_dir.pop();
        }
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut build = Command::new(cargo);
        build.args(["build", "--quiet", "--locked", "--package", "lightshaft-server", "--bin", "lightshaft"]);
        build.current_dir(env!("CARGO_MANIFEST_DIR"));
        if profile_dir.file_name().is_some_and(|name| name == "release") {
            build.arg("--release");
        }
        assert!(build.status().expect("cargo runs").success(), "lightshaft does not build");
        profile_dir.join("lightshaft")
    })
}

/// Runs `lightshaft` with `args` to its end.
pub fn run(args: &[&str]) -> Output {
    Command::new(lightshaft()).args(args).output().expect("lightshaft starts")
}

/// Runs `lightshaft` with `args`, expects exit code 0, and returns its standard output.
///
/// # Panics
/// With both outputs when the exit code is another.
pub fn run_ok(args: &[&str]) -> String {
    let output = run(args);
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "lightshaft {args:?}: {}\n{stdout}\n{stderr}", output.status);
    stdout
}
