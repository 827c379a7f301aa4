//! Webhooks: who is told of verdicts and decisions.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::baseline::Decision;
use super::image::ImageVerdict;
use super::run::RunSummary;
use super::text::check_name;
use super::time::TimeVerdict;
use crate::problem::FieldError;

/// What a webhook can be told of. Calibrations are no news.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
pub enum WebhookEvent {
    /// A run has the verdicts of all its cases.
    #[serde(rename = "run.finished")]
    RunFinished,
    /// A case's picture is `changed`.
    #[serde(rename = "case.changed")]
    CaseChanged,
    /// Nobody has accepted a picture of a case yet.
    #[serde(rename = "case.missing")]
    CaseMissing,
    /// A case has no picture: a job failed.
    #[serde(rename = "case.failed")]
    CaseFailed,
    /// A case's time is `slower`.
    #[serde(rename = "case.slower")]
    CaseSlower,
    /// Somebody approved, rejected or reset.
    #[serde(rename = "decision.made")]
    DecisionMade,
}

impl WebhookEvent {
    pub const ALL: [Self; 6] = [
        Self::RunFinished,
        Self::CaseChanged,
        Self::CaseMissing,
        Self::CaseFailed,
        Self::CaseSlower,
        Self::DecisionMade,
    ];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::RunFinished => "run.finished",
            Self::CaseChanged => "case.changed",
            Self::CaseMissing => "case.missing",
            Self::CaseFailed => "case.failed",
            Self::CaseSlower => "case.slower",
            Self::DecisionMade => "decision.made",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|event| event.as_str() == name)
    }
}

/// Body of `POST /v1/farm/webhooks`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "url": "https://chat.example/hooks/lightshaft",
    "secret": "correct horse battery staple",
    "events": ["run.finished", "case.slower"]
}))]
pub struct NewWebhook {
    /// Where to POST to: http or https, without a user name; at most 2000 characters. Redirects are not followed.
    pub url: String,
    /// Signs every message, and is never shown again: 16 to 256 characters. What begins with `whsec_` holds the key in
    /// base64, as libraries for Standard Webhooks expect; otherwise the text is the key.
    pub secret: String,
    /// All when empty.
    #[serde(default)]
    pub events: Vec<WebhookEvent>,
    /// Only of the suite of this name; of all when null.
    #[serde(default)]
    pub suite: Option<String>,
}

impl NewWebhook {
    /// Every field that is out of range; the address is read by the service.
    pub fn validate(&self) -> Vec<FieldError> {
        let mut errors = Vec::new();
        if self.url.chars().count() > 2000 {
            errors.push(FieldError::new("/url", "must have at most 2000 characters"));
        }
        if !(16..=256).contains(&self.secret.chars().count()) {
            errors.push(FieldError::new("/secret", "must have 16 to 256 characters"));
        }
        for (i, event) in self.events.iter().enumerate().filter(|(i, event)| self.events[..*i].contains(event)) {
            errors.push(FieldError::new(format!("/events/{i}"), format!("`{}` is named twice", event.as_str())));
        }
        errors.extend(self.suite.as_ref().and_then(|name| check_name(name, 100, "/suite")));
        errors
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Webhook {
    pub id: String,
    pub url: String,
    /// All when empty.
    pub events: Vec<WebhookEvent>,
    pub suite: Option<String>,
    pub created_at: Timestamp,
    /// Messages that are still to be delivered.
    pub waiting: u32,
    /// When one was last taken.
    pub delivered_at: Option<Timestamp>,
    /// What the last attempt failed of; null after a success, and before the first.
    pub error: Option<String>,
}

/// What is sent, with the headers of Standard Webhooks: `webhook-id` stays the same when a message is sent again,
/// `webhook-timestamp` is the time of the attempt in seconds, and `webhook-signature` is `v1,` and the base64 of HMAC-SHA256
/// over `id.timestamp.body`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WebhookMessage {
    #[serde(rename = "type")]
    pub event: WebhookEvent,
    /// When it happened.
    pub timestamp: Timestamp,
    pub data: WebhookData,
}

/// The run of `run.finished`, the decision of `decision.made`, the case of the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum WebhookData {
    Run(Box<RunSummary>),
    Decision(Box<Decision>),
    Case(CaseNews),
}

/// A case that does not pass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CaseNews {
    /// Id of the run.
    pub run: String,
    /// Name of the suite.
    pub suite: String,
    /// Name of the case.
    pub case: String,
    pub label: String,
    pub baseline: String,
    pub device_class: Option<String>,
    pub image_verdict: ImageVerdict,
    pub time_verdict: Option<TimeVerdict>,
    /// Why, in words.
    pub reason: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeliveryState {
    /// It is sent at `next_at`.
    Waiting,
    Delivered,
    /// Every attempt failed.
    GivenUp,
}

impl DeliveryState {
    pub const ALL: [Self; 3] = [Self::Waiting, Self::Delivered, Self::GivenUp];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Delivered => "delivered",
            Self::GivenUp => "given_up",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == name)
    }
}

/// A message on its way to a webhook.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WebhookDelivery {
    /// As in `webhook-id`.
    pub id: String,
    pub state: DeliveryState,
    /// When it is sent next; null when it is not.
    pub next_at: Option<Timestamp>,
    pub message: WebhookMessage,
    /// In their order.
    pub attempts: Vec<DeliveryAttempt>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DeliveryAttempt {
    pub at: Timestamp,
    /// How long it took.
    pub seconds: f64,
    /// What the receiver answered; null when it did not.
    pub status: Option<u16>,
    /// Null when the message was taken: the status was 200 to 299.
    pub error: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pointers(webhook: &NewWebhook) -> Vec<String> {
        webhook.validate().into_iter().map(|error| error.pointer).collect()
    }

    #[test]
    fn every_wrong_field_is_named() {
        let good = NewWebhook {
            url: "https://chat.example/".to_owned(),
            secret: "0123456789abcdef".to_owned(),
            events: WebhookEvent::ALL.to_vec(),
            suite: Some("cars".to_owned()),
        };
        assert!(good.validate().is_empty());
        let twice = WebhookEvent::CaseSlower;
        let bad = NewWebhook {
            url: "x".repeat(2001),
            secret: "short".to_owned(),
            events: vec![twice, twice],
            suite: Some(String::new()),
        };
        assert_eq!(pointers(&bad), ["/url", "/secret", "/events/1", "/suite"]);
    }

    #[test]
    fn names_of_events_are_those_of_the_wire() {
        for event in WebhookEvent::ALL {
            assert_eq!(serde_json::to_value(event).unwrap(), event.as_str());
            assert_eq!(WebhookEvent::from_name(event.as_str()), Some(event));
        }
        assert_eq!(WebhookEvent::from_name("case"), None);
    }
}
