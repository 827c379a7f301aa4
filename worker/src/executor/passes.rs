//! The render phase: progressive passes until there are enough samples or no more time.
//!
//! Passes take 1, 1, 2, 4, 8, … samples, so a first picture is there at once and the overhead of passes vanishes; their
//! size stops growing where one takes about a second, so that previews, the time limit and cancelling stay quick.

use std::time::{Duration, Instant};

use lightshaft_api::job::{LineSpaceUse, Metrics, Phase, RayCounts};
use lightshaft_engine::accel::line_space::Class;
use lightshaft_engine::device::{DeviceError, Pass, PassStats, Watch};

use super::part::Part;
use super::{OUTPUT_STARTS, RENDER_STARTS, Ready, Task, output};

/// How long a pass should take at most.
const PASS_TARGET: Duration = Duration::from_secs(1);

const PREVIEW_PERIOD: Duration = Duration::from_secs(1);

/// Making previews may take this share of the time.
const PREVIEW_SHARE: f64 = 0.05;

pub(super) fn render(
    task: &Task<'_>,
    ready: &mut Ready,
    first_sample: u32,
    samples: u32,
    part: &mut Part,
    metrics: &mut Metrics,
) -> Result<(), DeviceError> {
    let started = Instant::now();
    let stopped = || task.stopped();
    task.report(Phase::Render, RENDER_STARTS, 0);
    let first_tile_s = metrics.queue_s.unwrap_or(0.0) + task.started.elapsed().as_secs_f64();
    metrics.first_tile_s = Some(first_tile_s);
    task.observer.log(format!("the first tile begins {first_tile_s:.3} s after the task could run"));
    if let Some(aovs) = &mut part.aovs {
        let stats = ready.renderer.aovs(part.film.region, aovs, &stopped)?;
        add(metrics, &stats);
    }
    let mut schedule = Schedule::new(samples);
    let mut previews = Previews::new();
    while let Some(count) = schedule.next() {
        let pass_started = Instant::now();
        let watch = PassWatch { task, started, done: schedule.done, count, total: samples, spp: part.film.samples };
        let pass = Pass { region: part.film.region, first_sample: first_sample + schedule.done, samples: count };
        let stats = ready.renderer.render(&pass, &mut part.film, &watch)?;
        add(metrics, &stats);
        schedule.finished(count, pass_started.elapsed());
        PassWatch { spp: part.film.samples, ..watch }.progress(1.0);
        if stopped() {
            return Err(DeviceError::Cancelled);
        }
        let over_time = task.settings.time_limit_s.is_some_and(|limit| started.elapsed().as_secs_f64() >= limit);
        if over_time && schedule.done < samples {
            task.observer.log(format!("time limit reached after {} of {samples} samples", schedule.done));
            break;
        }
        if schedule.done < samples {
            previews.offer(task, part);
        }
    }
    metrics.render_s = started.elapsed().as_secs_f64() - previews.spent.as_secs_f64();
    if metrics.render_s > 0.0 {
        metrics.mrays_per_s = metrics.rays.total() as f64 / metrics.render_s / 1e6;
    }
    task.observer.log(format!(
        "rendered {} samples per pixel in {:.3} s on {}: {:.2} MRays/s",
        part.film.samples, metrics.render_s, metrics.device, metrics.mrays_per_s
    ));
    Ok(())
}

/// Turns the progress of one pass into that of the task.
struct PassWatch<'a> {
    task: &'a Task<'a>,
    /// When rendering began.
    started: Instant,
    /// Samples of the passes before, of this one, and of all.
    done: u32,
    count: u32,
    total: u32,
    /// Per pixel so far.
    spp: u32,
}

impl Watch for PassWatch<'_> {
    fn cancelled(&self) -> bool {
        self.task.stopped()
    }

    fn progress(&self, done: f64) {
        let of_samples = (f64::from(self.done) + f64::from(self.count) * done) / f64::from(self.total);
        // What ends first, samples or time, says how far it is.
        let of_time = self.task.settings.time_limit_s.map_or(0.0, |limit| self.started.elapsed().as_secs_f64() / limit);
        let fraction = of_samples.max(of_time).min(1.0);
        self.task.report(Phase::Render, RENDER_STARTS + (OUTPUT_STARTS - RENDER_STARTS) * fraction, self.spp);
    }
}

fn add(metrics: &mut Metrics, stats: &PassStats) {
    metrics.longest_submit_s = metrics.longest_submit_s.max(stats.longest_submit_s);
    let rays = &stats.rays;
    let sum = &mut metrics.rays;
    *sum = RayCounts {
        primary: sum.primary + rays.primary,
        shadow: sum.shadow + rays.shadow,
        ao: sum.ao + rays.ao,
        indirect: sum.indirect + rays.indirect,
    };
    let gates = &stats.counters.gates;
    let of = |class: Class| gates.of_class(class);
    if let Some(line_space) = metrics.line_space {
        metrics.line_space = Some(line_space.joined(LineSpaceUse {
            meshes: line_space.meshes,
            asked: line_space.asked,
            rays: gates.rays(),
            starts_inside: gates.starts_inside,
            beside: gates.beside,
            empty: of(Class::Empty),
            opaque: of(Class::Opaque),
            mixed: of(Class::Mixed),
            approximated: gates.approximated,
            too_far: gates.too_far,
            node_look_ups: gates.node_look_ups,
            skipped_nodes: gates.skipped_nodes,
        }));
    }
}

/// How many samples the next pass takes.
#[derive(Debug)]
struct Schedule {
    total: u32,
    done: u32,
    /// By the last pass.
    seconds_per_sample: f64,
}

impl Schedule {
    fn new(total: u32) -> Self {
        Self { total, done: 0, seconds_per_sample: 0.0 }
    }

    fn next(&self) -> Option<u32> {
        let left = self.total - self.done;
        if left == 0 {
            return None;
        }
        let affordable = PASS_TARGET.as_secs_f64() / self.seconds_per_sample.max(1e-9);
        Some(self.done.max(1).min(affordable as u32).clamp(1, left))
    }

    fn finished(&mut self, samples: u32, took: Duration) {
        self.done += samples;
        self.seconds_per_sample = took.as_secs_f64() / f64::from(samples);
    }
}

struct Previews {
    due: Instant,
    spent: Duration,
}

impl Previews {
    fn new() -> Self {
        Self { due: Instant::now(), spent: Duration::ZERO }
    }

    fn offer(&mut self, task: &Task<'_>, part: &Part) {
        let shows_all =
            part.film.region.width == task.settings.width && part.film.region.height == task.settings.height;
        let now = Instant::now();
        if now < self.due || !shows_all || !task.observer.wants_preview() {
            return;
        }
        match output::png(task, &part.film) {
            Ok(png) => task.observer.preview(png),
            Err(error) => tracing::warn!("no preview: {error}"),
        }
        let took = now.elapsed();
        self.spent += took;
        self.due = now + PREVIEW_PERIOD.max(took.div_f64(PREVIEW_SHARE));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passes(total: u32, seconds_per_sample: f64) -> Vec<u32> {
        let mut schedule = Schedule::new(total);
        let mut passes = Vec::new();
        while let Some(count) = schedule.next() {
            schedule.finished(count, Duration::from_secs_f64(f64::from(count) * seconds_per_sample));
            passes.push(count);
        }
        passes
    }

    #[test]
    fn passes_double_and_end_at_the_total() {
        assert_eq!(passes(1, 1e-6), [1]);
        assert_eq!(passes(20, 1e-6), [1, 1, 2, 4, 8, 4]);
    }

    #[test]
    fn a_pass_is_kept_to_about_a_second() {
        assert_eq!(passes(20, 0.25), [1, 1, 2, 4, 4, 4, 4]);
        assert_eq!(passes(3, 10.0), [1, 1, 1]);
    }

    #[test]
    fn any_number_of_samples_is_met_exactly() {
        for total in 1..200 {
            assert_eq!(passes(total, 0.013).iter().sum::<u32>(), total);
        }
    }
}
