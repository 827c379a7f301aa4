//! Reads pictures to compare: OpenEXR, Radiance .hdr, PNG and JPEG, as linear RGB.

use std::io::Cursor;

use image::{ImageFormat, ImageReader};
use lightshaft_engine::film::read_environment;
use lightshaft_engine::settings::HdrImage;

/// Pixels of the largest picture that is read, all channels of an OpenEXR file counted: 16384 x 16384.
const MAX_PIXELS: u64 = 1 << 28;

/// Reads a picture, whatever its name says. 8-bit formats are decoded from sRGB.
///
/// # Errors
/// In words: no picture, a broken or too large one.
pub(crate) fn read(bytes: &[u8]) -> Result<HdrImage, String> {
    match image::guess_format(bytes) {
        Ok(ImageFormat::Png | ImageFormat::Jpeg) => read_8_bit(bytes),
        _ => read_environment(bytes, MAX_PIXELS).map_err(|_| {
            "not a picture that can be read (expected PNG, JPEG, OpenEXR or Radiance .hdr of at most 16384 x 16384)"
                .to_owned()
        }),
    }
}

fn read_8_bit(bytes: &[u8]) -> Result<HdrImage, String> {
    let reader = || ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string());
    let (width, height) = reader()?.into_dimensions().map_err(|error| error.to_string())?;
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(format!("{width}x{height} pixels are more than the {MAX_PIXELS} that are read"));
    }
    let decoded = reader()?.decode().map_err(|error| error.to_string())?.into_rgb8();
    let table: [f32; 256] = std::array::from_fn(|i| srgb_to_linear(i as f32 / 255.0));
    let rgb = decoded.pixels().map(|pixel| pixel.0.map(|value| table[usize::from(value)])).collect();
    Ok(HdrImage { width, height, rgb })
}

/// IEC 61966-2-1.
fn srgb_to_linear(value: f32) -> f32 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_png_is_decoded_from_srgb() {
        let mut bytes = Cursor::new(Vec::new());
        let image = image::RgbImage::from_pixel(2, 1, image::Rgb([0, 128, 255]));
        image.write_to(&mut bytes, ImageFormat::Png).unwrap();
        let picture = read(bytes.get_ref()).unwrap();
        assert_eq!(picture.rgb.len(), 2);
        let [r, g, b] = picture.rgb[0];
        assert!(r == 0.0 && (g - 0.21586).abs() < 1e-4 && b == 1.0, "{:?}", picture.rgb[0]);
        let torn = &bytes.get_ref()[..40];
        assert!(read(torn).is_err());
    }

    #[test]
    fn an_exr_is_read_as_it_was_written() {
        let pixels = [[0.5, 1000.0, 0.25], [1.0, 2.0, 3.0]];
        let bytes = lightshaft_engine::film::encode_exr(2, 1, &pixels, None, &[]).unwrap();
        assert_eq!(read(&bytes).unwrap().rgb, pixels);
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        assert!(read(b"hello").unwrap_err().contains("expected PNG"));
        assert!(read(b"").is_err());
    }
}
