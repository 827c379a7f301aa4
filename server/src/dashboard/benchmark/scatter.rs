//! Speed against memory and against error, as points: what is worth its price.
//!
//! A configuration is on the Pareto front when no other one is at least as good in speed, memory and error and better in
//! one of them (V. Pareto, *Manuale di economia politica*, 1906). Figures that were not measured are left out of the
//! judgement, for all configurations alike.

use lightshaft_api::benchmark::Row;

/// The drawing, in its own units.
pub(in crate::dashboard) const WIDTH: f64 = 480.0;
pub(in crate::dashboard) const HEIGHT: f64 = 300.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 466.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 256.0;
/// Values that lie further apart than this are drawn by their logarithm.
const LOG_FROM: f64 = 20.0;
/// An error of less is that of rounding.
const LEAST_FLIP: f64 = 1e-6;

/// One chart.
pub(in crate::dashboard) struct Scatter {
    pub(in crate::dashboard) title: String,
    pub(in crate::dashboard) x_title: String,
    pub(in crate::dashboard) x_ticks: Vec<Tick>,
    pub(in crate::dashboard) y_ticks: Vec<Tick>,
    pub(in crate::dashboard) points: Vec<Point>,
    /// The front's corners, as an SVG path.
    pub(in crate::dashboard) front: String,
}

pub(in crate::dashboard) struct Tick {
    pub(in crate::dashboard) at: f64,
    pub(in crate::dashboard) text: String,
}

pub(in crate::dashboard) struct Point {
    pub(in crate::dashboard) x: f64,
    pub(in crate::dashboard) y: f64,
    /// Place in the table, from 1.
    pub(in crate::dashboard) number: usize,
    pub(in crate::dashboard) label: String,
    pub(in crate::dashboard) is_best: bool,
}

/// What is asked of a configuration.
#[derive(Clone, Copy)]
struct Figures {
    speed: f64,
    megabytes: Option<f64>,
    /// None where there is no error.
    flip: Option<f64>,
}

impl Figures {
    fn of(row: &Row) -> Option<Self> {
        let speed = row.timed.as_ref()?.mrays_per_s.median;
        let megabytes = row.built.as_ref().map(|built| (built.structure_bytes + built.line_space_bytes) as f64 / 1e6);
        let flip = row.picture.as_ref().map(|picture| picture.flip).filter(|&flip| flip >= LEAST_FLIP);
        Some(Self { speed, megabytes, flip })
    }

    /// Whether `other` is at least as good in everything and better in something.
    fn is_beaten_by(self, other: Self, by_memory: bool, by_error: bool) -> bool {
        let costs = |figures: Self| {
            let memory = figures.megabytes.filter(|_| by_memory).unwrap_or(0.0);
            let error = figures.flip.filter(|_| by_error).unwrap_or(0.0);
            [-figures.speed, memory, error]
        };
        let (own, its) = (costs(self), costs(other));
        own.iter().zip(&its).all(|(own, its)| its <= own) && own != its
    }
}

/// Charts of configurations: none where less than two were timed.
pub(in crate::dashboard) fn charts(rows: &[Row]) -> Vec<Scatter> {
    let measured: Vec<(usize, &Row, Figures)> = rows
        .iter()
        .enumerate()
        .filter_map(|(index, row)| Figures::of(row).map(|figures| (index + 1, row, figures)))
        .filter(|(_, _, figures)| figures.speed > 0.0)
        .collect();
    if measured.len() < 2 {
        return Vec::new();
    }
    let by_memory = measured.iter().all(|(_, _, figures)| figures.megabytes.is_some());
    let by_error = measured.iter().any(|(_, _, figures)| figures.flip.is_some());
    let mut charts = Vec::new();
    type Cost = fn(&Figures) -> f64;
    let axes: [(bool, &str, &str, Cost); 2] = [
        (by_memory, "Speed against memory", "MB of structures", |figures| figures.megabytes.unwrap_or_default()),
        (by_error, "Speed against error", "mean FLIP error", |figures| figures.flip.unwrap_or_default()),
    ];
    for (_, title, x_title, cost) in axes.into_iter().filter(|axis| axis.0) {
        let x = Axis::new(measured.iter().map(|(_, _, figures)| cost(figures)), LEFT, RIGHT);
        let y = Axis::new(measured.iter().map(|(_, _, figures)| figures.speed), BOTTOM, TOP);
        let points = measured.iter().map(|&(number, row, figures)| Point {
            x: x.place(cost(&figures)),
            y: y.place(figures.speed),
            number,
            label: format!("{}: {:.3} MRays/s, {} {x_title}", row.configuration, figures.speed, short(cost(&figures))),
            is_best: !measured.iter().any(|&(_, _, other)| figures.is_beaten_by(other, by_memory, by_error)),
        });
        charts.push(Scatter {
            title: title.to_owned(),
            x_title: x_title.to_owned(),
            x_ticks: x.ticks(),
            y_ticks: y.ticks(),
            points: points.collect(),
            front: front(measured.iter().map(|(_, _, figures)| (cost(figures), figures.speed)), &x, &y),
        });
    }
    charts
}

/// The steps below which no point of these two axes lies: from the cheapest to the fastest.
fn front(points: impl Iterator<Item = (f64, f64)>, x: &Axis, y: &Axis) -> String {
    let mut sorted: Vec<(f64, f64)> = points.collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)));
    let mut path = String::new();
    let mut fastest = f64::NEG_INFINITY;
    for (cost, speed) in sorted {
        if speed <= fastest {
            continue;
        }
        fastest = speed;
        let (across, up) = (x.place(cost), y.place(speed));
        let step = if path.is_empty() { format!("M{across:.1} {up:.1}") } else { format!("H{across:.1}V{up:.1}") };
        path.push_str(&step);
    }
    path
}

pub(super) struct Axis {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
    is_log: bool,
}

impl Axis {
    fn new(values: impl Iterator<Item = f64> + Clone, start: f64, end: f64) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(f64::NEG_INFINITY, f64::max);
        if low > 0.0 && high / low > LOG_FROM {
            return Self { low: low / 1.3, high: high * 1.3, start, end, is_log: true };
        }
        Self::from_zero(high, start, end)
    }

    /// Lengths can be compared by eye.
    pub(super) fn from_zero(high: f64, start: f64, end: f64) -> Self {
        let high = if high > 0.0 { high * 1.08 } else { 1.0 };
        Self { low: 0.0, high, start, end, is_log: false }
    }

    pub(super) fn place(&self, value: f64) -> f64 {
        let share = if self.is_log {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        self.start + share * (self.end - self.start)
    }

    pub(super) fn ticks(&self) -> Vec<Tick> {
        let values: Vec<f64> = if self.is_log {
            let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
            decades.flat_map(|decade| [1.0, 3.0].map(|digit| digit * 10f64.powi(decade))).collect()
        } else {
            let step = nice_step((self.high - self.low) / 4.0);
            (0..=(self.high / step) as u32).map(|i| f64::from(i) * step).collect()
        };
        let inside = values.into_iter().filter(|&value| value >= self.low && value <= self.high);
        inside.map(|value| Tick { at: self.place(value), text: short(value) }).collect()
    }
}

/// The next of 1, 2, 5 times a power of ten.
fn nice_step(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    let digit = [1.0, 2.0, 5.0].into_iter().find(|digit| digit * power >= step * 0.999).unwrap_or(10.0);
    digit * power
}

/// Three digits, without zeros that say nothing.
fn short(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { (2 - value.abs().log10().floor() as i32).clamp(0, 6) };
    let text = format!("{value:.*}", usize::try_from(digits).unwrap_or_default());
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(speed: f64, megabytes: f64, flip: Option<f64>) -> Figures {
        Figures { speed, megabytes: Some(megabytes), flip }
    }

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let reference = figures(10.0, 5.0, None);
        let large = figures(9.0, 8.0, None);
        let fast_but_wrong = figures(20.0, 9.0, Some(0.1));
        let beaten = |own: Figures, other: Figures| own.is_beaten_by(other, true, true);
        assert!(beaten(large, reference) && !beaten(reference, large));
        assert!(!beaten(fast_but_wrong, reference) && !beaten(reference, fast_but_wrong));
        assert!(!beaten(reference, reference), "nothing beats its like");
        assert!(reference.is_beaten_by(fast_but_wrong, false, false), "by speed alone");
    }

    #[test]
    fn the_line_goes_up_in_steps_from_the_cheapest() {
        let points = [(1.0, 5.0), (2.0, 4.0), (3.0, 9.0)];
        let (x, y) =
            (Axis::new(points.iter().map(|p| p.0), 0.0, 100.0), Axis::new(points.iter().map(|p| p.1), 100.0, 0.0));
        let path = front(points.into_iter(), &x, &y);
        assert_eq!(path, "M30.9 48.6H92.6V7.4");
    }

    #[test]
    fn axes_have_round_ticks_and_turn_logarithmic() {
        let texts = |values: &[f64]| -> Vec<String> {
            Axis::new(values.iter().copied(), 0.0, 100.0).ticks().into_iter().map(|tick| tick.text).collect()
        };
        assert_eq!(texts(&[1.0, 9.3]), ["0", "5", "10"]);
        assert_eq!(texts(&[0.002, 0.009]), ["0", "0.005"]);
        assert_eq!(texts(&[0.5, 70.0]), ["1", "3", "10", "30"]);
        assert_eq!(texts(&[0.0, 0.0]), ["0", "0.5", "1"]);
    }

    #[test]
    fn places_grow_with_values_on_both_scales() {
        for values in [[1.0, 2.0], [1.0, 1000.0]] {
            let axis = Axis::new(values.into_iter(), 10.0, 90.0);
            let (low, high) = (axis.place(values[0]), axis.place(values[1]));
            assert!((10.0..high).contains(&low) && high <= 90.0, "{low} {high}");
        }
    }
}
