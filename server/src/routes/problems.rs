//! `/problems`: the explanation of every problem's `type`, in plain text.

use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::web::body::Id;
use lightshaft_api::problem::Problem;

/// Every kind of problem.
#[utoipa::path(
    get, path = "/problems", tag = "service",
    responses((status = 200, body = String, content_type = "text/plain"))
)]
pub(super) async fn list_problems() -> String {
    Code::ALL.into_iter().map(describe).collect::<Vec<_>>().join("\n")
}

/// One kind of problem.
#[utoipa::path(
    get, path = "/problems/{code}", tag = "service",
    params(("code" = String, Path, description = "The end of a problem's `type`")),
    responses(
        (status = 200, body = String, content_type = "text/plain"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_problem(Id(code): Id) -> ApiResult<String> {
    Code::from_name(&code).map(describe).ok_or_else(|| ApiError::not_found("problem", &code))
}

fn describe(code: Code) -> String {
    format!("{} ({}): {}\n{}\n", code.as_str(), code.status().as_u16(), code.title(), code.explanation())
}
