//! The packed scene on the device: bind groups 1 (arrays) and 3 (uniforms) of the shading stages.
//!
//! Storage bindings: one for all arrays of structs, one or more for geometry and lists of numbers, one or more for
//! texels. With the four of `paths.wgsl` a stage stays below [`super::REQUIRED_STORAGE_BUFFERS`] where each pool fits
//! one binding.

use bytemuck::{Pod, Zeroable};

use super::context::{Context, whole};
use super::pace::PixelOrder;
use super::pool::{Pool, PoolLayout};
use crate::device::{DeviceError, Region};
use crate::integrate::sampler::SOBOL;
use crate::integrate::texture::srgb_to_linear;
use crate::pack::{PackedCamera, PackedEnvironment, PackedScene};

/// Mirror of `SceneInfo` in `shaders/shared/scene.wgsl`: offsets of structs in 16-byte elements of the tables, the
/// others in words of their pool.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct SceneInfo {
    pub camera: PackedCamera,
    pub environment: PackedEnvironment,
    pub meshes: u32,
    pub instances: u32,
    pub materials: u32,
    pub textures: u32,
    pub lights: u32,
    pub positions: u32,
    pub triangles: u32,
    pub slots: u32,
    pub spheres: u32,
    pub attributes: u32,
    pub instance_materials: u32,
    pub light_cdf: u32,
    pub light_count: u32,
    pub emitter_lights: u32,
    pub ggx_albedo: u32,
    pub srgb: u32,
    pub sobol: u32,
    pub environment_texels: u32,
    pub environment_cdf: u32,
    pub _pad: u32,
}
const _: () = assert!(size_of::<SceneInfo>() == 176);

/// Mirror of `Wave` in `shaders/shared/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct Wave {
    pub region_x: u32,
    pub region_y: u32,
    pub region_width: u32,
    pub first_pixel: u32,
    pub pixels: u32,
    pub first_sample: u32,
    pub samples: u32,
    pub seed: u32,
    pub bounce: u32,
    pub max_bounces: u32,
    pub closest_number: u32,
    pub shadow_number: u32,
    pub ao_samples: u32,
    pub ao_index: u32,
    pub ao_distance: f32,
    pub infinity: u32,
    pub accumulated: u32,
    pub zero: u32,
    pub capacity: u32,
    pub active_queue: u32,
    pub run: u32,
    pub runs: u32,
    pub run_step: u32,
    pub _pad: u32,
}
const _: () = assert!(size_of::<Wave>() == 96);

impl Wave {
    /// Over a region's pixels from the `first` in its order on.
    pub(super) fn over(region: Region, first: u32) -> Self {
        let PixelOrder { run, runs, step } = PixelOrder::new(region.pixels() as u32);
        Self {
            region_x: region.x,
            region_y: region.y,
            region_width: region.width,
            first_pixel: first,
            infinity: f32::INFINITY.to_bits(),
            run,
            runs,
            run_step: step,
            ..Self::default()
        }
    }
}

pub(super) struct GpuScene {
    pub pools: [PoolLayout; 2],
    pub layout: wgpu::BindGroupLayout,
    pub group: wgpu::BindGroup,
    /// Storage buffers in the group.
    pub bindings: usize,
    pub uniform_layout: wgpu::BindGroupLayout,
    pub uniforms: wgpu::BindGroup,
    pub wave: wgpu::Buffer,
    pub bytes: u64,
}

impl GpuScene {
    pub(super) fn upload(context: &Context, scene: &PackedScene) -> Result<Self, DeviceError> {
        let srgb: Vec<f32> = (0..256u16).map(|byte| srgb_to_linear(f32::from(byte) * (1.0 / 255.0))).collect();
        let mut tables = Parts::of_elements(16);
        let mut geometry = Parts::of_elements(4);
        let mut texels = Parts::of_elements(4);
        let info = SceneInfo {
            camera: scene.camera,
            environment: scene.environment,
            meshes: tables.push(&scene.meshes)?,
            instances: tables.push(&scene.instances)?,
            materials: tables.push(&scene.materials)?,
            textures: tables.push(&scene.textures)?,
            lights: tables.push(&scene.lights)?,
            positions: geometry.push(&scene.positions)?,
            triangles: geometry.push(&scene.triangles)?,
            slots: geometry.push(&scene.slots)?,
            spheres: geometry.push(&scene.spheres)?,
            attributes: geometry.push(&scene.attributes)?,
            instance_materials: geometry.push(&scene.instance_materials)?,
            light_cdf: geometry.push(&scene.light_cdf)?,
            light_count: scene.lights.len() as u32,
            emitter_lights: geometry.push(&scene.emitter_lights)?,
            ggx_albedo: geometry.push(&scene.ggx_albedo)?,
            srgb: geometry.push(&srgb)?,
            sobol: geometry.push(&SOBOL)?,
            // Texture texels come first, so that `PackedTexture::texel_offset` needs no base.
            environment_texels: {
                texels.push(&scene.texels)?;
                texels.push(&scene.environment_texels)?
            },
            environment_cdf: texels.push(&scene.environment_cdf)?,
            _pad: 0,
        };
        context.check_binding("the scene's tables", tables.bytes())?;
        let table_buffer = context.upload("tables", &tables.parts.concat())?;
        let words = Pool::upload(context, "words", "u32", (1, 1), 4, &geometry.parts)?;
        let texels = Pool::upload(context, "texels", "u32", (1, 5), 4, &texels.parts)?;
        let bytes = tables.bytes() + words.bytes + texels.bytes;
        let entries: Vec<_> =
            std::iter::once(wgpu::BindGroupEntry { binding: 0, resource: table_buffer.as_entire_binding() })
                .chain(words.entries())
                .chain(texels.entries())
                .collect();
        let bindings = entries.len();
        let (layout, group) = context.bind_storage("scene", &entries, true);
        let info = context.uniform("scene info", bytemuck::bytes_of(&info))?;
        let wave = context.uniform("wave", bytemuck::bytes_of(&Wave::default()))?;
        let (uniform_layout, uniforms) = context.bind_uniforms("uniforms", &[whole(&info), whole(&wave)]);
        Ok(Self {
            pools: [words.layout, texels.layout],
            layout,
            group,
            bindings,
            uniform_layout,
            uniforms,
            wave,
            bytes,
        })
    }
}

/// Arrays that follow each other in one buffer, each at a multiple of the buffer's element.
struct Parts<'a> {
    parts: Vec<&'a [u8]>,
    element_bytes: u64,
    elements: u64,
}

impl<'a> Parts<'a> {
    fn of_elements(element_bytes: u64) -> Self {
        Self { parts: Vec::new(), element_bytes, elements: 0 }
    }

    fn bytes(&self) -> u64 {
        self.elements * self.element_bytes
    }

    /// The array's offset in elements, of which each of its items is a multiple.
    fn push<T: Pod>(&mut self, array: &'a [T]) -> Result<u32, DeviceError> {
        let bytes: &[u8] = bytemuck::cast_slice(array);
        let offset = u32::try_from(self.elements)
            .map_err(|_| DeviceError::TooLarge("the scene's arrays exceed what 32 bits can number".to_owned()))?;
        self.elements += bytes.len() as u64 / self.element_bytes;
        self.parts.push(bytes);
        Ok(offset)
    }
}
