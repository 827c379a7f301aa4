//! How quickly jobs rendered, to tell how long the next will take.

use lightshaft_api::settings::Integrator;
use sqlx::FromRow;

use super::{SqliteStore, context, to_json};
use crate::store::{Measurement, Result};

#[derive(FromRow)]
struct MeasurementRow {
    scene_id: String,
    samples: f64,
    rays: f64,
    mrays_per_s: f64,
    device: String,
    device_kind: String,
}

impl SqliteStore {
    pub(super) async fn read_measurements(&self, integrator: Integrator, limit: u32) -> Result<Vec<Measurement>> {
        // Of a job that stopped at its time limit, the metrics say how many samples it has.
        let rows: Vec<MeasurementRow> = sqlx::query_as(
            "SELECT scene_id,
                    CAST(settings ->> '$.width' AS REAL) * (settings ->> '$.height') * (metrics ->> '$.spp') AS samples,
                    CAST(metrics ->> '$.rays.primary' AS REAL) + (metrics ->> '$.rays.shadow')
                        + (metrics ->> '$.rays.ao') + (metrics ->> '$.rays.indirect') AS rays,
                    CAST(metrics ->> '$.mrays_per_s' AS REAL) AS mrays_per_s,
                    metrics ->> '$.device' AS device, metrics ->> '$.device_kind' AS device_kind
             FROM job
             WHERE state = 'succeeded' AND kind = 'render' AND metrics IS NOT NULL AND settings -> '$.integrator' = $1
             ORDER BY id DESC LIMIT $2",
        )
        .bind(to_json(&integrator)?)
        .bind(limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading how quickly jobs rendered"))?;
        let measurement = |row: MeasurementRow| Measurement {
            scene: row.scene_id,
            samples: row.samples,
            rays: row.rays,
            mrays_per_s: row.mrays_per_s,
            device: row.device,
            device_kind: row.device_kind,
        };
        Ok(rows.into_iter().map(measurement).collect())
    }
}
