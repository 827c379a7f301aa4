//! Interleaved timing: every configuration once in every round, each between two times of the reference.
//!
//! Machines slow down and speed up over seconds. A ratio of two times taken one after the other cancels that, a ratio of
//! two means taken minutes apart does not. The order turns from round to round, so that no configuration always comes
//! after the same other one.

use lightshaft_api::benchmark::{Interval, Quartiles, Sample, Timed, WorkPerRay};
use lightshaft_api::job::RayCounts;
use lightshaft_compare::timing;
use lightshaft_engine::accel::line_space::Class;
use lightshaft_engine::device::{DeviceError, Pass, PassStats, Region, Renderer, Watch};
use lightshaft_engine::film::PassFilm;

/// Frames that are timed as one at most.
const MOST_FRAMES: f64 = 10_000.0;

/// One configuration in one view, ready to render.
pub(super) struct Runner {
    pub renderer: Box<dyn Renderer>,
    /// The whole picture.
    pub region: Region,
    /// Samples per pixel of a frame.
    pub spp: u32,
    /// Frames of one time, once it is known how long one takes.
    frames: u32,
}

/// The picture that errors are judged by, and what it cost.
pub(super) struct Picture {
    pub film: PassFilm,
    pub stats: PassStats,
}

impl Runner {
    pub(super) fn new(renderer: Box<dyn Renderer>, region: Region, spp: u32) -> Self {
        Self { renderer, region, spp, frames: 1 }
    }

    /// Renders the picture, and so warms everything up; then finds out how many frames make a time of `min_sample_s`.
    pub(super) fn warm_up(
        &mut self,
        picture_spp: u32,
        min_sample_s: f64,
        watch: &dyn Watch,
    ) -> Result<Picture, DeviceError> {
        let mut film = PassFilm::new(self.region);
        let pass = Pass { region: self.region, first_sample: 0, samples: picture_spp.max(self.spp) };
        let stats = self.renderer.render(&pass, &mut film, watch)?;
        let (_, first) = self.time(watch)?;
        self.frames = (min_sample_s / first.max(1e-9)).ceil().clamp(1.0, MOST_FRAMES) as u32;
        Ok(Picture { film, stats })
    }

    /// Renders its frames; answers rays and seconds.
    fn time(&mut self, watch: &dyn Watch) -> Result<(RayCounts, f64), DeviceError> {
        let mut film = PassFilm::new(self.region);
        let pass = Pass { region: self.region, first_sample: 0, samples: self.spp };
        let (mut rays, mut seconds) = (RayCounts::default(), 0.0);
        for _ in 0..self.frames {
            let stats = self.renderer.render(&pass, &mut film, watch)?;
            rays.primary += stats.rays.primary;
            rays.shadow += stats.rays.shadow;
            rays.ao += stats.rays.ao;
            rays.indirect += stats.rays.indirect;
            seconds += stats.seconds;
        }
        Ok((rays, seconds))
    }
}

/// Times of one configuration.
#[derive(Debug, Default)]
pub(super) struct Times {
    samples: Vec<Sample>,
    /// Of one frame, one for each view.
    rays: Vec<RayCounts>,
    work: Vec<PassStats>,
}

impl Times {
    pub(super) fn add_work(&mut self, stats: PassStats) {
        self.work.push(stats);
    }

    fn add(&mut self, round: u32, view: u32, frames: u32, rays: RayCounts, seconds: f64) {
        if self.rays.len() <= view as usize {
            let frames = u64::from(frames.max(1));
            self.rays.push(RayCounts {
                primary: rays.primary / frames,
                shadow: rays.shadow / frames,
                ao: rays.ao / frames,
                indirect: rays.indirect / frames,
            });
        }
        self.samples.push(Sample { round, view, frames, seconds, rays: rays.total(), ratio: None });
    }

    /// The figures; `None` before the first time.
    pub(super) fn summary(self) -> Option<Timed> {
        let views = self.samples.iter().map(|sample| sample.view).max()? + 1;
        let grouped = |figure: &dyn Fn(&Sample) -> Option<f64>| -> Vec<Vec<f64>> {
            let of = |view: u32| self.samples.iter().filter(move |s| s.view == view).filter_map(figure).collect();
            (0..views).map(of).collect()
        };
        let speeds = grouped(&|sample| Some(speed(sample) / 1e6));
        let frames = grouped(&|sample| Some(f64::from(sample.frames) / sample.seconds.max(1e-12)));
        let ratios = grouped(&|sample| sample.ratio);
        Some(Timed {
            mrays_per_s: timing::grouped_quartiles(&speeds).map(quartiles)?,
            frames_per_s: timing::grouped_quartiles(&frames).map(quartiles)?,
            ratio: timing::grouped_median(&ratios).map(|i| Interval { value: i.value, low: i.low, high: i.high }),
            rays: mean(&self.rays),
            per_ray: per_ray(&self.work),
            samples: self.samples,
        })
    }
}

/// Times every runner `rounds` times; `times` are theirs, in the same order.
pub(super) fn rounds(
    runners: &mut [Runner],
    reference: Option<usize>,
    view: u32,
    rounds: u32,
    times: &mut [Times],
    watch: &dyn Watch,
    done: &mut dyn FnMut(u32),
) -> Result<(), DeviceError> {
    let others: Vec<usize> = (0..runners.len()).filter(|&i| Some(i) != reference).collect();
    for round in 0..rounds {
        let mut run = |i: usize, times: &mut [Times]| -> Result<f64, DeviceError> {
            let (rays, seconds) = runners[i].time(watch)?;
            times[i].add(round, view, runners[i].frames, rays, seconds);
            Ok(rays.total() as f64 / seconds.max(1e-12))
        };
        let mut before = reference.map(|i| run(i, times)).transpose()?;
        for k in 0..others.len() {
            let i = others[(k + round as usize) % others.len()];
            let own = run(i, times)?;
            let after = reference.map(|i| run(i, times)).transpose()?;
            if let (Some(before), Some(after), Some(sample)) = (before, after, times[i].samples.last_mut()) {
                sample.ratio = Some(own / (0.5 * (before + after)));
            }
            before = after;
        }
        done(round + 1);
    }
    Ok(())
}

/// Rays per second.
fn speed(sample: &Sample) -> f64 {
    sample.rays as f64 / sample.seconds.max(1e-12)
}

fn quartiles(q: timing::Quartiles) -> Quartiles {
    Quartiles { lower: q.lower, median: q.median, upper: q.upper }
}

fn mean(rays: &[RayCounts]) -> RayCounts {
    let count = rays.len().max(1) as u64;
    let of = |kind: fn(&RayCounts) -> u64| rays.iter().map(kind).sum::<u64>() / count;
    RayCounts { primary: of(|r| r.primary), shadow: of(|r| r.shadow), ao: of(|r| r.ao), indirect: of(|r| r.indirect) }
}

fn per_ray(work: &[PassStats]) -> WorkPerRay {
    let rays = work.iter().map(|stats| stats.rays.total()).sum::<u64>().max(1) as f64;
    let of = |figure: &dyn Fn(&PassStats) -> u64| work.iter().map(figure).sum::<u64>() as f64 / rays;
    let class = |class: Class| of(&|stats| stats.counters.gates.of_class(class));
    WorkPerRay {
        box_tests: of(&|stats| stats.counters.box_tests),
        triangle_tests: of(&|stats| stats.counters.triangle_tests),
        look_ups: of(&|stats| stats.counters.gates.look_ups()),
        empty: class(Class::Empty),
        opaque: class(Class::Opaque),
        mixed: class(Class::Mixed),
        starts_inside: of(&|stats| stats.counters.gates.starts_inside),
        approximated: of(&|stats| stats.counters.gates.approximated),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;
    use lightshaft_engine::film::AovBuffers;

    /// Takes a known time for a frame of 100 rays, and notes when it ran.
    struct Clockwork {
        seconds: f64,
        name: char,
        log: Arc<Mutex<String>>,
    }

    impl Renderer for Clockwork {
        fn render(&mut self, pass: &Pass, film: &mut PassFilm, _: &dyn Watch) -> Result<PassStats, DeviceError> {
            self.log.lock().expect("nobody panics").push(self.name);
            film.samples += pass.samples;
            let rays = lightshaft_engine::device::RayCounts { primary: 100, ..Default::default() };
            Ok(PassStats { rays, seconds: self.seconds, ..PassStats::default() })
        }

        fn aovs(&mut self, _: Region, _: &mut AovBuffers, _: &dyn Watch) -> Result<PassStats, DeviceError> {
            Ok(PassStats::default())
        }

        fn device_bytes(&self) -> u64 {
            0
        }
    }

    fn runner(name: char, seconds: f64, log: &Arc<Mutex<String>>) -> Runner {
        let region = Region { x: 0, y: 0, width: 4, height: 4 };
        Runner::new(Box::new(Clockwork { seconds, name, log: Arc::clone(log) }), region, 1)
    }

    #[test]
    fn a_time_lasts_as_long_as_was_asked() {
        let log = Arc::default();
        for (seconds, frames) in [(0.03, 4), (0.5, 1), (1e-9, 10_000)] {
            let mut runner = runner('a', seconds, &log);
            let picture = runner.warm_up(16, 0.1, &|| false).expect("renders");
            assert_eq!((runner.frames, picture.film.samples), (frames, 16));
        }
    }

    #[test]
    fn the_reference_runs_between_the_others_and_their_order_turns() {
        let log = Arc::default();
        let mut runners = [runner('r', 0.2, &log), runner('a', 0.1, &log), runner('b', 0.4, &log)];
        let mut times: Vec<Times> = (0..3).map(|_| Times::default()).collect();
        let mut told = Vec::new();
        rounds(&mut runners, Some(0), 0, 3, &mut times, &|| false, &mut |round| told.push(round)).expect("renders");
        assert_eq!(*log.lock().expect("nobody panics"), "rarbrrbrarrarbr");
        assert_eq!(told, [1, 2, 3]);
        let timed: Vec<Timed> = times.into_iter().map(|times| times.summary().expect("times")).collect();
        assert_eq!(timed[0].ratio, None);
        assert_eq!(timed[0].samples.len(), 9);
        let ratio = timed[1].ratio.expect("a ratio");
        assert!((ratio.value - 2.0).abs() < 1e-12 && ratio.low == ratio.high);
        assert!((timed[2].ratio.expect("a ratio").value - 0.5).abs() < 1e-12);
        assert!((timed[1].mrays_per_s.median - 0.001).abs() < 1e-12);
        assert!((timed[1].frames_per_s.median - 10.0).abs() < 1e-9);
        assert_eq!(timed[1].rays.primary, 100);
    }

    #[test]
    fn without_a_reference_there_are_times_and_no_ratios() {
        let log = Arc::default();
        let mut runners = [runner('a', 0.1, &log), runner('b', 0.4, &log)];
        let mut times: Vec<Times> = (0..2).map(|_| Times::default()).collect();
        rounds(&mut runners, None, 0, 2, &mut times, &|| false, &mut |_| {}).expect("renders");
        assert_eq!(*log.lock().expect("nobody panics"), "abba");
        assert!(times.into_iter().all(|times| times.summary().expect("times").ratio.is_none()));
    }
}
