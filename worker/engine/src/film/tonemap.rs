//! From linear radiance to display colours.

use glam::Vec3;

/// How unbounded linear Rec. 709 radiance is brought into a display's range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ToneMap {
    /// Khronos PBR Neutral (Khronos 2024): keeps the colours of lit base colours up to 0.8, compresses above.
    #[default]
    PbrNeutral,
    /// AgX (Sobotka) with the contrast curve as a polynomial (Wrensch 2023), working in Rec. 2020.
    Agx,
    /// Clamps to 0..1.
    None,
}

impl ToneMap {
    /// Linear display colour, 0..1, of `radiance * 2^exposure_stops`. What is not a number becomes black.
    pub fn apply(self, radiance: [f32; 3], exposure_stops: f32) -> [f32; 3] {
        let scale = exposure_stops.exp2();
        let clean = radiance.map(|c| if c.is_nan() { 0.0 } else { (c * scale).clamp(0.0, 1e30) });
        let mapped = match self {
            Self::PbrNeutral => pbr_neutral(clean),
            Self::Agx => agx(clean),
            Self::None => clean,
        };
        mapped.map(|c| c.clamp(0.0, 1.0))
    }
}

/// The reference function of KhronosGroup/ToneMapping.
fn pbr_neutral(color: [f32; 3]) -> [f32; 3] {
    const START: f32 = 0.8 - 0.04;
    const DESATURATION: f32 = 0.15;
    let least = color[0].min(color[1]).min(color[2]);
    let offset = if least < 0.08 { least - 6.25 * least * least } else { 0.04 };
    let color = color.map(|c| c - offset);
    let peak = color[0].max(color[1]).max(color[2]);
    if peak < START {
        return color;
    }
    let d = 1.0 - START;
    let new_peak = 1.0 - d * d / (peak + d - START);
    let g = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    color.map(|c| {
        let compressed = c * (new_peak / peak);
        compressed + (new_peak - compressed) * g
    })
}

fn agx(color: [f32; 3]) -> [f32; 3] {
    // Rows of each matrix.
    const TO_REC2020: [[f32; 3]; 3] = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0113], [0.0164, 0.0880, 0.8956]];
    const FROM_REC2020: [[f32; 3]; 3] =
        [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]];
    const INSET: [[f32; 3]; 3] = [
        [0.856_627_15, 0.095_121_24, 0.048_251_606],
        [0.137_318_97, 0.761_242, 0.101_439_04],
        [0.111_898_21, 0.076_799_42, 0.811_302_4],
    ];
    const OUTSET: [[f32; 3]; 3] = [
        [1.127_100_6, -0.110_606_64, -0.016_493_939],
        [-0.141_329_76, 1.157_823_7, -0.016_493_939],
        [-0.141_329_76, -0.110_606_64, 1.251_936_4],
    ];
    const MIN_EV: f32 = -12.473_93;
    const MAX_EV: f32 = 4.026_069;
    let log = multiply(&INSET, multiply(&TO_REC2020, color))
        .map(|c| ((c.max(1e-10).log2() - MIN_EV) / (MAX_EV - MIN_EV)).clamp(0.0, 1.0));
    let linear = multiply(&OUTSET, log.map(agx_contrast)).map(|c| c.max(0.0).powf(2.2));
    multiply(&FROM_REC2020, linear)
}

fn agx_contrast(x: f32) -> f32 {
    let x2 = x * x;
    let x4 = x2 * x2;
    15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.002_32
}

fn multiply(rows: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    rows.map(|r| Vec3::from_array(r).dot(Vec3::from_array(v)))
}

/// sRGB opto-electronic transfer function (IEC 61966-2-1) of a linear value in 0..1.
pub fn linear_to_srgb(c: f32) -> f32 {
    if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

/// sRGB-encoded 8-bit pixels, row-major.
pub fn to_srgb8(radiance: &[[f32; 3]], tone_map: ToneMap, exposure_stops: f32) -> Vec<u8> {
    radiance
        .iter()
        .flat_map(|&c| tone_map.apply(c, exposure_stops))
        .map(|c| (linear_to_srgb(c) * 255.0 + 0.5) as u8)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f32; 3], b: [f32; 3], tolerance: f32) {
        assert!(a.iter().zip(b).all(|(x, y)| (x - y).abs() < tolerance), "{a:?} but expected {b:?}");
    }

    #[test]
    fn pbr_neutral_golden_values() {
        let map = |c| ToneMap::PbrNeutral.apply(c, 0.0);
        close(map([0.0; 3]), [0.0; 3], 1e-7);
        // Below the toe's end F90 = 0.04 is taken off smoothly, above it wholly; below 0.8 nothing else happens.
        close(map([0.04; 3]), [0.01; 3], 1e-6);
        close(map([0.5, 0.3, 0.2]), [0.46, 0.26, 0.16], 1e-6);
        close(map([1.0; 3]), [0.869_090_9; 3], 1e-6);
        // Very bright colours approach white without passing it.
        let bright = map([1000.0, 10.0, 10.0]);
        assert!(bright[0] > 0.999 && bright[0] <= 1.0 && bright[1] > 0.98, "{bright:?}");
    }

    #[test]
    fn agx_golden_values() {
        let map = |c| ToneMap::Agx.apply(c, 0.0);
        // Middle grey stays near middle grey, neutral stays neutral, black is black.
        let grey = map([0.18; 3]);
        close(grey, [grey[1]; 3], 2e-3);
        assert!((0.17..0.22).contains(&grey[1]), "{grey:?}");
        close(map([0.0; 3]), [0.0; 3], 1e-3);
        let white = map([16.0; 3]);
        assert!(white.iter().all(|&c| c > 0.95), "{white:?}");
        // Pure strong red loses saturation.
        let red = map([8.0, 0.0, 0.0]);
        assert!(red[0] > 0.8 && red[1] > 0.05, "{red:?}");
    }

    #[test]
    fn exposure_counts_in_stops_and_none_clamps() {
        close(ToneMap::None.apply([0.25, 0.5, 0.75], 1.0), [0.5, 1.0, 1.0], 1e-6);
        close(ToneMap::None.apply([-1.0, f32::NAN, f32::INFINITY], 0.0), [0.0, 0.0, 1.0], 1e-6);
    }

    #[test]
    fn srgb_encoding_matches_the_standard_and_undoes_decoding() {
        assert_eq!(to_srgb8(&[[0.0, 0.214_041, 1.0]], ToneMap::None, 0.0), [0, 127, 255]);
        for byte in 0..=255u8 {
            let linear = crate::integrate::texture::srgb_to_linear(f32::from(byte) / 255.0);
            assert_eq!((linear_to_srgb(linear) * 255.0 + 0.5) as u8, byte);
        }
    }
}
