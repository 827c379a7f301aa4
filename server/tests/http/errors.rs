//! Errors that no route makes itself.

use axum::body::Body;
use bytes::Bytes;
use http::{Method, StatusCode};
use serde_json::json;

use crate::harness::Service;

async fn raw(service: &Service, content_type: &str, body: impl Into<Body>) -> crate::harness::Answer {
    service.request(Method::POST, "/v1/jobs", &[("content-type", content_type)], body.into()).await
}

#[tokio::test]
async fn addresses_and_methods_that_do_not_exist_are_problems() {
    let service = Service::start().await;
    let answer = service.get("/v1/nothing").await;
    assert_eq!((answer.status, answer.problem().code()), (StatusCode::NOT_FOUND, "no-such-route"));
    for path in ["/v1/jobs/%ff", "/v1/jobs/x/artifacts/%ff", "/v1/jobs/%ff/artifacts/x"] {
        let answer = service.get(path).await;
        assert_eq!((answer.status, answer.problem().code()), (StatusCode::NOT_FOUND, "not-found"), "{path}");
    }
    let answer = service.delete("/v1/jobs").await;
    assert_eq!((answer.status, answer.problem().code()), (StatusCode::METHOD_NOT_ALLOWED, "method-not-allowed"));
    assert!(answer.header("allow").contains("GET"), "{}", answer.header("allow"));
}

#[tokio::test]
async fn a_browser_gets_a_page_for_an_address_that_does_not_exist() {
    let service = Service::start().await;
    let answer = service.get_with("/nothing", &[("accept", "text/html")]).await;
    assert_eq!(answer.status, StatusCode::NOT_FOUND);
    assert!(answer.header("content-type").starts_with("text/html"));
}

#[tokio::test]
async fn json_bodies_are_checked_for_type_form_and_size() {
    let service = Service::start_with(|config| config.limits.json_bytes = 1000).await;
    for content_type in ["text/plain", "application/x-www-form-urlencoded", ""] {
        let answer = raw(&service, content_type, "{}").await;
        let expected = (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type");
        assert_eq!((answer.status, answer.problem().code()), expected, "{content_type}");
    }
    let broken = raw(&service, "application/json", "{\n  \"scene\": \n}").await;
    assert_eq!((broken.status, broken.problem().code()), (StatusCode::BAD_REQUEST, "bad-json"));
    assert!(broken.problem().detail.contains("line 3 column 1"), "{}", broken.problem().detail);
    let large = raw(&service, "application/json", format!("\"{}\"", "x".repeat(1000))).await;
    assert_eq!((large.status, large.problem().code()), (StatusCode::PAYLOAD_TOO_LARGE, "too-large"));
    let deep = format!("{{\"scene\": \"x\", \"settings\": {{\"camera\": {}", "[".repeat(900));
    for body in [Bytes::from(deep), Bytes::from_static(b"{\"scene\": \"\xff\"}")] {
        let answer = raw(&service, "application/json", body).await;
        assert!(answer.status.is_client_error());
        answer.problem();
    }
}

#[tokio::test]
async fn a_body_that_stops_half_way_is_a_problem() {
    let service = Service::start().await;
    let cut = futures::stream::iter([Ok(Bytes::from_static(b"{\"scene\"")), Err(std::io::Error::other("cut"))]);
    let answer = raw(&service, "application/json", Body::from_stream(cut)).await;
    assert_eq!((answer.status, answer.problem().code()), (StatusCode::BAD_REQUEST, "incomplete-body"));
}

#[tokio::test]
async fn pages_of_other_sites_cannot_write() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    for (site, status) in [
        ("cross-site", StatusCode::FORBIDDEN),
        ("same-site", StatusCode::FORBIDDEN),
        ("same-origin", StatusCode::CREATED),
        ("none", StatusCode::CREATED),
    ] {
        let headers = [("content-type", "application/json"), ("sec-fetch-site", site)];
        let body = json!({ "scene": scene }).to_string().into();
        let answer = service.request(Method::POST, "/v1/jobs", &headers, body).await;
        assert_eq!(answer.status, status, "{site}");
    }
    let read = service.get_with("/v1/jobs", &[("sec-fetch-site", "cross-site")]).await;
    assert_eq!(read.status, StatusCode::OK);
}

#[tokio::test]
async fn nothing_of_the_inside_is_told() {
    let service = Service::start().await;
    let scene = service.scene(0).await;
    service.job(json!({ "scene": scene })).await;
    let dir = service.app.config.data_dir.clone();
    std::fs::remove_dir_all(dir.join("staging")).unwrap();
    let answer = service.request(Method::POST, "/v1/blobs", &[], Body::from("x")).await;
    assert_eq!((answer.status, answer.problem().code()), (StatusCode::INTERNAL_SERVER_ERROR, "internal"));
    let text = String::from_utf8(answer.body).unwrap();
    assert!(!text.contains("staging") && !text.contains(dir.to_str().unwrap()) && !text.contains("os error"), "{text}");
    let ready = service.get("/readyz").await;
    assert_eq!((ready.status, ready.problem().code()), (StatusCode::SERVICE_UNAVAILABLE, "not-ready"));
}
