//! Webhooks: messages of verdicts and decisions, signed, at least once.
//!
//! Whatever a message tells of is written to an outbox in the transaction that makes it true, so that no crash loses one; a
//! chore delivers them, with pauses that grow after each failure, and notes every attempt. Nothing waits for it. The form is
//! that of Standard Webhooks (github.com/standard-webhooks/standard-webhooks).

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use futures::future::join_all;
use hmac::{Hmac, KeyInit, Mac};
use http::header::{CONTENT_TYPE, USER_AGENT};
use http::{HeaderMap, HeaderName, HeaderValue};
use jiff::Timestamp;
use lightshaft_api::farm::{DeliveryAttempt, NewWebhook, Webhook, WebhookDelivery};
use lightshaft_api::problem::FieldError;
use sha2::Sha256;
use tokio::time::Instant;
use uuid::Uuid;

use super::super::App;
use crate::error::{ApiError, ApiResult};
use crate::queue::Millis;
use crate::store::{AfterAttempt, DueDelivery, PageRequest};

/// Webhooks that there may be.
const MOST_WEBHOOKS: usize = 100;
/// Messages sent in one go, all at once: a receiver that does not answer keeps the others for one time-out.
const BATCH: u32 = 32;
/// After so many attempts, over most of a day, a message is given up.
const MOST_ATTEMPTS: u32 = 10;
const FIRST_PAUSE_MS: Millis = 10_000;
const LONGEST_PAUSE_MS: Millis = 6 * 3_600_000;
/// How long it is told what became of a message.
const KEPT_MS: Millis = 30 * 24 * 3_600_000;

impl App {
    pub async fn create_webhook(&self, new: &NewWebhook) -> ApiResult<Webhook> {
        let mut errors = new.validate();
        if let Err(error) = self.messenger.check(&new.url) {
            errors.push(FieldError::new("/url", error.to_string()));
        }
        if signing_key(&new.secret).is_none() {
            errors.push(FieldError::new("/secret", "must hold base64 after `whsec_`"));
        }
        if self.store.webhooks(None).await?.len() >= MOST_WEBHOOKS {
            let detail = format!("there are {MOST_WEBHOOKS} webhooks already: delete one first");
            errors.push(FieldError::new("/url", detail));
        }
        if !errors.is_empty() {
            return Err(ApiError::fields(errors));
        }
        let id = Uuid::now_v7().to_string();
        self.store.add_webhook(&id, new, self.now()).await?;
        tracing::info!(webhook.id = %id, "webhook added");
        self.webhook(&id).await
    }

    pub async fn webhooks(&self) -> ApiResult<Vec<Webhook>> {
        Ok(self.store.webhooks(None).await?)
    }

    pub async fn webhook(&self, id: &str) -> ApiResult<Webhook> {
        self.store.webhooks(Some(id)).await?.pop().ok_or_else(|| ApiError::not_found("webhook", id))
    }

    pub async fn delete_webhook(&self, id: &str) -> ApiResult<()> {
        let deleted = self.store.delete_webhook(id).await?;
        if deleted { Ok(()) } else { Err(ApiError::not_found("webhook", id)) }
    }

    /// What became of a webhook's messages, newest first.
    pub async fn deliveries(&self, webhook: &str, page: &PageRequest) -> ApiResult<Vec<WebhookDelivery>> {
        self.webhook(webhook).await?;
        Ok(self.store.deliveries(webhook, page).await?)
    }

    /// Has a message sent now, whatever became of it.
    pub async fn resend_delivery(&self, webhook: &str, delivery: &str) -> ApiResult<WebhookDelivery> {
        let unknown = || ApiError::not_found("delivery", delivery);
        if !self.store.resend(webhook, delivery, self.now()).await? {
            return Err(unknown());
        }
        tracing::info!(webhook.id = %webhook, delivery.id = %delivery, "a message is to be sent again");
        self.store.delivery(webhook, delivery).await?.ok_or_else(unknown)
    }

    /// Sends messages that are due, at most a batch; returns how many were taken.
    pub async fn deliver_messages(&self) -> ApiResult<usize> {
        let due = self.store.due_deliveries(self.now(), BATCH).await?;
        let outcomes = join_all(due.into_iter().map(|delivery| self.deliver(delivery))).await;
        outcomes.into_iter().try_fold(0, |taken, outcome| Ok(taken + usize::from(outcome?)))
    }

    /// Forgets what ended long ago, at most a batch; returns how many.
    pub async fn forget_old_deliveries(&self) -> ApiResult<u64> {
        Ok(self.store.forget_deliveries(self.now() - KEPT_MS).await?)
    }

    /// One attempt; whether the message was taken.
    async fn deliver(&self, delivery: DueDelivery) -> ApiResult<bool> {
        let at = self.now();
        let begun = Instant::now();
        let headers = headers(&delivery, at / 1000)?;
        let answer = self.messenger.post(&delivery.url, headers, Bytes::from(delivery.body.clone())).await;
        let (status, error) = match answer {
            Ok(status @ 200..=299) => (Some(status), None),
            Ok(status) => (Some(status), Some(format!("it answered {status}"))),
            Err(error) => (None, Some(error)),
        };
        let is_taken = error.is_none();
        let after = match pause_after(delivery.attempts + 1) {
            _ if is_taken => AfterAttempt::Delivered,
            Some(pause) => AfterAttempt::AgainAt(self.now() + pause),
            None => AfterAttempt::GivenUp,
        };
        if !is_taken {
            tracing::warn!(webhook.id = %delivery.webhook, delivery.id = %delivery.id, status, "a message was not taken");
        }
        let at = Timestamp::from_millisecond(at).map_err(ApiError::internal)?;
        let attempt = DeliveryAttempt { at, seconds: begun.elapsed().as_secs_f64(), status, error };
        self.store.note_attempt(&delivery, &attempt, after).await?;
        Ok(is_taken)
    }
}

fn headers(delivery: &DueDelivery, timestamp_s: i64) -> ApiResult<HeaderMap> {
    let signature = signature(&delivery.secret, &delivery.id, timestamp_s, delivery.body.as_bytes());
    let signature = signature.ok_or_else(|| ApiError::internal("a webhook's secret that is none"))?;
    let mut headers = HeaderMap::new();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static("application/json"));
    headers.insert(USER_AGENT, HeaderValue::from_static(concat!("lightshaft/", env!("CARGO_PKG_VERSION"))));
    for (name, value) in [
        ("webhook-id", delivery.id.clone()),
        ("webhook-timestamp", timestamp_s.to_string()),
        ("webhook-signature", signature),
    ] {
        headers.insert(HeaderName::from_static(name), HeaderValue::try_from(value).map_err(ApiError::internal)?);
    }
    Ok(headers)
}

/// `None` of a `whsec_` that is followed by no base64.
fn signing_key(secret: &str) -> Option<Vec<u8>> {
    match secret.strip_prefix("whsec_") {
        Some(encoded) => STANDARD.decode(encoded).ok(),
        None => Some(secret.as_bytes().to_vec()),
    }
}

/// `v1,` and the base64 of HMAC-SHA256 (RFC 2104) over `id.timestamp.body`.
fn signature(secret: &str, id: &str, timestamp_s: i64, body: &[u8]) -> Option<String> {
    let mut mac = Hmac::<Sha256>::new_from_slice(&signing_key(secret)?).ok()?;
    mac.update(format!("{id}.{timestamp_s}.").as_bytes());
    mac.update(body);
    Some(format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes())))
}

/// How long to wait after so many attempts: four times longer each, up to six hours. `None` to give up.
fn pause_after(attempts: u32) -> Option<Millis> {
    (attempts < MOST_ATTEMPTS).then(|| (FIRST_PAUSE_MS << (2 * (attempts - 1))).min(LONGEST_PAUSE_MS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signature_is_that_of_openssl() {
        // printf 'id.1700000000.{}' | openssl dgst -sha256 -hmac 'correct horse battery staple' -binary | base64
        let found = signature("correct horse battery staple", "id", 1_700_000_000, b"{}").unwrap();
        assert_eq!(found, "v1,fzp35csu/x12f11qmqBWIGYlSFAVr+pjSVDsssVuMfk=");
    }

    #[test]
    fn a_signature_is_that_of_standard_webhooks() {
        // The example of the specification's reference libraries.
        let body = br#"{"test": 2432232314}"#;
        let found =
            signature("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, body);
        assert_eq!(found.unwrap(), "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
        assert_eq!(signing_key("whsec_no base64 at all"), None);
    }

    #[test]
    fn pauses_grow_and_end() {
        let pauses: Vec<Option<Millis>> = (1..=10).map(pause_after).collect();
        assert_eq!(pauses[..3], [Some(10_000), Some(40_000), Some(160_000)]);
        assert_eq!((pauses[8], pauses[9]), (Some(LONGEST_PAUSE_MS), None));
        let total: Millis = pauses.into_iter().flatten().sum();
        assert!((20 * 3_600_000..24 * 3_600_000).contains(&total), "most of a day: {total} ms");
    }
}
