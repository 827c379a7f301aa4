//! What must hold of every page, so that everybody can use it: with the keyboard, a screen reader, a small screen.

use serde_json::{Value, json};

use crate::browser::Browser;

/// What is wrong with the page that is open; empty when nothing is.
pub async fn complaints(browser: &Browser) -> Vec<String> {
    let found = browser.script(include_str!("audit.js")).await;
    let mut found: Vec<String> = found.as_array().into_iter().flatten().map(text).collect();
    // Names as a screen reader hears them: the browser computes them from labels, content and titles.
    let tree = browser.devtools("Accessibility.getFullAXTree", json!({})).await;
    let nodes = tree["nodes"].as_array().expect("an accessibility tree");
    assert!(nodes.len() > 10, "the tree of a whole page: {tree}");
    for node in nodes.iter().filter(|node| node["ignored"] == false && needs_name(node)) {
        if text(&node["name"]["value"]).trim().is_empty() {
            found.push(format!("a {} has no name: {node}", text(&node["role"]["value"])));
        }
    }
    found
}

/// Whether somebody who does not see a node must be told what it is.
fn needs_name(node: &Value) -> bool {
    let properties = node["properties"].as_array().into_iter().flatten();
    let is_focusable = properties.clone().any(|p| p["name"] == "focusable" && p["value"]["value"] == true);
    match text(&node["role"]["value"]).as_str() {
        "image" | "progressbar" | "meter" | "region" | "navigation" | "search" => true,
        // The document; and the part that the skip link jumps to.
        "RootWebArea" | "main" => false,
        _ => is_focusable,
    }
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().to_owned()
}
