//! Means of LDR- and HDR-FLIP against NVIDIA's own implementation: the package `flip-evaluator`, whose figures for these
//! pairs are in `nvidia_flip.csv`. `nvidia_flip.py` made that table from the same formulas.

use lightshaft_compare::{Image, PIXELS_PER_DEGREE, flip, hdr_flip};

const WIDTH: usize = 112;
const HEIGHT: usize = 80;
const TABLE: &str = include_str!("nvidia_flip.csv");
/// Means agree at least to this.
const TOLERANCE: f64 = 1e-3;

type Color = [f64; 3];
type Picture = Vec<Color>;

#[test]
fn means_agree_with_nvidias_implementation() {
    let (mut worst, mut wrong) = (0.0_f64, Vec::new());
    let rows: Vec<Vec<&str>> = TABLE.lines().skip(1).map(|line| line.split(',').collect()).collect();
    for row in &rows {
        let [range, reference_name, change, mean, start, stop, count] = row[..] else { panic!("{row:?}") };
        let expected: f64 = mean.parse().unwrap();
        let reference = picture(reference_name);
        let test = changed(change, &reference);
        let found = match range {
            "ldr" => flip(&to_8_bits(&reference), &to_8_bits(&test), 0.0, PIXELS_PER_DEGREE).unwrap().mean(),
            "hdr" => {
                let found = hdr_flip(&linear(&reference), &linear(&test), PIXELS_PER_DEGREE).unwrap();
                let exposures = found.exposures;
                assert_eq!(exposures.count, count.parse::<u32>().unwrap(), "{row:?}");
                assert!((exposures.start - start.parse::<f32>().unwrap()).abs() < 1e-4, "{row:?}: {exposures:?}");
                assert!((exposures.stop - stop.parse::<f32>().unwrap()).abs() < 1e-4, "{row:?}: {exposures:?}");
                found.error.mean()
            }
            _ => panic!("{row:?}"),
        };
        let apart = (found - expected).abs();
        worst = worst.max(apart);
        if apart > TOLERANCE {
            wrong.push(format!("{range} {reference_name}, {change}: {found:.6} instead of {expected}"));
        }
    }
    println!("{} pairs, apart by {worst:.1e} at most", rows.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(rows.iter().filter(|row| row[0] == "hdr").count(), 21);
    assert_eq!(rows.iter().filter(|row| row[0] == "ldr").count(), 15);
}

/// As a PNG holds it.
fn to_8_bits(picture: &[Color]) -> Image {
    let bytes: Vec<u8> =
        picture.iter().flatten().map(|channel| (channel.clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8).collect();
    Image::from_srgb8(WIDTH, HEIGHT, &bytes).unwrap()
}

fn linear(picture: &[Color]) -> Image {
    let pixels = picture.iter().map(|pixel| pixel.map(|channel| channel as f32)).collect();
    Image::new(WIDTH, HEIGHT, pixels).unwrap()
}

/// A picture of a function of column and row, and of where the pixel's centre lies in a square from 0 to 1.
fn paint(color: impl Fn((usize, usize), (f64, f64)) -> Color) -> Picture {
    let at = |i: usize| (i % WIDTH, i / WIDTH);
    let place = |(x, y): (usize, usize)| ((x as f64 + 0.5) / WIDTH as f64, (y as f64 + 0.5) / HEIGHT as f64);
    (0..WIDTH * HEIGHT).map(|i| color(at(i), place(at(i)))).collect()
}

/// Independent uniform values per channel (SplitMix64 of a counter).
fn units(seed: u64) -> Picture {
    let unit = |index: u64| {
        let mut z = ((seed << 32) + 1 + index).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f64 / f64::from(1 << 24)
    };
    (0..(WIDTH * HEIGHT) as u64).map(|i| [0, 1, 2].map(|channel| unit(3 * i + channel))).collect()
}

fn picture(name: &str) -> Picture {
    let is_light = |(column, row): (usize, usize)| (column / 8 + row / 8).is_multiple_of(2);
    let within = |(x, y): (f64, f64), center: (f64, f64), radius: f64| (x - center.0).hypot(y - center.1) < radius;
    match name {
        "ramp" => paint(|_, (x, y)| if within((x, y), (0.4, 0.5), 0.2) { [0.9, 0.2, 0.1] } else { [x, y, 1.0 - x] }),
        "checks" => paint(|at, _| if is_light(at) { [0.8, 0.7, 0.2] } else { [0.2, 0.3, 0.6] }),
        "static" => units(1),
        "sky" => paint(|_, (x, y)| {
            let glow = 4.0 / (1.0 + 400.0 * ((x - 0.7).powi(2) + (y - 0.25).powi(2)));
            if y > 0.7 {
                [0.05 + 0.1 * x, 0.04, 0.02]
            } else if within((x, y), (0.7, 0.25), 0.06) {
                [1000.0, 900.0, 700.0]
            } else {
                [0.3 + 0.5 * y + glow, 0.5 + 0.4 * y + glow, 0.9 + glow]
            }
        }),
        "room" => paint(|at, (x, y)| {
            let lamps = [(0.2, 30.0), (0.5, 200.0), (0.8, 1000.0)];
            let lit = lamps.iter().find(|(lamp, _)| within((x, y), (*lamp, 0.3), 0.05));
            match lit {
                Some((_, brightness)) => [*brightness, 0.8 * brightness, 0.5 * brightness],
                None if y > 0.6 && is_light(at) => [0.2, 0.18, 0.15],
                None if y > 0.6 => [0.02, 0.02, 0.03],
                None => [0.01 + 0.05 * x, 0.03, 0.04],
            }
        }),
        "speckle" => units(1).into_iter().map(|pixel| pixel.map(|unit| 10.0_f64.powf(5.0 * unit - 2.0))).collect(),
        _ => panic!("no picture is called {name}"),
    }
}

fn changed(name: &str, picture: &[Color]) -> Picture {
    let pixel = |x: usize, y: usize| picture[y * WIDTH + x];
    let each = |change: &dyn Fn(f64) -> f64| picture.iter().map(|pixel| pixel.map(change)).collect();
    let shifted = |by: usize| paint(|(x, y), _| pixel(x.saturating_sub(by), y));
    match name {
        "shift 1" => shifted(1),
        "shift 5" => shifted(5),
        "blur" => paint(|(x, y), _| {
            let near = |at: usize, most: usize| [at.saturating_sub(1), at, (at + 1).min(most - 1)];
            let around = near(y, HEIGHT).into_iter().flat_map(|y| near(x, WIDTH).map(|x| pixel(x, y)));
            let sum = around.fold([0.0; 3], |sum, pixel| std::array::from_fn(|i| sum[i] + pixel[i]));
            sum.map(|channel| channel / 9.0)
        }),
        "brighter" => each(&|channel| channel * 1.1),
        "noise" => {
            let pairs = picture.iter().zip(units(2));
            pairs.map(|(pixel, unit)| std::array::from_fn(|i| pixel[i] * (0.8 + 0.4 * unit[i]))).collect()
        }
        "fireflies" => {
            let pairs = picture.iter().zip(units(3));
            pairs.map(|(&pixel, unit)| if unit[0] < 0.002 { [500.0; 3] } else { pixel }).collect()
        }
        "clipped" => each(&|channel| channel.min(1.0)),
        _ => panic!("no change is called {name}"),
    }
}
