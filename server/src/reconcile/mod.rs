//! Chores that run beside the requests. Each is idempotent, takes no input, does a bounded piece of work, and is simply
//! run again by the timer: there are no retries inside.

mod blobs;
mod demands;
mod expiry;
mod farm;
mod leases;
mod scenes;

use std::time::Duration;

use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;

use crate::app::Shared;
use crate::error::ApiResult;

/// Starts every chore; they end with the service's shutdown token.
pub fn spawn(app: &Shared) -> JoinSet<()> {
    let mut chores = JoinSet::new();
    let ttl = app.config.lease_ttl;
    let look = (ttl / 10).clamp(Duration::from_millis(50), Duration::from_secs(5));
    // Workers may have been unable to reach a service that was down: each gets one full lease to come back.
    chores.spawn(every("leases", app.clone(), ttl, look, leases::run));
    let often = Duration::from_secs(1);
    chores.spawn(every("demands", app.clone(), often, often, demands::run));
    // Each look at jobs that have ended is one step; people and scripts wait for the last.
    let soon = Duration::from_millis(300);
    chores.spawn(every("farm", app.clone(), soon, soon, farm::run));
    chores.spawn(every("schedules", app.clone(), often, Duration::from_secs(5), farm::begin_scheduled));
    chores.spawn(every("webhooks", app.clone(), often, often, farm::deliver));
    chores.spawn(every("expiry", app.clone(), Duration::from_secs(60), Duration::from_secs(600), expiry::run));
    chores.spawn(every("discarded", app.clone(), often, Duration::from_secs(10), blobs::delete_discarded));
    chores.spawn(every("scenes", app.clone(), Duration::from_secs(10), Duration::from_secs(60), scenes::run));
    chores.spawn(every("blobs", app.clone(), Duration::from_secs(300), Duration::from_secs(6 * 3600), blobs::run));
    chores
}

async fn every<F>(name: &'static str, app: Shared, first: Duration, period: Duration, chore: fn(Shared) -> F)
where
    F: Future<Output = ApiResult<()>> + Send,
{
    let mut timer = tokio::time::interval_at(tokio::time::Instant::now() + first, period);
    timer.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = app.shutdown.cancelled() => return,
            _ = timer.tick() => {}
        }
        // Every chore may be left in its middle: what it had not done yet is done after the next start.
        let result = tokio::select! {
            () = app.shutdown.cancelled() => return,
            result = chore(app.clone()) => result,
        };
        if let Err(error) = result {
            tracing::error!(chore = name, error = %error, "chore failed; it will run again");
        }
    }
}
