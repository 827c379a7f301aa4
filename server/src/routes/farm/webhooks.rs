//! `/v1/farm/webhooks`

use axum::Json as Reply;
use axum::extract::State;
use http::{StatusCode, header};
use lightshaft_api::farm::{NewWebhook, Webhook, WebhookDelivery};
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;

use super::runs::Made;
use crate::app::Shared;
use crate::error::ApiResult;
use crate::store::PageRequest;
use crate::web::body::{Id, Ids, Json, PageParams, Params};
use crate::web::page::page;

/// Adds a webhook: an address that is told of verdicts and decisions, in the form of Standard Webhooks
/// (github.com/standard-webhooks): `WebhookMessage` as JSON with the headers `webhook-id`, `webhook-timestamp` and
/// `webhook-signature`. Whoever gets it answers 200 to 299 within 10 seconds; otherwise it is sent again after growing
/// pauses, 10 times in most of a day. A message may come twice, with the same `webhook-id`, and messages may overtake each
/// other.
#[utoipa::path(
    post, path = "/v1/farm/webhooks", tag = "farm", request_body = NewWebhook,
    responses(
        (status = 201, description = "Added", body = Webhook),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn create_webhook(
    State(app): State<Shared>,
    Json(new): Json<NewWebhook>,
) -> ApiResult<Made<Webhook>> {
    let webhook = app.create_webhook(&new).await?;
    let location = [(header::LOCATION, format!("/v1/farm/webhooks/{}", webhook.id))];
    Ok((StatusCode::CREATED, location, Reply(webhook)))
}

/// All webhooks, oldest first, without their secrets.
#[utoipa::path(
    get, path = "/v1/farm/webhooks", tag = "farm",
    responses(
        (status = 200, body = Page<Webhook>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn list_webhooks(State(app): State<Shared>) -> ApiResult<Reply<Page<Webhook>>> {
    Ok(Reply(Page { items: app.webhooks().await?, next_cursor: None }))
}

/// A webhook, and how its last attempt went.
#[utoipa::path(
    get, path = "/v1/farm/webhooks/{id}", tag = "farm", params(("id" = String, Path, description = "The webhook")),
    responses(
        (status = 200, body = Webhook),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn get_webhook(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Webhook>> {
    Ok(Reply(app.webhook(&id).await?))
}

/// Deletes a webhook with the messages that wait for it.
#[utoipa::path(
    delete, path = "/v1/farm/webhooks/{id}", tag = "farm", params(("id" = String, Path, description = "The webhook")),
    responses(
        (status = 204, description = "Deleted"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn delete_webhook(State(app): State<Shared>, Id(id): Id) -> ApiResult<StatusCode> {
    app.delete_webhook(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Messages of a webhook with every attempt to deliver them, newest first. What ended is forgotten after 30 days.
#[utoipa::path(
    get, path = "/v1/farm/webhooks/{id}/deliveries", tag = "farm",
    params(("id" = String, Path, description = "The webhook"), PageParams),
    responses(
        (status = 200, body = Page<WebhookDelivery>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn list_deliveries(
    State(app): State<Shared>,
    Id(id): Id,
    Params(rows): Params<PageParams>,
) -> ApiResult<Reply<Page<WebhookDelivery>>> {
    let request = PageRequest { limit: rows.limit()? + 1, after: rows.after_id()? };
    Ok(page(app.deliveries(&id, &request).await?, request.limit, |delivery| &delivery.id))
}

/// Sends a message again now, under its id: one that was given up, one that waits for its next attempt, or one that was
/// taken and lost by its receiver. Every further attempt is noted like the first.
#[utoipa::path(
    post, path = "/v1/farm/webhooks/{id}/deliveries/{delivery}/resend", tag = "farm",
    params(
        ("id" = String, Path, description = "The webhook"),
        ("delivery" = String, Path, description = "The message"),
    ),
    responses(
        (status = 200, description = "It waits to be sent", body = WebhookDelivery),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn resend_delivery(
    State(app): State<Shared>,
    Ids(id, delivery): Ids,
) -> ApiResult<Reply<WebhookDelivery>> {
    Ok(Reply(app.resend_delivery(&id, &delivery).await?))
}
