//! A case over its labels.

use lightshaft_api::farm::History;
use lightshaft_compare::timing::change_points;

use super::super::App;
use crate::error::{ApiError, ApiResult};
use crate::store::{BaselineKey, DecisionQuery, PageRequest};

/// Runs that a history goes back at most, and decisions that it shows.
const MOST_POINTS: u32 = 500;
const MOST_DECISIONS: u32 = 200;

impl App {
    /// The history of a case, by names; of the newest run's device class when none is given.
    pub async fn history(
        &self,
        suite: &str,
        case: &str,
        device_class: Option<&str>,
        baseline: &str,
    ) -> ApiResult<History> {
        let device_classes = self.store.device_classes(suite, case).await?;
        let wanted = device_class.map(str::to_owned).or_else(|| device_classes.first().cloned());
        let class = wanted.filter(|class| device_classes.contains(class));
        let class = class.ok_or_else(|| ApiError::not_found("history of a case", case))?;
        let points = self.store.history(suite, case, &class, MOST_POINTS).await?;
        let key = BaselineKey {
            baseline: baseline.to_owned(),
            suite_name: suite.to_owned(),
            case: case.to_owned(),
            device_class: class.clone(),
        };
        let reference = self.store.reference(&key).await?;
        let of_case = DecisionQuery {
            suite_name: Some(suite.to_owned()),
            case: Some(case.to_owned()),
            baseline: Some(baseline.to_owned()),
            ..DecisionQuery::default()
        };
        let decisions = self.store.decisions(&of_case, &PageRequest { limit: MOST_DECISIONS, after: None }).await?;
        let metric = points.last().map(|point| point.metric).unwrap_or_default();
        // Points without a time of the metric are no part of the series.
        let timed: Vec<(u32, f64)> = (0..)
            .zip(&points)
            .filter(|(_, point)| point.metric == metric)
            .filter_map(|(i, point)| Some((i, point.median_s?)))
            .collect();
        let series: Vec<f64> = timed.iter().map(|(_, median)| *median).collect();
        let changes = tokio::task::spawn_blocking(move || change_points(&series)).await.map_err(ApiError::internal)?;
        Ok(History {
            suite: suite.to_owned(),
            case: case.to_owned(),
            device_class: class,
            device_classes,
            baseline: baseline.to_owned(),
            change_points: changes.into_iter().map(|at| timed[at].0).collect(),
            noise_floor: reference.noise_floors.iter().find(|(of, _)| *of == metric).map(|(_, floor)| *floor),
            pictures: reference.pictures,
            decisions,
            points,
        })
    }
}
