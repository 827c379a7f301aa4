//! OpenEXR files for further work: linear radiance and named layers.
//!
//! One part with channels `R`, `G`, `B` and, for each AOV, `<layer>.<channel>` (`depth.Z`, `position.X`, `albedo.R`,
//! `instance_id.I`, `line_space_gamma.Y`, ...), the naming that viewers and compositors group layers by. Depth is planar,
//! along the camera's axis. Radiance and vectors are 32-bit
//! floats, ids and counts unsigned 32-bit integers. ZIP compression, no loss.

use std::io::Cursor;

use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, SmallVec, Text,
    WritableImage,
};

use super::{AovBuffers, AovLayer, EncodeError};
use crate::settings::Aov;

/// Encodes `radiance` and the layers of `aovs` (same size). `metadata` is written as `key=value` lines into the standard
/// `comments` attribute, whose order, unlike that of custom attributes, is fixed: the same input gives the same bytes.
pub fn encode_exr(
    width: u32,
    height: u32,
    radiance: &[[f32; 3]],
    aovs: Option<&AovBuffers>,
    metadata: &[(&str, String)],
) -> Result<Vec<u8>, EncodeError> {
    super::check_size(width, height, radiance.len())?;
    let mut channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = SmallVec::new();
    push_vector(&mut channels, "", ["R", "G", "B"], radiance);
    for (aov, layer) in aovs.map(|a| a.layers.as_slice()).unwrap_or_default() {
        let name = aov.name();
        let count = match layer {
            AovLayer::Scalar(v) => v.len(),
            AovLayer::Vector(v) => v.len(),
            AovLayer::Integer(v) => v.len(),
        };
        super::check_size(width, height, count)?;
        match layer {
            AovLayer::Scalar(v) => {
                let letter = if *aov == Aov::Depth { "Z" } else { "Y" };
                channels.push(AnyChannel::new(text(&format!("{name}.{letter}"))?, FlatSamples::F32(v.clone())));
            }
            AovLayer::Vector(v) => {
                let is_color = matches!(aov, Aov::Albedo | Aov::LineSpaceAnswer);
                let letters = if is_color { ["R", "G", "B"] } else { ["X", "Y", "Z"] };
                push_vector(&mut channels, &format!("{name}."), letters, v);
            }
            AovLayer::Integer(v) => {
                channels.push(AnyChannel::new(text(&format!("{name}.I"))?, FlatSamples::U32(v.clone())));
            }
        }
    }
    let lines: Vec<String> = metadata.iter().map(|(k, v)| format!("{k}={v}")).collect();
    let attributes = LayerAttributes {
        software_name: Some(text(&format!("lightshaft {}", crate::VERSION))?),
        comments: if lines.is_empty() { None } else { Some(text(&lines.join("\n"))?) },
        ..LayerAttributes::default()
    };
    let encoding = Encoding { compression: Compression::ZIP16, ..Encoding::default() };
    let size = (width as usize, height as usize);
    let image = Image::from_layer(Layer::new(size, attributes, encoding, AnyChannels::sort(channels)));
    let mut bytes = Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).map_err(|e| EncodeError(format!("EXR: {e}")))?;
    Ok(bytes.into_inner())
}

fn push_vector(
    channels: &mut SmallVec<[AnyChannel<FlatSamples>; 4]>,
    prefix: &str,
    letters: [&str; 3],
    values: &[[f32; 3]],
) {
    for (c, letter) in letters.iter().enumerate() {
        let samples = FlatSamples::F32(values.iter().map(|v| v[c]).collect());
        channels.push(AnyChannel::new(format!("{prefix}{letter}").as_str(), samples));
    }
}

/// EXR text is a byte a character: others become `?`.
fn text(s: &str) -> Result<Text, EncodeError> {
    let latin: String = s.chars().map(|c| if (c as u32) < 256 { c } else { '?' }).collect();
    Text::new_or_none(&latin).ok_or_else(|| EncodeError(format!("EXR: {s:?} is no valid text")))
}

#[cfg(test)]
mod tests {
    use exr::prelude::*;

    use super::super::{AovBuffers, AovLayer};
    use super::*;
    use crate::device::Region;

    #[test]
    fn every_layer_comes_back_bit_for_bit() {
        let region = Region { x: 0, y: 0, width: 5, height: 3 };
        let radiance: Vec<[f32; 3]> = (0..15).map(|i| [i as f32 * 1.1, 1e-30 * i as f32, 1e30]).collect();
        let mut aovs = AovBuffers::new(region, &Aov::ALL);
        for (_, layer) in &mut aovs.layers {
            match layer {
                AovLayer::Scalar(v) => v[3] = 2.5,
                AovLayer::Vector(v) => v[4] = [1.0, -2.0, 3.5],
                AovLayer::Integer(v) => v[5] = 4_000_000_001,
            }
        }
        let metadata = [("spp", "16".to_owned()), ("seed", "1".to_owned())];
        let encode = || encode_exr(5, 3, &radiance, Some(&aovs), &metadata).unwrap();
        let bytes = encode();
        assert_eq!(bytes, encode());

        let image = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(Cursor::new(&bytes))
            .unwrap();
        let layer = &image.layer_data;
        assert_eq!(layer.attributes.comments.as_ref().unwrap().to_string(), "spp=16\nseed=1");
        let find = |name: &str| {
            let channel = layer.channel_data.list.iter().find(|c| c.name.to_string() == name);
            channel.unwrap_or_else(|| panic!("no channel {name}")).sample_data.clone()
        };
        for (c, name) in ["R", "G", "B"].iter().enumerate() {
            assert_eq!(find(name), FlatSamples::F32(radiance.iter().map(|v| v[c]).collect()));
        }
        for (aov, layer) in &aovs.layers {
            match layer {
                AovLayer::Scalar(v) => {
                    let letter = if *aov == Aov::Depth { "Z" } else { "Y" };
                    assert_eq!(find(&format!("{}.{letter}", aov.name())), FlatSamples::F32(v.clone()));
                }
                AovLayer::Vector(v) => {
                    let is_color = matches!(aov, Aov::Albedo | Aov::LineSpaceAnswer);
                    let letter = if is_color { "G" } else { "Y" };
                    let expected = FlatSamples::F32(v.iter().map(|v| v[1]).collect());
                    assert_eq!(find(&format!("{}.{letter}", aov.name())), expected);
                }
                AovLayer::Integer(v) => assert_eq!(find(&format!("{}.I", aov.name())), FlatSamples::U32(v.clone())),
            }
        }
    }
}
