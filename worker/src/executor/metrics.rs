//! What a process can say about itself.

use std::collections::BTreeMap;

pub(crate) fn versions() -> BTreeMap<String, String> {
    BTreeMap::from([
        ("engine".to_owned(), lightshaft_engine::VERSION.to_owned()),
        ("structures".to_owned(), lightshaft_engine::accel::BUILDER_VERSION.to_string()),
    ])
}

/// Highest resident memory of this process so far; 0 where the system does not tell (`/proc` is Linux's).
pub(crate) fn peak_bytes() -> u64 {
    std::fs::read_to_string("/proc/self/status").ok().and_then(|status| high_water_mark(&status)).unwrap_or(0)
}

/// `VmHWM` of `/proc/<pid>/status` (proc_pid_status(5)), in bytes.
fn high_water_mark(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_high_water_mark_is_read_in_bytes() {
        let status = "Name:\tlightshaft\nVmPeak:\t  999 kB\nVmHWM:\t    2048 kB\nVmRSS:\t 1 kB\n";
        assert_eq!(high_water_mark(status), Some(2048 * 1024));
        assert_eq!(high_water_mark("Name:\tx\n"), None);
    }
}
