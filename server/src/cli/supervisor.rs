//! Worker processes of `serve`: started from the same binary, restarted when they die, and never left behind.
//!
//! A worker's standard input is its leash: the supervisor holds the other end of the pipe and writes nothing. When the
//! pipe closes, because the supervisor closed it or because it died, however it died, the worker gives its task back
//! and leaves.

use std::io;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const POLL_PERIOD: Duration = Duration::from_millis(50);
const RESTART_FIRST: Duration = Duration::from_millis(250);
const RESTART_CAP: Duration = Duration::from_secs(30);

/// A worker that lived for so long starts its back-off afresh.
const HEALTHY_AFTER: Duration = Duration::from_secs(20);

/// How long a worker may take to leave before it is killed.
const LEAVE_PATIENCE: Duration = Duration::from_secs(12);

#[derive(Debug)]
pub(crate) struct Supervisor {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Supervisor {
    /// Starts one process for each list of arguments, and keeps it alive.
    pub(crate) fn start(program: PathBuf, workers: Vec<Vec<String>>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let threads = workers
            .into_iter()
            .map(|arguments| {
                let (program, stop) = (program.clone(), Arc::clone(&stop));
                std::thread::spawn(move || keep_alive(&program, &arguments, &stop))
            })
            .collect();
        Self { stop, threads }
    }

    /// Lets every worker give its task back, and waits until all are gone.
    pub(crate) fn stop(self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            if thread.join().is_err() {
                tracing::error!("a supervisor thread had died");
            }
        }
    }
}

fn keep_alive(program: &PathBuf, arguments: &[String], stop: &AtomicBool) {
    let mut wait = RESTART_FIRST;
    while !stop.load(Ordering::Relaxed) {
        let started = Instant::now();
        match spawn(program, arguments) {
            Ok(child) => {
                tracing::info!(pid = child.id(), "worker started");
                watch(child, stop);
            }
            Err(error) => tracing::error!("the worker could not be started: {error}"),
        }
        if stop.load(Ordering::Relaxed) {
            return;
        }
        if started.elapsed() > HEALTHY_AFTER {
            wait = RESTART_FIRST;
        }
        tracing::warn!(wait_s = wait.as_secs_f64(), "restarting the worker");
        let until = Instant::now() + wait;
        while Instant::now() < until && !stop.load(Ordering::Relaxed) {
            std::thread::sleep(POLL_PERIOD);
        }
        wait = (wait * 2).min(RESTART_CAP);
    }
}

fn spawn(program: &PathBuf, arguments: &[String]) -> io::Result<Child> {
    // Its log goes where ours goes; standard output is ours alone.
    Command::new(program).args(arguments).stdin(Stdio::piped()).stdout(Stdio::null()).spawn()
}

/// Returns when the process has ended.
fn watch(mut child: Child, stop: &AtomicBool) {
    let mut leash = child.stdin.take();
    let mut kill_at: Option<Instant> = None;
    loop {
        match child.try_wait() {
            Ok(Some(status)) => {
                if !stop.load(Ordering::Relaxed) {
                    tracing::warn!(pid = child.id(), %status, "worker ended");
                }
                return;
            }
            Ok(None) => {}
            Err(error) => {
                tracing::error!("the worker cannot be watched: {error}");
                return;
            }
        }
        if stop.load(Ordering::Relaxed) {
            leash = None;
            let kill_at = *kill_at.get_or_insert_with(|| Instant::now() + LEAVE_PATIENCE);
            if Instant::now() >= kill_at {
                tracing::warn!(pid = child.id(), "the worker did not leave; killing it");
                let _ = child.kill();
            }
        }
        std::thread::sleep(POLL_PERIOD);
        // The leash must outlive the loop's turn.
        let _ = &leash;
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    fn lines(path: &std::path::Path) -> Vec<String> {
        std::fs::read_to_string(path).unwrap_or_default().lines().map(str::to_owned).collect()
    }

    fn until(what: impl Fn() -> bool) {
        let start = Instant::now();
        while !what() {
            assert!(start.elapsed() < Duration::from_secs(20), "waited too long");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    #[test]
    fn a_process_that_dies_is_started_again() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("starts");
        let script = format!("echo started >> {}", file.display());
        let supervisor = Supervisor::start("/bin/sh".into(), vec![vec!["-c".into(), script]]);
        until(|| lines(&file).len() >= 3);
        supervisor.stop();
        let count = lines(&file).len();
        std::thread::sleep(Duration::from_millis(600));
        assert_eq!(lines(&file).len(), count, "nothing starts after the stop");
    }

    #[test]
    fn a_stopped_supervisor_closes_the_leash_and_waits() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("log");
        let script = format!("echo up >> {0}; cat; echo left >> {0}", file.display());
        let supervisor = Supervisor::start("/bin/sh".into(), vec![vec!["-c".into(), script]]);
        until(|| lines(&file) == ["up"]);
        supervisor.stop();
        assert_eq!(lines(&file), ["up", "left"]);
    }
}
