//! Figures of configurations as bars with whiskers: speeds, with their quartiles, and speeds over the reference's, with their
//! interval and what the paper found.

use lightshaft_api::benchmark::Row;

use super::scatter::{Axis, Tick, WIDTH};

const LEFT: f64 = 8.0;
const RIGHT: f64 = WIDTH - 14.0;
/// Of a bar with its name above it, and of the scale below all.
const ROW: f64 = 38.0;
const SCALE: f64 = 42.0;

/// One chart. All bars begin at 0.
pub(in crate::dashboard) struct Bars {
    pub(in crate::dashboard) title: &'static str,
    /// What bars and whiskers are.
    pub(in crate::dashboard) note: &'static str,
    pub(in crate::dashboard) unit: &'static str,
    pub(in crate::dashboard) height: f64,
    pub(in crate::dashboard) ticks: Vec<Tick>,
    pub(in crate::dashboard) bars: Vec<Bar>,
}

pub(in crate::dashboard) struct Bar {
    /// Where its name stands.
    pub(in crate::dashboard) y: f64,
    pub(in crate::dashboard) name: String,
    pub(in crate::dashboard) label: String,
    pub(in crate::dashboard) low: f64,
    pub(in crate::dashboard) value: f64,
    pub(in crate::dashboard) high: f64,
    /// What the paper found.
    pub(in crate::dashboard) paper: Option<f64>,
}

/// A bar before it has a place.
struct Figure<'a> {
    name: &'a str,
    label: String,
    low: f64,
    value: f64,
    high: f64,
    paper: Option<f64>,
}

impl Bars {
    pub(in crate::dashboard) const START: f64 = LEFT;

    /// All charts of these configurations.
    pub(super) fn all(rows: &[Row]) -> Vec<Self> {
        Self::speeds(rows).into_iter().chain(Self::ratios(rows)).collect()
    }

    /// Of the configurations that were timed; `None` where there is none.
    fn speeds(rows: &[Row]) -> Option<Self> {
        let figures = rows.iter().filter_map(|row| {
            let speed = row.timed.as_ref()?.mrays_per_s;
            let label = format!("{:.3} MRays/s, quartiles {:.3} and {:.3}", speed.median, speed.lower, speed.upper);
            let (low, value, high) = (speed.lower, speed.median, speed.upper);
            Some(Figure { name: &row.configuration, label, low, value, high, paper: None })
        });
        Self::draw("Speed", "medians and quartiles", "MRays/s", figures.collect())
    }

    /// Of the configurations that were timed against a reference; `None` where there is none. Papers' speeds are those of
    /// other machines, so only their ratios stand beside ours.
    fn ratios(rows: &[Row]) -> Option<Self> {
        let figures = rows.iter().filter_map(|row| {
            let ratio = row.timed.as_ref()?.ratio?;
            let paper = row.paper.and_then(|paper| paper.ratio).filter(|ratio| ratio.is_finite() && *ratio > 0.0);
            let found = paper.map(|ratio| format!("; the paper: {ratio:.2}")).unwrap_or_default();
            let label = format!("{:.2}, 95 % interval {:.2} to {:.2}{found}", ratio.value, ratio.low, ratio.high);
            Some(Figure {
                name: &row.configuration,
                label,
                low: ratio.low,
                value: ratio.value,
                high: ratio.high,
                paper,
            })
        });
        let figures: Vec<Figure<'_>> = figures.collect();
        let note = if figures.iter().any(|figure| figure.paper.is_some()) {
            "medians and 95 % intervals; diamonds: the paper"
        } else {
            "medians and 95 % intervals"
        };
        Self::draw("Speed over the reference's", note, "times as fast", figures)
    }

    fn draw(title: &'static str, note: &'static str, unit: &'static str, figures: Vec<Figure<'_>>) -> Option<Self> {
        let most = figures.iter().flat_map(|figure| [figure.high, figure.paper.unwrap_or(0.0)]).fold(0.0, f64::max);
        if most <= 0.0 {
            return None;
        }
        let axis = Axis::from_zero(most, LEFT, RIGHT);
        let bar = |(index, figure): (usize, Figure<'_>)| Bar {
            y: 16.0 + index as f64 * ROW,
            name: figure.name.to_owned(),
            label: figure.label,
            low: axis.place(figure.low),
            value: axis.place(figure.value),
            high: axis.place(figure.high),
            paper: figure.paper.map(|value| axis.place(value)),
        };
        let bars: Vec<Bar> = figures.into_iter().enumerate().map(bar).collect();
        Some(Self { title, note, unit, height: bars.len() as f64 * ROW + SCALE, ticks: axis.ticks(), bars })
    }

    /// Where the scale is written.
    pub(in crate::dashboard) fn foot(&self) -> f64 {
        self.height - SCALE + 4.0
    }
}

#[cfg(test)]
mod tests {
    use lightshaft_api::benchmark::{Interval, PaperFigures};

    use super::super::tests::row;
    use super::*;

    #[test]
    fn bars_share_one_scale_and_leave_out_what_was_not_timed() {
        let drawn = Bars::speeds(&[row("a", Some(1.0)), row("b", None), row("c", Some(4.0))]).unwrap();
        let names: Vec<&str> = drawn.bars.iter().map(|bar| bar.name.as_str()).collect();
        assert_eq!(names, ["a", "c"]);
        assert_eq!(drawn.bars[1].label, "4.000 MRays/s, quartiles 2.000 and 8.000");
        let lengths: Vec<f64> = drawn.bars.iter().map(|bar| bar.value - Bars::START).collect();
        assert!((lengths[1] / lengths[0] - 4.0).abs() < 1e-9, "lengths compare as speeds do: {lengths:?}");
        assert!(drawn.bars.iter().all(|bar| bar.low < bar.value && bar.value < bar.high && bar.high <= RIGHT));
        assert!(drawn.bars.last().unwrap().y < drawn.foot());
        assert!(Bars::speeds(&[row("b", None)]).is_none());
    }

    #[test]
    fn ratios_stand_beside_the_papers() {
        let mut faster = row("LS", Some(2.0));
        if let Some(timed) = &mut faster.timed {
            timed.ratio = Some(Interval { value: 1.5, low: 1.25, high: 1.75 });
        }
        let ours = Bars::all(&[row("base", Some(1.0)), faster.clone()]);
        assert_eq!((ours.len(), ours[1].bars.len()), (2, 1), "the reference has no ratio");
        assert!(ours[1].bars[0].paper.is_none() && !ours[1].note.contains("paper"));
        faster.paper = Some(PaperFigures { ratio: Some(3.0), ..PaperFigures::default() });
        let chart = Bars::ratios(&[faster]).unwrap();
        let bar = &chart.bars[0];
        assert_eq!(bar.label, "1.50, 95 % interval 1.25 to 1.75; the paper: 3.00");
        let paper = bar.paper.unwrap();
        assert!((paper - Bars::START - 2.0 * (bar.value - Bars::START)).abs() < 1e-9 && paper <= RIGHT);
        assert!(chart.note.contains("diamonds: the paper"));
    }
}
