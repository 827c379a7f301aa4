//! Speeds as bars with whiskers: medians, and from the lower to the upper quartile.

use lightshaft_api::benchmark::Row;

use super::scatter::{Axis, Tick, WIDTH};

const LEFT: f64 = 8.0;
const RIGHT: f64 = WIDTH - 14.0;
/// Of a bar with its name above it, and of the scale below all.
const ROW: f64 = 38.0;
const SCALE: f64 = 42.0;

/// One chart. All bars begin at 0.
pub(in crate::dashboard) struct Bars {
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
    pub(in crate::dashboard) median: f64,
    pub(in crate::dashboard) high: f64,
}

impl Bars {
    pub(in crate::dashboard) const START: f64 = LEFT;

    /// Of the configurations that were timed; `None` where there is none.
    pub(super) fn of(rows: &[Row]) -> Option<Self> {
        let timed = || rows.iter().filter_map(|row| Some((row, row.timed.as_ref()?.mrays_per_s)));
        let most = timed().map(|(_, speed)| speed.upper).fold(0.0, f64::max);
        if most <= 0.0 {
            return None;
        }
        let axis = Axis::from_zero(most, LEFT, RIGHT);
        let bar = |(index, (row, speed)): (usize, (&Row, lightshaft_api::benchmark::Quartiles))| Bar {
            y: 16.0 + index as f64 * ROW,
            name: row.configuration.clone(),
            label: format!("{:.3} MRays/s, quartiles {:.3} and {:.3}", speed.median, speed.lower, speed.upper),
            low: axis.place(speed.lower),
            median: axis.place(speed.median),
            high: axis.place(speed.upper),
        };
        let bars: Vec<Bar> = timed().enumerate().map(bar).collect();
        Some(Self { height: bars.len() as f64 * ROW + SCALE, ticks: axis.ticks(), bars })
    }

    /// Where the scale is written.
    pub(in crate::dashboard) fn foot(&self) -> f64 {
        self.height - SCALE + 4.0
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::row;
    use super::*;

    #[test]
    fn bars_share_one_scale_and_leave_out_what_was_not_timed() {
        let drawn = Bars::of(&[row("a", Some(1.0)), row("b", None), row("c", Some(4.0))]).unwrap();
        let names: Vec<&str> = drawn.bars.iter().map(|bar| bar.name.as_str()).collect();
        assert_eq!(names, ["a", "c"]);
        assert_eq!(drawn.bars[1].label, "4.000 MRays/s, quartiles 2.000 and 8.000");
        let lengths: Vec<f64> = drawn.bars.iter().map(|bar| bar.median - Bars::START).collect();
        assert!((lengths[1] / lengths[0] - 4.0).abs() < 1e-9, "lengths compare as speeds do: {lengths:?}");
        assert!(drawn.bars.iter().all(|bar| bar.low < bar.median && bar.median < bar.high && bar.high <= RIGHT));
        assert!(drawn.bars.last().unwrap().y < drawn.foot());
        assert!(Bars::of(&[row("b", None)]).is_none());
    }
}
