//! What pictures hold: their layers, the pixels of one, all values at one place. A picture is a blob.

use futures::TryStreamExt;
use lightshaft_api::compare::{PictureLayer, PictureLayers, PixelValues, SampleForm};
use lightshaft_api::problem::FieldError;
use lightshaft_engine::film::AovLayer;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use tokio::sync::SemaphorePermit;

use super::App;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use lightshaft_worker::picture::{Picture, PictureError, wire_kind};

/// Names of layers in addresses: RFC 3986's unreserved characters stay.
const ESCAPED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');

/// The pixels of one layer as bytes, little-endian, row 0 at the top, the channels of a pixel together.
#[derive(Clone, Debug)]
pub struct RawLayer {
    pub width: u32,
    pub height: u32,
    pub channels: u8,
    pub form: SampleForm,
    pub samples: Vec<u8>,
}

pub(super) fn escape(layer: &str) -> String {
    utf8_percent_encode(layer, ESCAPED).to_string()
}

impl App {
    /// What a picture holds. `base` is the address below which its layers lie.
    pub async fn picture_layers(&self, hash: &str, base: &str) -> ApiResult<PictureLayers> {
        let (name, base) = (hash.to_owned(), base.to_owned());
        self.look_at(hash, move |picture| {
            let ranges = picture.ranges()?;
            let layers = picture.layers.iter().zip(ranges).map(|(layer, range)| PictureLayer {
                name: layer.name.clone(),
                kind: wire_kind(layer.kind),
                channels: layer.channels.clone(),
                minimum: range.bounds().map(|bounds| bounds.0),
                maximum: range.bounds().map(|bounds| bounds.1),
                non_finite: range.non_finite,
                href: format!("{base}/layers/{}", escape(&layer.name)),
            });
            Ok(PictureLayers {
                hash: name,
                width: picture.width,
                height: picture.height,
                display_referred: picture.display_referred,
                layers: layers.collect(),
            })
        })
        .await
    }

    /// One layer's pixels; without a `form`, floats as `f32` and integers as `u32`.
    pub async fn picture_layer(&self, hash: &str, name: &str, form: Option<SampleForm>) -> ApiResult<RawLayer> {
        let name = name.to_owned();
        let read = self.look_at(hash, move |picture| {
            let (width, height) = (picture.width, picture.height);
            let index = picture.find(&name)?;
            let layer = picture.read(index)?;
            Ok(to_bytes(&layer, form).map(|(channels, form, samples)| RawLayer {
                width,
                height,
                channels,
                form,
                samples,
            }))
        });
        read.await?.map_err(|expected| ApiError::bad_request("query/format", expected))
    }

    /// The values of all layers at one pixel.
    pub async fn picture_pixel(&self, hash: &str, x: u32, y: u32) -> ApiResult<PixelValues> {
        let read = self.look_at(hash, move |picture| {
            let ends = [("x", x, picture.width), ("y", y, picture.height)];
            match ends.into_iter().find(|(_, at, end)| at >= end) {
                Some((name, _, end)) => Ok(Err((name, end))),
                None => Ok(Ok(picture.pixel(x, y)?)),
            }
        });
        match read.await? {
            Ok(layers) => Ok(PixelValues { x, y, layers }),
            Err((name, end)) => {
                Err(ApiError::bad_request(&format!("query/{name}"), &format!("must be less than {end}")))
            }
        }
    }

    /// Opens a picture and works on it, on a thread for such work, when it is its turn.
    async fn look_at<T, F>(&self, hash: &str, work: F) -> ApiResult<T>
    where
        T: Send + 'static,
        F: FnOnce(Picture<'_>) -> Result<T, PictureError> + Send + 'static,
    {
        let _turn = self.picture_turn().await?;
        let bytes = self.picture_bytes(hash).await?;
        let max_pixels = self.config.limits.picture_pixels;
        let looked = tokio::task::spawn_blocking(move || Picture::open(&bytes, max_pixels).and_then(work));
        looked.await.map_err(ApiError::internal)?.map_err(|error| match error {
            PictureError::NoLayer(detail) => ApiError::new(Code::NotFound, detail),
            PictureError::Unreadable(detail) | PictureError::NotLinear(detail) => {
                ApiError::fields(vec![FieldError::new("path", detail)])
            }
        })
    }

    pub(super) async fn picture_turn(&self) -> ApiResult<SemaphorePermit<'_>> {
        self.picture_turns.acquire().await.map_err(ApiError::internal)
    }

    /// The whole file.
    pub(super) async fn picture_bytes(&self, hash: &str) -> ApiResult<Vec<u8>> {
        let size = self.blobs.size(hash).await.map_err(ApiError::internal)?;
        let size = size.ok_or_else(|| ApiError::not_found("picture", hash))?;
        let limit = self.config.limits.picture_bytes;
        if size > limit {
            return Err(ApiError::new(Code::TooLarge, format!("pictures of more than {limit} bytes are not read")));
        }
        let mut stream = self.blobs.read(hash, 0..size).await.map_err(ApiError::internal)?;
        let mut bytes = Vec::with_capacity(usize::try_from(size).unwrap_or_default());
        while let Some(chunk) = stream.try_next().await.map_err(ApiError::internal)? {
            bytes.extend_from_slice(&chunk);
        }
        Ok(bytes)
    }
}

/// Channels, form and samples; or the forms that the layer has.
fn to_bytes(layer: &AovLayer, form: Option<SampleForm>) -> Result<(u8, SampleForm, Vec<u8>), &'static str> {
    let floats = |values: &[f32]| match form {
        None | Some(SampleForm::F32) => {
            Ok((SampleForm::F32, values.iter().flat_map(|value| value.to_le_bytes()).collect()))
        }
        Some(SampleForm::F16) => {
            Ok((SampleForm::F16, values.iter().flat_map(|&value| to_half(value).to_le_bytes()).collect()))
        }
        Some(SampleForm::U32) => Err("must be f16 or f32: the layer holds floats"),
    };
    match layer {
        AovLayer::Vector(values) => floats(values.as_flattened()).map(|(form, samples)| (3, form, samples)),
        AovLayer::Scalar(values) => floats(values).map(|(form, samples)| (1, form, samples)),
        AovLayer::Integer(values) => match form {
            None | Some(SampleForm::U32) => {
                Ok((1, SampleForm::U32, values.iter().flat_map(|value| value.to_le_bytes()).collect()))
            }
            _ => Err("must be u32: the layer holds integers"),
        },
    }
}

/// The nearest half float; finite values stay finite.
fn to_half(value: f32) -> half::f16 {
    let bound = half::f16::MAX.to_f32();
    half::f16::from_f32(if value.is_finite() { value.clamp(-bound, bound) } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_little_endian_and_stay_finite() {
        let layer = AovLayer::Scalar(vec![1.0, -0.5, 1e9, f32::INFINITY]);
        let (channels, form, samples) = to_bytes(&layer, Some(SampleForm::F16)).unwrap();
        assert_eq!((channels, form), (1, SampleForm::F16));
        assert_eq!(samples, [0x00, 0x3c, 0x00, 0xb8, 0xff, 0x7b, 0x00, 0x7c]);
        assert!(to_bytes(&layer, Some(SampleForm::U32)).is_err());
        assert!(to_bytes(&AovLayer::Integer(vec![1]), Some(SampleForm::F16)).is_err());
    }
}
