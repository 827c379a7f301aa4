//! What a job will take: bytes from the scene and the settings, seconds from jobs like it.

use lightshaft_api::estimate::{Estimate, MeasuredJobs};
use lightshaft_api::scene::SceneSummary;
use lightshaft_api::settings::{Acceleration, DeviceChoice, JobSettings, RenderSettings};
use lightshaft_compare::timing;
use lightshaft_worker::estimate::line_space_bytes;

use super::App;
use crate::error::ApiResult;
use crate::store::Measurement;

/// Newest jobs that are looked at.
const MOST_JOBS: u32 = 50;
/// Four channels in single precision.
const LAYER_BYTES_PER_PIXEL: u64 = 16;

impl App {
    /// Of settings that have been checked.
    pub(super) async fn estimate(
        &self,
        scene: &str,
        summary: &SceneSummary,
        settings: &JobSettings,
    ) -> ApiResult<Estimate> {
        // Pictures are compared without the scene.
        let scene_bytes = if matches!(settings, JobSettings::Compare(_)) { 0 } else { summary.estimated_bytes };
        let (acceleration, picture_bytes) = match settings {
            JobSettings::Render(settings) => (Some(&settings.acceleration), picture_bytes(settings)),
            JobSettings::Build(settings) => (Some(&settings.acceleration), 0),
            JobSettings::Benchmark(_) | JobSettings::Compare(_) => (None, 0),
        };
        let line_space_bytes = acceleration.and_then(|acceleration| of_line_spaces(acceleration, summary));
        let measured = match settings {
            JobSettings::Render(settings) => {
                let recent = self.store.measurements(settings.integrator, MOST_JOBS).await?;
                like_it(recent, scene, settings.device)
            }
            JobSettings::Benchmark(_) | JobSettings::Build(_) | JobSettings::Compare(_) => None,
        };
        let samples = match settings {
            JobSettings::Render(s) => f64::from(s.width) * f64::from(s.height) * f64::from(s.spp),
            JobSettings::Benchmark(_) | JobSettings::Build(_) | JobSettings::Compare(_) => 0.0,
        };
        Ok(Estimate {
            scene_bytes,
            line_space_bytes,
            picture_bytes,
            bytes: scene_bytes.saturating_add(line_space_bytes.unwrap_or(0)).saturating_add(picture_bytes),
            render_s: measured.as_ref().map(|m| samples * m.rays_per_sample / (m.mrays_per_s * 1e6)),
            measured,
        })
    }
}

fn picture_bytes(settings: &RenderSettings) -> u64 {
    let pixels = u64::from(settings.width) * u64::from(settings.height);
    pixels * LAYER_BYTES_PER_PIXEL * (1 + settings.aovs.len() as u64)
}

fn of_line_spaces(acceleration: &Acceleration, scene: &SceneSummary) -> Option<u64> {
    let meshes: Vec<u64> = scene.meshes.iter().map(|mesh| mesh.triangles + mesh.spheres).collect();
    let instanced = scene.meshes.iter().map(|mesh| (mesh.triangles + mesh.spheres) * mesh.instances).sum();
    line_space_bytes(acceleration, &meshes, instanced)
}

/// Those of the same scene where there are any, and of the device that was used last.
fn like_it(recent: Vec<Measurement>, scene: &str, device: DeviceChoice) -> Option<MeasuredJobs> {
    let wanted_kind = match device {
        DeviceChoice::Auto => None,
        DeviceChoice::Cpu => Some("cpu"),
        DeviceChoice::Gpu => Some("gpu"),
    };
    let is_like_it = |m: &&Measurement| {
        wanted_kind.is_none_or(|kind| m.device_kind == kind) && m.samples > 0.0 && m.rays > 0.0 && m.mrays_per_s > 0.0
    };
    let able: Vec<&Measurement> = recent.iter().filter(is_like_it).collect();
    let same_scene = able.iter().any(|m| m.scene == scene);
    let near = || able.iter().filter(|m| !same_scene || m.scene == scene);
    let device = &near().next()?.device;
    let median = |values: Vec<f64>| timing::median(&values);
    let used: Vec<&&Measurement> = near().filter(|m| m.device == *device).collect();
    Some(MeasuredJobs {
        jobs: used.len() as u32,
        same_scene,
        device: device.clone(),
        mrays_per_s: median(used.iter().map(|m| m.mrays_per_s).collect())?,
        rays_per_sample: median(used.iter().map(|m| m.rays / m.samples).collect())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measurement(scene: &str, kind: &str, mrays_per_s: f64) -> Measurement {
        Measurement {
            scene: scene.to_owned(),
            samples: 100.0,
            rays: 300.0,
            mrays_per_s,
            device: format!("the {kind}"),
            device_kind: kind.to_owned(),
        }
    }

    #[test]
    fn the_same_scene_counts_before_others_and_one_device_at_a_time() {
        let recent = || {
            vec![
                measurement("other", "cpu", 9.0),
                measurement("mine", "cpu", 2.0),
                measurement("mine", "gpu", 50.0),
                measurement("mine", "cpu", 4.0),
                measurement("mine", "cpu", 0.0),
            ]
        };
        let found = like_it(recent(), "mine", DeviceChoice::Cpu).unwrap();
        assert_eq!((found.jobs, found.same_scene, found.mrays_per_s, found.rays_per_sample), (2, true, 3.0, 3.0));
        assert_eq!(like_it(recent(), "mine", DeviceChoice::Gpu).unwrap().mrays_per_s, 50.0);
        assert_eq!(like_it(recent(), "mine", DeviceChoice::Auto).unwrap().device, "the cpu", "the newest");
        let elsewhere = like_it(recent(), "new", DeviceChoice::Auto).unwrap();
        assert_eq!((elsewhere.jobs, elsewhere.same_scene, elsewhere.mrays_per_s), (3, false, 4.0));
        assert_eq!(like_it(Vec::new(), "mine", DeviceChoice::Auto), None);
    }
}
