//! KHR_materials_pbrSpecularGlossiness (archived): older exports carry their colours in it and nowhere else.
//!
//! Such a material is a dielectric whose reflectance has a colour. It is put where the metallic-roughness description
//! would be: diffuse as base colour without metal, specular as the dielectric's reflectance, and its texture in the place
//! of the metallic-roughness one. A material that has a metallic-roughness description beside it keeps that one.

use serde::Deserialize;

use super::document::{Material, MetallicRoughness, TextureInfo};

/// Where a material's two textures stand in the file.
pub(super) const TEXTURES: [&str; 2] = [
    "extensions/KHR_materials_pbrSpecularGlossiness/diffuseTexture",
    "extensions/KHR_materials_pbrSpecularGlossiness/specularGlossinessTexture",
];

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

/// Describes a material that only has a specular-glossiness description in the other one's terms.
pub(super) fn convert(material: &mut Material) {
    if material.pbr_metallic_roughness != MetallicRoughness::default() {
        return;
    }
    let Some(source) = material.extensions.specular_glossiness.take() else { return };
    material.pbr_metallic_roughness = MetallicRoughness {
        base_color_factor: source.diffuse_factor,
        base_color_texture: source.diffuse_texture,
        metallic_factor: 0.0,
        roughness_factor: 1.0 - source.glossiness_factor,
        metallic_roughness_texture: source.specular_glossiness_texture,
        specular_factor: Some(source.specular_factor),
    };
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
    fn specular_and_glossiness_become_a_dielectric() {
        let result = converted(
            r#"{"extensions": {"KHR_materials_pbrSpecularGlossiness":
                {"diffuseFactor": [0.8, 0.1, 0.2, 0.5], "specularFactor": [0.5, 0.25, 0], "glossinessFactor": 0.25,
                 "diffuseTexture": {"index": 3}, "specularGlossinessTexture": {"index": 4, "texCoord": 1}}}}"#,
        );
        assert_eq!((result.metallic_factor, result.roughness_factor), (0.0, 0.75));
        assert_eq!((result.base_color_factor, result.specular_factor), ([0.8, 0.1, 0.2, 0.5], Some([0.5, 0.25, 0.0])));
        let texture = result.metallic_roughness_texture.expect("the extension's texture");
        assert_eq!((result.base_color_texture.map(|t| t.index), texture.index, texture.tex_coord), (Some(3), 4, 1));
    }

    #[test]
    fn what_is_left_out_is_white_and_smooth() {
        let result = converted(r#"{"extensions": {"KHR_materials_pbrSpecularGlossiness": {}}}"#);
        assert_eq!((result.base_color_factor, result.specular_factor), ([1.0; 4], Some([1.0; 3])));
        assert_eq!((result.metallic_factor, result.roughness_factor), (0.0, 0.0));
    }

    #[test]
    fn a_metallic_roughness_description_wins() {
        let result = converted(
            r#"{"pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 1]},
                "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [1, 0, 0, 1]}}}"#,
        );
        assert_eq!((result.base_color_factor, result.specular_factor), ([0.1, 0.2, 0.3, 1.0], None));
    }
}
