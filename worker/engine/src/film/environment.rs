//! Environment maps from Radiance .hdr and OpenEXR files.

use std::io::Cursor;

use exr::prelude::{FlatSamples, MetaData, ReadChannels, ReadLayers, read};
use image::ImageDecoder;
use image::codecs::hdr::HdrDecoder;

use crate::settings::HdrImage;

#[derive(Debug, thiserror::Error)]
pub enum EnvironmentError {
    #[error("not an environment map: neither Radiance HDR (#?RADIANCE) nor OpenEXR")]
    UnknownFormat,
    #[error("the environment map has {width}x{height} pixels, more than the {limit} that are allowed")]
    TooLarge { width: u64, height: u64, limit: u64 },
    #[error("{format}: {detail}")]
    Malformed { format: &'static str, detail: String },
}

/// Decodes a map, whatever its name says, if it has at most `max_pixels`. Sizes are checked before pixels are allocated.
pub fn read_environment(bytes: &[u8], max_pixels: u64) -> Result<HdrImage, EnvironmentError> {
    let image = if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        read_exr(bytes, max_pixels)?
    } else if bytes.starts_with(b"#?") {
        read_hdr(bytes, max_pixels)?
    } else {
        return Err(EnvironmentError::UnknownFormat);
    };
    if image.rgb.iter().flatten().any(|c| !c.is_finite() || *c < 0.0) {
        tracing::warn!("the environment map has negative or infinite radiance, which counts as black");
    }
    Ok(image)
}

fn check(width: u64, height: u64, limit: u64) -> Result<(), EnvironmentError> {
    match width.checked_mul(height) {
        Some(pixels) if pixels <= limit && pixels > 0 => Ok(()),
        _ => Err(EnvironmentError::TooLarge { width, height, limit }),
    }
}

fn read_hdr(bytes: &[u8], limit: u64) -> Result<HdrImage, EnvironmentError> {
    let malformed =
        |e: image::ImageError| EnvironmentError::Malformed { format: "Radiance HDR", detail: e.to_string() };
    let decoder = HdrDecoder::new(Cursor::new(bytes)).map_err(malformed)?;
    let (width, height) = decoder.dimensions();
    check(width.into(), height.into(), limit)?;
    let mut rgb = vec![[0.0f32; 3]; width as usize * height as usize];
    decoder.read_image(bytemuck::cast_slice_mut(&mut rgb)).map_err(malformed)?;
    Ok(HdrImage { width, height, rgb })
}

fn read_exr(bytes: &[u8], limit: u64) -> Result<HdrImage, EnvironmentError> {
    let malformed = |detail: String| EnvironmentError::Malformed { format: "OpenEXR", detail };
    let failed = |e: exr::error::Error| malformed(e.to_string());
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(failed)?;
    for header in &meta.headers {
        let (width, height) = (header.layer_size.width() as u64, header.layer_size.height() as u64);
        // Every channel is decoded, so all of them count.
        let channels = header.channels.list.len().max(1) as u64;
        check(width, height, limit)?;
        check(width, height.saturating_mul(channels), limit.saturating_mul(4))?;
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(failed)?;
    let layer = image.layer_data;
    let (width, height) = (layer.size.width() as u32, layer.size.height() as u32);
    let channel = |name: &str| layer.channel_data.list.iter().find(|c| c.name.eq_case_insensitive(name));
    let grey = channel("Y");
    let mut rgb = vec![[0.0f32; 3]; width as usize * height as usize];
    for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
        let found = channel(name).or(grey).ok_or_else(|| malformed(format!("has no channel {name} (nor Y)")))?;
        if matches!(found.sample_data, FlatSamples::U32(_)) {
            return Err(malformed(format!("channel {name} holds integers, radiance must be floats")));
        }
        if found.sample_data.len() != rgb.len() {
            return Err(malformed(format!("channel {name} is subsampled")));
        }
        rgb.iter_mut().zip(found.sample_data.values_as_f32()).for_each(|(pixel, value)| pixel[c] = value);
    }
    Ok(HdrImage { width, height, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::encode_exr;

    fn radiance() -> Vec<[f32; 3]> {
        (0..8).map(|i| [i as f32, 0.5, 100.0 * i as f32]).collect()
    }

    #[test]
    fn exr_maps_come_back() {
        let bytes = encode_exr(4, 2, &radiance(), None, &[]).unwrap();
        let image = read_environment(&bytes, 8).unwrap();
        assert_eq!((image.width, image.height, image.rgb), (4, 2, radiance()));
    }

    #[test]
    fn hdr_maps_come_back_within_their_precision() {
        let pixels: Vec<image::Rgb<f32>> = radiance().into_iter().map(image::Rgb).collect();
        let mut bytes = Vec::new();
        image::codecs::hdr::HdrEncoder::new(&mut bytes).encode(&pixels, 4, 2).unwrap();
        let image = read_environment(&bytes, 8).unwrap();
        for (got, expected) in image.rgb.iter().zip(radiance()) {
            let largest = expected.iter().fold(0.0f32, |a, &b| a.max(b));
            assert!((0..3).all(|c| (got[c] - expected[c]).abs() <= largest / 128.0), "{got:?} but {expected:?}");
        }
    }

    #[test]
    fn oversized_truncated_and_foreign_files_say_what_is_wrong() {
        let bytes = encode_exr(4, 2, &radiance(), None, &[]).unwrap();
        let error = read_environment(&bytes, 7).unwrap_err().to_string();
        assert_eq!(error, "the environment map has 4x2 pixels, more than the 7 that are allowed");
        let error = read_environment(&bytes[..bytes.len() - 20], 8).unwrap_err().to_string();
        assert!(error.starts_with("OpenEXR: "), "{error}");
        let error =
            read_environment(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\nxx", 8).unwrap_err().to_string();
        assert!(error.starts_with("Radiance HDR: "), "{error}");
        assert!(matches!(read_environment(b"\x89PNG....", 8), Err(EnvironmentError::UnknownFormat)));
    }
}
