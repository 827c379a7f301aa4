//! `/v1/blobs`

use axum::extract::{Request, State};
use axum::response::Response;
use http::{HeaderMap, StatusCode};
use lightshaft_api::blob::{BlobQuery, MissingBlobs, StoredBlob};
use lightshaft_api::problem::Problem;

use crate::app::Shared;
use crate::error::{ApiError, ApiResult};
use crate::web::body::{Id, Json, upload};
use crate::web::file::{self, Binary};

/// Stores a body and answers its hash, such as an environment map.
#[utoipa::path(
    post, path = "/v1/blobs", tag = "blobs",
    request_body(content = inline(Binary), content_type = "application/octet-stream"),
    responses(
        (status = 201, body = StoredBlob),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn store_blob(
    State(app): State<Shared>,
    request: Request,
) -> ApiResult<(StatusCode, axum::Json<StoredBlob>)> {
    let body = upload(request, app.config.limits.blob_bytes)?;
    Ok((StatusCode::CREATED, axum::Json(app.put_blob(body, None).await?)))
}

/// Stores a body under the hash that it must have. May be repeated.
#[utoipa::path(
    put, path = "/v1/blobs/{hash}", tag = "blobs",
    params(("hash" = String, Path, description = "BLAKE3, 64 lower-case hex digits")),
    request_body(content = inline(Binary), content_type = "application/octet-stream"),
    responses(
        (status = 200, body = StoredBlob),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn put_blob(
    State(app): State<Shared>,
    Id(hash): Id,
    request: Request,
) -> ApiResult<axum::Json<StoredBlob>> {
    let body = upload(request, app.config.limits.blob_bytes)?;
    Ok(axum::Json(app.put_blob(body, Some(&hash)).await?))
}

/// The bytes of a blob, as a picture where it is one (PNG, OpenEXR). Takes If-None-Match and Range.
#[utoipa::path(
    get, path = "/v1/blobs/{hash}", tag = "blobs",
    params(("hash" = String, Path, description = "BLAKE3, 64 lower-case hex digits")),
    responses(
        (status = 200, body = inline(Binary), content_type = "application/octet-stream"),
        (status = 206, description = "The range that was asked for", body = inline(Binary), content_type = "application/octet-stream"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_blob(State(app): State<Shared>, Id(hash): Id, headers: HeaderMap) -> ApiResult<Response> {
    let start = app.blobs.start(&hash, 8).await.map_err(ApiError::internal)?.unwrap_or_default();
    file::serve(&app, &hash, media_type(&start), file::IMMUTABLE, &headers, "blob").await
}

/// By its first bytes. Pages show pictures; anything else is bytes, whatever somebody uploaded.
fn media_type(start: &[u8]) -> &'static str {
    match start {
        [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n', ..] => "image/png",
        [0x76, 0x2f, 0x31, 0x01, ..] => "image/x-exr",
        _ => "application/octet-stream",
    }
}

/// Which of these blobs are not here.
#[utoipa::path(
    post, path = "/v1/blobs:missing", tag = "blobs", request_body = BlobQuery,
    responses(
        (status = 200, body = MissingBlobs),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn missing_blobs(
    State(app): State<Shared>,
    Json(query): Json<BlobQuery>,
) -> ApiResult<axum::Json<MissingBlobs>> {
    Ok(axum::Json(MissingBlobs { missing: app.missing_blobs(query.hashes).await? }))
}
