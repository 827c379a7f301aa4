//! What a process can say about itself.

use std::collections::BTreeMap;
use std::sync::LazyLock;

/// The first 16 digits of this program's hash: times of two runs are only those of one program where they agree. Taken
/// from the running program where the system has that (`/proc/self/exe` is there even when the file was replaced).
static BUILD: LazyLock<Option<String>> = LazyLock::new(|| {
    let running = std::path::Path::new("/proc/self/exe");
    let program = if running.exists() { running.to_owned() } else { std::env::current_exe().ok()? };
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(std::fs::File::open(program).ok()?).ok()?;
    Some(hasher.finalize().to_hex()[..16].to_owned())
});

pub(crate) fn versions() -> BTreeMap<String, String> {
    let mut versions = BTreeMap::from([
        ("engine".to_owned(), lightshaft_engine::VERSION.to_owned()),
        ("structures".to_owned(), lightshaft_engine::accel::BUILDER_VERSION.to_string()),
    ]);
    if let Some(build) = &*BUILD {
        versions.insert("build".to_owned(), build.clone());
    }
    versions
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
    fn the_program_is_named_by_its_hash() {
        let versions = versions();
        let build = &versions["build"];
        assert!(build.len() == 16 && build.bytes().all(|digit| digit.is_ascii_hexdigit()), "{build}");
    }

    #[test]
    fn the_high_water_mark_is_read_in_bytes() {
        let status = "Name:\tlightshaft\nVmPeak:\t  999 kB\nVmHWM:\t    2048 kB\nVmRSS:\t 1 kB\n";
        assert_eq!(high_water_mark(status), Some(2048 * 1024));
        assert_eq!(high_water_mark("Name:\tx\n"), None);
    }
}
