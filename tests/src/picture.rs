//! Pictures that a job leaves.

use exr::prelude::{ReadChannels, ReadLayers};
use lightshaft_compare::{Comparison, Image, Options, compare};

/// Decodes a PNG as sRGB.
///
/// # Panics
/// When it is no PNG.
pub fn png(bytes: &[u8]) -> Image {
    let picture = image::load_from_memory_with_format(bytes, image::ImageFormat::Png).expect("a PNG").into_rgb8();
    Image::from_srgb8(picture.width() as usize, picture.height() as usize, picture.as_raw()).expect("a picture")
}

/// Decodes the colour channels of an OpenEXR file's first layer that has them; linear.
///
/// # Panics
/// When it has none, or is no EXR.
pub fn exr(bytes: &[u8]) -> Image {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| (size.width(), vec![[0.0_f32; 3]; size.area()]),
            |(width, pixels), at, (r, g, b): (f32, f32, f32)| pixels[at.y() * *width + at.x()] = [r, g, b],
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(std::io::Cursor::new(bytes))
        .expect("an EXR with R, G and B");
    let size = image.layer_data.size;
    Image::new(size.width(), size.height(), image.layer_data.channel_data.pixels.1).expect("a picture")
}

/// Mean of all channels.
pub fn mean(image: &Image) -> f64 {
    let sum: f64 = image.pixels().iter().flatten().map(|&c| f64::from(c)).sum();
    sum / (3 * image.pixels().len()) as f64
}

/// Whether it shows something: neither black nor of one colour.
pub fn shows_something(image: &Image) -> bool {
    let first = image.pixels()[0];
    mean(image) > 0.01 && image.pixels().iter().any(|pixel| *pixel != first)
}

/// # Panics
/// When the sizes differ.
pub fn against(reference: &Image, test: &Image) -> Comparison {
    compare(reference, test, &Options::default()).expect("pictures of one size")
}
