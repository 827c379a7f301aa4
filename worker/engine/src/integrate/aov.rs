//! First-hit quantities: layers beside the picture, and the picture of the `aov` integrator.
//!
//! Layers look through pixel centres and see blended surfaces where their alpha is at least a half, so that they carry
//! no noise.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::alpha::{AlphaFilter, SEED_HALF};
use super::camera::camera_ray;
use super::surface::{hit_point, shade_point};
use super::{Sample, Tally, primary_ray};
use crate::film::AovLayer;
use crate::pack::{NONE, PackedScene};
use crate::settings::Aov;
use crate::trace::Counters;

/// All quantities of one pixel, in the layout of `shaders/first_hit.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct FirstHit {
    /// Vectors are zero on a miss.
    pub position: Vec3,
    /// Planar: the world-space distance from the camera along its forward axis, not along the ray, as compositors read
    /// `Z`; infinite on a miss.
    pub depth: f32,
    /// On the camera's side.
    pub geometric_normal: Vec3,
    /// Ids are [`NONE`] on a miss.
    pub instance: u32,
    pub shading_normal: Vec3,
    pub primitive: u32,
    /// Linear base colour.
    pub albedo: Vec3,
    pub material: u32,
    pub box_tests: u32,
    pub primitive_tests: u32,
    _pad: [u32; 2],
}
const _: () = assert!(size_of::<FirstHit>() == 80);

impl FirstHit {
    fn miss(counters: Counters) -> Self {
        Self {
            depth: f32::INFINITY,
            instance: NONE,
            primitive: NONE,
            material: NONE,
            box_tests: u32::try_from(counters.box_tests).unwrap_or(u32::MAX),
            primitive_tests: u32::try_from(counters.triangle_tests).unwrap_or(u32::MAX),
            ..Self::zeroed()
        }
    }

    /// Writes the quantity of one layer to its place `i`.
    pub(crate) fn store(&self, aov: Aov, layer: &mut AovLayer, i: usize) {
        match layer {
            AovLayer::Scalar(values) => values[i] = self.depth,
            AovLayer::Vector(values) => {
                values[i] = match aov {
                    Aov::Position => self.position,
                    Aov::GeometricNormal => self.geometric_normal,
                    Aov::ShadingNormal => self.shading_normal,
                    _ => self.albedo,
                }
                .to_array();
            }
            AovLayer::Integer(values) => {
                values[i] = match aov {
                    Aov::InstanceId => self.instance,
                    Aov::PrimitiveId => self.primitive,
                    Aov::MaterialId => self.material,
                    Aov::BoxTests => self.box_tests,
                    _ => self.primitive_tests,
                };
            }
        }
    }
}

/// What the ray through the centre of pixel `(x, y)` meets.
pub fn first_hit(scene: &PackedScene, x: u32, y: u32, tally: &mut Tally) -> FirstHit {
    let ray = camera_ray(&scene.camera, x, y, 0.5, 0.5);
    let mut counters = Counters::default();
    let hit = scene.accel.closest(&ray, &AlphaFilter { scene, seed: SEED_HALF }, &mut counters);
    tally.rays.primary += 1;
    tally.counters += counters;
    let mut out = FirstHit::miss(counters);
    if let Some(hit) = hit {
        let surface = shade_point(scene, &hit_point(scene, &ray, &hit), -ray.direction);
        out.depth = hit.t * ray.direction.dot(Vec3::from_array(scene.camera.forward));
        out.position = surface.position;
        out.geometric_normal = surface.geometric_normal;
        out.shading_normal = surface.normal;
        out.albedo = surface.base_color;
        out.instance = hit.instance;
        out.primitive = hit.primitive;
        out.material = surface.material;
    }
    out
}

/// The shading normal mapped to 0..1; black on a miss.
pub fn normal_radiance(scene: &PackedScene, sample: Sample, tally: &mut Tally) -> Vec3 {
    let ray = primary_ray(scene, sample);
    tally.rays.primary += 1;
    match tally.nearest(scene, &ray, 0, &AlphaFilter { scene, seed: SEED_HALF }) {
        Some(hit) => shade_point(scene, &hit_point(scene, &ray, &hit), -ray.direction).normal * 0.5 + Vec3::splat(0.5),
        None => Vec3::ZERO,
    }
}

#[cfg(test)]
mod tests {
    use glam::Affine3A;

    use super::*;
    use crate::integrate::tests::{camera, matte, prepare, scene, settings, square};
    use crate::scene::{Camera, Projection};
    use crate::settings::Integrator;

    #[test]
    fn depth_is_the_same_all_over_a_wall_before_the_camera() {
        let projection = Projection::Perspective { fov_y_rad: 0.6 };
        let camera = Camera { projection, ..camera(Vec3::ZERO, Vec3::Z, 3.0, 1.0) };
        let scene = scene(vec![(square(), matte(0.5, 1.0), Affine3A::IDENTITY)]);
        let packed = prepare(&scene, &settings(Integrator::Aov, camera, 0.0));
        for (x, y) in [(0, 0), (16, 16), (31, 3)] {
            let depth = first_hit(&packed, x, y, &mut Tally::default()).depth;
            assert!((depth - 3.0).abs() < 1e-5, "{depth} at {x}, {y}");
        }
    }
}
