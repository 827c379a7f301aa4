//! Deletes blobs that nothing names: outputs of superseded attempts, maps that no job was made with. A week of grace,
//! so that what is uploaded now can be used later.

use jiff::Timestamp;

use crate::app::Shared;
use crate::error::{ApiError, ApiResult};
use crate::queue::Millis;

const GRACE_MS: Millis = 7 * 24 * 3_600_000;

pub(super) async fn run(app: Shared) -> ApiResult<()> {
    let before = Timestamp::from_millisecond(app.now() - GRACE_MS).map_err(ApiError::internal)?;
    let deleted = app.sweep_blobs(before).await?;
    if deleted > 0 {
        tracing::info!(deleted, "unused blobs deleted");
    }
    Ok(())
}

/// Deletes what was let go of meanwhile, sooner than that.
pub(super) async fn delete_discarded(app: Shared) -> ApiResult<()> {
    let deleted = app.delete_discarded().await?;
    tracing::debug!(deleted, "discarded blobs deleted");
    Ok(())
}
