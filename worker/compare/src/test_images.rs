//! Deterministic images for the tests of this crate.

use crate::image::Image;

pub(crate) fn flat(width: usize, height: usize, color: [f32; 3]) -> Image {
    Image::new(width, height, vec![color; width * height]).unwrap()
}

/// Independent uniform values per channel (SplitMix64).
pub(crate) fn noise(width: usize, height: usize, seed: u64) -> Image {
    let mut state = seed;
    let mut next = move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1 << 24) as f32
    };
    Image::new(width, height, (0..width * height).map(|_| [next(), next(), next()]).collect()).unwrap()
}

/// A colour ramp with a hard-edged disc in it.
pub(crate) fn gradient(width: usize, height: usize) -> Image {
    let pixel = |i: usize| {
        let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        if (x - 0.4).hypot(y - 0.5) < 0.2 { [0.9, 0.2, 0.1] } else { [x, y, 1.0 - x] }
    };
    Image::new(width, height, (0..width * height).map(pixel).collect()).unwrap()
}

/// Moved right by whole pixels; the left border repeats.
pub(crate) fn shifted(image: &Image, by: usize) -> Image {
    let width = image.width();
    let pixels = image.pixels().chunks_exact(width).flat_map(|row| (0..width).map(|x| row[x.saturating_sub(by)]));
    Image::new(width, image.height(), pixels.collect()).unwrap()
}
