//! Makes jobs for thumbnails that scenes lack, because something failed after their upload.

use crate::app::Shared;
use crate::error::ApiResult;

pub(super) async fn run(app: Shared) -> ApiResult<()> {
    app.create_missing_thumbnail_jobs().await
}
