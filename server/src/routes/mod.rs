//! Every route of the service, in one list that yields both the router and the OpenAPI document. A handler is short:
//! read the request, one call, one reply.

mod blobs;
mod farm;
mod health;
mod jobs;
mod leases;
mod meshes;
mod pictures;
mod problems;
mod queue;
mod scenes;
mod status;
mod workers;

use axum::extract::{DefaultBodyLimit, Request};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router, middleware};
use http::{Method, Uri};
use utoipa::OpenApi;
use utoipa::openapi::OpenApi as Document;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::app::Shared;
use crate::dashboard;
use crate::error::ApiError;
use crate::problems::Code;
use crate::web::observe::observe;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Lightshaft",
        description = "A network render service: scenes in, pictures and metrics out. JSON is snake_case, times are RFC 3339 \
                       in UTC, sizes are in bytes and durations in seconds unless a name says otherwise. Every error is \
                       an RFC 9457 problem document.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    components(schemas(lightshaft_api::problem::Problem, lightshaft_api::event::Event)),
    tags(
        (name = "scenes", description = "What is rendered: glTF 2.0 files"),
        (name = "jobs", description = "What is asked for, and what came of it"),
        (name = "pictures", description = "What pictures hold, and how far two are apart"),
        (name = "farm", description = "The regression farm: is the picture still right, and is it still as fast?"),
        (name = "blobs", description = "Immutable bytes named by their BLAKE3 hash"),
        (name = "meshes", description = "Unique meshes and the structures built for them"),
        (name = "workers", description = "Who renders"),
        (name = "leases", description = "The worker protocol"),
        (name = "service", description = "The state of the service"),
    )
)]
struct ApiDoc;

/// All routes, without state.
fn api() -> OpenApiRouter<Shared> {
    OpenApiRouter::with_openapi(ApiDoc::openapi())
        .routes(routes!(scenes::list_scenes, scenes::upload_scene))
        .routes(routes!(scenes::get_scene, scenes::delete_scene))
        .routes(routes!(scenes::get_thumbnail))
        .routes(routes!(jobs::list_jobs, jobs::create_job))
        .routes(routes!(jobs::get_job, jobs::change_job, jobs::delete_job))
        .routes(routes!(queue::get_queue))
        .routes(routes!(jobs::cancel_job))
        .routes(routes!(jobs::retry_job))
        .routes(routes!(jobs::list_tasks))
        .routes(routes!(jobs::list_attempts))
        .routes(routes!(jobs::list_artifacts))
        .routes(routes!(jobs::get_artifact))
        .routes(routes!(pictures::list_artifact_layers))
        .routes(routes!(pictures::get_artifact_layer))
        .routes(routes!(pictures::get_artifact_pixel))
        .routes(routes!(jobs::get_preview))
        .routes(routes!(jobs::get_log))
        .routes(routes!(jobs::job_events))
        .routes(routes!(jobs::all_events))
        .routes(routes!(farm::suites::list_suites, farm::suites::create_suite))
        .routes(routes!(farm::suites::get_suite))
        .routes(routes!(farm::runs::list_runs, farm::runs::create_run))
        .routes(routes!(farm::runs::get_run))
        .routes(routes!(farm::runs::cancel_run))
        .routes(routes!(farm::decisions::approve_cases))
        .routes(routes!(farm::decisions::reject_cases))
        .routes(routes!(farm::decisions::approve_case))
        .routes(routes!(farm::decisions::reject_case))
        .routes(routes!(farm::runs::get_case_artifact))
        .routes(routes!(farm::decisions::list_decisions))
        .routes(routes!(farm::decisions::list_baselines))
        .routes(routes!(farm::decisions::reset_baseline))
        .routes(routes!(farm::runs::get_history))
        .routes(routes!(farm::runs::create_calibration))
        .routes(routes!(farm::runs::get_calibration))
        .routes(routes!(farm::schedules::list_schedules, farm::schedules::create_schedule))
        .routes(routes!(farm::schedules::change_schedule, farm::schedules::delete_schedule))
        .routes(routes!(farm::webhooks::list_webhooks, farm::webhooks::create_webhook))
        .routes(routes!(farm::webhooks::get_webhook, farm::webhooks::delete_webhook))
        .routes(routes!(farm::webhooks::list_deliveries))
        .routes(routes!(farm::webhooks::resend_delivery))
        .routes(routes!(blobs::store_blob))
        .routes(routes!(blobs::get_blob, blobs::put_blob))
        .routes(routes!(blobs::missing_blobs))
        .routes(routes!(pictures::list_blob_layers))
        .routes(routes!(pictures::get_blob_layer))
        .routes(routes!(pictures::get_blob_pixel))
        .routes(routes!(pictures::compare_pictures))
        .routes(routes!(pictures::get_heat_map))
        .routes(routes!(pictures::get_difference))
        .routes(routes!(meshes::list_meshes))
        .routes(routes!(meshes::get_mesh))
        .routes(routes!(meshes::find_structures))
        .routes(routes!(meshes::add_structure))
        .routes(routes!(workers::list_workers, workers::register_worker))
        .routes(routes!(workers::get_worker, workers::remove_worker))
        .routes(routes!(workers::drain_worker))
        .routes(routes!(workers::undrain_worker))
        .routes(routes!(workers::part_worker))
        .routes(routes!(leases::lease_task))
        .routes(routes!(leases::heartbeat))
        .routes(routes!(leases::append_log))
        .routes(routes!(leases::complete))
        .routes(routes!(leases::fail))
        .routes(routes!(leases::release))
        .routes(routes!(status::get_status))
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::metrics))
        .routes(routes!(problems::list_problems))
        .routes(routes!(problems::get_problem))
}

/// The OpenAPI document of all routes.
pub fn document() -> Document {
    api().into_openapi()
}

/// The whole service as one router: the API, and the pages that ask it in process.
pub fn router(app: Shared) -> Router {
    let (router, document) = api().split_for_parts();
    let api = router
        .route("/openapi.json", get(|| async move { Json(document) }))
        .method_not_allowed_fallback(method_not_allowed)
        .fallback(no_such_route)
        .with_state(app);
    api.clone()
        .merge(dashboard::router(api))
        // Every body has its own budget, counted where it is read.
        .layer(DefaultBodyLimit::disable())
        .layer(middleware::from_fn(observe))
}

async fn no_such_route(request: Request) -> Response {
    if dashboard::wants_html(request.headers()) {
        return dashboard::not_found(request).await;
    }
    let path: String = request.uri().path().chars().take(200).collect();
    ApiError::new(Code::NoSuchRoute, format!("`{path}` is not part of the API: see /openapi.json")).into_response()
}

async fn method_not_allowed(method: Method, uri: Uri) -> ApiError {
    let path: String = uri.path().chars().take(200).collect();
    ApiError::new(Code::MethodNotAllowed, format!("{method} is not allowed on `{path}`"))
}
