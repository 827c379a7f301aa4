//! Renders passes in waves: as many samples at a time as keep every submit at tens of milliseconds ([`super::pace`]).

use std::sync::Arc;
use std::time::Instant;

use bytemuck::Zeroable;

use super::context::Context;
use super::layers::Layers;
use super::pace::{Pace, PixelOrder};
use super::scene::{GpuScene, Wave};
use super::stages::{MIN_SLOTS, Run, Stages, WIDEST_SLOT_BYTES, most_bindings};
use super::structure::{GpuStructure, Kept};
use crate::accel::line_space::GateCounters;
use crate::device::{DeviceError, Pass, PassStats, RayCounts, Region, Renderer, Watch};
use crate::film::{AovBuffers, PassFilm};
use crate::integrate::aov::FirstHit;
use crate::pack::{NONE, PackedScene};
use crate::settings::{Integrator, RenderSettings};
use crate::trace::Counters;

/// Samples of a pixel that stand side by side in a wave, when there are so many: their rays are alike.
const SAMPLES_TOGETHER: u32 = 16;
/// Times that one wave is tried again on a fresh device.
const MAX_RETRIES: u32 = 2;
/// Bounces between two looks at whether any path is alive: a look costs as much as a short submit.
const LIVENESS_INTERVAL: u32 = 8;

/// A scene on the device. Lost with it, and made again from the packed scene.
pub(super) struct Resident {
    pub context: Arc<Context>,
    pub structure: Arc<GpuStructure>,
    pub scene: GpuScene,
}

impl Resident {
    fn upload(context: Arc<Context>, structure: Arc<GpuStructure>, packed: &PackedScene) -> Result<Self, DeviceError> {
        let scene = GpuScene::upload(&context, packed)?;
        context.check_bindings(most_bindings(&structure, &scene))?;
        context.check()?;
        Ok(Self { context, structure, scene })
    }

    pub(super) fn run(&self) -> Run<'_> {
        Run {
            context: &self.context,
            structure: &self.structure,
            scene: &self.scene,
            longest_s: std::cell::Cell::new(0.0),
        }
    }
}

pub(super) struct GpuRenderer {
    packed: Arc<PackedScene>,
    integrator: Integrator,
    seed: u32,
    resident: Resident,
    stages: Option<Stages>,
    layers: Option<Layers>,
    wave_pace: Pace,
    layer_pace: Pace,
}

impl GpuRenderer {
    pub(super) fn new(
        context: Arc<Context>,
        structure: Arc<GpuStructure>,
        packed: Arc<PackedScene>,
        settings: &RenderSettings,
    ) -> Result<Self, DeviceError> {
        let (wave_pace, layer_pace) = Self::paces(&context);
        let resident = Resident::upload(context, structure, &packed)?;
        Ok(Self {
            packed,
            integrator: settings.integrator,
            seed: settings.seed,
            resident,
            stages: None,
            layers: None,
            wave_pace,
            layer_pace,
        })
    }

    fn paces(context: &Context) -> (Pace, Pace) {
        let pace = |slot_bytes| Pace::new(MIN_SLOTS, slot_bytes, context.binding_limit());
        (pace(WIDEST_SLOT_BYTES), pace(size_of::<FirstHit>() as u64))
    }

    /// Runs `work`; when the device is lost, again on a new one.
    fn with_retries<T>(&mut self, mut work: impl FnMut(&mut Self) -> Result<T, DeviceError>) -> Result<T, DeviceError> {
        let mut retries = 0;
        loop {
            let reason = match work(self) {
                Err(DeviceError::Lost(reason)) if retries < MAX_RETRIES => reason,
                result => return result,
            };
            retries += 1;
            tracing::warn!(reason, retries, "the GPU was lost; opening it again");
            match self.revive() {
                Ok(()) | Err(DeviceError::Lost(_)) => {}
                Err(error) => return Err(error),
            }
        }
    }

    fn revive(&mut self) -> Result<(), DeviceError> {
        self.stages = None;
        self.layers = None;
        let context = Arc::new(self.resident.context.reopen()?);
        (self.wave_pace, self.layer_pace) = Self::paces(&context);
        let structure = Kept::default().of_scene(&context, &self.packed)?;
        self.resident = Resident::upload(context, structure, &self.packed)?;
        Ok(())
    }

    /// Stages with room for the next wave.
    fn reserve_stages(&mut self, needed: u64) -> Result<(), DeviceError> {
        let slots = needed.min(u64::from(self.wave_pace.slots())) as u32;
        if self.stages.as_ref().is_none_or(|stages| stages.slots < slots) {
            self.stages = None;
            let Resident { context, structure, scene } = &self.resident;
            self.stages = Some(Stages::new(context, structure, scene, self.integrator, slots.next_power_of_two())?);
        }
        Ok(())
    }

    /// The sums over all samples of the pass of pixels from the `first` in the region's order on; how many, is up to the
    /// pace.
    fn render_run(&mut self, pass: &Pass, first: u32, watch: &dyn Watch) -> Result<RunSums, DeviceError> {
        let left = pass.region.pixels() as u32 - first;
        self.reserve_stages(u64::from(left) * u64::from(pass.samples))?;
        let Some(stages) = &self.stages else { return Err(DeviceError::Other("no stages".to_owned())) };
        let slots = stages.slots.min(self.wave_pace.slots());
        let pixels = (slots / pass.samples.min(SAMPLES_TOGETHER)).clamp(1, left);
        let context = &*self.resident.context;
        let before = stages.totals(context)?;
        let (mut done, mut longest_s) = (0, 0.0_f64);
        while done < pass.samples {
            if watch.cancelled() {
                return Err(DeviceError::Cancelled);
            }
            let slots = stages.slots.min(self.wave_pace.slots());
            let samples = (slots / pixels).clamp(1, pass.samples - done);
            let wave = Wave {
                pixels,
                first_sample: pass.first_sample + done,
                samples,
                seed: self.seed,
                accumulated: done,
                capacity: stages.slots,
                ..Wave::over(pass.region, first)
            };
            let run = self.resident.run();
            render_wave(stages, &run, wave, self.integrator)?;
            let wave_s = run.longest_s.get();
            tracing::trace!(slots = pixels * samples, longest_s = wave_s, "wave");
            longest_s = longest_s.max(self.wave_pace.record(pixels * samples, wave_s));
            done += samples;
            let finished = f64::from(first) + f64::from(pixels) * f64::from(done) / f64::from(pass.samples);
            watch.progress(finished / pass.region.pixels() as f64);
        }
        let counted = stages.totals(context)?.since(&before);
        let primary = u64::from(pixels) * u64::from(pass.samples);
        let is_ao = matches!(self.integrator, Integrator::Ao { .. });
        let rays = RayCounts {
            primary,
            indirect: counted.closest - primary,
            shadow: if is_ao { 0 } else { counted.shadow },
            ao: if is_ao { counted.shadow } else { 0 },
        };
        Ok(RunSums { sums: stages.sums(context, pixels)?, rays, gates: counted.gates(), longest_s })
    }
}

/// Values of a region's pixels that came in the order of their turns, row by row.
fn in_rows<T: Copy + Zeroable>(region: Region, values: &[T]) -> Vec<T> {
    let order = PixelOrder::new(region.pixels() as u32);
    let mut rows = vec![T::zeroed(); values.len()];
    for (number, value) in (0..).zip(values) {
        rows[order.pixel(number) as usize] = *value;
    }
    rows
}

struct RunSums {
    sums: Vec<[f64; 3]>,
    rays: RayCounts,
    gates: GateCounters,
    longest_s: f64,
}

/// All bounces of one wave, and its radiance into the sums.
fn render_wave(stages: &Stages, run: &Run<'_>, mut wave: Wave, integrator: Integrator) -> Result<(), DeviceError> {
    stages.generate(run, &wave)?;
    match integrator {
        Integrator::Aov => {
            wave.closest_number = NONE;
            stages.bounce(run, &wave)?;
        }
        Integrator::Ao { samples, distance } => {
            wave.ao_samples = samples.max(1);
            wave.ao_distance = distance;
            stages.trace(run, &wave)?;
            for ray in 0..wave.ao_samples {
                wave.ao_index = ray;
                wave.shadow_number = 1 + ray;
                stages.shade(run, &wave)?;
            }
        }
        Integrator::Direct => bounces(stages, run, &mut wave, 0, 1)?,
        Integrator::Path { max_bounces } => {
            bounces(stages, run, &mut wave, max_bounces, max_bounces.saturating_add(1))?
        }
        Integrator::Whitted { max_bounces } => bounces(stages, run, &mut wave, max_bounces, max_bounces)?,
    }
    stages.accumulate(run, &wave)
}

/// Vertices 0 to `last`. A path's last ray may only look for the light that its last vertex could not connect to.
fn bounces(stages: &Stages, run: &Run<'_>, wave: &mut Wave, max_bounces: u32, last: u32) -> Result<(), DeviceError> {
    wave.max_bounces = max_bounces;
    for bounce in 0..=last {
        wave.active_queue = bounce % 2;
        if bounce > 0 && bounce % LIVENESS_INTERVAL == 0 && !stages.has_paths(run.context, wave.active_queue)? {
            break;
        }
        wave.bounce = bounce;
        wave.closest_number = bounce.wrapping_mul(2);
        wave.shadow_number = wave.closest_number.wrapping_add(1);
        stages.bounce(run, wave)?;
    }
    Ok(())
}

impl Renderer for GpuRenderer {
    fn render(&mut self, pass: &Pass, film: &mut PassFilm, watch: &dyn Watch) -> Result<PassStats, DeviceError> {
        pass.region.check_within(film.region)?;
        if pass.first_sample.checked_add(pass.samples).is_none() {
            return Err(DeviceError::Other("the pass counts its samples past 32 bits".to_owned()));
        }
        let started = Instant::now();
        let mut stats = PassStats::default();
        let mut sums = Vec::with_capacity(pass.region.pixels());
        while sums.len() < pass.region.pixels() && pass.samples > 0 {
            let first = sums.len() as u32;
            let run = self.with_retries(|renderer| renderer.render_run(pass, first, watch))?;
            sums.extend(run.sums);
            stats.rays += run.rays;
            stats.counters.gates += run.gates;
            stats.longest_submit_s = stats.longest_submit_s.max(run.longest_s);
        }
        let sums = in_rows(pass.region, &sums);
        // Only now, so that a cancelled pass leaves the film as it was.
        for (i, sum) in pass.region.places_in(film.region).zip(sums) {
            (0..3).for_each(|c| film.sum[i][c] += sum[c]);
        }
        film.samples += pass.samples;
        stats.seconds = started.elapsed().as_secs_f64();
        Ok(stats)
    }

    fn aovs(&mut self, region: Region, out: &mut AovBuffers, watch: &dyn Watch) -> Result<PassStats, DeviceError> {
        region.check_within(out.region)?;
        if let Some((aov, _)) = out.layers.iter().find(|(aov, _)| aov.is_of_line_space()) {
            return Err(DeviceError::Other(format!("layer {} is made by the CPU device alone", aov.name())));
        }
        let started = Instant::now();
        let mut stats = PassStats::default();
        let mut hits = Vec::with_capacity(region.pixels());
        while hits.len() < region.pixels() {
            if watch.cancelled() {
                return Err(DeviceError::Cancelled);
            }
            let first = hits.len() as u32;
            let (part, longest_s) = self.with_retries(|renderer| {
                let pixels = renderer.layer_pace.slots().min(region.pixels() as u32 - first);
                let layers = Layers::reserve(&mut renderer.layers, &renderer.resident, pixels)?;
                let run = renderer.resident.run();
                let hits = layers.render(&run, region, first, pixels)?;
                Ok((hits, renderer.layer_pace.record(pixels, run.longest_s.get())))
            })?;
            hits.extend(part);
            stats.longest_submit_s = stats.longest_submit_s.max(longest_s);
        }
        for hit in &hits {
            let (box_tests, triangle_tests) = (hit.box_tests.into(), hit.primitive_tests.into());
            stats.counters += Counters { box_tests, triangle_tests, ..Counters::default() };
        }
        stats.rays.primary = hits.len() as u64;
        out.store_hits(region, &in_rows(region, &hits));
        stats.seconds = started.elapsed().as_secs_f64();
        Ok(stats)
    }

    fn device_bytes(&self) -> u64 {
        let stages = self.stages.as_ref().map_or(0, Stages::bytes);
        self.resident.structure.bytes + self.resident.scene.bytes + stages
    }
}

#[cfg(test)]
mod tests {
    use glam::{Affine3A, Vec3};

    use super::*;
    use crate::device::Device;
    use crate::device::gpu::GpuDevice;
    use crate::integrate::tests::{camera, matte, prepare, scene, settings, sphere, square};

    #[test]
    fn jobs_leave_nothing_behind() {
        let context = Arc::new(Context::open(None).expect("tests need an adapter (mesa-vulkan-drivers has one)"));
        let allocated = || {
            let report = context.device.generate_allocator_report().expect("Vulkan counts");
            (report.allocations.len(), report.total_allocated_bytes)
        };
        let mut device = GpuDevice::with_context(context.clone());
        let mut job = |number: usize| {
            let lifted = Affine3A::from_translation(Vec3::Z * number as f32);
            let objects =
                scene(vec![(square(), matte(0.5, 1.0), Affine3A::IDENTITY), (sphere(), matte(0.5, 1.0), lifted)]);
            let integrator = if number.is_multiple_of(2) {
                Integrator::Direct
            } else {
                Integrator::Ao { samples: 2, distance: 1.0 }
            };
            let settings = settings(integrator, camera(Vec3::ZERO, Vec3::Z, 4.0, 1.0), 1.0);
            let region = Region::full(&settings);
            let mut renderer = device.prepare(Arc::new(prepare(&objects, &settings)), &settings).expect("prepares");
            let mut film = PassFilm::new(region);
            renderer.render(&Pass { region, first_sample: 0, samples: 1 }, &mut film, &|| false).expect("renders");
        };
        job(0);
        job(1);
        let after_two = allocated();
        (2..30).for_each(&mut job);
        assert_eq!(allocated(), after_two);
    }
}
