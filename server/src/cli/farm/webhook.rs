//! `lightshaft farm webhook …`

use lightshaft_api::client::Client;
use lightshaft_api::farm::{NewWebhook, Webhook, WebhookDelivery, WebhookEvent};

use super::{Global, Result, output};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Tell an address of verdicts and decisions.
    Add(AddArgs),
    /// List webhooks, and how they fare.
    List,
    /// Delete a webhook with the messages that wait for it.
    Delete {
        /// Its id.
        id: String,
    },
    /// Send a message again, now; whatever became of it.
    Resend {
        /// Id of the webhook.
        id: String,
        /// Id of the message, as `deliveries` lists it.
        delivery: String,
    },
    /// List a webhook's messages with the attempts to deliver them, newest first.
    Deliveries {
        /// Its id.
        id: String,
    },
}

#[derive(Debug, clap::Args)]
pub(crate) struct AddArgs {
    /// Where to post to: http or https.
    url: String,
    /// Signs messages, 16 to 256 characters; better by the environment, since others see a command's arguments.
    #[arg(long, env = "LIGHTSHAFT_WEBHOOK_SECRET", hide_env_values = true)]
    secret: String,
    /// Only this event; may be repeated. [default: all]
    #[arg(long = "event", value_parser = parse_event, value_name = "EVENT")]
    events: Vec<WebhookEvent>,
    /// Only of this suite.
    #[arg(long, value_name = "NAME")]
    suite: Option<String>,
}

pub(super) async fn run(command: &Command, client: &Client, global: &Global) -> Result<()> {
    match command {
        Command::Add(args) => {
            let new = NewWebhook {
                url: args.url.clone(),
                secret: args.secret.clone(),
                events: args.events.clone(),
                suite: args.suite.clone(),
            };
            let webhook = client.create_webhook(&new).await?;
            if global.json { output::print_json(&webhook) } else { print(&[webhook]) }
        }
        Command::List => {
            let webhooks = client.webhooks().await?.items;
            if global.json { output::print_json(&webhooks) } else { print(&webhooks) }
        }
        Command::Delete { id } => Ok(client.delete_webhook(id).await?),
        Command::Resend { id, delivery } => {
            let delivery = client.resend_delivery(id, delivery).await?;
            if global.json { output::print_json(&delivery) } else { print_deliveries(&[delivery]) }
        }
        Command::Deliveries { id } => {
            let deliveries = client.deliveries(id, None).await?.items;
            if global.json { output::print_json(&deliveries) } else { print_deliveries(&deliveries) }
        }
    }
}

fn parse_event(name: &str) -> std::result::Result<WebhookEvent, String> {
    let names = WebhookEvent::ALL.map(WebhookEvent::as_str).join(", ");
    WebhookEvent::from_name(name).ok_or_else(|| format!("must be one of {names}"))
}

fn print(webhooks: &[Webhook]) -> Result<()> {
    let mut table = output::Table::new(&["id", "address", "events", "suite", "waiting", "delivered", "error"]);
    for webhook in webhooks {
        let events: Vec<&str> = webhook.events.iter().map(|event| event.as_str()).collect();
        table.row([
            webhook.id.clone(),
            webhook.url.clone(),
            if events.is_empty() { "all".to_owned() } else { events.join(", ") },
            webhook.suite.clone().unwrap_or_else(|| "all".to_owned()),
            webhook.waiting.to_string(),
            webhook.delivered_at.map_or_else(|| "never".to_owned(), |at| format!("{at:.0}")),
            webhook.error.clone().unwrap_or_default(),
        ]);
    }
    table.print()
}

fn print_deliveries(deliveries: &[WebhookDelivery]) -> Result<()> {
    let mut table = output::Table::new(&["id", "event", "happened", "state", "attempts", "last error"]);
    for delivery in deliveries {
        table.row([
            delivery.id.clone(),
            delivery.message.event.as_str().to_owned(),
            format!("{:.0}", delivery.message.timestamp),
            delivery.state.as_str().to_owned(),
            delivery.attempts.len().to_string(),
            delivery.attempts.last().and_then(|attempt| attempt.error.clone()).unwrap_or_default(),
        ]);
    }
    table.print()
}
