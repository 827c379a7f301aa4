//! The times of a case over its labels, drawn: medians with quartiles, the band of noise, change points.

use lightshaft_api::farm::{History, HistoryPoint, TimeVerdict};

use super::super::filters::human_seconds;

/// The drawing, in its own units.
const WIDTH: f64 = 960.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 944.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 230.0;
/// No more labels than can be read.
const MOST_LABELS: usize = 16;

pub(super) struct Chart {
    pub(super) view_box: String,
    pub(super) marks: Vec<Mark>,
    /// The medians as one line, broken where a level changes.
    pub(super) line: String,
    /// Levels between change points, with the noise around each.
    pub(super) levels: Vec<Level>,
    pub(super) y_ticks: Vec<(f64, String)>,
    pub(super) x_labels: Vec<(f64, String)>,
    /// Where the times change to another level.
    pub(super) changes: Vec<f64>,
    pub(super) summary: String,
}

pub(super) struct Mark {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) low: f64,
    pub(super) high: f64,
    /// Names the colour.
    pub(super) class: &'static str,
    pub(super) label: String,
    pub(super) href: String,
}

pub(super) struct Level {
    pub(super) x: f64,
    pub(super) width: f64,
    pub(super) y: f64,
    /// Upper edge and height of the noise; none without a calibration.
    pub(super) band: Option<(f64, f64)>,
}

/// `None` where nothing was timed.
pub(super) fn of(history: &History) -> Option<Chart> {
    let timed: Vec<(usize, f64, &HistoryPoint)> =
        history.points.iter().enumerate().filter_map(|(i, point)| Some((i, point.median_s?, point))).collect();
    let high = timed.iter().map(|(_, median, point)| point.upper_quartile_s.unwrap_or(*median)).fold(0.0, f64::max);
    if high <= 0.0 {
        return None;
    }
    let count = history.points.len();
    let step = (RIGHT - LEFT) / count as f64;
    let across = |index: usize| LEFT + (index as f64 + 0.5) * step;
    // From 0: a change is seen as large as it is.
    let top = high * 1.12;
    let up = |seconds: f64| BOTTOM - seconds / top * (BOTTOM - TOP);

    let starts: Vec<usize> = std::iter::once(0)
        .chain(history.change_points.iter().map(|&start| start as usize))
        .chain(std::iter::once(count))
        .collect();
    let (mut levels, mut line) = (Vec::new(), String::new());
    for bounds in starts.windows(2) {
        let of_level: Vec<_> = timed.iter().filter(|(i, ..)| (bounds[0]..bounds[1]).contains(i)).collect();
        for (order, (i, median, _)) in of_level.iter().enumerate() {
            let command = if order == 0 { 'M' } else { 'L' };
            line.push_str(&format!("{command}{:.1} {:.1}", across(*i), up(*median)));
        }
        let Some(level) = middle(of_level.iter().map(|(_, median, _)| *median).collect()) else { continue };
        let (x, end) = (LEFT + bounds[0] as f64 * step, LEFT + bounds[1] as f64 * step);
        let band = history.noise_floor.map(|noise| {
            let edges = (up((level * (1.0 + noise)).min(top)), up(level / (1.0 + noise)));
            (edges.0, edges.1 - edges.0)
        });
        levels.push(Level { x, width: end - x, y: up(level), band });
    }
    let marks = timed.iter().map(|&(i, median, point)| Mark {
        x: across(i),
        y: up(median),
        low: up(point.lower_quartile_s.unwrap_or(median)),
        high: up(point.upper_quartile_s.unwrap_or(median)),
        class: match (point.ok, point.time) {
            (false, Some(TimeVerdict::Slower)) => "slower",
            (_, Some(TimeVerdict::Faster)) => "faster",
            (_, Some(TimeVerdict::TooNoisyToSay)) => "noisy",
            (false, _) => "red",
            _ => "same",
        },
        label: format!("{}: {}", point.label, human_seconds(median)),
        href: format!("/farm/runs/{}", point.run),
    });
    let every = count.div_ceil(MOST_LABELS).max(1);
    let labels = history.points.iter().enumerate().filter(|(i, _)| i % every == 0);
    let changes: Vec<f64> = history.change_points.iter().map(|&start| LEFT + f64::from(start) * step).collect();
    let last = timed.last().map(|(_, median, _)| human_seconds(*median)).unwrap_or_default();
    Some(Chart {
        view_box: format!("0 0 {WIDTH} 300"),
        marks: marks.collect(),
        line,
        levels,
        y_ticks: (0..=4).map(|i| top / 4.0 * f64::from(i)).map(|value| (up(value), human_seconds(value))).collect(),
        x_labels: labels.map(|(i, point)| (across(i), point.label.chars().take(14).collect())).collect(),
        summary: format!("Time over {count} runs, the last {last}; {} change points", changes.len()),
        changes,
    })
}

fn middle(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let (lower, upper) = (values.get(values.len().checked_sub(1)? / 2)?, values.get(values.len() / 2)?);
    Some(0.5 * (lower + upper))
}

#[cfg(test)]
mod tests {
    use super::super::super::tests::fixture;
    use super::*;

    #[test]
    fn levels_end_at_change_points_and_bands_are_as_wide_as_the_noise() {
        let history = fixture::history();
        let chart = of(&history).unwrap();
        assert_eq!((chart.marks.len(), chart.levels.len(), chart.changes.len()), (4, 2, 1));
        assert!((chart.levels[0].x + chart.levels[0].width - chart.changes[0]).abs() < 1e-9);
        assert!(chart.levels[1].y < chart.levels[0].y, "slower is higher");
        let (top, height) = chart.levels[0].band.unwrap();
        assert!(top < chart.levels[0].y && top + height > chart.levels[0].y);
        assert_eq!(chart.line.matches('M').count(), 2);
        assert_eq!(chart.marks[3].class, "slower");
        for mark in &chart.marks {
            assert!(mark.high <= mark.y && mark.y <= mark.low && mark.high >= TOP && mark.low <= BOTTOM);
        }
    }

    #[test]
    fn without_times_there_is_no_chart() {
        let mut history = fixture::history();
        history.points.iter_mut().for_each(|point| point.median_s = None);
        assert!(of(&history).is_none());
        history.points.clear();
        assert!(of(&history).is_none());
    }

    #[test]
    fn the_middle_of_even_many_lies_between_two() {
        assert_eq!(middle(vec![3.0, 1.0]), Some(2.0));
        assert_eq!(middle(vec![3.0, 1.0, 9.0]), Some(3.0));
        assert_eq!(middle(Vec::new()), None);
    }
}
