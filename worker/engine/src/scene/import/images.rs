//! Images: PNG and JPEG, embedded or beside the document, decoded to RGBA8 in parallel.
//!
//! Each header is held to the budget before any pixel is decoded. An image that is missing or broken costs the picture
//! a texture, not the scene: that is a warning. An image over the budget is an error.

use std::borrow::Cow;
use std::io::Cursor;
use std::sync::Arc;

use image::{ImageFormat, ImageReader};
use rayon::prelude::*;

use super::Session;
use super::accessor::Accessors;
use super::document::{Document, TextureInfo};
use crate::scene::error::{ImportError, ImportErrorKind, Result};
use crate::scene::limits::Limits;
use crate::scene::model::Image;
use crate::scene::source::{Meter, Source, uri};

/// The scene's images, and which of them each glTF image became.
#[derive(Debug, Default)]
pub(super) struct Images {
    pub(super) images: Vec<Arc<Image>>,
    pub(super) by_index: Vec<Option<u32>>,
}

/// Loads every image that a material uses.
pub(super) fn load(document: &Document, accessors: &Accessors<'_>, session: &mut Session<'_>) -> Result<Images> {
    let source = session.source;
    let mut encoded = Vec::new();
    for index in used_images(document) {
        session.check_cancelled()?;
        let position = format!("images/{index}");
        match read(document, accessors, index, &position, source, &mut session.meter) {
            Ok(bytes) => encoded.push((index, bytes)),
            Err(error) if error.kind == ImportErrorKind::MissingFile => {
                session.warnings.add(&position, format!("{}; rendered without this texture", error.message));
            }
            Err(error) => return Err(error),
        }
    }

    let mut headers = Vec::new();
    let mut pixels = 0;
    for (index, bytes) in &encoded {
        let position = format!("images/{index}");
        match Header::read(bytes) {
            Ok(header) => {
                let side = u64::from(header.width.max(header.height));
                Limits::check(&position, "pixels along one side", side, u64::from(session.limits.image_side))?;
                pixels += u64::from(header.width) * u64::from(header.height);
                Limits::check(&position, "pixels over all images", pixels, session.limits.texture_pixels)?;
                if let Some(declared) = document.images[*index].mime_type.as_deref()
                    && !header.format.to_mime_type().eq_ignore_ascii_case(declared)
                {
                    let actual = header.format.to_mime_type();
                    session
                        .warnings
                        .add(&position, format!("says that it is {declared:?} but is {actual}; read as that"));
                }
                headers.push(Some(header));
            }
            Err(message) => {
                session.warnings.add(&position, format!("{message}; rendered without this texture"));
                headers.push(None);
            }
        }
    }

    let cancel = session.cancel;
    let decoded: Vec<Option<Result<Image, String>>> = encoded
        .par_iter()
        .zip(&headers)
        .map(|((index, bytes), header)| {
            let header = header.as_ref()?;
            (!cancel()).then(|| header.decode(bytes, document.images[*index].name.clone()))
        })
        .collect();
    session.check_cancelled()?;

    let mut loaded = Images { images: Vec::new(), by_index: vec![None; document.images.len()] };
    for ((index, _), image) in encoded.iter().zip(decoded) {
        match image {
            Some(Ok(image)) => {
                loaded.by_index[*index] = Some(loaded.images.len() as u32);
                loaded.images.push(Arc::new(image));
            }
            Some(Err(message)) => {
                session.warnings.add(&format!("images/{index}"), format!("{message}; rendered without this texture"));
            }
            None => {}
        }
    }
    Ok(loaded)
}

/// Images that a material's texture shows, in order, each once.
fn used_images(document: &Document) -> Vec<usize> {
    let mut used: Vec<usize> = document
        .materials
        .iter()
        .flat_map(|material| {
            let pbr = &material.pbr_metallic_roughness;
            let infos: [&Option<TextureInfo>; 4] = [
                &pbr.base_color_texture,
                &pbr.metallic_roughness_texture,
                &material.normal_texture,
                &material.emissive_texture,
            ];
            infos.into_iter().flatten().filter_map(|info| document.textures[info.index].source)
        })
        .collect();
    used.sort_unstable();
    used.dedup();
    used
}

fn read<'a>(
    document: &'a Document,
    accessors: &'a Accessors<'_>,
    index: usize,
    position: &str,
    source: &'a Source,
    meter: &mut Meter<'_>,
) -> Result<Cow<'a, [u8]>> {
    let image = &document.images[index];
    match (&image.uri, image.buffer_view) {
        (_, Some(view)) => Ok(Cow::Borrowed(accessors.view(view))),
        (Some(reference), None) => {
            let position = format!("{position}/uri");
            if let Some(bytes) = uri::data_uri(reference, &position)? {
                return Ok(Cow::Owned(bytes));
            }
            source.read_reference(reference, &position, meter)
        }
        (None, None) => Err(ImportError::malformed(position, "needs a uri or a bufferView")),
    }
}

struct Header {
    format: ImageFormat,
    width: u32,
    height: u32,
}

impl Header {
    fn read(bytes: &[u8]) -> Result<Self, String> {
        let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string())?;
        let format = match reader.format() {
            Some(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
            Some(format) => return Err(format!("is {}; PNG and JPEG are supported", format.to_mime_type())),
            None => return Err("is neither PNG nor JPEG".to_owned()),
        };
        let (width, height) = reader.into_dimensions().map_err(|error| format!("cannot be decoded: {error}"))?;
        if width == 0 || height == 0 {
            return Err("has no pixels".to_owned());
        }
        Ok(Self { format, width, height })
    }

    /// Any bit depth and channel layout becomes RGBA8.
    fn decode(&self, bytes: &[u8], name: String) -> Result<Image, String> {
        let mut limits = image::Limits::no_limits();
        limits.max_image_width = Some(self.width);
        limits.max_image_height = Some(self.height);
        // RGBA16 is the widest that either format decodes to; as much again for the decoder itself.
        limits.max_alloc = Some(u64::from(self.width) * u64::from(self.height) * 16 + (16 << 20));
        let mut reader = ImageReader::with_format(Cursor::new(bytes), self.format);
        reader.limits(limits);
        let decoded = reader.decode().map_err(|error| format!("cannot be decoded: {error}"))?;
        let rgba = decoded.into_rgba8();
        Ok(Image { name, width: rgba.width(), height: rgba.height(), rgba8: rgba.into_raw() })
    }
}
