//! Server-sent events, over a real socket.

use std::time::Duration;

use futures::StreamExt;
use http::StatusCode;
use lightshaft_api::event::{Event, EventKind};
use serde_json::json;

use crate::harness::{Service, new_job};

async fn next<S>(stream: &mut S) -> Option<Event>
where
    S: futures::Stream<Item = lightshaft_api::client::Result<Event>> + Unpin,
{
    let event = tokio::time::timeout(Duration::from_secs(10), stream.next()).await.expect("an event in time");
    event.map(|event| event.unwrap())
}

#[tokio::test]
async fn a_jobs_events_are_told_from_its_creation_to_its_end() {
    let service = Service::start().await;
    let client = service.listen().await;
    let scene = service.scene(0).await;
    let worker = service.worker(&["cpu"]).await;
    let job = client.create_job(&new_job(&scene), None).await.unwrap().summary.id;
    let mut stream = client.job_events(&job, None).await.unwrap();
    assert_eq!(next(&mut stream).await.unwrap().kind, EventKind::JobCreated);
    let lease = service.lease(&worker).await.unwrap();
    assert_eq!(next(&mut stream).await.unwrap().kind, EventKind::JobStarted);
    let leased = next(&mut stream).await.unwrap();
    assert_eq!((leased.kind, &leased.data["worker"]), (EventKind::TaskLeased, &json!(worker)));
    let preview = service.store_blob("picture").await;
    let beat = json!({ "phase": "render", "progress": 0.25, "spp": 4, "preview": preview });
    service.report(&lease, "heartbeat", beat).await;
    let progress = next(&mut stream).await.unwrap();
    assert_eq!((progress.kind, progress.id), (EventKind::JobProgress, None));
    assert_eq!((&progress.data["progress"], &progress.data["phase"]), (&json!(0.25), &json!("render")));
    let preview = next(&mut stream).await.unwrap();
    assert_eq!(preview.data["href"], format!("/v1/jobs/{job}/preview.png"));
    service.complete(&lease, "image.png", "x").await;
    assert_eq!(next(&mut stream).await.unwrap().kind, EventKind::TaskSucceeded);
    assert_eq!(next(&mut stream).await.unwrap().kind, EventKind::JobSucceeded);
    assert_eq!(next(&mut stream).await, None, "the stream ends with the job");

    let mut resumed = client.job_events(&job, leased.id).await.unwrap();
    assert_eq!(next(&mut resumed).await.unwrap().kind, EventKind::TaskSucceeded);
    assert_eq!(next(&mut resumed).await.unwrap().kind, EventKind::JobSucceeded);
    assert_eq!(next(&mut resumed).await, None);
}

#[tokio::test]
async fn the_stream_of_all_jobs_begins_now_or_where_it_was_left() {
    let service = Service::start().await;
    let client = service.listen().await;
    let scene = service.scene(0).await;
    client.create_job(&new_job(&scene), None).await.unwrap();
    let mut stream = client.events(None).await.unwrap();
    let second = client.create_job(&new_job(&scene), None).await.unwrap().summary.id;
    let event = next(&mut stream).await.unwrap();
    assert_eq!((event.kind, &event.job), (EventKind::JobCreated, &second));
    let mut from_start = client.events(Some(0)).await.unwrap();
    assert_ne!(next(&mut from_start).await.unwrap().job, second);
    assert_eq!(next(&mut from_start).await.unwrap(), event);
    let wrong = service.get_with("/v1/events", &[("last-event-id", "x")]).await;
    assert_eq!((wrong.status, wrong.pointers()), (StatusCode::BAD_REQUEST, vec!["header/last-event-id".to_owned()]));
}

#[tokio::test]
async fn streams_and_long_polls_end_with_the_service() {
    let service = Service::start().await;
    let client = service.listen().await;
    let worker = service.worker(&["cpu"]).await;
    let mut stream = client.events(None).await.unwrap();
    let (poller, request) = (client.clone(), crate::harness::lease_request(&worker, 30));
    let poll = tokio::spawn(async move { poller.lease(&request).await });
    tokio::time::sleep(Duration::from_millis(100)).await;
    service.app.shutdown.cancel();
    assert_eq!(next(&mut stream).await, None);
    let lease = tokio::time::timeout(Duration::from_secs(5), poll).await.unwrap().unwrap().unwrap();
    assert!(lease.is_none());
}
