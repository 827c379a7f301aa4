//! `/v1/compare`, and what pictures hold: below `/v1/jobs/{id}/artifacts/{name}` and `/v1/blobs/{hash}`.

use axum::Json as Reply;
use axum::body::Body;
use axum::extract::{FromRequest, Request, State};
use axum::response::{IntoResponse, Response};
use http::{HeaderMap, HeaderName};
use lightshaft_api::blob::is_hash;
use lightshaft_api::compare::{
    CompareRequest, Compared, ComparedPicture, PictureLayers, PixelValues, SampleForm, is_exposure,
};
use lightshaft_api::problem::Problem;
use lightshaft_engine::film::COLOR;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::app::{ComparisonKey, RawLayer, Shared, UploadedPictures};
use crate::error::{ApiError, ApiResult};
use crate::web::body::{Id, Ids, Json, Params, ThreeIds, media_type};
use crate::web::file::{self, Binary, IMMUTABLE, REVALIDATE};

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LayerParams {
    /// `f16` or `f32` for floats, `u32` for integers; `f32` and `u32` by default.
    #[param(inline)]
    format: Option<SampleForm>,
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PixelParams {
    /// Column, from the left.
    x: u32,
    /// Row, from the top.
    y: u32,
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct HeatMapParams {
    /// Layer of the reference; `color` by default.
    a_layer: Option<String>,
    /// Layer of the other picture; that of the reference by default.
    b_layer: Option<String>,
    /// Stops by which both are brightened, -32 to 32. Not for HDR-FLIP.
    #[serde(default)]
    exposure: f32,
    /// Whether HDR-FLIP is drawn.
    #[serde(default)]
    hdr: bool,
    /// Whether a scale bar is drawn to the right of the map, and below it where the map is low; true by default. The map
    /// lies in the upper left corner, and without the bar has the size of the pictures.
    #[serde(default = "yes")]
    scale: bool,
}

fn yes() -> bool {
    true
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct DifferenceParams {
    /// Layer of the reference; `color` by default.
    a_layer: Option<String>,
    /// Layer of the other picture; that of the reference by default.
    b_layer: Option<String>,
    /// What the difference is multiplied with; 1 by default.
    gain: Option<f32>,
}

/// Layers of a picture that a job left: names, kinds and ranges.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/artifacts/{name}/layers", tag = "pictures",
    params(("id" = String, Path, description = "The job"), ("name" = String, Path, description = "`image.exr`, `image.png`")),
    responses(
        (status = 200, body = PictureLayers),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_artifact_layers(
    State(app): State<Shared>,
    Ids(id, name): Ids,
) -> ApiResult<Reply<PictureLayers>> {
    let artifact = app.artifact(&id, &name).await?;
    Ok(Reply(app.picture_layers(&artifact.hash, &artifact.href).await?))
}

/// One layer's pixels: little-endian samples, row 0 at the top, the channels of a pixel together. The headers
/// `Picture-Width`, `Picture-Height`, `Picture-Channels` (1 or 3) and `Picture-Format` (`f16`, `f32`, `u32`) say how.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/artifacts/{name}/layers/{layer}", tag = "pictures",
    params(
        ("id" = String, Path, description = "The job"),
        ("name" = String, Path, description = "`image.exr`, `image.png`"),
        ("layer" = String, Path, description = "`color`, `depth`, …"),
        LayerParams,
    ),
    responses(
        (status = 200, body = inline(Binary), content_type = "application/octet-stream"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_artifact_layer(
    State(app): State<Shared>,
    ThreeIds(id, name, layer): ThreeIds,
    Params(params): Params<LayerParams>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let artifact = app.artifact(&id, &name).await?;
    raw_layer(&app, &artifact.hash, &layer, params.format, REVALIDATE, &headers).await
}

/// The values of all layers at one pixel.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/artifacts/{name}/pixel", tag = "pictures",
    params(
        ("id" = String, Path, description = "The job"),
        ("name" = String, Path, description = "`image.exr`, `image.png`"),
        PixelParams,
    ),
    responses(
        (status = 200, body = PixelValues),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_artifact_pixel(
    State(app): State<Shared>,
    Ids(id, name): Ids,
    Params(at): Params<PixelParams>,
) -> ApiResult<Reply<PixelValues>> {
    let artifact = app.artifact(&id, &name).await?;
    Ok(Reply(app.picture_pixel(&artifact.hash, at.x, at.y).await?))
}

/// Layers of a picture that is a blob: names, kinds and ranges.
#[utoipa::path(
    get, path = "/v1/blobs/{hash}/layers", tag = "pictures",
    params(("hash" = String, Path, description = "BLAKE3, 64 lower-case hex digits")),
    responses(
        (status = 200, body = PictureLayers),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_blob_layers(State(app): State<Shared>, Id(hash): Id) -> ApiResult<Reply<PictureLayers>> {
    Ok(Reply(app.picture_layers(&hash, &format!("/v1/blobs/{hash}")).await?))
}

/// One layer's pixels, as those of a job's picture.
#[utoipa::path(
    get, path = "/v1/blobs/{hash}/layers/{layer}", tag = "pictures",
    params(
        ("hash" = String, Path, description = "BLAKE3, 64 lower-case hex digits"),
        ("layer" = String, Path, description = "`color`, `depth`, …"),
        LayerParams,
    ),
    responses(
        (status = 200, body = inline(Binary), content_type = "application/octet-stream"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_blob_layer(
    State(app): State<Shared>,
    Ids(hash, layer): Ids,
    Params(params): Params<LayerParams>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    raw_layer(&app, &hash, &layer, params.format, IMMUTABLE, &headers).await
}

/// The values of all layers at one pixel of a blob.
#[utoipa::path(
    get, path = "/v1/blobs/{hash}/pixel", tag = "pictures",
    params(("hash" = String, Path, description = "BLAKE3, 64 lower-case hex digits"), PixelParams),
    responses(
        (status = 200, body = PixelValues),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_blob_pixel(
    State(app): State<Shared>,
    Id(hash): Id,
    Params(at): Params<PixelParams>,
) -> ApiResult<Reply<PixelValues>> {
    Ok(Reply(app.picture_pixel(&hash, at.x, at.y).await?))
}

/// How far two pictures are apart: RMSE, relative MSE, SSIM, FLIP, HDR-FLIP and differing pixels, with limits. Pictures are artifacts
/// of jobs, blobs, or uploads: then the body is `multipart/form-data` with the files as parts `a` and `b`, and the rest, if
/// any, as JSON in a part `request`. Answers 200 whether the limits are kept or not: see `passed`.
#[utoipa::path(
    post, path = "/v1/compare", tag = "pictures",
    request_body(content((CompareRequest = "application/json"), (inline(Binary) = "multipart/form-data"))),
    responses(
        (status = 200, body = Compared),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn compare_pictures(State(app): State<Shared>, request: Request) -> ApiResult<Reply<Compared>> {
    let (wanted, uploads) = if media_type(request.headers()).as_deref() == Some("multipart/form-data") {
        app.receive_comparison(request).await?
    } else {
        (Json::from_request(request, &app).await?.0, UploadedPictures::default())
    };
    Ok(Reply(app.compare(&wanted, uploads).await?))
}

/// The FLIP or HDR-FLIP error of every pixel of two blobs (magma: 0 is black, 1 pale yellow), with a scale bar. `POST /v1/compare` answers such addresses.
#[utoipa::path(
    get, path = "/v1/compare/{a}/{b}/heat-map.png", tag = "pictures",
    params(
        ("a" = String, Path, description = "BLAKE3 of the reference"),
        ("b" = String, Path, description = "BLAKE3 of the other picture"),
        HeatMapParams,
    ),
    responses(
        (status = 200, body = inline(Binary), content_type = "image/png"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_heat_map(
    State(app): State<Shared>,
    Ids(a, b): Ids,
    Params(params): Params<HeatMapParams>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let exposure = params.exposure;
    if !is_exposure(exposure) {
        return Err(ApiError::bad_request("query/exposure", "must be -32 to 32 stops"));
    }
    let key = ComparisonKey { exposure, hdr: params.hdr, ..key(a, b, params.a_layer, params.b_layer)? };
    let scale = params.scale;
    let etag = etag(&format!("heat map {scale} {key:?}"));
    file::made(&etag, "image/png", IMMUTABLE, &headers, async || Ok(Body::from(app.heat_map(&key, scale).await?))).await
}

/// The absolute difference of every channel of two blobs times `gain`, as a display shows it. Layers that are no colour are
/// spread over their common range first.
#[utoipa::path(
    get, path = "/v1/compare/{a}/{b}/difference.png", tag = "pictures",
    params(
        ("a" = String, Path, description = "BLAKE3 of the reference"),
        ("b" = String, Path, description = "BLAKE3 of the other picture"),
        DifferenceParams,
    ),
    responses(
        (status = 200, body = inline(Binary), content_type = "image/png"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_difference(
    State(app): State<Shared>,
    Ids(a, b): Ids,
    Params(params): Params<DifferenceParams>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let gain = params.gain.unwrap_or(1.0);
    if !(gain.is_finite() && gain > 0.0) {
        return Err(ApiError::bad_request("query/gain", "must be a number greater than 0"));
    }
    let key = key(a, b, params.a_layer, params.b_layer)?;
    let etag = etag(&format!("difference {gain} {key:?}"));
    file::made(&etag, "image/png", IMMUTABLE, &headers, async || Ok(Body::from(app.difference(&key, gain).await?)))
        .await
}

fn key(a: String, b: String, a_layer: Option<String>, b_layer: Option<String>) -> ApiResult<ComparisonKey> {
    for (name, hash) in [("a", &a), ("b", &b)] {
        if !is_hash(hash) {
            return Err(ApiError::bad_request(&format!("path/{name}"), "must be 64 lower-case hex digits"));
        }
    }
    let a_layer = a_layer.unwrap_or_else(|| COLOR.to_owned());
    let b_layer = b_layer.unwrap_or_else(|| a_layer.clone());
    let (a, b) = (ComparedPicture { hash: a, layer: a_layer }, ComparedPicture { hash: b, layer: b_layer });
    Ok(ComparisonKey { a, b, exposure: 0.0, tolerance: 0.0, hdr: false })
}

/// Of what is made from content that does not change: where it comes from, and the version that makes it.
fn etag(origin: &str) -> String {
    let hash = blake3::hash(format!("{} {origin}", env!("CARGO_PKG_VERSION")).as_bytes());
    format!("\"{}\"", &hash.to_hex()[..32])
}

async fn raw_layer(
    app: &Shared,
    hash: &str,
    layer: &str,
    format: Option<SampleForm>,
    cache: &'static str,
    headers: &HeaderMap,
) -> ApiResult<Response> {
    let etag = etag(&format!("layer {hash} {layer} {format:?}"));
    file::made(&etag, "application/octet-stream", cache, headers, async || {
        Ok(to_response(app.picture_layer(hash, layer, format).await?))
    })
    .await
}

fn to_response(layer: RawLayer) -> Response {
    let format = match layer.form {
        SampleForm::F16 => "f16",
        SampleForm::F32 => "f32",
        SampleForm::U32 => "u32",
    };
    let header = |name: &'static str, value: String| (HeaderName::from_static(name), value);
    let described = [
        header("picture-width", layer.width.to_string()),
        header("picture-height", layer.height.to_string()),
        header("picture-channels", layer.channels.to_string()),
        header("picture-format", format.to_owned()),
    ];
    (described, layer.samples).into_response()
}
