//! Takes runs of the regression farm further, and begins those that are due.

use crate::app::Shared;
use crate::error::ApiResult;

pub(super) async fn run(app: Shared) -> ApiResult<()> {
    app.follow_farm().await
}

pub(super) async fn begin_scheduled(app: Shared) -> ApiResult<()> {
    app.begin_scheduled_runs().await.map(|_| ())
}
