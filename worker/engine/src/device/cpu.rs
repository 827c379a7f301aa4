//! The CPU device: rayon over tiles, native kernels.
//!
//! Tiles are computed apart and written to the film when all are done, so that a cancelled pass leaves the film as it
//! was. Nothing depends on the number of threads or the order of tiles.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use super::{Device, DeviceError, DeviceInfo, Pass, PassStats, Region, Renderer, Watch};
use crate::film::{AovBuffers, PassFilm};
use crate::integrate::aov::first_hit;
use crate::integrate::usage::usage;
use crate::integrate::{Sample, Tally, radiance};
use crate::pack::PackedScene;
use crate::settings::{Integrator, RenderSettings};
use crate::trace::Kernels;

/// Side of a tile in pixels.
const TILE: u32 = 16;

/// Renders in rayon's current thread pool.
#[derive(Debug, Default)]
pub struct CpuDevice;

impl CpuDevice {
    pub fn new() -> Self {
        Self
    }
}

impl Device for CpuDevice {
    fn info(&self) -> DeviceInfo {
        let threads = rayon::current_num_threads();
        let plural = if threads == 1 { "" } else { "s" };
        DeviceInfo {
            kind: "cpu",
            name: format!("{}, {threads} thread{plural}", Kernels::detect().name()),
            driver: String::new(),
            backend: String::new(),
            device_type: "Cpu".into(),
            max_binding_bytes: 0,
        }
    }

    fn prepare(
        &mut self,
        scene: Arc<PackedScene>,
        settings: &RenderSettings,
    ) -> Result<Box<dyn Renderer>, DeviceError> {
        Ok(Box::new(CpuRenderer { scene, integrator: settings.integrator, seed: settings.seed }))
    }
}

struct CpuRenderer {
    scene: Arc<PackedScene>,
    integrator: Integrator,
    seed: u32,
}

impl Renderer for CpuRenderer {
    fn render(&mut self, pass: &Pass, film: &mut PassFilm, watch: &dyn Watch) -> Result<PassStats, DeviceError> {
        pass.region.check_within(film.region)?;
        let last = pass.first_sample.checked_add(pass.samples);
        let last = last.ok_or_else(|| DeviceError::Other("the pass counts its samples past 32 bits".into()))?;
        let started = Instant::now();
        let (scene, integrator, seed) = (&*self.scene, self.integrator, self.seed);
        let tiles = for_tiles(pass.region, watch, |x, y, tally| {
            let mut sum = [0.0f64; 3];
            for index in pass.first_sample..last {
                let value = radiance(scene, integrator, Sample { x, y, index, seed }, tally);
                sum[0] += f64::from(value.x);
                sum[1] += f64::from(value.y);
                sum[2] += f64::from(value.z);
            }
            sum
        })?;
        let mut stats = PassStats::default();
        for tile in tiles {
            add(&mut stats, &tile.tally);
            for (i, value) in tile.region.places_in(film.region).zip(&tile.values) {
                (0..3).for_each(|c| film.sum[i][c] += value[c]);
            }
        }
        film.samples += pass.samples;
        stats.seconds = started.elapsed().as_secs_f64();
        Ok(stats)
    }

    fn aovs(&mut self, region: Region, out: &mut AovBuffers, watch: &dyn Watch) -> Result<PassStats, DeviceError> {
        region.check_within(out.region)?;
        let started = Instant::now();
        let (scene, integrator, seed) = (&*self.scene, self.integrator, self.seed);
        let mut stats = PassStats::default();
        if out.layers.iter().any(|(aov, _)| !aov.is_of_line_space()) {
            for tile in for_tiles(region, watch, |x, y, tally| first_hit(scene, x, y, tally))? {
                add(&mut stats, &tile.tally);
                out.store_hits(tile.region, &tile.values);
            }
        }
        if out.layers.iter().any(|(aov, _)| aov.is_of_line_space()) {
            for tile in for_tiles(region, watch, |x, y, tally| usage(scene, integrator, x, y, seed, tally))? {
                add(&mut stats, &tile.tally);
                out.store_usage(tile.region, &tile.values);
            }
        }
        stats.seconds = started.elapsed().as_secs_f64();
        Ok(stats)
    }

    fn device_bytes(&self) -> u64 {
        0
    }
}

fn add(stats: &mut PassStats, tally: &Tally) {
    stats.rays += tally.rays;
    stats.counters += tally.counters;
}

struct Tile<T> {
    region: Region,
    values: Vec<T>,
    tally: Tally,
}

/// Evaluates every pixel of `region`, tile by tile; `watch` is asked at every pixel, which costs less than one ray.
fn for_tiles<T: Send>(
    region: Region,
    watch: &dyn Watch,
    pixel: impl Fn(u32, u32, &mut Tally) -> T + Sync,
) -> Result<Vec<Tile<T>>, DeviceError> {
    let (columns, rows) = (region.width.div_ceil(TILE), region.height.div_ceil(TILE));
    let (cancelled, done) = (AtomicBool::new(false), AtomicU32::new(0));
    let tiles: Vec<Option<Tile<T>>> = (0..columns * rows)
        .into_par_iter()
        .map(|number| {
            let (dx, dy) = (number % columns * TILE, number / columns * TILE);
            let tile = Region {
                x: region.x + dx,
                y: region.y + dy,
                width: TILE.min(region.width - dx),
                height: TILE.min(region.height - dy),
            };
            let mut tally = Tally::default();
            let mut values = Vec::with_capacity(tile.pixels());
            for y in tile.y..tile.y + tile.height {
                for x in tile.x..tile.x + tile.width {
                    if cancelled.load(Ordering::Relaxed) || watch.cancelled() {
                        cancelled.store(true, Ordering::Relaxed);
                        return None;
                    }
                    values.push(pixel(x, y, &mut tally));
                }
            }
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            watch.progress(f64::from(done) / f64::from(columns * rows));
            Some(Tile { region: tile, values, tally })
        })
        .collect();
    tiles.into_iter().collect::<Option<Vec<_>>>().ok_or(DeviceError::Cancelled)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use glam::{Affine3A, Vec3};

    use super::*;
    use crate::film::{AovLayer, Merger, encode_part};
    use crate::integrate::tests::{camera, glow, matte, prepare, scene, settings, sphere, square};
    use crate::settings::Aov;

    fn job() -> (Arc<PackedScene>, RenderSettings) {
        let lamp = Affine3A::from_translation(Vec3::new(0.5, 1.0, 3.0));
        let scene = scene(vec![
            (square(), matte(0.8, 0.5), Affine3A::from_scale(Vec3::splat(2.0))),
            (sphere(), matte(0.5, 0.2), Affine3A::from_translation(Vec3::Z)),
            (square(), glow(Vec3::splat(4.0)), lamp * Affine3A::from_scale(Vec3::splat(0.3))),
        ]);
        let view = camera(Vec3::ZERO, Vec3::new(0.6, 0.0, 0.8), 9.0, 2.5);
        let mut settings = settings(Integrator::Path { max_bounces: 4 }, view, 0.2);
        (settings.width, settings.height) = (40, 36);
        (Arc::new(prepare(&scene, &settings)), settings)
    }

    fn render(packed: &Arc<PackedScene>, settings: &RenderSettings, passes: &[Pass], region: Region) -> PassFilm {
        let mut film = PassFilm::new(region);
        let mut renderer = CpuDevice::new().prepare(packed.clone(), settings).expect("the CPU takes any scene");
        for pass in passes {
            renderer.render(pass, &mut film, &|| false).expect("not cancelled");
        }
        film
    }

    #[test]
    fn threads_tiles_and_passes_do_not_change_the_picture() {
        let (packed, settings) = job();
        let full = Region::full(&settings);
        let whole = |first_sample, samples| Pass { region: full, first_sample, samples };
        let reference = render(&packed, &settings, &[whole(0, 12)], full);
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
            let film = pool.install(|| render(&packed, &settings, &[whole(0, 12)], full));
            assert_eq!(film, reference, "{threads} threads");
        }
        let progressive = render(&packed, &settings, &[whole(0, 1), whole(1, 7), whole(8, 4)], full);
        assert_eq!((progressive.mean(), progressive.samples), (reference.mean(), 12));

        // Tiles that do not align with the device's own, the left one in two passes, through part files.
        let left = Region { width: 13, ..full };
        let right = Region { x: 13, width: 27, ..full };
        let mut merger = Merger::new(full);
        for (region, first_sample, samples) in [(right, 0, 12), (left, 5, 7), (left, 0, 5)] {
            let film = render(&packed, &settings, &[Pass { region, first_sample, samples }], region);
            merger.add(&encode_part(&film, None)).expect("intact");
        }
        assert_eq!(merger.finish().expect("complete").0.mean(), reference.mean());
    }

    #[test]
    fn another_seed_gives_another_picture_of_the_same_scene() {
        let (packed, mut settings) = job();
        let region = Region::full(&settings);
        let pass = Pass { region, first_sample: 0, samples: 16 };
        let a = render(&packed, &settings, &[pass], region).mean();
        settings.seed = 2;
        let b = render(&packed, &settings, &[pass], region).mean();
        assert_ne!(a, b);
        let sum = |film: &[[f32; 3]]| film.iter().map(|p| p[1]).sum::<f32>();
        assert!((sum(&a) / sum(&b) - 1.0).abs() < 0.02);
    }

    #[test]
    fn layers_of_tiles_merge_into_those_of_the_whole() {
        let (packed, settings) = job();
        let full = Region::full(&settings);
        let mut renderer = CpuDevice::new().prepare(packed, &settings).expect("the CPU takes any scene");
        let mut aovs = |region| {
            let mut out = AovBuffers::new(region, &Aov::ALL);
            let stats = renderer.aovs(region, &mut out, &|| false).expect("not cancelled");
            // One through each pixel's centre, and one of its first sample.
            assert_eq!(stats.rays.primary, 2 * region.pixels() as u64);
            assert!(stats.counters.box_tests > 0);
            out
        };
        let upper = Region { height: 20, ..full };
        let lower = Region { y: 20, height: 16, ..full };
        let whole = aovs(full);
        let mut merger = Merger::new(full);
        for region in [upper, lower] {
            merger.add(&encode_part(&PassFilm::new(region), Some(&aovs(region)))).expect("intact");
        }
        assert_eq!(merger.finish().expect("complete").1, Some(whole.clone()));
        let ids = whole.layers.iter().find(|l| l.0 == Aov::InstanceId);
        let Some((_, AovLayer::Integer(ids))) = ids else { panic!("instance ids are integers") };
        assert!([0, 1, 2, u32::MAX].iter().all(|id| ids.contains(id)));
    }

    #[test]
    fn cancelling_stops_soon_and_leaves_the_film_alone() {
        let (packed, settings) = job();
        let region = Region::full(&settings);
        let mut film = PassFilm::new(region);
        let mut renderer = CpuDevice::new().prepare(packed, &settings).expect("the CPU takes any scene");
        let asked = AtomicUsize::new(0);
        let cancel = || asked.fetch_add(1, Ordering::Relaxed) >= 100;
        let result = renderer.render(&Pass { region, first_sample: 0, samples: 4 }, &mut film, &cancel);
        assert!(matches!(result, Err(DeviceError::Cancelled)));
        assert!(asked.load(Ordering::Relaxed) < 200);
        assert_eq!(film, PassFilm::new(region));
    }

    #[test]
    fn a_pass_tells_how_far_it_is() {
        struct Told(std::sync::Mutex<Vec<f64>>);
        impl Watch for Told {
            fn cancelled(&self) -> bool {
                false
            }

            fn progress(&self, done: f64) {
                self.0.lock().expect("nobody panics").push(done);
            }
        }
        let (packed, settings) = job();
        let region = Region::full(&settings);
        let mut renderer = CpuDevice::new().prepare(packed, &settings).expect("the CPU takes any scene");
        let told = Told(std::sync::Mutex::default());
        let pass = Pass { region, first_sample: 0, samples: 1 };
        renderer.render(&pass, &mut PassFilm::new(region), &told).expect("not cancelled");
        let mut told = told.0.into_inner().expect("nobody panics");
        told.sort_by(f64::total_cmp);
        let tiles = region.width.div_ceil(TILE) * region.height.div_ceil(TILE);
        let expected: Vec<f64> = (1..=tiles).map(|done| f64::from(done) / f64::from(tiles)).collect();
        assert_eq!(told, expected);
    }

    #[test]
    fn passes_outside_of_the_film_are_refused() {
        let (packed, settings) = job();
        let mut film = PassFilm::new(Region { x: 8, y: 0, width: 8, height: 8 });
        let mut renderer = CpuDevice::new().prepare(packed, &settings).expect("the CPU takes any scene");
        let region = Region { x: 0, y: 0, width: 8, height: 8 };
        let result = renderer.render(&Pass { region, first_sample: 0, samples: 1 }, &mut film, &|| false);
        assert!(matches!(result, Err(DeviceError::Other(message)) if message.contains("the pass covers")));
    }
}
