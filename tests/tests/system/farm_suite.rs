//! The sample suite on Lightshaft itself, by command, as a CI runs it: not one pixel may differ, on either device.

use std::path::Path;
use std::process::{Command, Output};

use lightshaft_tests::{Service, binary};
use serde_json::Value;

const SUITE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/farm/generated.toml");

fn farm(service: &Service, args: &[&str], code: i32) -> Output {
    let output = Command::new(binary::lightshaft())
        .env("LIGHTSHAFT_SERVER", service.url())
        .arg("farm")
        .args(args)
        .output()
        .expect("lightshaft starts");
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "{args:?}: {stdout}\n{stderr}");
    output
}

fn json(service: &Service, args: &[&str], code: i32) -> Value {
    let output = farm(service, &[args, &["--json"]].concat(), code);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{args:?}: {error}"))
}

fn verdicts(run: &Value) -> Vec<(&str, &str)> {
    let cases = run["cases"].as_array().expect("cases").iter();
    cases.map(|case| (case["name"].as_str().unwrap_or(""), case["image"]["verdict"].as_str().unwrap_or(""))).collect()
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn every_picture_is_the_same_however_it_is_rendered() {
    let service = Service::start_with(&["--no-thumbnails"]);
    let [junit, markdown, html] = ["farm.xml", "farm.md", "farm.html"].map(|name| service.scratch(name));
    let path = |path: &Path| path.to_str().expect("a UTF-8 path").to_owned();
    let (junit_path, markdown_path, html_path) = (path(&junit), path(&markdown), path(&html));

    let reports = ["--junit", &junit_path, "--markdown", &markdown_path, "--html", &html_path];
    let first = json(&service, &[&["run", SUITE, "--label", "base"][..], &reports[..]].concat(), 1);
    let all = verdicts(&first);
    assert!(all.len() >= 7 && all.iter().all(|(_, verdict)| *verdict == "missing"), "{all:?}");
    assert!(read(&junit).contains(&format!("tests=\"{}\"", all.len())), "{}", read(&junit));
    assert!(read(&markdown).contains(&format!("{} new", all.len())), "{}", read(&markdown));
    assert_eq!(read(&html).matches("data:image/png;base64,").count(), all.len());

    // Nobody decides by accident, or without a name.
    farm(&service, &["approve", "base", "--who", "ci"], 2);
    farm(&service, &["approve", "base", "--all"], 2);
    let decisions = json(&service, &["approve", "base", "--all", "--who", "ci", "--why", "first pictures"], 0);
    assert_eq!(decisions.as_array().map(Vec::len), Some(all.len()));
    farm(&service, &["status", "base"], 0);

    for setting in ["split={\"tiles\":[3,2]}", "split={\"tiles\":[1,4]}"] {
        let run = json(&service, &["run", SUITE, "--label", setting, "--set", setting], 0);
        let wrong: Vec<_> = verdicts(&run).into_iter().filter(|(_, verdict)| *verdict != "identical").collect();
        assert!(wrong.is_empty(), "{setting}: {wrong:?}");
    }

    let broken = json(&service, &["run", SUITE, "--label", "broken", "--set", "seed=8", "--case", "cpu-path"], 1);
    assert_eq!(verdicts(&broken), [("cpu-path", "changed")]);
    let report = farm(&service, &["report", "broken"], 1);
    let report = String::from_utf8_lossy(&report.stdout);
    assert!(report.starts_with("## generated: 1 changed\n"), "{report}");
    let history = json(&service, &["history", "generated", "cpu-path"], 0);
    assert_eq!(history["points"].as_array().map(Vec::len), Some(4), "{history:#}");
    json(&service, &["reject", "broken", "cpu-path", "--who", "ci", "--why", "another seed"], 0);
    json(&service, &["reset", "generated", "cpu-path", "--who", "ci", "--why", "to see it go"], 0);
    let after = json(&service, &["run", SUITE, "--label", "after", "--case", "cpu-path"], 1);
    assert_eq!(verdicts(&after), [("cpu-path", "missing")]);
}
