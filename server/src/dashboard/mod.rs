//! The dashboard: pages for people, rendered on the server, brought to life by a little script of our own.
//!
//! The dashboard is a client of the public JSON API and of nothing else. Pages ask it in process ([`client::Api`]), so
//! whatever a page can show a script can get too, and the access rules of the API hold for both. In the browser the
//! script listens to the event stream, fetches the page again, and patches the regions that changed: one template is
//! the only source of what a region looks like.
//!
//! | path | page |
//! |---|---|
//! | `/` | overview: state, running jobs, recent pictures, workers |
//! | `/jobs`, `/jobs/{id}` | table of jobs; one job with its picture |
//! | `/jobs/new` | form that submits a job |
//! | `/queue` | what waits, in which order, and why |
//! | `/compare` | pictures side by side, over each other, and what sets them apart |
//! | `/farm`, `/farm/runs/{id}` | the regression farm: runs; the cases of one with their verdicts |
//! | `/farm/history`, `/farm/decisions` | a case over its labels; who decided what |
//! | `/farm/schedules` | runs that begin by the clock |
//! | `/farm/webhooks`, `/farm/webhooks/{id}` | who is told of verdicts; what became of each message |
//! | `/benchmarks` | what benchmarks found, by scene, device and parameter |
//! | `/scenes`, `/scenes/{id}` | cards and upload; one scene |
//! | `/workers` | devices, work in progress, caches |
//! | `/meshes`, `/meshes/{hash}` | structures that exist, who holds them, how often they need not be built |
//! | `/docs` | reference of the API, made from `/openapi.json` |
//! | `/assets/{version}/{file}` | style sheet, scripts, pictures; cached for ever by version |
//!
//! Nothing is loaded from elsewhere and no script or style is inline, so [`CONTENT_SECURITY_POLICY`] forbids both.

mod assets;
mod benchmark;
mod client;
mod compare;
mod comparison;
mod farm;
mod filters;
mod form;
mod job;
mod jobs;
mod meshes;
mod new_job;
mod overview;
mod page;
mod queue;
mod reference;
mod scenes;
mod schema;
#[cfg(test)]
mod tests;
mod workers;

use axum::Router;
use axum::routing::get;

pub use page::{CONTENT_SECURITY_POLICY, not_found, wants_html};

/// The pages. `api` is the router of the JSON API, which they ask in process; it should carry no middleware that
/// only makes sense for requests from outside, such as compression.
pub fn router(api: Router) -> Router {
    Router::new()
        .route("/", get(overview::show))
        .route("/jobs", get(jobs::list))
        .route("/jobs/new", get(new_job::show))
        .route("/jobs/{id}", get(job::show))
        .route("/queue", get(queue::show))
        .route("/compare", get(compare::show))
        .route("/benchmarks", get(benchmark::list::show))
        .route("/farm", get(farm::list))
        .route("/farm/runs/{id}", get(farm::run::show))
        .route("/farm/history", get(farm::history::show))
        .route("/farm/decisions", get(farm::decisions::list))
        .route("/farm/schedules", get(farm::schedules::show))
        .route("/farm/webhooks", get(farm::webhooks::list))
        .route("/farm/webhooks/{id}", get(farm::webhooks::show))
        .route("/scenes", get(scenes::list))
        .route("/scenes/{id}", get(scenes::show))
        .route("/workers", get(workers::list))
        .route("/meshes", get(meshes::list))
        .route("/meshes/{hash}", get(meshes::show))
        .route("/docs", get(reference::show))
        .route("/assets/{version}/{file}", get(assets::serve))
        .route("/favicon.ico", get(assets::favicon))
        .with_state(client::ApiRouter(api))
}
