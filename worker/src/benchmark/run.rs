//! Runs a plan: scene by scene, comparison by comparison, view by view.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use lightshaft_api::benchmark::{BenchmarkResults, Comparison, PictureDifference, Row, SceneResults};
use lightshaft_api::job::{Metrics, Phase};
use lightshaft_api::problem::FieldError;
use lightshaft_api::settings::{BenchmarkSettings, CameraChoice, DeviceChoice, Effect, RenderSettings, file_name};
use lightshaft_compare::{Image, Options, compare, heat_map_with_scale};
use lightshaft_engine::device::cpu::CpuDevice;
use lightshaft_engine::device::{Device, DeviceInfo, Region};
use lightshaft_engine::film::{EncodeError, ToneMap, encode_png, encode_png_srgb8};
use lightshaft_engine::pack;
use lightshaft_engine::scene::{self, Scene};

use super::build::{Structures, build};
use super::measure::{Picture, Runner, Times, rounds};
use super::plan::{Plan, PlannedComparison, Scenes};
use super::report;
use super::stage::{Frame, Staged, stage};
use crate::executor::{Artifact, Choice, Executor, Observer, Progress, TaskError, metrics_json, peak_bytes, versions};
use crate::settings::resolve;

/// What a benchmark left.
#[derive(Clone, Debug)]
pub struct BenchmarkOutputs {
    pub results: BenchmarkResults,
    /// Of all configurations together.
    pub metrics: Metrics,
    /// The results as JSON, CSV and Markdown; pictures and heat maps.
    pub artifacts: Vec<Artifact>,
}

/// A benchmark under way.
struct Run<'a> {
    executor: &'a Executor,
    settings: &'a BenchmarkSettings,
    observer: &'a dyn Observer,
    stop: &'a AtomicBool,
    choice: Choice,
    width: u32,
    height: u32,
    /// Comparisons that are done, and all.
    done: usize,
    total: usize,
    device: Option<DeviceInfo>,
    pictures: Vec<Artifact>,
}

impl Executor {
    /// Runs a benchmark. Blocks; uses rayon's global pool. `settings` must have been validated.
    ///
    /// # Errors
    /// [`TaskError::Stopped`] soon after `stop` was set; scenes that cannot be read, views that are not there. A
    /// configuration that this build cannot have is no error: its row says why.
    pub fn benchmark(
        &self,
        settings: &BenchmarkSettings,
        scenes: &dyn Scenes,
        observer: &dyn Observer,
        stop: &AtomicBool,
    ) -> Result<BenchmarkOutputs, TaskError> {
        let started = Instant::now();
        let plan = Plan::of(settings, scenes.list())?;
        let mut run = Run {
            executor: self,
            settings,
            observer,
            stop,
            choice: choose(self, settings, plan.needs_cpu())?,
            width: plan.width,
            height: plan.height,
            done: 0,
            total: plan.scenes.iter().map(|(_, comparisons)| comparisons.len()).sum(),
            device: None,
            pictures: Vec::new(),
        };
        let mut results = Vec::new();
        for (index, (input, comparisons)) in plan.scenes.iter().enumerate() {
            run.report(Phase::Import, 0.0);
            let source = scenes.open(index, self.limits())?;
            let scene = scene::import(&source, self.limits(), &|| stop.load(Ordering::Relaxed))?;
            let prefix = if plan.scenes.len() > 1 {
                format!("{}-{}-", index + 1, file_name(&input.name))
            } else {
                String::new()
            };
            let mut compared = Vec::new();
            for (number, comparison) in comparisons.iter().enumerate() {
                let part = if comparisons.len() > 1 { format!("{}-", number + 1) } else { String::new() };
                observer.log(format!("{}: {}", input.name, comparison.title));
                compared.push(run.comparison(&scene, &input.views, comparison, &format!("{prefix}{part}"))?);
                run.done += 1;
            }
            results.push(SceneResults {
                name: input.name.clone(),
                measured: input.measured.clone(),
                stand_in: input.stand_in,
                triangles: scene.meshes.iter().map(|mesh| mesh.triangles.len() as u64).sum(),
                spheres: scene.meshes.iter().map(|mesh| mesh.spheres.len() as u64).sum(),
                instances: scene.instances.len() as u64,
                meshes: scene.meshes.len() as u64,
                comparisons: compared,
            });
        }
        let device = run.device.take();
        let results = BenchmarkResults {
            title: plan.title,
            preset: settings.preset,
            source: plan.source,
            device: device.as_ref().map(|info| info.name.clone()).unwrap_or_default(),
            device_kind: device.as_ref().map(|info| info.kind.to_owned()).unwrap_or_default(),
            driver: device.map(|info| info.driver).unwrap_or_default(),
            versions: versions(),
            width: plan.width,
            height: plan.height,
            spp: settings.spp,
            picture_spp: settings.picture_spp,
            seed: settings.seed,
            repetitions: settings.repetitions,
            min_sample_s: settings.min_sample_s,
            columns: plan.columns,
            scenes: results,
            total_s: started.elapsed().as_secs_f64(),
        };
        let metrics = sum(&results);
        let mut artifacts = report::artifacts(&results)?;
        artifacts.push(metrics_json(&metrics)?);
        artifacts.append(&mut run.pictures);
        Ok(BenchmarkOutputs { results, metrics, artifacts })
    }
}

impl Run<'_> {
    fn comparison(
        &mut self,
        scene: &Scene,
        views: &[CameraChoice],
        planned: &PlannedComparison,
        prefix: &str,
    ) -> Result<Comparison, TaskError> {
        let frame = Frame { settings: self.settings, width: self.width, height: self.height, views };
        let construction = Effect::Primary {};
        let staged = stage(scene, planned.effect.as_ref().unwrap_or(&construction), frame);
        let Some((_, first)) = staged.views.first() else {
            return Err(TaskError::bad_input("/settings/views: there is no view to render"));
        };
        let resolved = resolve(first, &staged.scene, None).map_err(bad_view)?;
        let whole = pack::with_overlays(&staged.scene, &resolved);
        let mut rows = Vec::new();
        let mut contenders = Vec::new();
        for configuration in &planned.configurations {
            self.check_stop()?;
            self.report(Phase::Structures, 0.0);
            let structures = match &configuration.acceleration {
                Err(why) => Err(why.clone()),
                Ok(acceleration) => build(self.executor, acceleration, &whole, first, self.observer, self.stop)?,
            };
            if let Err(why) = &structures {
                self.observer.log(format!("{}: not available: {why}", configuration.name));
            }
            rows.push(Row {
                configuration: configuration.name.clone(),
                acceleration: configuration.written.clone(),
                unavailable: structures.as_ref().err().cloned(),
                built: structures.as_ref().ok().map(|structures| structures.built.clone()),
                timed: None,
                picture: None,
                paper: configuration.paper,
                warnings: structures.as_ref().map(|structures| structures.warnings.clone()).unwrap_or_default(),
            });
            // Where only building counts, nothing is kept.
            if let (Ok(structures), true) = (structures, planned.effect.is_some()) {
                contenders.push((rows.len() - 1, structures));
            }
        }
        if planned.effect.is_some() {
            let reference =
                contenders.iter().position(|(row, _)| Some(&rows[*row].configuration) == planned.reference.as_ref());
            self.time(&staged, &whole, &contenders, reference, prefix, &mut rows)?;
        } else {
            // Everything is built on the CPU, whatever renders.
            self.device.get_or_insert_with(|| CpuDevice::new().info());
        }
        Ok(Comparison {
            effect: planned.effect.clone(),
            title: planned.title.clone(),
            note: planned
                .effect
                .as_ref()
                .map_or("structures are built, and nothing is rendered", |_| staged.note)
                .to_owned(),
            reference: planned.reference.clone(),
            views: planned.effect.as_ref().map_or(Vec::new(), |_| staged.views.iter().map(|v| v.0.clone()).collect()),
            rows,
        })
    }

    fn time(
        &mut self,
        staged: &Staged,
        whole: &Scene,
        contenders: &[(usize, Structures)],
        reference: Option<usize>,
        prefix: &str,
        rows: &mut [Row],
    ) -> Result<(), TaskError> {
        let mut times: Vec<Times> = contenders.iter().map(|_| Times::default()).collect();
        let count = staged.views.len();
        let repetitions = self.settings.repetitions;
        for (view, (_, settings)) in staged.views.iter().enumerate() {
            let mut runners = Vec::new();
            for (_, structures) in contenders {
                self.check_stop()?;
                self.report(Phase::Prepare, view as f64 / count as f64);
                runners.push(self.runner(settings, &staged.scene, whole, structures)?);
            }
            let stop = self.stop;
            let watch = || stop.load(Ordering::Relaxed);
            let mut pictures = Vec::new();
            for (runner, times) in runners.iter_mut().zip(&mut times) {
                let picture = runner.warm_up(self.settings.picture_spp, self.settings.min_sample_s, &watch)?;
                times.add_work(picture.stats);
                pictures.push(picture);
            }
            let names = contenders.iter().map(|(row, _)| *row);
            self.compare(view, &pictures, reference, names, prefix, rows)?;
            drop(pictures);
            let mut told = |round: u32| {
                let of_view = f64::from(round) / f64::from(repetitions);
                self.report(Phase::Render, (view as f64 + of_view) / count as f64);
            };
            rounds(&mut runners, reference, view as u32, repetitions, &mut times, &watch, &mut told)?;
        }
        for ((row, _), times) in contenders.iter().zip(times) {
            rows[*row].timed = times.summary();
        }
        Ok(())
    }

    fn runner(
        &mut self,
        view: &RenderSettings,
        scene: &Scene,
        whole: &Scene,
        structures: &Structures,
    ) -> Result<Runner, TaskError> {
        let resolved = resolve(view, scene, None).map_err(bad_view)?;
        let packed = pack::pack(whole, &resolved, Arc::clone(&structures.accel))
            .map_err(|error| TaskError::bad_input(error.to_string()))?;
        let on_device = self.executor.devices().prepare(&self.choice, &Arc::new(packed), &resolved)?;
        self.device.get_or_insert(on_device.info);
        Ok(Runner::new(on_device.renderer, Region::full(&resolved), resolved.spp))
    }

    /// Judges the pictures of one view by the reference's; those of the first view are kept.
    fn compare(
        &mut self,
        view: usize,
        pictures: &[Picture],
        reference: Option<usize>,
        row_numbers: impl Iterator<Item = usize>,
        prefix: &str,
        rows: &mut [Row],
    ) -> Result<(), TaskError> {
        let (width, height) = (self.width as usize, self.height as usize);
        let image = |picture: &Picture| {
            Image::new(width, height, picture.film.mean()).map_err(|error| TaskError::worker(error.to_string()))
        };
        let base = reference.map(|i| image(&pictures[i])).transpose()?;
        for (i, (picture, row)) in pictures.iter().zip(row_numbers).enumerate() {
            let row = &mut rows[row];
            let name = file_name(&row.configuration);
            let (heat_name, picture_name) =
                (format!("heatmap-{prefix}{name}.png"), format!("picture-{prefix}{name}.png"));
            if view == 0 {
                let metadata = [("Software", format!("lightshaft {}", env!("CARGO_PKG_VERSION")))];
                let mean = picture.film.mean();
                let png = encode_png(self.width, self.height, &mean, ToneMap::PbrNeutral, 0.0, &metadata);
                self.keep(&picture_name, png)?;
            }
            let Some(base) = base.as_ref().filter(|_| Some(i) != reference) else { continue };
            let comparison = compare(base, &image(picture)?, &Options::default())
                .map_err(|error| TaskError::worker(error.to_string()))?;
            if view == 0 {
                let drawing = heat_map_with_scale(&comparison.flip);
                let png = encode_png_srgb8(drawing.width as u32, drawing.height as u32, &drawing.rgb, &[]);
                self.keep(&heat_name, png)?;
            }
            let worst = row.picture.get_or_insert(PictureDifference {
                rmse: 0.0,
                flip: 0.0,
                differing_pixels: 0,
                heat_map: heat_name,
                picture: picture_name,
            });
            worst.rmse = worst.rmse.max(comparison.report.differences.rmse);
            worst.flip = worst.flip.max(comparison.report.flip_mean);
            worst.differing_pixels += comparison.report.differences.differing_pixels as u64;
        }
        Ok(())
    }

    fn keep(&mut self, name: &str, png: Result<Vec<u8>, EncodeError>) -> Result<(), TaskError> {
        let bytes = png.map_err(|error| TaskError::worker(format!("{name} could not be encoded: {error}")))?;
        self.pictures.push(Artifact { name: name.to_owned().into(), media_type: "image/png", bytes });
        Ok(())
    }

    fn check_stop(&self) -> Result<(), TaskError> {
        if self.stop.load(Ordering::Relaxed) { Err(TaskError::Stopped) } else { Ok(()) }
    }

    /// `within`: of the comparison that is under way.
    fn report(&self, phase: Phase, within: f64) {
        let fraction = (self.done as f64 + within) / self.total.max(1) as f64;
        self.observer.progress(Progress { phase, fraction: 0.99 * fraction.min(1.0), spp: 0 });
    }
}

/// What all of it took: times of building and rendering, the rays of all times.
fn sum(results: &BenchmarkResults) -> Metrics {
    let mut metrics = Metrics {
        device: results.device.clone(),
        device_kind: results.device_kind.clone(),
        versions: results.versions.clone(),
        spp: results.spp,
        total_s: results.total_s,
        peak_bytes: peak_bytes(),
        ..Metrics::default()
    };
    let rows = results.scenes.iter().flat_map(|scene| &scene.comparisons).flat_map(|comparison| &comparison.rows);
    for row in rows {
        if let Some(built) = &row.built {
            metrics.build_s += built.init_s;
            metrics.structure_bytes = metrics.structure_bytes.max(built.structure_bytes);
            metrics.line_space_bytes = metrics.line_space_bytes.max(built.line_space_bytes);
        }
        for sample in row.timed.iter().flat_map(|timed| &timed.samples) {
            metrics.render_s += sample.seconds;
        }
        if let Some(timed) = &row.timed {
            let frames: u64 = timed.samples.iter().map(|sample| u64::from(sample.frames)).sum();
            metrics.rays.primary += timed.rays.primary * frames;
            metrics.rays.shadow += timed.rays.shadow * frames;
            metrics.rays.ao += timed.rays.ao * frames;
            metrics.rays.indirect += timed.rays.indirect * frames;
        }
        let told = row.warnings.iter().map(|warning| format!("{}: {warning}", row.configuration));
        metrics.warnings.extend(told);
    }
    if metrics.render_s > 0.0 {
        metrics.mrays_per_s = metrics.rays.total() as f64 / metrics.render_s / 1e6;
    }
    metrics
}

/// One device for all configurations: the CPU, where one of them needs it and the settings leave the choice to us.
fn choose(executor: &Executor, settings: &BenchmarkSettings, needs_cpu: bool) -> Result<Choice, TaskError> {
    let devices = executor.devices();
    let wanted = if needs_cpu && settings.device == DeviceChoice::Auto { DeviceChoice::Cpu } else { settings.device };
    Ok(devices.choose(wanted, settings.adapter.as_deref())?)
}

/// A view that the scene does not have.
fn bad_view(error: FieldError) -> TaskError {
    TaskError::bad_input(format!("{}: {}", error.pointer.replace("/settings/camera", "/settings/views"), error.detail))
}
