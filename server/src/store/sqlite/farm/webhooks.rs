//! Webhooks, and the outbox of their messages.

use std::collections::BTreeMap;

use async_trait::async_trait;
use jiff::Timestamp;
use lightshaft_api::farm::{
    CaseNews, Decision, DeliveryAttempt, DeliveryState, ImageVerdict, NewWebhook, RunKind, TimeVerdict, Webhook,
    WebhookData, WebhookDelivery, WebhookEvent, WebhookMessage,
};
use sqlx::FromRow;
use uuid::Uuid;

use super::runs::read_summary;
use crate::queue::Millis;
use crate::store::sqlite::{SqliteStore, Tx, commit, context, from_json, from_name, timestamp, to_json};
use crate::store::{AfterAttempt, CaseStep, DueDelivery, OpenCase, PageRequest, Result, WebhookStore};

/// Deliveries that are forgotten in one transaction.
const FORGET_BATCH: u32 = 1000;

#[derive(FromRow)]
struct WebhookRow {
    id: String,
    url: String,
    events: String,
    suite_name: Option<String>,
    created_at: i64,
    waiting: u32,
    delivered_at: Option<i64>,
    error: Option<String>,
}

#[derive(FromRow)]
struct DueRow {
    id: String,
    webhook_id: String,
    url: String,
    secret: String,
    body: String,
    attempts: u32,
}

#[derive(FromRow)]
struct DeliveryRow {
    id: String,
    state: String,
    due_at: Option<i64>,
    body: String,
}

impl DeliveryRow {
    fn into_delivery(self, attempts: Vec<DeliveryAttempt>) -> Result<WebhookDelivery> {
        Ok(WebhookDelivery {
            state: from_name(&self.state)?,
            next_at: self.due_at.map(timestamp).transpose()?,
            message: from_json(&self.body)?,
            attempts,
            id: self.id,
        })
    }
}

#[derive(FromRow)]
struct AttemptRow {
    delivery_id: String,
    at: i64,
    seconds: f64,
    status: Option<u16>,
    error: Option<String>,
}

#[async_trait]
impl WebhookStore for SqliteStore {
    async fn add_webhook(&self, id: &str, new: &NewWebhook, now: Millis) -> Result<()> {
        sqlx::query(
            "INSERT INTO farm_webhook (id, url, secret, events, suite_name, created_at) VALUES ($1, $2, $3, $4, $5, $6)",
        )
        .bind(id)
        .bind(&new.url)
        .bind(&new.secret)
        .bind(to_json(&new.events)?)
        .bind(&new.suite)
        .bind(now)
        .execute(&self.writer)
        .await
        .map_err(context("adding a webhook"))?;
        Ok(())
    }

    async fn webhooks(&self, id: Option<&str>) -> Result<Vec<Webhook>> {
        let rows: Vec<WebhookRow> = sqlx::query_as(
            "SELECT w.id, w.url, w.events, w.suite_name, w.created_at,
                    (SELECT COUNT(*) FROM farm_delivery d WHERE d.webhook_id = w.id AND d.state = 'waiting') AS waiting,
                    (SELECT MAX(a.at) FROM farm_delivery d JOIN farm_attempt a ON a.delivery_id = d.id
                     WHERE d.webhook_id = w.id AND a.error IS NULL) AS delivered_at,
                    (SELECT a.error FROM farm_delivery d JOIN farm_attempt a ON a.delivery_id = d.id
                     WHERE d.webhook_id = w.id ORDER BY a.at DESC, a.delivery_id DESC LIMIT 1) AS error
             FROM farm_webhook w WHERE $1 IS NULL OR w.id = $1 ORDER BY w.id",
        )
        .bind(id)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading webhooks"))?;
        rows.into_iter()
            .map(|row| {
                Ok(Webhook {
                    id: row.id,
                    url: row.url,
                    events: from_json(&row.events)?,
                    suite: row.suite_name,
                    created_at: timestamp(row.created_at)?,
                    waiting: row.waiting,
                    delivered_at: row.delivered_at.map(timestamp).transpose()?,
                    error: row.error,
                })
            })
            .collect()
    }

    async fn delete_webhook(&self, id: &str) -> Result<bool> {
        let deleted = sqlx::query("DELETE FROM farm_webhook WHERE id = $1")
            .bind(id)
            .execute(&self.writer)
            .await
            .map_err(context("deleting a webhook"))?;
        Ok(deleted.rows_affected() > 0)
    }

    async fn due_deliveries(&self, now: Millis, limit: u32) -> Result<Vec<DueDelivery>> {
        let rows: Vec<DueRow> = sqlx::query_as(
            "SELECT d.id, d.webhook_id, w.url, w.secret, d.body,
                    (SELECT COUNT(*) FROM farm_attempt a WHERE a.delivery_id = d.id) AS attempts
             FROM farm_delivery d JOIN farm_webhook w ON w.id = d.webhook_id
             WHERE d.state = 'waiting' AND d.due_at <= $1 ORDER BY d.due_at, d.id LIMIT $2",
        )
        .bind(now)
        .bind(limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading the outbox"))?;
        let delivery = |row: DueRow| DueDelivery {
            id: row.id,
            webhook: row.webhook_id,
            url: row.url,
            secret: row.secret,
            body: row.body,
            attempts: row.attempts,
        };
        Ok(rows.into_iter().map(delivery).collect())
    }

    async fn note_attempt(&self, due: &DueDelivery, attempt: &DeliveryAttempt, after: AfterAttempt) -> Result<()> {
        let (state, due_at) = match after {
            AfterAttempt::Delivered => (DeliveryState::Delivered, None),
            AfterAttempt::AgainAt(at) => (DeliveryState::Waiting, Some(at)),
            AfterAttempt::GivenUp => (DeliveryState::GivenUp, None),
        };
        let mut tx = self.begin().await?;
        let noted = sqlx::query("UPDATE farm_delivery SET state = $2, due_at = $3 WHERE id = $1 AND state = 'waiting'")
            .bind(&due.id)
            .bind(state.as_str())
            .bind(due_at)
            .execute(&mut *tx)
            .await
            .map_err(context("noting what became of a message"))?;
        // Its webhook may have been deleted meanwhile.
        if noted.rows_affected() > 0 {
            sqlx::query(
                "INSERT INTO farm_attempt (delivery_id, number, at, seconds, status, error) VALUES ($1, $2, $3, $4, $5, $6)",
            )
            .bind(&due.id)
            .bind(due.attempts + 1)
            .bind(attempt.at.as_millisecond())
            .bind(attempt.seconds)
            .bind(attempt.status)
            .bind(&attempt.error)
            .execute(&mut *tx)
            .await
            .map_err(context("noting an attempt"))?;
        }
        commit(tx).await
    }

    async fn deliveries(&self, webhook: &str, page: &PageRequest) -> Result<Vec<WebhookDelivery>> {
        let rows: Vec<DeliveryRow> = sqlx::query_as(
            "SELECT id, state, due_at, body FROM farm_delivery WHERE webhook_id = $1 AND ($2 IS NULL OR id < $2)
             ORDER BY id DESC LIMIT $3",
        )
        .bind(webhook)
        .bind(&page.after)
        .bind(page.limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading deliveries"))?;
        let mut attempts = match (rows.first(), rows.last()) {
            (Some(newest), Some(oldest)) => self.read_delivery_attempts(webhook, &oldest.id, &newest.id).await?,
            _ => BTreeMap::new(),
        };
        rows.into_iter()
            .map(|row| {
                let attempts = attempts.remove(&row.id).unwrap_or_default();
                row.into_delivery(attempts)
            })
            .collect()
    }

    async fn delivery(&self, webhook: &str, id: &str) -> Result<Option<WebhookDelivery>> {
        let row: Option<DeliveryRow> =
            sqlx::query_as("SELECT id, state, due_at, body FROM farm_delivery WHERE webhook_id = $1 AND id = $2")
                .bind(webhook)
                .bind(id)
                .fetch_optional(&self.readers)
                .await
                .map_err(context("reading a delivery"))?;
        let Some(row) = row else { return Ok(None) };
        let attempts = self.read_delivery_attempts(webhook, id, id).await?.remove(id).unwrap_or_default();
        row.into_delivery(attempts).map(Some)
    }

    async fn resend(&self, webhook: &str, delivery: &str, now: Millis) -> Result<bool> {
        let changed =
            sqlx::query("UPDATE farm_delivery SET state = 'waiting', due_at = $3 WHERE webhook_id = $1 AND id = $2")
                .bind(webhook)
                .bind(delivery)
                .bind(now)
                .execute(&self.writer)
                .await
                .map_err(context("having a message sent again"))?;
        Ok(changed.rows_affected() > 0)
    }

    async fn forget_deliveries(&self, before: Millis) -> Result<u64> {
        let deleted = sqlx::query(
            "DELETE FROM farm_delivery WHERE id IN
                 (SELECT id FROM farm_delivery WHERE state <> 'waiting' AND created_at < $1 LIMIT $2)",
        )
        .bind(before)
        .bind(FORGET_BATCH)
        .execute(&self.writer)
        .await
        .map_err(context("forgetting deliveries"))?;
        Ok(deleted.rows_affected())
    }
}

impl SqliteStore {
    async fn read_delivery_attempts(
        &self,
        webhook: &str,
        oldest: &str,
        newest: &str,
    ) -> Result<BTreeMap<String, Vec<DeliveryAttempt>>> {
        let rows: Vec<AttemptRow> = sqlx::query_as(
            "SELECT a.delivery_id, a.at, a.seconds, a.status, a.error
             FROM farm_delivery d JOIN farm_attempt a ON a.delivery_id = d.id
             WHERE d.webhook_id = $1 AND d.id BETWEEN $2 AND $3 ORDER BY a.delivery_id, a.number",
        )
        .bind(webhook)
        .bind(oldest)
        .bind(newest)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading attempts"))?;
        let mut attempts: BTreeMap<String, Vec<DeliveryAttempt>> = BTreeMap::new();
        for row in rows {
            let attempt =
                DeliveryAttempt { at: timestamp(row.at)?, seconds: row.seconds, status: row.status, error: row.error };
            attempts.entry(row.delivery_id).or_default().push(attempt);
        }
        Ok(attempts)
    }
}

/// Tells of a case's verdict, where it is one that does not pass, and of the run that ended with it.
pub(super) async fn tell_of_case(
    tx: &mut Tx,
    case: &OpenCase,
    step: &CaseStep,
    run_has_ended: bool,
    now: Millis,
) -> Result<()> {
    if case.kind != RunKind::Check {
        return Ok(());
    }
    if let Some(image) = &step.image {
        let of_picture = match image.verdict {
            ImageVerdict::Identical | ImageVerdict::WithinTolerance => None,
            ImageVerdict::Changed => Some((WebhookEvent::CaseChanged, image.reason.clone())),
            ImageVerdict::Missing => Some((WebhookEvent::CaseMissing, image.reason.clone())),
            ImageVerdict::Failed => Some((WebhookEvent::CaseFailed, image.reason.clone())),
        };
        let time_verdict = step.time.as_ref().and_then(|time| time.verdict);
        let of_time = step.time.as_ref().filter(|_| time_verdict == Some(TimeVerdict::Slower));
        let of_time = of_time.map(|time| (WebhookEvent::CaseSlower, Some(time.reason.clone())));
        for (event, reason) in of_picture.into_iter().chain(of_time) {
            let news = CaseNews {
                run: case.run.clone(),
                suite: case.suite_name.clone(),
                case: case.case.name.clone(),
                label: case.label.clone(),
                baseline: case.baseline.clone(),
                device_class: step.device_class.clone().or_else(|| case.case.device_class.clone()),
                image_verdict: image.verdict,
                time_verdict,
                reason,
            };
            tell(tx, event, &case.suite_name, WebhookData::Case(news), now).await?;
        }
    }
    if run_has_ended {
        let run = read_summary(tx, &case.run).await?;
        tell(tx, WebhookEvent::RunFinished, &case.suite_name, WebhookData::Run(Box::new(run)), now).await?;
    }
    Ok(())
}

pub(super) async fn tell_of_decision(tx: &mut Tx, decision: &Decision) -> Result<()> {
    let data = WebhookData::Decision(Box::new(decision.clone()));
    tell(tx, WebhookEvent::DecisionMade, &decision.suite, data, decision.at.as_millisecond()).await
}

/// Puts a message into the outbox, once for each webhook that wants it.
async fn tell(tx: &mut Tx, event: WebhookEvent, suite: &str, data: WebhookData, now: Millis) -> Result<()> {
    let wanting: Vec<String> = sqlx::query_scalar(
        "SELECT id FROM farm_webhook
         WHERE (suite_name IS NULL OR suite_name = $1)
           AND (json_array_length(events) = 0 OR EXISTS (SELECT 1 FROM json_each(events) WHERE value = $2))",
    )
    .bind(suite)
    .bind(event.as_str())
    .fetch_all(&mut **tx)
    .await
    .map_err(context("looking for webhooks"))?;
    if wanting.is_empty() {
        return Ok(());
    }
    let timestamp: Timestamp = timestamp(now)?;
    let body = to_json(&WebhookMessage { event, timestamp, data })?;
    for webhook in wanting {
        sqlx::query(
            "INSERT INTO farm_delivery (id, webhook_id, body, state, due_at, created_at)
             VALUES ($1, $2, $3, 'waiting', $4, $4)",
        )
        .bind(Uuid::now_v7().to_string())
        .bind(webhook)
        .bind(&body)
        .bind(now)
        .execute(&mut **tx)
        .await
        .map_err(context("writing to the outbox"))?;
    }
    Ok(())
}
