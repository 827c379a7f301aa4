//! Forgets idempotency keys after a day, events and messages of webhooks after a month, jobs and runs of the farm when they
//! have been kept for long enough; and keeps the write-ahead log small.

use crate::app::{KEY_LIFETIME_MS, Shared};
use crate::error::ApiResult;
use crate::queue::Millis;

const EVENT_LIFETIME_MS: Millis = 30 * 24 * 3_600_000;

pub(super) async fn run(app: Shared) -> ApiResult<()> {
    let now = app.now();
    while app.store.forget_before(now - KEY_LIFETIME_MS, now - EVENT_LIFETIME_MS).await? > 0 {}
    while app.delete_old_jobs().await? > 0 {}
    while app.delete_old_runs().await? > 0 {}
    while app.forget_old_deliveries().await? > 0 {}
    app.forget_gone_workers();
    app.store.checkpoint().await?;
    Ok(())
}
