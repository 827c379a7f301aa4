//! `/v1/farm`: the regression farm.

pub(super) mod decisions;
pub(super) mod runs;
pub(super) mod schedules;
pub(super) mod suites;
pub(super) mod webhooks;

use crate::error::{ApiError, ApiResult};

/// A query parameter that is one of some names.
fn choice<T>(
    name: &str,
    value: Option<&str>,
    read: impl Fn(&str) -> Option<T>,
    expected: &str,
) -> ApiResult<Option<T>> {
    let wrong = || ApiError::bad_request(&format!("query/{name}"), &format!("must be {expected}"));
    value.map(|value| read(value).ok_or_else(wrong)).transpose()
}
