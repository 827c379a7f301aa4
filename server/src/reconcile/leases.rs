//! The reaper: tasks of silent workers go back to the queue.

use crate::app::Shared;
use crate::error::ApiResult;

pub(super) async fn run(app: Shared) -> ApiResult<()> {
    while app.expire_leases().await? > 0 {}
    Ok(())
}
