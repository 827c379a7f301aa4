//! The images that are compared.

use crate::plane::Plane;
use crate::z_test::LEAST_RENDERINGS;

/// Scene-linear RGB with BT.709 primaries, row 0 at the top. Values may be anything, NaN and infinities included.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    #[error("an image of {width} x {height} pixels cannot be compared: it needs at least one pixel")]
    Empty { width: usize, height: usize },
    #[error("an image of {width} x {height} pixels came with {found} pixels")]
    PixelCount { width: usize, height: usize, found: usize },
    #[error(
        "the images differ in size: the reference has {reference_width} x {reference_height} pixels, the test image {test_width} x {test_height}"
    )]
    Size { reference_width: usize, reference_height: usize, test_width: usize, test_height: usize },
    #[error("{found} renderings are too few to know how far they scatter: it takes at least {LEAST_RENDERINGS}")]
    Renderings { found: usize },
}

impl Image {
    /// # Errors
    /// [`Error::Empty`] without pixels, [`Error::PixelCount`] when `pixels` is not `width * height` long.
    pub fn new(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Result<Self, Error> {
        match width.checked_mul(height) {
            Some(0) => Err(Error::Empty { width, height }),
            Some(count) if count == pixels.len() => Ok(Self { width, height, pixels }),
            _ => Err(Error::PixelCount { width, height, found: pixels.len() }),
        }
    }

    /// From 8-bit sRGB (as a PNG holds it), decoded to linear.
    ///
    /// # Errors
    /// As [`Image::new`]; `rgb` holds three bytes per pixel.
    pub fn from_srgb8(width: usize, height: usize, rgb: &[u8]) -> Result<Self, Error> {
        let (pixels, rest) = rgb.as_chunks::<3>();
        if !rest.is_empty() {
            return Err(Error::PixelCount { width, height, found: pixels.len() });
        }
        let pixels = pixels.iter().map(|pixel| pixel.map(|c| srgb_decode(f32::from(c) / 255.0))).collect();
        Self::new(width, height, pixels)
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// As a display shows it: multiplied by `2^exposure`, clamped to 0..1, sRGB-encoded (IEC 61966-2-1). Channels
    /// that are NaN become 0.
    pub(crate) fn encoded(&self, exposure: f32) -> Vec<[f32; 3]> {
        let scale = exposure.exp2();
        self.pixels.iter().map(|pixel| pixel.map(|c| srgb_encode((c * scale).clamp(0.0, 1.0).max(0.0)))).collect()
    }

    /// As [`Image::from_srgb8`] would read it: clamped, sRGB-encoded, three bytes per pixel.
    pub fn to_srgb8(&self, exposure: f32) -> Vec<u8> {
        self.encoded(exposure).into_iter().flatten().map(|c| (c * 255.0).round() as u8).collect()
    }

    pub(crate) fn plane(&self, values: Vec<f32>) -> Plane {
        Plane::new(self.width, self.height, values)
    }
}

pub(crate) fn same_size(reference: &Image, test: &Image) -> Result<(), Error> {
    if (reference.width, reference.height) == (test.width, test.height) {
        return Ok(());
    }
    Err(Error::Size {
        reference_width: reference.width,
        reference_height: reference.height,
        test_width: test.width,
        test_height: test.height,
    })
}

/// Relative luminance of linear BT.709 RGB.
pub(crate) fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

pub(crate) fn is_finite(pixel: &[f32; 3]) -> bool {
    pixel.iter().all(|c| c.is_finite())
}

pub(crate) fn srgb_encode(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

pub(crate) fn srgb_decode(encoded: f32) -> f32 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_wrong_pixel_counts() {
        assert_eq!(Image::new(0, 4, vec![]), Err(Error::Empty { width: 0, height: 4 }));
        let short = Image::new(2, 2, vec![[0.0; 3]; 3]);
        assert_eq!(short, Err(Error::PixelCount { width: 2, height: 2, found: 3 }));
        assert!(Image::new(usize::MAX, 2, vec![[0.0; 3]]).is_err(), "the product overflows");
        assert!(Image::from_srgb8(1, 1, &[0, 0]).is_err());
    }

    #[test]
    fn srgb_round_trip_is_exact_in_8_bits() {
        let bytes: Vec<u8> = (0..=255).flat_map(|v| [v; 3]).collect();
        let image = Image::from_srgb8(256, 1, &bytes).unwrap();
        assert_eq!(image.to_srgb8(0.0), bytes);
    }

    #[test]
    fn encoding_clamps_and_survives_nan() {
        let shown = |color: f32, exposure: f32| Image::new(1, 1, vec![[color; 3]]).unwrap().encoded(exposure)[0][0];
        assert_eq!(shown(f32::NAN, 0.0), 0.0);
        assert_eq!(shown(-1.0, 0.0), 0.0);
        assert!((shown(f32::INFINITY, 0.0) - 1.0).abs() < 1e-6);
        assert!((shown(0.25, 2.0) - 1.0).abs() < 1e-6, "two stops are a factor of four");
    }
}
