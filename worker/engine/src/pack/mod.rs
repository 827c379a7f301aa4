//! The packed scene: one set of flat arrays that the CPU shades from and the GPU uploads as they are.
//!
//! Both devices read the same numbers with the same arithmetic, so that their pictures agree. Every struct here has a
//! mirror in `shaders/shared/scene.wgsl`; a test compares sizes and offsets with naga's layout.

mod environment;
mod geometry;
mod ggx_table;
mod layout;
mod light_sizes;
mod lights;
mod materials;
mod overlay;

pub use ggx_table::GGX_TABLE_SIZE;
pub use layout::*;
pub use overlay::{placements, with_overlays};

use std::sync::Arc;

use crate::accel::SceneAccel;
use crate::integrate::camera::pack_camera;
use crate::scene::{Aabb, Scene};
use crate::settings::RenderSettings;

/// Everything a device needs to trace and shade one scene under one job's lights.
#[derive(Debug)]
pub struct PackedScene {
    pub meshes: Vec<PackedMesh>,
    pub instances: Vec<PackedInstance>,
    /// Object-space vertex positions of all meshes, one after the other.
    pub positions: Vec<[f32; 3]>,
    /// Vertex numbers relative to the mesh's `position_offset`.
    pub triangles: Vec<[u32; 3]>,
    /// Material slot of every primitive: per mesh first its triangles, then its spheres.
    pub slots: Vec<u32>,
    /// Centre and radius.
    pub spheres: Vec<[f32; 4]>,
    /// Normals, tangents, UVs and colours; each mesh's arrays start where its [`PackedMesh`] says.
    pub attributes: Vec<f32>,
    /// Material of slot `s` of an instance: `instance_materials[instance.material_base + s]`.
    pub instance_materials: Vec<u32>,
    pub materials: Vec<PackedMaterial>,
    pub textures: Vec<PackedTexture>,
    /// RGBA8 texels of all images, red in the low byte.
    pub texels: Vec<u32>,
    pub lights: Vec<PackedLight>,
    /// For each light the last of all 32-bit numbers that selects it; increases, up to `u32::MAX`.
    pub light_cdf: Vec<u32>,
    /// For each light its size in world units: see [`light_sizes`]. No device but the CPU asks.
    pub light_sizes: Vec<f32>,
    /// Light number of each primitive of instances that emit: `emitter_lights[instance.emitter_base + primitive]`.
    pub emitter_lights: Vec<u32>,
    pub environment: PackedEnvironment,
    /// Linear radiance of the environment map, `width * height` texels; empty for a constant environment.
    pub environment_texels: Vec<[f32; 4]>,
    /// Inclusive cumulative probabilities of the rows (`height`), then of the texels in each row (`width * height`).
    pub environment_cdf: Vec<f32>,
    /// Directional albedo of the GGX lobe, for energy compensation (layout: see `ggx_table.rs`).
    pub ggx_albedo: Vec<f32>,
    pub bounds: Aabb,
    pub camera: PackedCamera,
    pub accel: Arc<SceneAccel>,
}

#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// An array would outgrow the 32-bit numbers that both devices index with.
    #[error("the scene has {count} {what}, more than the {limit} that a device can address")]
    TooLarge { what: &'static str, count: u64, limit: u64 },
    /// The scene contradicts itself; import never makes such a one.
    #[error("{0}")]
    InvalidScene(String),
    /// A setting that no picture can be made from.
    #[error("{field}: {detail}")]
    InvalidSetting { field: &'static str, detail: String },
}

/// `count` as a 32-bit number below [`NONE`].
fn index(what: &'static str, count: usize) -> Result<u32, PackError> {
    u32::try_from(count).ok().filter(|&n| n < NONE).ok_or(PackError::TooLarge {
        what,
        count: count as u64,
        limit: u64::from(NONE) - 1,
    })
}

/// Flattens `scene` (made by [`with_overlays`], so that the ground is in it) and the lights of `settings`.
///
/// `accel` must be built over `scene.meshes` and [`placements`] of the same scene. Takes time and memory in proportion
/// to the scene; the structures are shared, not copied.
pub fn pack(scene: &Scene, settings: &RenderSettings, accel: Arc<SceneAccel>) -> Result<PackedScene, PackError> {
    if settings.width == 0 || settings.height == 0 {
        let detail = format!("is {}x{}, must be at least 1x1 pixel", settings.width, settings.height);
        return Err(PackError::InvalidSetting { field: "width, height", detail });
    }
    let geometry = geometry::pack_geometry(scene)?;
    let materials = materials::pack_materials(scene)?;
    let environment = environment::pack_environment(&settings.environment)?;
    let mut packed = PackedScene {
        meshes: geometry.meshes,
        instances: geometry.instances,
        positions: geometry.positions,
        triangles: geometry.triangles,
        slots: geometry.slots,
        spheres: geometry.spheres,
        attributes: geometry.attributes,
        instance_materials: geometry.instance_materials,
        materials: materials.materials,
        textures: materials.textures,
        texels: materials.texels,
        lights: Vec::new(),
        light_cdf: Vec::new(),
        light_sizes: Vec::new(),
        emitter_lights: Vec::new(),
        environment: environment.header,
        environment_texels: environment.texels,
        environment_cdf: environment.cdf,
        ggx_albedo: ggx_table::ggx_albedo().to_vec(),
        bounds: geometry.bounds,
        camera: pack_camera(&settings.camera, settings.width, settings.height),
        accel,
    };
    let punctual = scene.lights.iter().chain(&settings.extra_lights);
    let radius = radius(overlay::own_bounds(scene, settings));
    lights::pack_lights(&mut packed, punctual, environment.mean_radiance, radius)?;
    packed.light_sizes = light_sizes::light_sizes(&packed);
    Ok(packed)
}

/// Radius of the sphere around `bounds`, at least the smallest positive number.
fn radius(bounds: Aabb) -> f32 {
    if bounds.is_empty() { 1.0 } else { (0.5 * bounds.extent()).length().max(f32::MIN_POSITIVE) }
}

#[cfg(test)]
mod tests {
    use glam::{Affine3A, Vec3};

    use super::*;
    use crate::integrate::tests::{camera, matte, scene, settings, square};
    use crate::scene::{Image, Texture, TextureRef};
    use crate::settings::Integrator;

    fn error(change: impl Fn(&mut Scene, &mut RenderSettings)) -> String {
        let mut scene = scene(vec![(square(), matte(0.5, 1.0), Affine3A::IDENTITY)]);
        let mut settings = settings(Integrator::Direct, camera(Vec3::ZERO, Vec3::Z, 3.0, 1.0), 0.0);
        change(&mut scene, &mut settings);
        let accel = SceneAccel::build(Vec::<crate::accel::Structure>::new(), &[]);
        pack(&scene, &settings, Arc::new(accel)).map(|_| ()).expect_err("must be refused").to_string()
    }

    #[test]
    fn contradictions_are_named() {
        assert_eq!(error(|_, s| s.width = 0), "width, height: is 0x32, must be at least 1x1 pixel");
        let e = error(|s, _| s.instances[0].materials = [7].into());
        assert_eq!(e, "instance 0 (\"\"): names material 7 of 1");
        let e = error(|s, _| s.instances[0].materials = [].into());
        assert_eq!(e, "instance 0 (\"\"): has materials for 0 of the mesh's 1 slots");
        let e = error(|s, _| Arc::make_mut(&mut s.meshes[0]).triangle_slots[1] = 1);
        assert_eq!(e, "mesh \"\": names slot 1 of 1");
        let e = error(|s, _| Arc::make_mut(&mut s.meshes[0]).triangles[1][2] = 4);
        assert_eq!(e, "mesh \"\": triangle 1 names a vertex beyond the 4 there are");
        let e = error(|s, _| Arc::make_mut(&mut s.meshes[0]).normals = vec![Vec3::Z]);
        assert_eq!(e, "mesh \"\": normals are 1 for 4 vertices");
        let used = Some(TextureRef { texture: 3, uv_set: 0, transform: TextureRef::IDENTITY });
        let e = error(|s, _| s.materials[0].normal_texture = used);
        assert_eq!(e, "material \"\": names texture 3 of 0");
        let e = error(|_, s| s.environment = crate::settings::Environment::Constant(Vec3::splat(f32::NAN)));
        assert_eq!(e, "environment: radiance is [NaN, NaN, NaN], must be finite and not negative");
    }

    #[test]
    fn images_are_stored_once_however_often_they_are_used() {
        let used = Some(TextureRef { texture: 0, uv_set: 0, transform: TextureRef::IDENTITY });
        let material = crate::scene::Material {
            base_color_texture: used,
            emissive_texture: used,
            metallic_roughness_texture: used,
            ..matte(0.5, 1.0)
        };
        let mut scene = scene(vec![(square(), material, Affine3A::IDENTITY)]);
        let rgba8 = vec![1, 2, 3, 4, 5, 6, 7, 8];
        scene.images.push(Arc::new(Image { name: String::new(), width: 2, height: 1, rgba8 }));
        let wrap = Default::default();
        scene.textures.push(Texture { image: 0, wrap_u: wrap, wrap_v: wrap, filter: Default::default() });
        let packed = materials::pack_materials(&scene).expect("consistent");
        assert_eq!(packed.texels, [0x0403_0201, 0x0807_0605]);
        // Two uses: decoded from sRGB and not.
        assert_eq!(packed.textures.len(), 2);
        assert_eq!(packed.materials[0].base_color_texture, packed.materials[0].emissive_texture);
    }
}
