//! `/farm/webhooks`: who is told of verdicts and decisions, and adding one; `/farm/webhooks/{id}`: what became of each
//! message.

use askama::Template;
use axum::extract::{Path, Query};
use axum::response::{IntoResponse, Response};
use lightshaft_api::farm::{Webhook, WebhookData, WebhookDelivery, WebhookEvent};
use lightshaft_api::page::Page as List;
use serde::Deserialize;

use super::super::client::{Api, escape, with_query};
use super::super::filters;
use super::super::page::{Page, PageError};

/// Messages of a page.
const DELIVERIES: u32 = 50;

#[derive(Template)]
#[template(path = "farm_webhooks.html")]
struct WebhooksPage {
    here: &'static str,
    webhooks: Vec<Webhook>,
    events: [WebhookEvent; 6],
}

pub(in crate::dashboard) async fn list(api: Api) -> Result<Response, PageError> {
    let webhooks: List<Webhook> = api.get("/v1/farm/webhooks").await?;
    Ok(Page(WebhooksPage { here: "farm", webhooks: webhooks.items, events: WebhookEvent::ALL }).into_response())
}

/// Which messages, as the links of the page have it.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(in crate::dashboard) struct Place {
    cursor: String,
}

#[derive(Template)]
#[template(path = "farm_webhook.html")]
struct WebhookPage {
    here: &'static str,
    webhook: Webhook,
    deliveries: Vec<Told>,
    first: Option<String>,
    next: Option<String>,
}

/// A message, and what it tells of.
struct Told {
    delivery: WebhookDelivery,
    /// Id of the run that it is about.
    run: Option<String>,
    about: String,
    /// What was sent, laid out for reading.
    body: String,
}

impl Told {
    fn of(delivery: WebhookDelivery) -> Self {
        let (run, about) = match &delivery.message.data {
            WebhookData::Run(run) => (Some(run.id.clone()), format!("{} at {}", run.suite_name, run.label)),
            WebhookData::Case(news) => {
                (Some(news.run.clone()), format!("{}: {} at {}", news.suite, news.case, news.label))
            }
            WebhookData::Decision(made) => {
                let case = made.case.as_deref().unwrap_or("all cases");
                (made.run.clone(), format!("{} {} by {}: {case}", made.suite, made.kind.as_str(), made.who))
            }
        };
        let body = serde_json::to_string_pretty(&delivery.message).unwrap_or_default();
        Self { delivery, run, about, body }
    }
}

pub(in crate::dashboard) async fn show(
    api: Api,
    Path(id): Path<String>,
    Query(place): Query<Place>,
) -> Result<Response, PageError> {
    let path = format!("/v1/farm/webhooks/{}", escape(&id));
    let webhook: Webhook = api.get(&path).await?;
    let deliveries = with_query(&format!("{path}/deliveries?limit={DELIVERIES}"), &[("cursor", &place.cursor)]);
    let deliveries: List<WebhookDelivery> = api.get(&deliveries).await?;
    let here = format!("/farm/webhooks/{}", escape(&id));
    let page = WebhookPage {
        here: "farm",
        webhook,
        first: (!place.cursor.is_empty()).then(|| here.clone()),
        next: deliveries.next_cursor.map(|cursor| with_query(&here, &[("cursor", &cursor)])),
        deliveries: deliveries.items.into_iter().map(Told::of).collect(),
    };
    Ok(Page(page).into_response())
}
