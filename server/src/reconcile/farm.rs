//! Takes runs of the regression farm further, begins those that are due, and sends what webhooks are told.

use crate::app::Shared;
use crate::error::ApiResult;

pub(super) async fn run(app: Shared) -> ApiResult<()> {
    app.follow_farm().await
}

pub(super) async fn begin_scheduled(app: Shared) -> ApiResult<()> {
    app.begin_scheduled_runs().await.map(|_| ())
}

pub(super) async fn deliver(app: Shared) -> ApiResult<()> {
    app.deliver_messages().await.map(|_| ())
}
