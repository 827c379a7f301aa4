//! The checked-in document is the one that the service serves.

use std::path::PathBuf;

use http::StatusCode;
use serde_json::Value;

use crate::harness::Service;

#[tokio::test]
async fn the_checked_in_document_is_up_to_date() {
    let service = Service::start().await;
    let served = service.get("/openapi.json").await;
    assert_eq!(served.status, StatusCode::OK);
    let mut text = serde_json::to_string_pretty(&served.json::<Value>()).unwrap();
    text.push('\n');
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../api/openapi.json");
    if std::env::var_os("UPDATE_OPENAPI").is_some() {
        std::fs::write(&path, &text).unwrap();
        // The Python client's types are made from it.
        let generator = path.with_file_name("python").join("generate.py");
        assert!(std::process::Command::new("python3").arg(generator).status().unwrap().success());
    }
    let checked_in = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(checked_in == text, "api/openapi.json differs from the routes: run the tests once with UPDATE_OPENAPI=1");
}

#[tokio::test]
async fn every_operation_says_what_it_answers() {
    let document: Value = Service::start().await.get("/openapi.json").await.json();
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"));
    let paths = document["paths"].as_object().unwrap();
    assert!(paths.len() > 25);
    for (path, item) in paths {
        for (method, operation) in item.as_object().unwrap() {
            let name = format!("{method} {path}");
            assert!(operation["operationId"].is_string(), "{name}");
            let responses = operation["responses"].as_object().unwrap();
            assert!(responses.keys().any(|status| status.starts_with('2')), "{name}");
            let answers_problems = path.starts_with("/v1/");
            assert!(!answers_problems || responses.contains_key("default"), "{name}");
        }
    }
}

#[tokio::test]
async fn every_reference_leads_somewhere() {
    fn references(value: &Value, found: &mut Vec<String>) {
        match value {
            Value::Object(map) => {
                found.extend(map.get("$ref").and_then(Value::as_str).map(str::to_owned));
                map.values().for_each(|value| references(value, found));
            }
            Value::Array(values) => values.iter().for_each(|value| references(value, found)),
            _ => {}
        }
    }
    let document: Value = Service::start().await.get("/openapi.json").await.json();
    let mut found = Vec::new();
    references(&document, &mut found);
    assert!(!found.is_empty());
    for reference in found {
        let pointer = reference.strip_prefix('#').unwrap();
        assert!(document.pointer(pointer).is_some(), "{reference}");
    }
}
