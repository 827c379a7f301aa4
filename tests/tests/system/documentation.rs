//! Lists in the documentation are compared with what the program says, so that neither is forgotten.

use std::collections::BTreeSet;
use std::path::Path;

use lightshaft_tests::Service;
use lightshaft_tests::binary::run_ok;
use lightshaft_tests::glb::Gltf;
use serde_json::json;

#[tokio::test]
async fn every_endpoint_is_listed() {
    let service = Service::start_with(&["--workers", "0"]);
    let document = service.get("/openapi.json").await.json();
    let mut found = BTreeSet::new();
    for (path, methods) in document["paths"].as_object().unwrap() {
        for method in methods.as_object().unwrap().keys().filter(|key| *key != "parameters") {
            found.insert(format!("{} {path}", method.to_uppercase()));
        }
    }
    assert_eq!(first_cells(&read("docs/API-DESIGN.md"), |cell| cell.contains(" /")), found);
}

#[tokio::test]
async fn every_event_of_the_description_is_listed() {
    let service = Service::start_with(&["--workers", "0"]);
    let document = service.get("/openapi.json").await.json();
    let kinds = document["components"]["schemas"]["EventKind"]["enum"].as_array().expect("the kinds of events");
    let kinds: BTreeSet<String> = kinds.iter().map(|kind| kind.as_str().unwrap().to_owned()).collect();
    let is_event = |cell: &str| cell.starts_with("job.") || cell.starts_with("task.");
    assert_eq!(first_cells(&read("docs/API-DESIGN.md"), is_event), kinds);
}

#[tokio::test]
async fn every_problem_code_is_listed() {
    let service = Service::start_with(&["--workers", "0"]);
    let explained = service.get("/problems").await.text();
    // Each block begins with `code (status): title`.
    let codes = explained.lines().filter_map(|line| {
        let (code, rest) = line.split_once(" (")?;
        rest.get(..3)?.parse::<u16>().ok().map(|_| code.to_owned())
    });
    let codes: BTreeSet<String> = codes.collect();
    assert!(codes.len() > 10, "{explained}");
    let listed = first_cells(&section(&read("docs/API-DESIGN.md"), "## Problem codes"), |_| true);
    assert_eq!(listed, codes);
}

#[tokio::test]
async fn every_metric_is_listed() {
    let service = Service::start();
    let scene = service.scene(Gltf::triangle().glb()).await;
    service.render(&scene, json!({"width": 16, "height": 16, "spp": 1})).await;
    let metrics = service.get("/metrics").await.text();
    let series = metrics.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next().map(str::to_owned));
    let series: BTreeSet<String> = series.collect();
    assert!(series.len() >= 8, "{metrics}");
    let listed = first_cells(&read("docs/OPERATIONS.md"), |cell| cell.starts_with("lightshaft_"));
    let unlisted: Vec<_> = series.difference(&listed).collect();
    assert!(unlisted.is_empty(), "not in docs/OPERATIONS.md: {unlisted:?}");
}

#[test]
fn every_option_of_the_daemons_is_listed() {
    let operations = read("docs/OPERATIONS.md");
    let listed = first_cells(&operations, |cell| cell.starts_with("--"));
    let listed: BTreeSet<&str> = listed.iter().map(|cell| cell.split(' ').next().unwrap()).collect();
    for command in ["serve", "worker"] {
        let help = run_ok(&[command, "--help"]);
        let options = help.lines().filter_map(|line| line.trim_start().trim_start_matches("-h, ").strip_prefix("--"));
        for option in options.map(|rest| format!("--{}", rest.split([' ', '<', '=']).next().unwrap())) {
            assert!(
                option == "--help" || option == "--version" || listed.contains(option.as_str()),
                "{command} {option}"
            );
        }
    }
}

#[test]
fn links_between_documents_lead_somewhere() {
    let mut seen = 0;
    for document in
        ["README.md", "docs/ARCHITECTURE.md", "docs/API-DESIGN.md", "docs/OPERATIONS.md", "docs/STATE-MACHINE.md"]
    {
        let folder = root().join(document).parent().unwrap().to_owned();
        let text = read(document);
        for target in text.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next()) {
            if target.contains("://") || target.is_empty() {
                continue;
            }
            assert!(folder.join(target).exists(), "{document} links to {target}");
            seen += 1;
        }
    }
    assert!(seen > 10);
}

fn root() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// The part of a document under a heading, up to the next of its level.
fn section(document: &str, heading: &str) -> String {
    let start = document.find(heading).unwrap_or_else(|| panic!("the heading {heading}"));
    let rest = &document[start + heading.len()..];
    rest[..rest.find("\n## ").unwrap_or(rest.len())].to_owned()
}

/// Everything in backticks in the first cell of table rows, where `wanted`.
fn first_cells(document: &str, wanted: impl Fn(&str) -> bool) -> BTreeSet<String> {
    let cells = document.lines().filter_map(|line| line.strip_prefix("| ")?.split(" | ").next());
    let names = cells.flat_map(|cell| cell.split('`').skip(1).step_by(2));
    names.filter(|name| wanted(name)).map(str::to_owned).collect()
}
