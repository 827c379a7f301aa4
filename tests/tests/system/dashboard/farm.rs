//! The regression farm's pages: what changed is seen, judged and kept.

use lightshaft_tests::Service;
use lightshaft_tests::browser::Browser;
use reqwest::Method;
use serde_json::{Value, json};

use super::{decoded, says};

/// As `tests/browser` has it.
const SUITE: &str = include_str!("../../../farm/still-life.toml");

async fn suite(service: &Service) -> String {
    let request = service.request(Method::POST, "/v1/farm/suites").header("content-type", "application/toml");
    let reply = service.send(request.body(SUITE)).await;
    assert_eq!(reply.status, 201, "{}", reply.text());
    reply.json()["id"].as_str().unwrap().to_owned()
}

/// Runs a suite to its end.
async fn run(service: &Service, suite: &str, scene: &str, label: &str, overrides: Value) -> String {
    let body = json!({"suite": suite, "label": label, "scenes": {"demo": scene}, "overrides": overrides});
    let reply = service.post("/v1/farm/runs", &body).await;
    assert_eq!(reply.status, 201, "{}", reply.text());
    let id = reply.json()["id"].as_str().unwrap().to_owned();
    service
        .until("the run to finish", async || {
            let run = service.get(&format!("/v1/farm/runs/{id}")).await.json();
            (run["state"] == "finished").then_some(())
        })
        .await;
    id
}

#[tokio::test]
async fn a_change_is_seen_compared_and_approved() {
    let service = Service::start_with(&["--no-thumbnails"]);
    let scene = service.generated(&["demo"]).await;
    let suite = suite(&service).await;
    let base = run(&service, &suite, &scene, "base", json!({})).await;
    let browser = Browser::open().await;
    browser.go(service.url()).await;
    browser.until("what waits", &says("#farm-health", "2 cases wait for a decision")).await;
    browser.click_on("#farm-health", "still life at base").await;
    browser.until("the run", &format!("return location.pathname === '/farm/runs/{base}'")).await;

    // Nothing is decided without a name, nor of nothing.
    browser.type_into("#decide [name=who]", "Ada").await;
    browser.click_on("#decide", "Approve chosen").await;
    browser.until("what is missing", &says("#alerts", "Nothing is chosen")).await;
    browser.click_on("#decide", "Choose all that wait").await;
    browser.type_into("#decide [name=why]", "first pictures").await;
    browser.click_on("#decide", "Approve chosen").await;
    browser.until("the new state", &says("#state", "Ok")).await;
    assert_eq!(service.get(&format!("/v1/farm/runs/{base}")).await.json()["ok"], true);

    let broken = run(&service, &suite, &scene, "no bounces", json!({"max_bounces": 0})).await;
    browser.go(&format!("{}/farm/runs/{broken}?show=changed", service.url())).await;
    browser.until("the case that changed", &says("#case-path .verdicts", "Changed")).await;
    browser.until("its heat map", &decoded("#case-path .frame + .frame img")).await;
    let cases = browser.script("return document.querySelectorAll('.case').length").await;
    assert_eq!(cases, 1, "occlusion has no bounces");
    assert_eq!(browser.script("return document.querySelector('#decide [name=who]').value").await, "Ada");

    browser.click_on("#case-path", "Compare").await;
    let is_compared = "return location.pathname === '/compare'
        && document.querySelector('[data-figures]')?.innerText.includes('Mean FLIP')";
    browser.until("the comparison", is_compared).await;

    browser.go(&format!("{}/farm/runs/{broken}", service.url())).await;
    browser.click("#case-path [name=cases]").await;
    browser.type_into("#decide [name=why]", "the light is gone").await;
    browser.click_on("#decide", "Reject chosen").await;
    browser.until("the decision", &says("#case-path", "the light is gone")).await;
    browser.click_on("#case-path", "path").await;
    browser.until("the history", &says("h1", "path")).await;
    for part in ["no bounces", "base", "Rejected", "Approved", "the light is gone"] {
        browser.until(part, &says("main", part)).await;
    }
    assert_eq!(browser.errors().await, Vec::<String>::new());
}
