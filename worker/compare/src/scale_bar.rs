//! An error map with a scale bar beside it, for files that are looked at on their own.
//!
//! The map itself lies untouched in the upper left corner. The bar takes columns to its right, and rows below where a map
//! is too low for legible values: white, with the colours from 0 at the bottom to 1 at the top.

use crate::heat_map::{heat_map, magma};
use crate::plane::Plane;

/// Values that the bar names.
const TICKS: [(f32, &str); 5] = [(0.0, "0"), (0.25, "0.25"), (0.5, "0.5"), (0.75, "0.75"), (1.0, "1")];
const PAPER: [u8; 3] = [255; 3];
const INK: [u8; 3] = [26, 26, 26];

// In units, which are one pixel for maps of up to 360 rows and grow with larger ones.
const UNIT_ROWS: usize = 360;
/// Between map and bar, above and below the bar, and right of the values.
const MARGIN: usize = 6;
const BAR_WIDTH: usize = 10;
const TICK: usize = 3;
/// Lowest bar whose values do not touch: five lines of text, and a third as much between them.
const LEAST_BAR: usize = 4 * (GLYPH_HEIGHT * 4 / 3) + GLYPH_HEIGHT;
const GLYPH_HEIGHT: usize = 7;
const GLYPH_ADVANCE: usize = 6;
const TEXT_WIDTH: usize = 4 * GLYPH_ADVANCE;

/// An RGB8 picture, row 0 at the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drawing {
    pub width: usize,
    pub height: usize,
    /// `width * height * 3` bytes.
    pub rgb: Vec<u8>,
}

/// The map in magma ([`heat_map`]) with a bar that says what its colours mean.
pub fn heat_map_with_scale(error: &Plane) -> Drawing {
    let unit = (error.height() / UNIT_ROWS).max(1);
    let bar_left = error.width() + MARGIN * unit;
    let height = error.height().max((LEAST_BAR + 2 * MARGIN) * unit);
    let width = bar_left + (BAR_WIDTH + 2 * TICK + TEXT_WIDTH + MARGIN) * unit;
    let mut drawing = Drawing { width, height, rgb: PAPER.repeat(width * height) };
    let map = heat_map(error);
    for (y, row) in map.chunks_exact(3 * error.width()).enumerate() {
        drawing.rgb[3 * y * width..][..row.len()].copy_from_slice(row);
    }
    drawing.bar(bar_left, unit);
    drawing
}

impl Drawing {
    fn bar(&mut self, left: usize, unit: usize) {
        // The outermost values stand half beyond the bar.
        let top = MARGIN * unit + GLYPH_HEIGHT * unit / 2;
        let rows = self.height - 2 * top;
        // A frame, since the ends of the scale are nearly black and nearly white.
        self.fill([left, top - 1], [BAR_WIDTH * unit, rows + 2], INK);
        for y in 0..rows {
            let value = 1.0 - y as f32 / (rows - 1) as f32;
            self.fill([left + 1, top + y], [BAR_WIDTH * unit - 2, 1], magma(value));
        }
        let right = left + BAR_WIDTH * unit;
        for (value, text) in TICKS {
            let y = top + ((1.0 - value) * (rows - 1) as f32).round() as usize;
            self.fill([right, y - (unit - 1) / 2], [TICK * unit, unit], INK);
            self.write([right + 2 * TICK * unit, y - GLYPH_HEIGHT * unit / 2], text, unit);
        }
    }

    fn write(&mut self, [left, top]: [usize; 2], text: &str, unit: usize) {
        for (place, glyph) in text.chars().filter_map(glyph).enumerate() {
            for (row, bits) in glyph.iter().enumerate() {
                for column in (0..5).filter(|column| bits >> (4 - column) & 1 == 1) {
                    let at = [left + (place * GLYPH_ADVANCE + column) * unit, top + row * unit];
                    self.fill(at, [unit, unit], INK);
                }
            }
        }
    }

    fn fill(&mut self, [left, top]: [usize; 2], [width, height]: [usize; 2], color: [u8; 3]) {
        for y in top..top + height {
            let row = &mut self.rgb[3 * (y * self.width + left)..][..3 * width];
            row.as_chunks_mut::<3>().0.fill(color);
        }
    }
}

/// Rows of five pixels, the left one in the highest of five bits.
#[rustfmt::skip]
fn glyph(character: char) -> Option<[u8; GLYPH_HEIGHT]> {
    Some(match character {
        '0' => [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110],
        '1' => [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
        '2' => [0b01110, 0b10001, 0b00001, 0b00010, 0b00100, 0b01000, 0b11111],
        '5' => [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110],
        '7' => [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000],
        '.' => [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00100, 0b00100],
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Plane {
        Plane::new(width, height, (0..width * height).map(|i| (i % width) as f32 / width as f32).collect())
    }

    fn pixel(drawing: &Drawing, x: usize, y: usize) -> [u8; 3] {
        let at = 3 * (y * drawing.width + x);
        [drawing.rgb[at], drawing.rgb[at + 1], drawing.rgb[at + 2]]
    }

    #[test]
    fn the_map_lies_untouched_in_the_upper_left_corner() {
        for (width, height) in [(1, 1), (48, 36), (640, 480), (30, 1080)] {
            let error = ramp(width, height);
            let (map, drawing) = (heat_map(&error), heat_map_with_scale(&error));
            assert_eq!(drawing.rgb.len(), 3 * drawing.width * drawing.height);
            assert!(drawing.width > width && drawing.height >= height);
            for (y, row) in map.chunks_exact(3 * width).enumerate() {
                assert_eq!(&drawing.rgb[3 * y * drawing.width..][..row.len()], row, "row {y} of {width} x {height}");
            }
        }
    }

    #[test]
    fn the_bar_runs_from_0_below_to_1_above_beside_its_values() {
        let drawing = heat_map_with_scale(&ramp(64, 240));
        let across = 64 + MARGIN + BAR_WIDTH / 2;
        let column: Vec<[u8; 3]> = (0..drawing.height).map(|y| pixel(&drawing, across, y)).collect();
        let colors: Vec<[u8; 3]> = column.into_iter().filter(|color| ![PAPER, INK].contains(color)).collect();
        assert_eq!((colors[0], colors[colors.len() - 1]), (magma(1.0), magma(0.0)));
        let light = |color: &[u8; 3]| color.iter().map(|&channel| u32::from(channel)).sum::<u32>();
        assert!(colors.is_sorted_by_key(|color| std::cmp::Reverse(light(color))), "brighter upwards");
        let text_left = 64 + MARGIN + BAR_WIDTH + 2 * TICK;
        let lines: Vec<bool> =
            (0..drawing.height).map(|y| (text_left..drawing.width).any(|x| pixel(&drawing, x, y) == INK)).collect();
        let blocks = lines.windows(2).filter(|pair| !pair[0] && pair[1]).count();
        assert_eq!(blocks, TICKS.len(), "five values, none touching");
    }

    #[test]
    fn values_of_the_lowest_map_do_not_touch_and_large_maps_have_large_ones() {
        let (low, high) = (heat_map_with_scale(&ramp(8, 4)), heat_map_with_scale(&ramp(8, 1440)));
        assert_eq!(low.height, LEAST_BAR + 2 * MARGIN);
        assert_eq!(high.width - 8, 4 * (low.width - 8), "four units a pixel");
    }

    #[test]
    fn every_character_of_the_values_has_a_glyph() {
        assert!(TICKS.iter().flat_map(|(_, text)| text.chars()).all(|character| glyph(character).is_some()));
        assert!(TICKS.iter().all(|(_, text)| text.len() * GLYPH_ADVANCE <= TEXT_WIDTH));
    }
}
