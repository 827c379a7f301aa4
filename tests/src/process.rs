//! Processes of Linux: who is whose child, and signals.

use std::fs;
use std::process::Command;

/// Direct children of a process.
pub fn children(parent: u32) -> Vec<u32> {
    let Ok(processes) = fs::read_dir("/proc") else { return Vec::new() };
    let pids = processes.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|&pid| parent_and_state(pid).is_some_and(|(p, state)| p == parent && state != 'Z')).collect()
}

/// Whether a process runs (a zombie does not).
pub fn is_alive(pid: u32) -> bool {
    parent_and_state(pid).is_some_and(|(_, state)| state != 'Z')
}

/// Sends a signal by its name (`KILL`, `STOP`, `CONT`, `TERM`). A process that is gone already is no error.
pub fn signal(pid: u32, name: &str) {
    let _ = Command::new("kill").arg(format!("-{name}")).arg(pid.to_string()).status();
}

/// Kills a process with all its descendants.
pub fn kill_tree(pid: u32) {
    let below = children(pid);
    signal(pid, "KILL");
    below.into_iter().for_each(kill_tree);
}

/// Parent and state letter of `/proc/<pid>/stat`, whose second field is a name in parentheses.
fn parent_and_state(pid: u32) -> Option<(u32, char)> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    let state = fields.next()?.chars().next()?;
    Some((fields.next()?.parse().ok()?, state))
}
