//! Keys of requests that may be repeated: of jobs and of runs, each with a table of its own.

use crate::queue::Millis;
use crate::store::sqlite::{Tx, context};
use crate::store::{Creation, Idempotency, Result};

/// Statements of one table.
pub(super) struct Keys {
    look_up: &'static str,
    keep: &'static str,
}

pub(super) const OF_JOBS: Keys = Keys {
    look_up: "SELECT fingerprint, job_id FROM idempotency WHERE key = $1 AND created_at >= $2",
    keep: "INSERT INTO idempotency (key, fingerprint, job_id, created_at) VALUES ($1, $2, $3, $4)
           ON CONFLICT (key) DO UPDATE SET fingerprint = $2, job_id = $3, created_at = $4",
};

pub(super) const OF_RUNS: Keys = Keys {
    look_up: "SELECT fingerprint, run_id FROM farm_idempotency WHERE key = $1 AND created_at >= $2",
    keep: "INSERT INTO farm_idempotency (key, fingerprint, run_id, created_at) VALUES ($1, $2, $3, $4)
           ON CONFLICT (key) DO UPDATE SET fingerprint = $2, run_id = $3, created_at = $4",
};

impl Keys {
    /// What came of a key that was used before.
    pub(super) async fn repeated(&self, tx: &mut Tx, wanted: &Idempotency) -> Result<Option<Creation>> {
        let known: Option<(String, String)> = sqlx::query_as(self.look_up)
            .bind(&wanted.key)
            .bind(wanted.not_before)
            .fetch_optional(&mut **tx)
            .await
            .map_err(context("looking up an idempotency key"))?;
        let made = |(fingerprint, id): (String, String)| match fingerprint == wanted.fingerprint {
            true => Creation::Repeated(id),
            false => Creation::KeyReused,
        };
        Ok(known.map(made))
    }

    pub(super) async fn keep(&self, tx: &mut Tx, used: &Idempotency, made: &str, now: Millis) -> Result<()> {
        sqlx::query(self.keep)
            .bind(&used.key)
            .bind(&used.fingerprint)
            .bind(made)
            .bind(now)
            .execute(&mut **tx)
            .await
            .map_err(context("keeping an idempotency key"))?;
        Ok(())
    }
}
