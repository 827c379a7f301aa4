//! Gives up jobs that demand a device which no worker has.

use crate::app::Shared;
use crate::error::ApiResult;

pub(super) async fn run(app: Shared) -> ApiResult<()> {
    app.give_up_unmet_jobs().await
}
