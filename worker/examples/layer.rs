//! A layer of a rendered EXR as a PNG:
//! `cargo run --release -p lightshaft-worker --example layer -- image.exr LAYER out.png [MOST]`.
//!
//! Layers of three channels are shown as they are; of counts and numbers 0 is black and `MOST` (the largest there is, when
//! left out) the brightest of the colours of error maps.

use lightshaft_compare::{Plane, heat_map};
use lightshaft_engine::film::{AovLayer, ExrLayers, encode_png_srgb8};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, name, out, most @ ..] = &arguments[..] else {
        return Err("usage: layer FILE.exr LAYER OUT.png [MOST]".into());
    };
    let bytes = std::fs::read(file)?;
    let layers = ExrLayers::open(&bytes, 1 << 26)?;
    let index = layers.layers().iter().position(|layer| layer.name == *name);
    let values = match layers.read(index.ok_or_else(|| format!("{file} has no layer {name}"))?)? {
        AovLayer::Vector(colors) => {
            let byte = |value: f32| (255.0 * value.clamp(0.0, 1.0)).round() as u8;
            let rgb: Vec<u8> = colors.iter().flatten().map(|&value| byte(value)).collect();
            return write(out, &layers, &rgb);
        }
        AovLayer::Scalar(values) => values,
        AovLayer::Integer(values) => values.into_iter().map(|value| value as f32).collect(),
    };
    let most = match most {
        [most] => most.parse()?,
        _ => values.iter().copied().filter(|value| value.is_finite()).fold(f32::MIN_POSITIVE, f32::max),
    };
    println!("{name}: {most} is the brightest");
    let shares = values.iter().map(|value| value / most).collect();
    write(out, &layers, &heat_map(&Plane::new(layers.width(), layers.height(), shares)))
}

fn write(out: &str, layers: &ExrLayers<'_>, rgb: &[u8]) -> Result<(), Box<dyn std::error::Error>> {
    Ok(std::fs::write(out, encode_png_srgb8(layers.width() as u32, layers.height() as u32, rgb, &[])?)?)
}
