//! What a job that compares found, on its page: figures, the heat map, and the way to the page that compares.

use lightshaft_api::compare::Comparison;
use lightshaft_api::job::Job;
use lightshaft_worker::executor::{COMPARISON_JSON, HEAT_MAP_PNG};

use super::client::{Api, escape};
use super::page::PageError;

pub(super) struct Found {
    pub(super) comparison: Comparison,
    /// Figures by name.
    pub(super) figures: Vec<(&'static str, String)>,
    /// Address.
    pub(super) heat_map: Option<String>,
    /// Address of the page that compares the two.
    pub(super) page: String,
}

impl Found {
    /// `None` while there is no result.
    pub(super) async fn of(api: &Api, job: &Job) -> Result<Option<Self>, PageError> {
        let has = |name: &str| job.artifacts.iter().find(|artifact| artifact.name == name);
        if has(COMPARISON_JSON).is_none() {
            return Ok(None);
        }
        let path = format!("/v1/jobs/{}/artifacts/{COMPARISON_JSON}", escape(&job.summary.id));
        let comparison: Comparison = api.get(&path).await?;
        let (a, b) = (&comparison.a, &comparison.b);
        let layer = if a.layer == "color" { String::new() } else { format!("&layer={}", escape(&a.layer)) };
        Ok(Some(Self {
            figures: figures(&comparison),
            heat_map: has(HEAT_MAP_PNG).map(|artifact| artifact.href.clone()),
            page: format!("/compare?p={}&p={}{layer}", escape(&a.hash), escape(&b.hash)),
            comparison,
        }))
    }
}

fn figures(comparison: &Comparison) -> Vec<(&'static str, String)> {
    let report = &comparison.report;
    let share = 100.0 * report.differing_pixels as f64 / report.pixels.max(1) as f64;
    let four = |value: f64| format!("{value:.4}");
    let mut figures = vec![
        ("RMSE", four(report.rmse)),
        ("Relative MSE", four(report.rel_mse)),
        ("MAE", four(report.mae)),
        ("PSNR", report.psnr.map_or_else(|| "none: they are the same".to_owned(), |psnr| format!("{psnr:.2} dB"))),
        ("SSIM", four(report.ssim)),
        ("Mean FLIP", four(report.flip_mean)),
        ("FLIP, 99 %", four(report.flip_p99)),
    ];
    if let Some(hdr) = &report.hdr_flip {
        figures.push(("Mean HDR-FLIP", four(hdr.mean)));
        figures.push(("HDR-FLIP, 99 %", four(hdr.p99)));
    }
    figures.push(("Differing pixels", format!("{} of {} ({share:.2} %)", report.differing_pixels, report.pixels)));
    if let Some([x, y]) = report.max_at {
        figures.push(("Largest difference", format!("{} at {x}, {y}", report.max_difference)));
    }
    figures
}
