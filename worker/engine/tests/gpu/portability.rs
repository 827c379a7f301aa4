//! The same pictures on a second implementation of Vulkan: SwiftShader, which comes with Chromium. What only one driver
//! accepts, or compiles as we mean it, shows here.

use std::path::Path;
use std::process::Command;

/// Where Debian's package puts it.
const SWIFTSHADER: &str = "/usr/lib/chromium/vk_swiftshader_icd.json";

/// The Vulkan loader reads its settings once, so each test goes again in a process of its own.
#[track_caller]
fn passes_on_swiftshader(test: &str) {
    if !Path::new(SWIFTSHADER).exists() {
        eprintln!("skipped: there is no {SWIFTSHADER}");
        return;
    }
    let output = Command::new(std::env::current_exe().expect("has a path"))
        .args([test, "--exact", "--nocapture"])
        .env("VK_DRIVER_FILES", SWIFTSHADER)
        .env("LIGHTSHAFT_ADAPTER", "SwiftShader")
        .output()
        .expect("starts");
    let [stdout, stderr] = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    assert!(output.status.success() && stdout.contains("1 passed"), "{test}: {stdout}\n{stderr}");
}

#[test]
fn a_path_traced_picture() {
    passes_on_swiftshader("pictures::path");
}

#[test]
fn rays_against_instances() {
    passes_on_swiftshader("traversal::instances_mirrored_sheared_and_overlapping");
}
