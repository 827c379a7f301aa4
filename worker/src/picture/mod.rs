//! Pictures as files hold them: OpenEXR with its layers, Radiance .hdr, PNG and JPEG. One home for what the command
//! `compare`, the service and jobs of kind `compare` read and compare.

pub mod compare;

use std::io::Cursor;

use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use lightshaft_api::compare::{LayerValue, PictureLayerKind};
use lightshaft_engine::film::{
    AovLayer, COLOR, ExrLayers, LayerInfo, LayerKind, LayerRange, integer_value, is_exr, read_environment,
};

/// A file that has been looked at. What an OpenEXR file holds is decoded when it is asked for.
pub struct Picture<'a> {
    pub width: u32,
    pub height: u32,
    /// Tone mapped already; decoded to linear.
    pub display_referred: bool,
    pub layers: Vec<LayerInfo>,
    content: Content<'a>,
}

enum Content<'a> {
    Layers(ExrLayers<'a>),
    Color(Vec<[f32; 3]>),
}

/// Why a file is no picture, or not this one: words for whoever sent it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PictureError {
    #[error("{0}")]
    Unreadable(String),
    #[error("{0}")]
    NoLayer(String),
    #[error("{0}")]
    NotLinear(String),
}

/// What went wrong inside, as a problem of the file.
fn unreadable(error: impl ToString) -> PictureError {
    PictureError::Unreadable(error.to_string())
}

impl<'a> Picture<'a> {
    /// Reads a picture of at most `max_pixels`, whatever its name says. Sizes are checked before pixels are allocated.
    pub fn open(bytes: &'a [u8], max_pixels: u64) -> Result<Self, PictureError> {
        if is_exr(bytes) {
            let file = ExrLayers::open(bytes, max_pixels).map_err(unreadable)?;
            return Ok(Self {
                width: u32::try_from(file.width()).map_err(unreadable)?,
                height: u32::try_from(file.height()).map_err(unreadable)?,
                display_referred: false,
                layers: file.layers().to_vec(),
                content: Content::Layers(file),
            });
        }
        match image::guess_format(bytes) {
            Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => read_encoded(bytes, format, max_pixels),
            _ if bytes.starts_with(b"#?") => {
                let map = read_environment(bytes, max_pixels).map_err(unreadable)?;
                Ok(Self::color(map.width, map.height, false, map.rgb))
            }
            _ => Err(unreadable("not a picture that can be read: expected PNG, JPEG, OpenEXR or Radiance .hdr")),
        }
    }

    fn color(width: u32, height: u32, display_referred: bool, pixels: Vec<[f32; 3]>) -> Self {
        let channels = ["R", "G", "B"].map(str::to_owned).to_vec();
        let layers = vec![LayerInfo { name: COLOR.to_owned(), kind: LayerKind::Color, channels }];
        Self { width, height, display_referred, layers, content: Content::Color(pixels) }
    }

    /// Place of a layer in [`Self::layers`].
    pub fn find(&self, name: &str) -> Result<usize, PictureError> {
        self.layers.iter().position(|layer| layer.name == name).ok_or_else(|| {
            let there: Vec<&str> = self.layers.iter().map(|layer| layer.name.as_str()).collect();
            let name: String = name.chars().take(128).collect();
            PictureError::NoLayer(format!("there is no layer `{name}`: the picture has {}", there.join(", ")))
        })
    }

    /// A layer's pixels, row 0 at the top.
    pub fn read(self, layer: usize) -> Result<AovLayer, PictureError> {
        match self.content {
            Content::Layers(file) => file.read(layer).map_err(unreadable),
            Content::Color(pixels) => Ok(AovLayer::Vector(pixels)),
        }
    }

    pub fn ranges(&self) -> Result<Vec<LayerRange>, PictureError> {
        match &self.content {
            Content::Layers(file) => file.ranges().map_err(unreadable),
            Content::Color(pixels) => Ok(vec![range_of(pixels.as_flattened().iter().map(|&value| f64::from(value)))]),
        }
    }

    /// Every layer's values at a pixel inside the picture.
    pub fn pixel(&self, x: u32, y: u32) -> Result<Vec<LayerValue>, PictureError> {
        let values = match &self.content {
            Content::Layers(file) => file.pixel(x as usize, y as usize).map_err(unreadable)?,
            Content::Color(pixels) => {
                let pixel = pixels[y as usize * self.width as usize + x as usize];
                vec![pixel.map(f64::from).to_vec()]
            }
        };
        let layers = self.layers.iter().zip(values);
        let known = |kind: LayerKind, value: f64| {
            let none = kind == LayerKind::Integer && value == f64::from(u32::MAX);
            Some(value).filter(|value| value.is_finite() && !none)
        };
        Ok(layers
            .map(|(layer, values)| LayerValue {
                name: layer.name.clone(),
                values: values.into_iter().map(|value| known(layer.kind, value)).collect(),
            })
            .collect())
    }
}

/// The range of a layer's pixels.
pub fn range(layer: &AovLayer) -> LayerRange {
    match layer {
        AovLayer::Scalar(values) => range_of(values.iter().map(|&value| f64::from(value))),
        AovLayer::Vector(values) => range_of(values.as_flattened().iter().map(|&value| f64::from(value))),
        AovLayer::Integer(values) => range_of(values.iter().map(|&value| integer_value(value))),
    }
}

fn range_of(values: impl Iterator<Item = f64>) -> LayerRange {
    let mut range = LayerRange::default();
    values.for_each(|value| range.add(value));
    range
}

pub fn wire_kind(kind: LayerKind) -> PictureLayerKind {
    match kind {
        LayerKind::Color => PictureLayerKind::Color,
        LayerKind::Vector => PictureLayerKind::Vector,
        LayerKind::Scalar => PictureLayerKind::Scalar,
        LayerKind::Integer => PictureLayerKind::Integer,
    }
}

/// PNG and JPEG, decoded from sRGB. Their alpha is left out.
fn read_encoded<'a>(bytes: &'a [u8], format: ImageFormat, max_pixels: u64) -> Result<Picture<'a>, PictureError> {
    let (width, height) = ImageReader::with_format(Cursor::new(bytes), format).into_dimensions().map_err(unreadable)?;
    if u64::from(width) * u64::from(height) > max_pixels {
        let detail = format!("the picture has {width} x {height} pixels, more than the {max_pixels} that are read");
        return Err(unreadable(detail));
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    // Eight bytes a pixel at most; the rest is for what else the file holds.
    limits.max_alloc = Some(max_pixels.saturating_mul(8).saturating_add(16 << 20));
    reader.limits(limits);
    let pixels: Vec<[f32; 3]> = match reader.decode().map_err(unreadable)? {
        deep @ (DynamicImage::ImageLuma16(_)
        | DynamicImage::ImageLumaA16(_)
        | DynamicImage::ImageRgb16(_)
        | DynamicImage::ImageRgba16(_)) => {
            let decode = |value: u16| srgb_to_linear(f32::from(value) / 65535.0);
            deep.into_rgb16().pixels().map(|pixel| pixel.0.map(decode)).collect()
        }
        decoded => {
            let table: [f32; 256] = std::array::from_fn(|i| srgb_to_linear(i as f32 / 255.0));
            decoded.into_rgb8().pixels().map(|pixel| pixel.0.map(|value| table[usize::from(value)])).collect()
        }
    };
    Ok(Picture::color(width, height, true, pixels))
}

/// IEC 61966-2-1.
fn srgb_to_linear(value: f32) -> f32 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAX: u64 = 1 << 20;

    fn color(bytes: &[u8]) -> Result<Vec<[f32; 3]>, PictureError> {
        match Picture::open(bytes, MAX)?.read(0)? {
            AovLayer::Vector(pixels) => Ok(pixels),
            other => panic!("{other:?}"),
        }
    }

    fn png(image: impl Into<DynamicImage>) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.into().write_to(&mut bytes, ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn a_png_is_decoded_from_srgb() {
        let bytes = png(image::RgbImage::from_pixel(2, 1, image::Rgb([0, 128, 255])));
        let [r, g, b] = color(&bytes).unwrap()[1];
        assert!(r == 0.0 && (g - 0.21586).abs() < 1e-4 && b == 1.0);
        let deep = png(DynamicImage::ImageLuma16(image::ImageBuffer::from_pixel(1, 1, image::Luma([257u16]))));
        let [r, ..] = color(&deep).unwrap()[0];
        assert!((r - 1.0 / 255.0 / 12.92).abs() < 1e-7, "16 bits keep what 8 have");
        assert!(color(&bytes[..40]).is_err());
    }

    #[test]
    fn an_exr_is_read_as_it_was_written() {
        let pixels = [[0.5, 1000.0, 0.25], [1.0, -2.0, 3.0]];
        let bytes = lightshaft_engine::film::encode_exr(2, 1, &pixels, None, &[]).unwrap();
        assert_eq!(color(&bytes).unwrap(), pixels);
        let picture = Picture::open(&bytes, MAX).unwrap();
        assert_eq!(picture.pixel(1, 0).unwrap()[0].values, [Some(1.0), Some(-2.0), Some(3.0)]);
        assert_eq!(picture.find("depth").unwrap_err().to_string(), "there is no layer `depth`: the picture has color");
    }

    #[test]
    fn a_small_file_may_not_hold_a_huge_picture() {
        let bytes = png(image::GrayImage::new(5000, 5000));
        assert!(bytes.len() < 1 << 20, "less than a byte for 20 pixels");
        let error = color(&bytes).unwrap_err().to_string();
        assert_eq!(error, "the picture has 5000 x 5000 pixels, more than the 1048576 that are read");
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        for bytes in [b"hello".as_slice(), b"", b"#?RADIANCE\nrubbish", b"\x76\x2f\x31\x01", b"\x89PNG\r\n\x1a\n"] {
            assert!(color(bytes).is_err(), "{bytes:?}");
        }
        assert!(color(b"hello").unwrap_err().to_string().contains("expected PNG"));
    }
}
