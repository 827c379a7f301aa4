//! A case over its runs.

use lightshaft_api::farm::{HistoryPoint, ImageResult, TimeResult};
use sqlx::FromRow;

use crate::store::Result;
use crate::store::sqlite::{SqliteStore, context, from_json, timestamp};

#[derive(FromRow)]
struct PointRow {
    run_id: String,
    label: String,
    labels: String,
    created_at: i64,
    ok: bool,
    image: String,
    time: Option<String>,
    picture: Option<String>,
}

impl SqliteStore {
    pub(super) async fn read_device_classes(&self, suite_name: &str, case: &str) -> Result<Vec<String>> {
        sqlx::query_scalar(
            "SELECT c.device_class FROM farm_case c JOIN farm_run r ON r.id = c.run_id
             WHERE c.name = $2 AND c.device_class IS NOT NULL AND c.state = 'finished'
               AND r.suite_name = $1 AND r.kind = 'check'
             GROUP BY c.device_class ORDER BY MAX(c.run_id) DESC",
        )
        .bind(suite_name)
        .bind(case)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading a case's device classes"))
    }

    pub(super) async fn read_history(
        &self,
        suite_name: &str,
        case: &str,
        class: &str,
        limit: u32,
    ) -> Result<Vec<HistoryPoint>> {
        let mut rows: Vec<PointRow> = sqlx::query_as(
            "SELECT c.run_id, r.label, r.labels, r.created_at, c.ok, c.image, c.time,
                    (SELECT a.blob FROM farm_artifact a
                     WHERE a.run_id = c.run_id AND a.case_name = c.name AND a.name = 'image.png') AS picture
             FROM farm_case c JOIN farm_run r ON r.id = c.run_id
             WHERE c.name = $2 AND c.device_class = $3 AND c.state = 'finished' AND r.suite_name = $1
               AND r.kind = 'check'
             ORDER BY c.run_id DESC LIMIT $4",
        )
        .bind(suite_name)
        .bind(case)
        .bind(class)
        .bind(limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading a case's history"))?;
        rows.reverse();
        rows.into_iter().map(PointRow::into_point).collect()
    }
}

impl PointRow {
    fn into_point(self) -> Result<HistoryPoint> {
        let image: ImageResult = from_json(&self.image)?;
        let time: Option<TimeResult> = self.time.map(|text| from_json(&text)).transpose()?;
        let spread = time.as_ref().and_then(|time| time.spread);
        Ok(HistoryPoint {
            run: self.run_id,
            label: self.label,
            labels: from_json(&self.labels)?,
            at: timestamp(self.created_at)?,
            ok: self.ok,
            image: image.verdict,
            pixels: image.pixels,
            time: time.as_ref().and_then(|time| time.verdict),
            confirmation: time.as_ref().map(|time| time.confirmation.state).unwrap_or_default(),
            metric: time.as_ref().map(|time| time.metric).unwrap_or_default(),
            median_s: spread.map(|spread| spread.median_s),
            lower_quartile_s: spread.map(|spread| spread.lower_quartile_s),
            upper_quartile_s: spread.map(|spread| spread.upper_quartile_s),
            picture: self.picture.map(|blob| format!("/v1/blobs/{blob}")),
        })
    }
}
