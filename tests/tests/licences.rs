//! Licences and sources of every dependency, checked offline against the lists in `deny.toml`.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

#[test]
fn every_dependency_has_an_allowed_licence_and_source() {
    let deny = deny_toml();
    let (licences, registries) = (list(&deny, "allow = ["), list(&deny, "allow-registry = ["));
    assert!(licences.iter().any(|l| l == "MIT") && registries.len() == 1, "deny.toml was read: {licences:?}");
    assert!(!licences.iter().any(|licence| licence.contains("GPL")), "copyleft is not for this project");

    let packages = dependencies();
    assert!(packages.len() > 100, "the whole graph was read");
    let mut wrong = Vec::new();
    for package in &packages {
        let name = format!("{} {}", package["name"], package["version"]);
        let licence = package["license"].as_str().unwrap_or("none");
        if !allows(licence, &licences) {
            wrong.push(format!("{name}: the licence {licence} is not among those that deny.toml allows"));
        }
        let source = package["source"].as_str().unwrap_or_default();
        if !registries.iter().any(|registry| source == format!("registry+{registry}")) {
            wrong.push(format!("{name}: the source {source} is no registry that deny.toml allows"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn expressions_of_licences_are_understood() {
    let allowed = ["MIT".to_owned(), "Apache-2.0".to_owned(), "Unicode-3.0".to_owned()];
    for good in [
        "MIT",
        "MIT OR GPL-3.0",
        "AGPL-3.0 OR MIT",
        "MIT/Apache-2.0",
        "(MIT OR Apache-2.0) AND Unicode-3.0",
        "GPL-2.0 AND Zlib OR MIT",
        "MIT AND (Zlib OR Apache-2.0)",
    ] {
        assert!(allows(good, &allowed), "{good}");
    }
    for bad in [
        "GPL-3.0",
        "MIT AND GPL-3.0",
        "(MIT OR Zlib) AND GPL-3.0",
        "",
        "none",
        "Apache-2.0 WITH LLVM-exception",
        "MIT AND (Zlib OR GPL-3.0)",
    ] {
        assert!(!allows(bad, &allowed), "{bad}");
    }
}

/// Packages that are built for this machine, but for those of the workspace.
fn dependencies() -> Vec<Value> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let version = Command::new("rustc").arg("-vV").output().expect("rustc runs");
    let version = String::from_utf8_lossy(&version.stdout).into_owned();
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).expect("rustc names its host");
    let output = Command::new(cargo)
        .args(["metadata", "--format-version=1", "--locked", "--offline", "--filter-platform", host])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON");
    let packages = metadata["packages"].as_array().expect("a list of packages");
    packages.iter().filter(|package| !package["source"].is_null()).cloned().collect()
}

fn deny_toml() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deny.toml");
    std::fs::read_to_string(path).expect("deny.toml in the repository's root")
}

/// The strings of the first array that follows `start`.
fn list(toml: &str, start: &str) -> Vec<String> {
    let rest = &toml[toml.find(&format!("\n{start}")).unwrap_or_else(|| panic!("{start} in deny.toml")) + 1..];
    let array = &rest[..rest.find(']').expect("the array ends")];
    array.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Whether an SPDX expression can be satisfied by allowed licences. `AND` binds closer than `OR`; `/` is an old `OR`.
fn allows(expression: &str, allowed: &[String]) -> bool {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let mut words = spaced.split_whitespace().peekable();
    let result = any_of(&mut words, allowed);
    result && words.next().is_none()
}

type Words<'a> = std::iter::Peekable<std::str::SplitWhitespace<'a>>;

fn any_of(words: &mut Words<'_>, allowed: &[String]) -> bool {
    let mut result = all_of(words, allowed);
    while words.next_if_eq(&"OR").is_some() {
        result |= all_of(words, allowed);
    }
    result
}

fn all_of(words: &mut Words<'_>, allowed: &[String]) -> bool {
    let mut result = licence(words, allowed);
    while words.next_if_eq(&"AND").is_some() {
        result &= licence(words, allowed);
    }
    result
}

fn licence(words: &mut Words<'_>, allowed: &[String]) -> bool {
    if words.next_if_eq(&"(").is_some() {
        let result = any_of(words, allowed);
        return words.next().is_some_and(|word| word == ")") && result;
    }
    let mut name = words.next().unwrap_or_default().to_owned();
    if words.next_if_eq(&"WITH").is_some() {
        name = format!("{name} WITH {}", words.next().unwrap_or_default());
    }
    allowed.contains(&name)
}
