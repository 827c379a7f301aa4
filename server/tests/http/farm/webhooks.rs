//! `/v1/farm/webhooks`, with a receiver that listens.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::response::IntoResponse;
use axum::routing::post;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use http::{HeaderMap, StatusCode};
use lightshaft_api::farm::{
    DeliveryState, ImageVerdict, TimeVerdict, Webhook, WebhookData, WebhookDelivery, WebhookEvent, WebhookMessage,
};
use lightshaft_api::page::Page;
use serde_json::{Value, json};
use sha2::Sha256;

use super::{Farm, honest};

const SECRET: &str = "correct horse battery staple";
const SECOND_MS: i64 = 1000;

/// Whoever is told: it answers with the statuses that it was given, and 200 when there are no more.
#[derive(Clone, Default)]
struct Receiver {
    url: String,
    got: Arc<Mutex<Vec<(HeaderMap, Bytes)>>>,
    statuses: Arc<Mutex<VecDeque<u16>>>,
}

impl Receiver {
    async fn start(statuses: &[u16]) -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let receiver = Self {
            url: format!("http://{}/hook?channel=1", listener.local_addr().unwrap()),
            statuses: Arc::new(Mutex::new(statuses.iter().copied().collect())),
            ..Self::default()
        };
        let router = Router::new().route("/hook", post(take)).with_state(receiver.clone());
        tokio::spawn(async move { axum::serve(listener, router).await });
        receiver
    }

    /// What came, with every signature checked.
    fn messages(&self) -> Vec<WebhookMessage> {
        let got = self.got.lock().unwrap();
        got.iter()
            .map(|(headers, body)| {
                let header = |name: &str| headers[name].to_str().unwrap();
                let mut mac = Hmac::<Sha256>::new_from_slice(SECRET.as_bytes()).unwrap();
                mac.update(format!("{}.{}.", header("webhook-id"), header("webhook-timestamp")).as_bytes());
                mac.update(body);
                let signature = format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes()));
                assert_eq!(header("webhook-signature"), signature);
                assert_eq!(header("content-type"), "application/json");
                serde_json::from_slice(body).unwrap()
            })
            .collect()
    }

    fn events(&self) -> Vec<&'static str> {
        self.messages().iter().map(|message| message.event.as_str()).collect()
    }

    fn ids(&self) -> Vec<String> {
        let got = self.got.lock().unwrap();
        got.iter().map(|(headers, _)| headers["webhook-id"].to_str().unwrap().to_owned()).collect()
    }
}

async fn take(State(receiver): State<Receiver>, headers: HeaderMap, body: Bytes) -> impl IntoResponse {
    receiver.got.lock().unwrap().push((headers, body));
    let status = receiver.statuses.lock().unwrap().pop_front().unwrap_or(200);
    (StatusCode::from_u16(status).unwrap(), [("location", "/hook?redirected")])
}

async fn start() -> Farm {
    Farm::start_with(|config| config.webhook_allow_private = true).await
}

/// Adds a webhook, with what it is to be told of.
async fn add(farm: &Farm, receiver: &Receiver, more: Value) -> String {
    let mut body = json!({ "url": receiver.url, "secret": SECRET });
    body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    let answer = farm.service.post("/v1/farm/webhooks", body).await;
    assert_eq!(answer.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&answer.body));
    assert!(!String::from_utf8_lossy(&answer.body).contains(SECRET), "a secret is never shown");
    let webhook: Webhook = answer.json();
    assert_eq!(answer.header("location"), format!("/v1/farm/webhooks/{}", webhook.id));
    webhook.id
}

async fn deliver(farm: &Farm) -> usize {
    farm.service.app.deliver_messages().await.unwrap()
}

async fn deliveries(farm: &Farm, webhook: &str) -> Vec<WebhookDelivery> {
    farm.service.get(&format!("/v1/farm/webhooks/{webhook}/deliveries")).await.json::<Page<_>>().items
}

async fn read(farm: &Farm, webhook: &str) -> Webhook {
    farm.service.get(&format!("/v1/farm/webhooks/{webhook}")).await.json()
}

#[tokio::test]
async fn verdicts_and_decisions_are_told_signed_and_once() {
    let (farm, receiver) = (start().await, Receiver::start(&[]).await);
    let webhook = add(&farm, &receiver, json!({})).await;
    let base = farm.run("base", json!({})).await;
    assert_eq!((deliver(&farm).await, deliver(&farm).await), (2, 0), "once");
    farm.decide(&base, "plain", "approve").await;
    let slow = farm.run("slow", json!({ "spp": 12, "exposure": 30 })).await;
    farm.run("slow, but fine", json!({})).await;
    assert_eq!(deliver(&farm).await, 5);

    let mut events = receiver.events();
    events[..2].sort_unstable();
    assert_eq!(events[..2], ["case.missing", "run.finished"]);
    events[2..].sort_unstable();
    assert_eq!(events[2..], ["case.changed", "case.slower", "decision.made", "run.finished", "run.finished"]);
    let messages = receiver.messages();
    let of = |event: WebhookEvent| messages.iter().filter(move |message| message.event == event);
    let WebhookData::Run(run) = &of(WebhookEvent::RunFinished).next().unwrap().data else { panic!("{messages:?}") };
    assert_eq!((&run.id, run.ok, run.counts.missing), (&base.summary.id, Some(false), 1), "as the run ended");
    let WebhookData::Decision(made) = &of(WebhookEvent::DecisionMade).next().unwrap().data else { panic!() };
    assert_eq!((made.who.as_str(), made.case.as_deref()), ("Ada", Some("plain")));
    for event in [WebhookEvent::CaseChanged, WebhookEvent::CaseSlower] {
        let WebhookData::Case(news) = &of(event).next().unwrap().data else { panic!("{messages:?}") };
        assert_eq!((news.run.as_str(), news.case.as_str()), (slow.summary.id.as_str(), "plain"));
        assert_eq!((news.image_verdict, news.time_verdict), (ImageVerdict::Changed, Some(TimeVerdict::Slower)));
        assert_eq!((news.device_class.as_deref(), news.label.as_str()), (Some("cpu: AVX2"), "slow"));
        assert!(news.reason.is_some());
    }
    let told = deliveries(&farm, &webhook).await;
    assert_eq!(told.len(), 7);
    assert!(told.iter().all(|one| one.state == DeliveryState::Delivered && one.next_at.is_none()));
    assert!(told.iter().all(|one| one.attempts.len() == 1 && one.attempts[0].status == Some(200)));
    let page: Page<WebhookDelivery> =
        farm.service.get(&format!("/v1/farm/webhooks/{webhook}/deliveries?limit=3")).await.json();
    assert_eq!((&page.items[..], page.next_cursor.is_some()), (&told[..3], true), "newest first");
    let read = read(&farm, &webhook).await;
    assert_eq!((read.waiting, read.error, read.delivered_at.is_some()), (0, None, true));
}

#[tokio::test]
async fn only_what_was_asked_for_is_told() {
    let (farm, receiver) = (start().await, Receiver::start(&[]).await);
    add(&farm, &receiver, json!({ "events": ["case.changed", "decision.made"] })).await;
    add(&farm, &receiver, json!({ "suite": "another" })).await;
    let base = farm.baseline().await;
    farm.run("unchanged", json!({})).await;
    farm.calibrate(5, honest).await;
    assert_eq!((deliver(&farm).await, receiver.events()), (1, vec!["decision.made"]));
    add(&farm, &receiver, json!({ "suite": "small", "events": ["decision.made"] })).await;
    let reset = json!({ "who": "Ada", "why": "anew", "suite": base.summary.suite_name });
    assert_eq!(farm.service.post("/v1/farm/baselines/main/reset", reset).await.status, StatusCode::OK);
    assert_eq!((deliver(&farm).await, receiver.events().len()), (2, 3), "one for each that wants it");
    let ids = receiver.ids();
    assert_ne!(ids[1], ids[2], "each is a message of its own");
}

#[tokio::test]
async fn what_is_not_taken_is_sent_again_under_its_id_after_growing_pauses() {
    let (farm, receiver) = (start().await, Receiver::start(&[500, 302]).await);
    let webhook = add(&farm, &receiver, json!({ "events": ["run.finished"] })).await;
    farm.run("base", json!({})).await;
    assert_eq!((deliver(&farm).await, deliver(&farm).await), (0, 0));
    assert_eq!(receiver.ids().len(), 1, "not before its time");
    let waiting = deliveries(&farm, &webhook).await.remove(0);
    let attempt = &waiting.attempts[0];
    assert_eq!((waiting.state, attempt.status), (DeliveryState::Waiting, Some(500)));
    assert_eq!(waiting.next_at.unwrap().as_millisecond(), attempt.at.as_millisecond() + 10 * SECOND_MS);
    let failing = read(&farm, &webhook).await;
    assert_eq!((failing.waiting, failing.error.as_deref()), (1, Some("it answered 500")));

    farm.service.clock.advance(10 * SECOND_MS);
    assert_eq!(deliver(&farm).await, 0, "a redirect is no success, and is not followed");
    farm.service.clock.advance(39 * SECOND_MS);
    assert_eq!((deliver(&farm).await, receiver.ids().len()), (0, 2));
    farm.service.clock.advance(SECOND_MS);
    assert_eq!((deliver(&farm).await, receiver.ids().len()), (1, 3));
    let ids = receiver.ids();
    assert!(ids.iter().all(|id| *id == waiting.id), "{ids:?}");
    let bodies: Vec<Bytes> = receiver.got.lock().unwrap().iter().map(|(_, body)| body.clone()).collect();
    assert!(bodies.iter().all(|body| *body == bodies[0]), "the message is what it was");
    assert_eq!(receiver.messages().len(), 3, "each is signed for its own time");
    let delivered = deliveries(&farm, &webhook).await.remove(0);
    let statuses: Vec<Option<u16>> = delivered.attempts.iter().map(|attempt| attempt.status).collect();
    assert_eq!((delivered.state, statuses), (DeliveryState::Delivered, vec![Some(500), Some(302), Some(200)]));
}

#[tokio::test]
async fn a_message_that_nobody_takes_is_given_up_and_forgotten_after_a_month() {
    let farm = start().await;
    let closed = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let nobody = Receiver { url: format!("http://{closed}/"), ..Receiver::default() };
    let webhook = add(&farm, &nobody, json!({ "events": ["run.finished"] })).await;
    farm.run("base", json!({})).await;
    for _ in 0..12 {
        assert_eq!(deliver(&farm).await, 0);
        farm.service.clock.advance(6 * 3600 * SECOND_MS);
    }
    let lost = deliveries(&farm, &webhook).await.remove(0);
    assert_eq!((lost.state, lost.attempts.len(), lost.next_at), (DeliveryState::GivenUp, 10, None));
    assert!(lost.attempts[9].error.as_ref().unwrap().contains("refused"), "{:?}", lost.attempts[9]);
    let forget = || farm.service.app.forget_old_deliveries();
    assert_eq!(forget().await.unwrap(), 0);
    farm.service.clock.advance(30 * 24 * 3600 * SECOND_MS);
    assert_eq!((forget().await.unwrap(), deliveries(&farm, &webhook).await.len()), (1, 0));
}

#[tokio::test]
async fn a_message_is_sent_again_when_somebody_asks_for_it() {
    let (farm, receiver) = (start().await, Receiver::start(&[500]).await);
    let webhook = add(&farm, &receiver, json!({ "events": ["run.finished"] })).await;
    farm.run("base", json!({})).await;
    assert_eq!(deliver(&farm).await, 0);
    let waiting = deliveries(&farm, &webhook).await.remove(0);
    let path = format!("/v1/farm/webhooks/{webhook}/deliveries/{}/resend", waiting.id);
    let resend = async || -> WebhookDelivery {
        let answer = farm.service.post(&path, json!(null)).await;
        assert_eq!(answer.status, StatusCode::OK, "{}", String::from_utf8_lossy(&answer.body));
        answer.json()
    };
    let sooner = resend().await;
    assert_eq!((sooner.state, sooner.attempts.len()), (DeliveryState::Waiting, 1));
    assert!(sooner.next_at < waiting.next_at, "at once, not after its pause");
    assert_eq!(deliver(&farm).await, 1);
    resend().await;
    assert_eq!(deliver(&farm).await, 1, "also one that was taken");
    let told = deliveries(&farm, &webhook).await.remove(0);
    assert_eq!((told.state, told.attempts.len()), (DeliveryState::Delivered, 3));
    assert!(receiver.ids().iter().all(|id| *id == waiting.id), "under its id, for receivers that know it");

    let other = add(&farm, &receiver, json!({})).await;
    for path in [path.replace(&webhook, &other), path.replace(&waiting.id, "none")] {
        assert_eq!(farm.service.post(&path, json!(null)).await.status, StatusCode::NOT_FOUND, "{path}");
    }
}

#[tokio::test]
async fn a_deleted_webhook_is_told_nothing_more() {
    let (farm, receiver) = (start().await, Receiver::start(&[]).await);
    let webhook = add(&farm, &receiver, json!({})).await;
    farm.run("base", json!({})).await;
    let path = format!("/v1/farm/webhooks/{webhook}");
    assert_eq!(farm.service.delete(&path).await.status, StatusCode::NO_CONTENT);
    assert_eq!((deliver(&farm).await, receiver.ids().len()), (0, 0), "what waited for it is gone too");
    assert_eq!(farm.service.delete(&path).await.status, StatusCode::NOT_FOUND);
    for path in [path.clone(), format!("{path}/deliveries")] {
        assert_eq!(farm.service.get(&path).await.status, StatusCode::NOT_FOUND, "{path}");
    }
    assert!(farm.service.get("/v1/farm/webhooks").await.json::<Page<Webhook>>().items.is_empty());
}

#[tokio::test]
async fn what_is_wrong_with_a_webhook_is_named() {
    let farm = Farm::start().await;
    let wrong = json!({ "url": "ftp://chat.example", "secret": "short", "events": ["run.finished", "run.finished"] });
    assert_eq!(farm.service.post("/v1/farm/webhooks", wrong).await.pointers(), ["/secret", "/events/1", "/url"]);
    let cases = [
        (json!({ "url": "http://127.0.0.1:9/", "secret": SECRET }), "/url"),
        (json!({ "url": "http://[::1]/", "secret": SECRET }), "/url"),
        (json!({ "url": "https://ada:secret@chat.example/", "secret": SECRET }), "/url"),
        (json!({ "url": "https://chat.example/", "secret": "whsec_this is no base64" }), "/secret"),
        (json!({ "url": "https://chat.example/", "secret": SECRET, "events": ["run"] }), "/events/0"),
        (json!({ "url": "https://chat.example/" }), "/secret"),
    ];
    for (body, pointer) in cases {
        let answer = farm.service.post("/v1/farm/webhooks", body.clone()).await;
        assert_eq!(
            (answer.status, answer.pointers()),
            (StatusCode::UNPROCESSABLE_ENTITY, vec![pointer.to_owned()]),
            "{body}"
        );
    }
    // A name that stands for this machine is found out when it is looked up.
    let receiver = Receiver::start(&[]).await;
    let named = Receiver { url: receiver.url.replace("127.0.0.1", "localhost"), ..receiver.clone() };
    let webhook = add(&farm, &named, json!({ "events": ["run.finished"] })).await;
    farm.run("base", json!({})).await;
    assert_eq!((deliver(&farm).await, receiver.ids().len()), (0, 0));
    let attempt = deliveries(&farm, &webhook).await.remove(0).attempts.remove(0);
    assert!(attempt.error.unwrap().contains("private"));
}
