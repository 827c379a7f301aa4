//! `/v1/farm/schedules`

use http::StatusCode;
use lightshaft_api::farm::{RunSummary, Schedule};
use lightshaft_api::page::Page;
use serde_json::{Value, json};

use super::{Farm, SUITE};

const MINUTE_MS: i64 = 60_000;

async fn body(farm: &Farm, cron: &str) -> Value {
    let suite = farm.suite(SUITE).await;
    json!({ "name": "often", "cron": cron,
            "run": { "suite": suite, "label": "nightly", "scenes": { "triangle": farm.scene } } })
}

async fn schedules(farm: &Farm) -> Vec<Schedule> {
    farm.service.get("/v1/farm/schedules").await.json::<Page<Schedule>>().items
}

#[tokio::test]
async fn a_run_begins_when_it_is_due_and_missed_times_count_once() {
    let farm = Farm::start().await;
    // The clock begins on a full hour.
    let made = farm.service.post("/v1/farm/schedules", body(&farm, "*/10 * * * *").await).await;
    assert_eq!(made.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&made.body));
    let begin = || farm.service.app.begin_scheduled_runs();
    assert_eq!(begin().await.unwrap(), 0, "not due");
    farm.service.clock.advance(10 * MINUTE_MS);
    assert_eq!((begin().await.unwrap(), begin().await.unwrap()), (1, 0), "once");
    farm.service.clock.advance(35 * MINUTE_MS);
    assert_eq!((begin().await.unwrap(), begin().await.unwrap()), (1, 0), "three times were missed");
    let runs: Page<RunSummary> = farm.service.get("/v1/farm/runs").await.json();
    let first = made.json::<Schedule>().next_at.unwrap();
    let labels: Vec<&str> = runs.items.iter().rev().map(|run| run.label.as_str()).collect();
    assert_eq!(labels.len(), 2);
    assert_eq!(labels[0], format!("nightly {}", first.strftime("%Y-%m-%dT%H:%MZ")));
    let read = &schedules(&farm).await[0];
    assert_eq!((read.last_run.as_ref(), read.error.as_ref()), (Some(&runs.items[0].id), None));
    assert_eq!(read.next_at.unwrap().as_millisecond(), first.as_millisecond() + 40 * MINUTE_MS);
}

#[tokio::test]
async fn what_is_wrong_with_a_schedule_is_named_when_it_is_made() {
    let farm = Farm::start().await;
    let mut wrong = body(&farm, "61 * * * *").await;
    wrong["name"] = json!(" ");
    wrong["run"]["overrides"] = json!({ "spp": 0 });
    let answer = farm.service.post("/v1/farm/schedules", wrong).await;
    assert_eq!(answer.pointers(), ["/name", "/cron", "/run/overrides/spp"]);
    let good = body(&farm, "0 0 * * *").await;
    assert_eq!(farm.service.post("/v1/farm/schedules", good.clone()).await.status, StatusCode::CREATED);
    assert_eq!(farm.service.post("/v1/farm/schedules", good).await.pointers(), ["/name"], "there is one of this name");
}

#[tokio::test]
async fn a_run_that_cannot_begin_is_told_of_and_a_deleted_schedule_begins_none() {
    let farm = Farm::start().await;
    farm.service.post("/v1/farm/schedules", body(&farm, "* * * * *").await).await;
    assert_eq!(farm.service.delete(&format!("/v1/scenes/{}", farm.scene)).await.status, StatusCode::NO_CONTENT);
    farm.service.clock.advance(MINUTE_MS);
    assert_eq!(farm.service.app.begin_scheduled_runs().await.unwrap(), 0);
    let read = schedules(&farm).await.remove(0);
    assert!(read.error.unwrap().contains("/scenes/triangle"));
    let path = format!("/v1/farm/schedules/{}", read.id);
    assert_eq!(farm.service.delete(&path).await.status, StatusCode::NO_CONTENT);
    assert_eq!(farm.service.delete(&path).await.status, StatusCode::NOT_FOUND);
    assert!(schedules(&farm).await.is_empty());
}

#[tokio::test]
async fn a_paused_schedule_begins_nothing_and_goes_on_from_when_it_is_resumed() {
    let farm = Farm::start().await;
    let made: Schedule = farm.service.post("/v1/farm/schedules", body(&farm, "*/10 * * * *").await).await.json();
    let first = made.next_at.unwrap().as_millisecond();
    let path = format!("/v1/farm/schedules/{}", made.id);
    let change = async |paused: bool| -> Schedule {
        let answer = farm.service.patch(&path, json!({ "paused": paused })).await;
        assert_eq!(answer.status, StatusCode::OK, "{}", String::from_utf8_lossy(&answer.body));
        answer.json()
    };
    assert_eq!(change(false).await, made, "it runs already");
    let paused = change(true).await;
    assert_eq!((paused.paused, paused.next_at), (true, None));
    farm.service.clock.advance(35 * MINUTE_MS);
    assert_eq!(farm.service.app.begin_scheduled_runs().await.unwrap(), 0);
    let resumed = change(false).await;
    assert_eq!((resumed.paused, resumed.next_at.unwrap().as_millisecond()), (false, first + 30 * MINUTE_MS));
    assert_eq!(farm.service.app.begin_scheduled_runs().await.unwrap(), 0, "what passed is skipped");
    farm.service.clock.advance(5 * MINUTE_MS);
    assert_eq!(farm.service.app.begin_scheduled_runs().await.unwrap(), 1);

    assert_eq!(farm.service.patch(&path, json!({ "paused": 1 })).await.pointers(), ["/paused"]);
    let unknown = farm.service.patch("/v1/farm/schedules/none", json!({ "paused": true })).await;
    assert_eq!(unknown.status, StatusCode::NOT_FOUND);
    let mut sleeping = body(&farm, "* * * * *").await;
    sleeping["name"] = json!("later");
    sleeping["paused"] = json!(true);
    let sleeping: Schedule = farm.service.post("/v1/farm/schedules", sleeping).await.json();
    assert_eq!((sleeping.paused, sleeping.next_at), (true, None), "from the beginning");
}
