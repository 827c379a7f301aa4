//! How much work one submit gets: which pixels a wave takes, and how many.
//!
//! Pictures begin with the sky, and a ray that meets nothing costs a tenth of one that meets a forest. Waves that took the
//! pixels row by row would grow over the sky and then hold the device for many times as long as they should. So
//! a wave takes short runs of pixels from all over the picture ([`PixelOrder`]): each one costs about what the others do, and
//! what the slowest of the last ones took says how large the next may be ([`Pace`]).

/// What one submit should take. Long enough that gaps between submits do not count, short enough for a display, a
/// cancel and the drivers' watchdogs.
const SUBMIT_TARGET_S: f64 = 0.025;
/// First wave: small, because nothing is known of the device's speed.
const FIRST_SLOTS: u32 = 2048;
/// Fast GPUs are full with it, and its buffers take 200 MB.
const MAX_SLOTS: u32 = 1 << 20;
/// A wave may have so many times the slots of the one before.
const MAX_GROWTH: f64 = 2.0;
/// What the slowest wave counts for after each further one: one that was slow by chance is forgotten after ten.
const MEMORY: f64 = 0.85;

/// How many slots the next wave gets.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    slots: u32,
    least: u32,
    most: u32,
    /// Seconds a slot, in the longest submit of the slowest recent wave. None before the second wave: the first one's
    /// time is mostly that of the driver's compiler.
    slowest: Option<f64>,
    warm: bool,
}

impl Pace {
    /// `slot_bytes`: what a slot takes in the buffer where it takes most; `binding_bytes`: what that may have.
    pub(super) fn new(least: u32, slot_bytes: u64, binding_bytes: u64) -> Self {
        let most = 1 << (binding_bytes / slot_bytes).clamp(1, MAX_SLOTS.into()).ilog2();
        Self { slots: FIRST_SLOTS.min(most), least: least.min(most), most, slowest: None, warm: false }
    }

    pub(super) fn slots(&self) -> u32 {
        self.slots
    }

    /// Learns from a wave of so many slots, whose longest submit took so long. Answers these seconds again, unless they say
    /// nothing of later ones.
    pub(super) fn record(&mut self, slots: u32, longest_s: f64) -> f64 {
        if !std::mem::replace(&mut self.warm, true) {
            return 0.0;
        }
        let cost = longest_s.max(1e-6) / f64::from(slots.max(1));
        let slowest = self.slowest.map_or(cost, |slowest| cost.max(MEMORY * slowest));
        self.slowest = Some(slowest);
        let next = (SUBMIT_TARGET_S / slowest).min(MAX_GROWTH * f64::from(self.slots));
        self.slots = (next as u32).clamp(self.least, self.most);
        longest_s
    }
}

/// Neighbouring pixels that a wave takes together, at least: as many as GPUs trace in step.
const RUN: u32 = 32;
/// So that the product of two numbers of runs fits 32 bits.
const MAX_RUNS: u32 = u16::MAX as u32;

/// The order in which the pixels of a region, numbered row by row, are taken: in runs, each of which is far from the one before,
/// and any number of which are evenly spread over the region (Weyl's sequence, by the golden section).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PixelOrder {
    /// Pixels of a run.
    pub run: u32,
    /// Whole runs; the pixels behind them come last.
    pub runs: u32,
    /// From one run to the next, modulo `runs`, with which it has no divisor in common.
    pub step: u32,
}

impl PixelOrder {
    pub(super) fn new(pixels: u32) -> Self {
        let run = pixels.div_ceil(MAX_RUNS).next_power_of_two().max(RUN);
        let runs = pixels / run;
        let golden = (f64::from(runs) * 0.618_034) as u32;
        let step = (golden..).find(|&step| gcd(step, runs) == 1).unwrap_or(1);
        Self { run, runs, step }
    }

    /// The pixel whose turn is the `number`-th, as `path_sample` in `sampler.wgsl` finds it.
    pub(super) fn pixel(&self, number: u32) -> u32 {
        let run = number / self.run;
        if run < self.runs { run * self.step % self.runs * self.run + number % self.run } else { number }
    }
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waves on a device that takes `cost(wave)` seconds a slot and `fixed_s` a submit; answers the times of the waves
    /// and the slots of the last one.
    fn simulate(pace: &mut Pace, waves: usize, fixed_s: f64, cost: impl Fn(usize) -> f64) -> (Vec<f64>, u32) {
        let times = (0..waves).map(|wave| {
            let slots = pace.slots();
            pace.record(slots, fixed_s + f64::from(slots) * cost(wave))
        });
        (times.collect(), pace.slots())
    }

    fn pace() -> Pace {
        Pace::new(256, 64, 128 << 20)
    }

    #[test]
    fn submits_come_close_to_the_target_on_slow_devices_and_stay_there() {
        for cost in [1e-7, 1e-6, 3e-6, 1e-5, 5e-5] {
            let (times, _) = simulate(&mut pace(), 60, 2e-4, |_| cost);
            assert_eq!(times[0], 0.0, "the compiler's time counts");
            assert!(times.iter().all(|&s| s < 0.11), "{cost}: {times:?}");
            assert!(times[20..].iter().all(|s| (0.02..0.027).contains(s)), "{cost}: {times:?}");
        }
    }

    #[test]
    fn fast_devices_get_the_largest_waves_soon() {
        let (times, slots) = simulate(&mut pace(), 24, 3e-4, |_| 1e-9);
        assert_eq!(slots, MAX_SLOTS, "{times:?}");
        let (_, slots) = simulate(&mut Pace::new(256, 64, 1 << 20), 24, 3e-4, |_| 1e-9);
        assert_eq!(slots, (1 << 20) / 64, "more than a binding holds");
    }

    #[test]
    fn waves_of_uneven_cost_are_sized_by_the_slowest() {
        let cost = |wave: usize| if wave % 5 == 4 { 3e-6 } else { 1e-6 };
        let (times, _) = simulate(&mut pace(), 200, 2e-4, cost);
        // Between two slow waves, four waves forget: 0.85 ^ -5 = 2.25.
        assert!(times[20..].iter().all(|&s| s < 0.06), "{times:?}");
        let mean = times[20..].iter().sum::<f64>() / 180.0;
        assert!(mean > 0.01, "waves are small throughout: {mean}");
    }

    #[test]
    fn a_hiccup_is_forgotten() {
        let mut pace = pace();
        let (_, before) = simulate(&mut pace, 30, 0.0, |_| 1e-6);
        let (_, at_once) = simulate(&mut pace, 1, 0.0, |_| 4e-6);
        assert!(at_once * 3 < before, "{at_once} after {before}");
        let (_, later) = simulate(&mut pace, 12, 0.0, |_| 1e-6);
        assert!(later * 10 > before * 9, "{later} after {before}");
    }

    #[test]
    fn every_pixel_has_one_turn() {
        for pixels in [1, 31, 32, 33, 64, 3072, 4099, 640 * 480] {
            let order = PixelOrder::new(pixels);
            let mut seen = vec![false; pixels as usize];
            for number in 0..pixels {
                assert!(!std::mem::replace(&mut seen[order.pixel(number) as usize], true), "{pixels}: {number}");
            }
        }
        for pixels in [1920 * 1080, u32::MAX] {
            let order = PixelOrder::new(pixels);
            assert!(order.runs <= MAX_RUNS && gcd(order.step, order.runs) == 1, "{order:?}");
        }
    }

    #[test]
    fn waves_are_spread_over_the_picture() {
        let (width, height) = (1920, 1080);
        let order = PixelOrder::new(width * height);
        let pixels = 64 * order.run;
        for first in [0, 100 * pixels, 700 * pixels] {
            let upper = (first..first + pixels).filter(|&n| order.pixel(n) / width < height / 4).count() as f64;
            let share = upper / f64::from(pixels);
            assert!((0.2..0.3).contains(&share), "{share} of a wave in the upper quarter");
        }
    }
}
