//! `/v1/farm/suites`

use http::StatusCode;
use lightshaft_api::farm::{NewSuite, Suite, SuiteSummary};
use lightshaft_api::page::Page;
use serde_json::json;

use super::{Farm, SUITE};

#[tokio::test]
async fn the_same_content_is_the_same_suite_in_any_form() {
    let farm = Farm::start().await;
    let first = farm.post_toml(SUITE).await;
    assert_eq!(first.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&first.body));
    let suite: Suite = first.json();
    assert_eq!(first.header("location"), format!("/v1/farm/suites/{}", suite.id));
    assert_eq!((suite.cases[0].repeat, suite.cases[0].settings.spp), (3, 4));
    let again = farm.post_toml(&format!("# a remark\n{SUITE}")).await;
    assert_eq!((again.status, again.json::<Suite>()), (StatusCode::OK, suite.clone()));
    let as_json = farm.service.post("/v1/farm/suites", json!(NewSuite::from_toml(SUITE).unwrap())).await;
    assert_eq!((as_json.status, as_json.json::<Suite>().id), (StatusCode::OK, suite.id.clone()));
    let changed: Suite = farm.post_toml(&SUITE.replace("spp = 4", "spp = 5")).await.json();
    assert_ne!((&changed.id, &changed.hash), (&suite.id, &suite.hash));
    assert_eq!(farm.service.get(&format!("/v1/farm/suites/{}", suite.id)).await.json::<Suite>(), suite);
    let listed: Page<SuiteSummary> = farm.service.get("/v1/farm/suites?name=small").await.json();
    assert_eq!(listed.items.iter().map(|one| &one.id).collect::<Vec<_>>(), [&changed.id, &suite.id]);
    let page: Page<SuiteSummary> = farm.service.get("/v1/farm/suites?limit=1").await.json();
    assert_eq!((page.items.len(), page.items[0].cases), (1, 1));
    let next = format!("/v1/farm/suites?cursor={}", page.next_cursor.unwrap());
    assert_eq!(farm.service.get(&next).await.json::<Page<SuiteSummary>>().items[0].id, suite.id);
    assert!(farm.service.get("/v1/farm/suites?name=other").await.json::<Page<SuiteSummary>>().items.is_empty());
}

#[tokio::test]
async fn what_is_wrong_in_a_suite_is_named() {
    let farm = Farm::start().await;
    let syntax = farm.post_toml("name = \n").await;
    assert_eq!((syntax.status, syntax.problem().code()), (StatusCode::BAD_REQUEST, "bad-toml"));
    assert!(syntax.problem().detail.contains("line 1"), "{}", syntax.problem().detail);
    let fields = farm.post_toml(&SUITE.replace("max_rmse = 0.02", "max_rmse = -1, max_flop = 1")).await;
    assert_eq!(
        (fields.status, fields.pointers()),
        (StatusCode::UNPROCESSABLE_ENTITY, vec!["/case/0/image/max_flop".to_owned()])
    );
    let ranges = farm.post_toml(&SUITE.replace("max_rmse = 0.02", "max_rmse = -1").replace("spp = 4", "spp = 0")).await;
    assert_eq!(ranges.pointers(), ["/case/0/image/max_rmse", "/case/0/settings/spp"]);
    let text = [("content-type", "text/plain")];
    let body = axum::body::Body::from(SUITE);
    let wrong_type = farm.service.request(http::Method::POST, "/v1/farm/suites", &text, body).await;
    assert_eq!(wrong_type.status, StatusCode::UNSUPPORTED_MEDIA_TYPE);
    let unknown = farm.service.get("/v1/farm/suites/none").await;
    assert_eq!((unknown.status, unknown.problem().code()), (StatusCode::NOT_FOUND, "not-found"));
}
