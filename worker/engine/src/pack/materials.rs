//! Materials, the textures they use, and the texels behind them.

use std::collections::HashMap;

use super::{
    MATERIAL_ALPHA_BLEND, MATERIAL_ALPHA_MASK, MATERIAL_SPECULAR_GLOSSINESS, MATERIAL_UNLIT, NONE, PackError,
    PackedMaterial, PackedTexture, TEXTURE_NEAREST, TEXTURE_SRGB, TEXTURE_UV1, TEXTURE_WRAP_V_SHIFT, WRAP_CLAMP,
    WRAP_MIRRORED, WRAP_REPEAT, index,
};
use crate::scene::{AlphaMode, Filter, Image, Material, Scene, TextureRef, Wrap};

pub(super) struct Materials {
    pub materials: Vec<PackedMaterial>,
    pub textures: Vec<PackedTexture>,
    pub texels: Vec<u32>,
}

pub(super) fn pack_materials(scene: &Scene) -> Result<Materials, PackError> {
    let mut packer = Packer {
        scene,
        textures: Vec::new(),
        known: HashMap::new(),
        texels: Vec::new(),
        offsets: vec![None; scene.images.len()],
    };
    let materials = scene.materials.iter().map(|m| packer.material(m)).collect::<Result<_, _>>()?;
    Ok(Materials { materials, textures: packer.textures, texels: packer.texels })
}

struct Packer<'a> {
    scene: &'a Scene,
    textures: Vec<PackedTexture>,
    /// Number of each texture by its bits.
    known: HashMap<[u32; size_of::<PackedTexture>() / 4], u32>,
    texels: Vec<u32>,
    /// First texel of each image that some material uses.
    offsets: Vec<Option<u32>>,
}

impl Packer<'_> {
    fn material(&mut self, m: &Material) -> Result<PackedMaterial, PackError> {
        let mut flags = match m.alpha_mode {
            AlphaMode::Opaque => 0,
            AlphaMode::Mask => MATERIAL_ALPHA_MASK,
            AlphaMode::Blend => MATERIAL_ALPHA_BLEND,
        };
        if m.unlit {
            flags |= MATERIAL_UNLIT;
        }
        let mut roughness_encoding = 0;
        if m.specular_glossiness {
            flags |= MATERIAL_SPECULAR_GLOSSINESS;
            roughness_encoding = TEXTURE_SRGB;
        }
        Ok(PackedMaterial {
            base_color: m.base_color,
            emissive: m.emissive.to_array(),
            metallic: m.metallic,
            dielectric_f0: m.dielectric_f0.to_array(),
            roughness: m.roughness,
            normal_scale: m.normal_scale,
            alpha_cutoff: m.alpha_cutoff,
            flags,
            base_color_texture: self.texture(m, m.base_color_texture, TEXTURE_SRGB)?,
            metallic_roughness_texture: self.texture(m, m.metallic_roughness_texture, roughness_encoding)?,
            normal_texture: self.texture(m, m.normal_texture, 0)?,
            emissive_texture: self.texture(m, m.emissive_texture, TEXTURE_SRGB)?,
            _pad: 0,
        })
    }

    /// Adds one use of a texture; its texels are shared with all other uses of the image.
    fn texture(&mut self, material: &Material, used: Option<TextureRef>, flags: u32) -> Result<u32, PackError> {
        let Some(used) = used else { return Ok(NONE) };
        let invalid = |detail: String| PackError::InvalidScene(format!("material {:?}: {detail}", material.name));
        let scene = self.scene;
        let texture = scene
            .textures
            .get(used.texture as usize)
            .ok_or_else(|| invalid(format!("names texture {} of {}", used.texture, scene.textures.len())))?;
        let image = scene
            .images
            .get(texture.image as usize)
            .ok_or_else(|| invalid(format!("uses image {} of {}", texture.image, scene.images.len())))?;
        let texel_offset = match self.offsets[texture.image as usize] {
            Some(offset) => offset,
            None => self.image(image)?,
        };
        self.offsets[texture.image as usize] = Some(texel_offset);
        let mut flags = flags | wrap(texture.wrap_u) | wrap(texture.wrap_v) << TEXTURE_WRAP_V_SHIFT;
        if texture.filter == Filter::Nearest {
            flags |= TEXTURE_NEAREST;
        }
        if used.uv_set == 1 {
            flags |= TEXTURE_UV1;
        }
        let packed = PackedTexture {
            transform: used.transform,
            texel_offset,
            width: image.width,
            height: image.height,
            flags,
            _pad: [0; 2],
        };
        // Materials often share a texture: one entry per distinct use.
        let key = bytemuck::cast(packed);
        if let Some(known) = self.known.get(&key) {
            return Ok(*known);
        }
        let number = index("textures", self.textures.len())?;
        self.textures.push(packed);
        self.known.insert(key, number);
        Ok(number)
    }

    fn image(&mut self, image: &Image) -> Result<u32, PackError> {
        let pixels = image.width as usize * image.height as usize;
        if pixels == 0 || image.rgba8.len() != 4 * pixels {
            let (w, h, bytes) = (image.width, image.height, image.rgba8.len());
            return Err(PackError::InvalidScene(format!("image {:?}: {bytes} bytes for {w}x{h} pixels", image.name)));
        }
        let offset = index("texels", self.texels.len())?;
        self.texels.extend(image.rgba8.chunks_exact(4).map(|t| u32::from_le_bytes([t[0], t[1], t[2], t[3]])));
        index("texels", self.texels.len())?;
        Ok(offset)
    }
}

fn wrap(wrap: Wrap) -> u32 {
    match wrap {
        Wrap::Repeat => WRAP_REPEAT,
        Wrap::MirroredRepeat => WRAP_MIRRORED,
        Wrap::ClampToEdge => WRAP_CLAMP,
    }
}
