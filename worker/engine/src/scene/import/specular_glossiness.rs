//! KHR_materials_pbrSpecularGlossiness (archived): older exports carry their colours in it and nowhere else.
//!
//! Such a material is turned into the metallic-roughness one that reflects nearly the same, by the conversion that the
//! Khronos group published with the extension: the metalness is solved for from the brightness of both colours. With
//! textures the specular part would have to be solved for per texel; it is left out, and the diffuse texture stays.
//! A material that has a metallic-roughness description beside it keeps that one.

use serde::Deserialize;

use super::document::{Material, MetallicRoughness, TextureInfo};

pub(super) const NAME: &str = "KHR_materials_pbrSpecularGlossiness";

/// Reflectance of a dielectric at normal incidence.
const DIELECTRIC: f32 = 0.04;
/// Of a textured material, whose glossiness is in the texture that is left out.
const TEXTURED_ROUGHNESS: f32 = 0.5;

#[derive(Debug, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct SpecularGlossiness {
    diffuse_factor: [f32; 4],
    diffuse_texture: Option<TextureInfo>,
    specular_factor: [f32; 3],
    glossiness_factor: f32,
    specular_glossiness_texture: Option<TextureInfo>,
}

impl Default for SpecularGlossiness {
    fn default() -> Self {
        Self {
            diffuse_factor: [1.0; 4],
            diffuse_texture: None,
            specular_factor: [1.0; 3],
            glossiness_factor: 1.0,
            specular_glossiness_texture: None,
        }
    }
}

/// Puts a metallic-roughness description into a material that only has a specular-glossiness one.
pub(super) fn convert(material: &mut Material) {
    if material.pbr_metallic_roughness != MetallicRoughness::default() {
        return;
    }
    if let Some(source) = material.extensions.specular_glossiness.take() {
        material.pbr_metallic_roughness = metallic_roughness(source);
    }
}

fn metallic_roughness(source: SpecularGlossiness) -> MetallicRoughness {
    if source.diffuse_texture.is_some() || source.specular_glossiness_texture.is_some() {
        let roughness = if source.specular_glossiness_texture.is_some() {
            TEXTURED_ROUGHNESS
        } else {
            1.0 - source.glossiness_factor
        };
        return MetallicRoughness {
            base_color_factor: source.diffuse_factor,
            base_color_texture: source.diffuse_texture,
            metallic_factor: 0.0,
            roughness_factor: roughness,
            metallic_roughness_texture: None,
        };
    }
    let [red, green, blue, alpha] = source.diffuse_factor;
    let diffuse = [red, green, blue];
    let specular = source.specular_factor;
    let transmitted = 1.0 - specular.into_iter().fold(0.0, f32::max);
    let metallic = solve_metallic(brightness(diffuse), brightness(specular), transmitted);
    let mut base_color = [0.0, 0.0, 0.0, alpha];
    for channel in 0..3 {
        let of_dielectric = diffuse[channel] * transmitted / ((1.0 - DIELECTRIC) * (1.0 - metallic).max(1e-6));
        let of_metal = (specular[channel] - DIELECTRIC * (1.0 - metallic)) / metallic.max(1e-6);
        let share = metallic * metallic;
        base_color[channel] = (of_dielectric * (1.0 - share) + of_metal * share).clamp(0.0, 1.0);
    }
    MetallicRoughness {
        base_color_factor: base_color,
        base_color_texture: None,
        metallic_factor: metallic,
        roughness_factor: 1.0 - source.glossiness_factor,
        metallic_roughness_texture: None,
    }
}

fn solve_metallic(diffuse: f32, specular: f32, transmitted: f32) -> f32 {
    if specular < DIELECTRIC {
        return 0.0;
    }
    let b = diffuse * transmitted / (1.0 - DIELECTRIC) + specular - 2.0 * DIELECTRIC;
    let c = DIELECTRIC - specular;
    let discriminant = (b * b - 4.0 * DIELECTRIC * c).max(0.0);
    ((-b + discriminant.sqrt()) / (2.0 * DIELECTRIC)).clamp(0.0, 1.0)
}

/// Perceived brightness (the HSP model's weights).
fn brightness([red, green, blue]: [f32; 3]) -> f32 {
    (0.299 * red * red + 0.587 * green * green + 0.114 * blue * blue).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn converted(json: &str) -> MetallicRoughness {
        let mut material: Material = serde_json::from_str(json).unwrap();
        convert(&mut material);
        material.pbr_metallic_roughness
    }

    #[test]
    fn a_matt_colour_stays_that_colour() {
        let result = converted(
            r#"{"extensions": {"KHR_materials_pbrSpecularGlossiness":
                {"diffuseFactor": [0.8, 0.1, 0.2, 0.5], "specularFactor": [0, 0, 0], "glossinessFactor": 0.25}}}"#,
        );
        assert_eq!((result.metallic_factor, result.roughness_factor), (0.0, 0.75));
        for (got, expected) in result.base_color_factor.into_iter().zip([0.8 / 0.96, 0.1 / 0.96, 0.2 / 0.96, 0.5]) {
            assert!((got - expected).abs() < 1e-6, "{got} for {expected}");
        }
    }

    #[test]
    fn a_coloured_reflection_without_diffuse_is_a_metal() {
        let result = converted(
            r#"{"extensions": {"KHR_materials_pbrSpecularGlossiness":
                {"diffuseFactor": [0, 0, 0, 1], "specularFactor": [1.0, 0.77, 0.34], "glossinessFactor": 1}}}"#,
        );
        assert!(result.metallic_factor > 0.999, "{}", result.metallic_factor);
        assert!((result.base_color_factor[1] - 0.77).abs() < 1e-3, "{:?}", result.base_color_factor);
        assert_eq!(result.roughness_factor, 0.0);
    }

    #[test]
    fn a_metallic_roughness_description_wins() {
        let result = converted(
            r#"{"pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 1]},
                "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [1, 0, 0, 1]}}}"#,
        );
        assert_eq!(result.base_color_factor, [0.1, 0.2, 0.3, 1.0]);
    }
}
