//! Takes runs of the regression farm further.

use crate::app::Shared;
use crate::error::ApiResult;

pub(super) async fn run(app: Shared) -> ApiResult<()> {
    app.follow_farm().await
}
