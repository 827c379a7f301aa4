//! Textures of generated scenes, painted here and encoded as PNG.

use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

use super::rng::Rng;

/// Paints `width` x `height` pixels; `paint` gets (u, v) at the pixel's centre, v pointing down, and answers sRGB and alpha.
fn png(width: u32, height: u32, mut paint: impl FnMut(f32, f32) -> [f32; 4]) -> Vec<u8> {
    let mut pixels = Vec::with_capacity((width * height * 4) as usize);
    for y in 0..height {
        for x in 0..width {
            let color = paint((x as f32 + 0.5) / width as f32, (y as f32 + 0.5) / height as f32);
            pixels.extend(color.map(|channel| (channel.clamp(0.0, 1.0) * 255.0).round() as u8));
        }
    }
    let mut file = Vec::new();
    // Writing to memory fails only for sizes that do not fit the pixels.
    let written = PngEncoder::new(&mut file).write_image(&pixels, width, height, ExtendedColorType::Rgba8);
    debug_assert!(written.is_ok());
    file
}

/// One leaf, tip up, on nothing.
pub(super) fn leaf() -> Vec<u8> {
    png(128, 128, |u, v| {
        let (x, y) = ((u - 0.5) * 2.0, v);
        // The outline swells from the tip (v = 0) and narrows to a stalk.
        let width = 0.78 * (std::f32::consts::PI * y.powf(0.8)).sin().max(0.0).powf(0.9) * (1.0 - 0.25 * y);
        let stalk = if y > 0.8 { 0.05 } else { 0.0 };
        let inside = x.abs() < width.max(stalk);
        let rib = (1.0 - (x.abs() * 14.0).min(1.0)) * 0.16;
        let vein = ((y * 9.0 + x.abs() * 4.5).fract() - 0.5).abs();
        let vein = if vein < 0.06 { 0.05 } else { 0.0 };
        let shade = 0.85 + 0.3 * (1.0 - y) - 0.12 * x.abs();
        [(0.24 + rib + vein) * shade, (0.46 + rib + vein) * shade, (0.14 + rib) * shade, if inside { 1.0 } else { 0.0 }]
    })
}

/// Terrazzo tiles: a 2 x 2 patch that repeats, with chips in the stone and darker joints.
pub(super) fn tiles(seed: u64) -> Vec<u8> {
    const SIZE: usize = 512;
    let mut rng = Rng::new(seed, 7);
    let chips: Vec<(f32, f32, f32, f32, [f32; 3])> = (0..420)
        .map(|_| {
            let palette =
                [[0.62, 0.45, 0.36], [0.36, 0.40, 0.42], [0.80, 0.74, 0.62], [0.45, 0.33, 0.28], [0.9, 0.88, 0.84]];
            (rng.unit(), rng.unit(), rng.range(0.004, 0.014), rng.range(0.0, 6.3), palette[rng.below(palette.len())])
        })
        .collect();
    let grain: Vec<f32> = (0..SIZE * SIZE).map(|_| rng.range(-0.018, 0.018)).collect();
    png(SIZE as u32, SIZE as u32, |u, v| {
        let (tile_u, tile_v) = ((u * 2.0).fract(), (v * 2.0).fract());
        let edge = tile_u.min(1.0 - tile_u).min(tile_v).min(1.0 - tile_v);
        if edge < 0.012 {
            return [0.42, 0.40, 0.38, 1.0];
        }
        let parity = ((u * 2.0) as i32 + (v * 2.0) as i32) % 2;
        let base = if parity == 0 { [0.76, 0.73, 0.68] } else { [0.70, 0.68, 0.65] };
        let chip = chips.iter().find(|(x, y, radius, turn, _)| {
            let (dx, dy) = (u - x, v - y);
            let (a, b) = (dx * turn.cos() + dy * turn.sin(), dy * turn.cos() - dx * turn.sin());
            a.abs() + b.abs() * 1.7 < *radius
        });
        let color = chip.map_or(base, |(.., color)| *color);
        let noise = grain[((v * SIZE as f32) as usize * SIZE + (u * SIZE as f32) as usize).min(SIZE * SIZE - 1)];
        [color[0] + noise, color[1] + noise, color[2] + noise, 1.0]
    })
}

/// Bands of glaze for a vase, from the foot (v = 1) to the lip.
pub(super) fn glaze() -> Vec<u8> {
    png(256, 256, |u, v| {
        let wave = 0.012 * (u * std::f32::consts::TAU * 8.0).sin();
        let height = 1.0 - v + wave;
        let cream = [0.90, 0.86, 0.77];
        let blue = [0.10, 0.22, 0.44];
        let rust = [0.66, 0.28, 0.16];
        let scallop = ((u * 16.0).fract() - 0.5).abs() * 0.10;
        let color = match height {
            h if h < 0.12 => blue,
            h if h < 0.15 => cream,
            h if h < 0.18 => rust,
            h if h > 0.42 - scallop && h < 0.52 + scallop => blue,
            h if h > 0.455 + 0.5 * scallop && h < 0.6 => cream,
            h if h > 0.66 && h < 0.69 => rust,
            h if h > 0.88 => blue,
            _ => cream,
        };
        [color[0], color[1], color[2], 1.0]
    })
}
