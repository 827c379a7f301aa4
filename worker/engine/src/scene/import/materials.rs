//! Materials, textures and samplers (glTF 2.0, 3.8 and 3.9; KHR_texture_transform, KHR_materials_emissive_strength,
//! KHR_materials_unlit).

use std::collections::HashMap;

use glam::Vec3;

use super::document::{self, Document, TextureInfo};
use super::images::Images;
use super::warnings::Warnings;
use crate::scene::error::{ImportError, Result};
use crate::scene::model::{AlphaMode, Filter, Material, Texture, TextureRef, Wrap};

/// All materials of the document, and the textures that they use.
pub(super) fn convert(
    document: &Document,
    images: &Images,
    warnings: &mut Warnings,
) -> Result<(Vec<Material>, Vec<Texture>)> {
    let occluded = document.materials.iter().filter(|material| material.occlusion_texture.is_some()).count();
    if occluded > 0 {
        // What it holds is how much of the surroundings a point sees: here rays find that out.
        warnings.add(
            "materials",
            format!("{occluded} have an occlusion texture, which light transport makes superfluous; ignored"),
        );
    }
    let mut converter = Converter { document, images, warnings, textures: Vec::new(), by_index: HashMap::new() };
    let materials: Result<Vec<Material>> =
        document.materials.iter().enumerate().map(|(index, source)| converter.material(index, source)).collect();
    Ok((materials?, converter.textures))
}

struct Converter<'a> {
    document: &'a Document,
    images: &'a Images,
    warnings: &'a mut Warnings,
    textures: Vec<Texture>,
    /// What each glTF texture became; `None` when its image could not be loaded.
    by_index: HashMap<usize, Option<u32>>,
}

impl Converter<'_> {
    fn material(&mut self, index: usize, source: &document::Material) -> Result<Material> {
        let at = format!("materials/{index}");
        let pbr = &source.pbr_metallic_roughness;
        let strength = source.extensions.emissive_strength.as_ref().map_or(1.0, |strength| strength.emissive_strength);
        let normal = source.normal_texture.as_ref();
        let material = Material {
            name: if source.name.is_empty() { format!("material {index}") } else { source.name.clone() },
            base_color: pbr.base_color_factor.map(|factor| factor.max(0.0)),
            base_color_texture: self.texture(&pbr.base_color_texture, &at, "baseColorTexture")?,
            metallic: pbr.metallic_factor.clamp(0.0, 1.0),
            roughness: pbr.roughness_factor.clamp(0.0, 1.0),
            metallic_roughness_texture: self.texture(
                &pbr.metallic_roughness_texture,
                &at,
                "metallicRoughnessTexture",
            )?,
            dielectric_f0: pbr
                .specular_factor
                .map_or(Vec3::splat(Material::DIELECTRIC_F0), |factor| Vec3::from(factor).clamp(Vec3::ZERO, Vec3::ONE)),
            specular_glossiness: pbr.specular_factor.is_some(),
            normal_texture: self.texture(&source.normal_texture, &at, "normalTexture")?,
            normal_scale: normal.and_then(|info| info.scale).unwrap_or(1.0),
            emissive: Vec3::from(source.emissive_factor).max(Vec3::ZERO) * strength.max(0.0),
            emissive_texture: self.texture(&source.emissive_texture, &at, "emissiveTexture")?,
            alpha_mode: match source.alpha_mode.as_deref() {
                None | Some("OPAQUE") => AlphaMode::Opaque,
                Some("MASK") => AlphaMode::Mask,
                Some("BLEND") => AlphaMode::Blend,
                Some(other) => {
                    let message = format!("{other:?} is not OPAQUE, MASK or BLEND; rendered opaque");
                    self.warnings.add(&format!("{at}/alphaMode"), message);
                    AlphaMode::Opaque
                }
            },
            alpha_cutoff: source.alpha_cutoff.unwrap_or(0.5),
            unlit: source.extensions.unlit.is_some(),
        };
        check_finite(&material, &at)?;
        Ok(material)
    }

    fn texture(&mut self, info: &Option<TextureInfo>, at: &str, field: &str) -> Result<Option<TextureRef>> {
        let Some(info) = info else { return Ok(None) };
        let at = format!("{at}/{field}");
        let transform = info.extensions.transform.as_ref();
        let uv_set = transform.and_then(|transform| transform.tex_coord).unwrap_or(info.tex_coord);
        if uv_set > 1 {
            let message = format!("{uv_set} is beyond the supported UV sets 0 and 1; rendered without this texture");
            self.warnings.add(&format!("{at}/texCoord"), message);
            return Ok(None);
        }
        let transform = transform.map_or(TextureRef::IDENTITY, uv_matrix);
        if !transform.as_flattened().iter().all(|entry| entry.is_finite()) {
            let at = format!("{at}/extensions/KHR_texture_transform");
            return Err(ImportError::malformed(at, "offset, rotation and scale must be finite"));
        }
        Ok(self.texture_index(info.index).map(|texture| TextureRef { texture, uv_set, transform }))
    }

    fn texture_index(&mut self, index: usize) -> Option<u32> {
        if let Some(known) = self.by_index.get(&index) {
            return *known;
        }
        let source = &self.document.textures[index];
        if source.source.is_none() {
            let message = "has no PNG or JPEG source; rendered without this texture";
            self.warnings.add(&format!("textures/{index}"), message);
        }
        let image = source.source.and_then(|image| self.images.by_index[image]);
        let converted = image.map(|image| {
            let texture = self.sampled(image, source.sampler);
            self.textures.push(texture);
            self.textures.len() as u32 - 1
        });
        self.by_index.insert(index, converted);
        converted
    }

    fn sampled(&mut self, image: u32, sampler: Option<usize>) -> Texture {
        let Some(index) = sampler else {
            return Texture { image, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, filter: Filter::Linear };
        };
        let sampler = &self.document.samplers[index];
        let mut wrap = |field: &str, value: Option<u32>| match value {
            None | Some(10497) => Wrap::Repeat,
            Some(33071) => Wrap::ClampToEdge,
            Some(33648) => Wrap::MirroredRepeat,
            Some(other) => {
                let message = format!("{other} is not 10497, 33071 or 33648; the texture repeats");
                self.warnings.add(&format!("samplers/{index}/{field}"), message);
                Wrap::Repeat
            }
        };
        let (wrap_u, wrap_v) = (wrap("wrapS", sampler.wrap_s), wrap("wrapT", sampler.wrap_t));
        let filter = if sampler.mag_filter == Some(9728) { Filter::Nearest } else { Filter::Linear };
        Texture { image, wrap_u, wrap_v, filter }
    }
}

/// Translation times rotation times scale. The rotation is counter-clockwise as seen with v pointing down, so that the
/// extension's own example (offset [0, 1], a quarter turn, scale 0.5) shows the lower left quadrant.
fn uv_matrix(transform: &document::TextureTransform) -> [[f32; 3]; 2] {
    let (sin, cos) = transform.rotation.sin_cos();
    let [scale_u, scale_v] = transform.scale;
    let [offset_u, offset_v] = transform.offset;
    [[cos * scale_u, sin * scale_v, offset_u], [-sin * scale_u, cos * scale_v, offset_v]]
}

/// JSON has no infinity, but a number beyond the range of f32 becomes one.
fn check_finite(material: &Material, at: &str) -> Result<()> {
    let fields = [
        ("pbrMetallicRoughness/baseColorFactor", material.base_color.iter().sum()),
        ("normalTexture/scale", material.normal_scale),
        ("emissiveFactor", material.emissive.element_sum()),
        ("alphaCutoff", material.alpha_cutoff),
    ];
    for (field, value) in fields {
        if !f32::is_finite(value) {
            return Err(ImportError::malformed(format!("{at}/{field}"), "must be finite"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apply(rows: [[f32; 3]; 2], u: f32, v: f32) -> [f32; 2] {
        rows.map(|[a, b, c]| a * u + b * v + c)
    }

    #[test]
    fn texture_transform_maps_the_extensions_own_examples() {
        let quarter = document::TextureTransform {
            offset: [0.0, 1.0],
            rotation: std::f32::consts::FRAC_PI_2,
            scale: [0.5, 0.5],
            tex_coord: None,
        };
        let matrix = uv_matrix(&quarter);
        for (uv, expected) in [([0.0, 0.0], [0.0, 1.0]), ([1.0, 0.0], [0.0, 0.5]), ([1.0, 1.0], [0.5, 0.5])] {
            let [u, v] = apply(matrix, uv[0], uv[1]);
            assert!((u - expected[0]).abs() < 1e-6 && (v - expected[1]).abs() < 1e-6, "{uv:?} -> {u}, {v}");
        }
        let flip = document::TextureTransform {
            offset: [0.0, 1.0],
            scale: [1.0, -1.0],
            ..document::TextureTransform::default()
        };
        assert_eq!(apply(uv_matrix(&flip), 0.25, 0.25), [0.25, 0.75]);
    }
}
