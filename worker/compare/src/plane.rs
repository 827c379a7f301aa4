//! One channel of an image, and separable filters over it.

/// Row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    /// # Panics
    /// When there are not `width * height` values.
    pub fn new(width: usize, height: usize, values: Vec<f32>) -> Self {
        assert_eq!(values.len(), width * height, "values of {width} x {height} pixels");
        Self { width, height, values }
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Arithmetic mean, summed in double precision.
    pub fn mean(&self) -> f64 {
        self.values.iter().map(|&v| f64::from(v)).sum::<f64>() / self.values.len() as f64
    }

    /// The value that a share `p` (0 to 1) of all values does not exceed, by the nearest-rank method.
    pub fn percentile(&self, p: f64) -> f32 {
        let mut sorted = self.values.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        let rank = (p * sorted.len() as f64).ceil() as usize;
        sorted[rank.clamp(1, sorted.len()) - 1]
    }

    pub(crate) fn map2(&self, other: &Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let values = self.values.iter().zip(&other.values).map(|(&a, &b)| f(a, b)).collect();
        Self::new(self.width, self.height, values)
    }

    /// Correlates rows with `horizontal`, then columns with `vertical`. Both have an odd length; beyond the border
    /// the nearest pixel counts.
    pub(crate) fn filter(&self, horizontal: &[f32], vertical: &[f32]) -> Self {
        let (width, height) = (self.width, self.height);
        let mut rows = vec![0.0; self.values.len()];
        // Each row with its border, so that every tap is one run over it.
        let margin = horizontal.len() / 2;
        let mut wide = vec![0.0; width + 2 * margin];
        for (row, out) in self.values.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
            wide[..margin].fill(row[0]);
            wide[margin..margin + width].copy_from_slice(row);
            wide[margin + width..].fill(row[width - 1]);
            for (tap, &weight) in horizontal.iter().enumerate() {
                for (out, &value) in out.iter_mut().zip(&wide[tap..]) {
                    *out += weight * value;
                }
            }
        }
        let mut values = vec![0.0; self.values.len()];
        let radius = vertical.len() / 2;
        for (y, out) in values.chunks_exact_mut(width).enumerate() {
            for (tap, &weight) in vertical.iter().enumerate() {
                let source = (y + tap).saturating_sub(radius).min(height - 1);
                for (out, &value) in out.iter_mut().zip(&rows[source * width..][..width]) {
                    *out += weight * value;
                }
            }
        }
        Self::new(width, height, values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filter_keeps_constants_and_moves_by_an_off_centre_tap() {
        let flat = Plane::new(7, 5, vec![3.0; 35]);
        let blur = [0.25, 0.5, 0.25];
        assert!(flat.filter(&blur, &blur).values().iter().all(|v| (v - 3.0).abs() < 1e-6));

        let ramp = Plane::new(4, 2, vec![0.0, 1.0, 2.0, 3.0, 10.0, 11.0, 12.0, 13.0]);
        let next = ramp.filter(&[0.0, 0.0, 1.0], &[0.0, 1.0, 0.0]);
        assert_eq!(next.values(), [1.0, 2.0, 3.0, 3.0, 11.0, 12.0, 13.0, 13.0], "the border repeats");
        let below = ramp.filter(&[0.0, 1.0, 0.0], &[0.0, 0.0, 1.0]);
        assert_eq!(below.values()[..4], [10.0, 11.0, 12.0, 13.0]);
        assert_eq!(below.values()[4..], [10.0, 11.0, 12.0, 13.0]);
    }

    #[test]
    fn percentile_is_the_nearest_rank() {
        let plane = Plane::new(100, 1, (1..=100).rev().map(|v| v as f32).collect());
        assert_eq!(plane.percentile(0.99), 99.0);
        assert_eq!(plane.percentile(1.0), 100.0);
        assert_eq!(plane.percentile(0.0), 1.0);
        assert_eq!(plane.percentile(0.5), 50.0);
    }
}
