//! PNG files for people: tone mapped, sRGB, 8 bits, with the render's metadata in text chunks.

use super::EncodeError;
use super::tonemap::{ToneMap, to_srgb8};

/// Encodes `radiance` (row-major, `width * height`). `metadata` becomes one international text chunk an entry, in order;
/// keywords are 1 to 79 printable Latin characters. The same input gives the same bytes.
pub fn encode_png(
    width: u32,
    height: u32,
    radiance: &[[f32; 3]],
    tone_map: ToneMap,
    exposure_stops: f32,
    metadata: &[(&str, String)],
) -> Result<Vec<u8>, EncodeError> {
    super::check_size(width, height, radiance.len())?;
    encode_png_srgb8(width, height, &to_srgb8(radiance, tone_map, exposure_stops), metadata)
}

/// Encodes colours as they are: sRGB, 8 bits, three bytes a pixel.
pub fn encode_png_srgb8(
    width: u32,
    height: u32,
    srgb: &[u8],
    metadata: &[(&str, String)],
) -> Result<Vec<u8>, EncodeError> {
    super::check_size(width, height, srgb.len() / 3)?;
    let failed = |e: png::EncodingError| EncodeError(format!("PNG: {e}"));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    for (keyword, text) in metadata {
        encoder.add_itxt_chunk((*keyword).to_owned(), text.clone()).map_err(failed)?;
    }
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(srgb).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_and_metadata_come_back() {
        let radiance = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.5, 2.0], [0.25; 3], [0.1, 0.2, 0.3], [9.0; 3]];
        let metadata = [("Software", "lightshaft".to_owned()), ("device", "CPU ü".to_owned())];
        let encode = || encode_png(3, 2, &radiance, ToneMap::None, 0.0, &metadata).unwrap();
        let bytes = encode();
        assert_eq!(bytes, encode());
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, to_srgb8(&radiance, ToneMap::None, 0.0));
        let info = reader.info();
        assert_eq!((info.width, info.height), (3, 2));
        assert_eq!(info.utf8_text[1].keyword, "device");
        assert_eq!(info.utf8_text[1].get_text().unwrap(), "CPU ü");
    }

    #[test]
    fn a_wrong_number_of_pixels_is_an_error() {
        let error = encode_png(2, 2, &[[0.0; 3]; 3], ToneMap::None, 0.0, &[]).unwrap_err();
        assert_eq!(error.to_string(), "2x2 pixels need 4 values, there are 3");
    }
}
