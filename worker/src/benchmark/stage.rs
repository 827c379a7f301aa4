//! The scene as an effect sees it: lit the same for every configuration, and seen from a few views.

use std::f32::consts::{PI, TAU};
use std::sync::Arc;

use glam::{Affine3A, Quat, Vec3};
use lightshaft_api::settings::{
    BenchmarkSettings, CameraChoice, CustomCamera, Effect, Environment, Ground, Integrator, Light, LightKind,
    RenderSettings,
};
use lightshaft_engine::scene::{self, Aabb, Camera, Instance, Material, Mesh, MeshHash, Projection, Scene, mesh_hash};

/// Views of a scene that brings cameras, and of one that does not.
const MOST_CAMERAS: u32 = 3;
const VIEWS_AROUND: u32 = 3;

/// Smooth enough to be a mirror to the Whitted integrator.
const MIRROR_ROUGHNESS: f32 = 0.0;

/// A scene, lit, and what to render from each view.
#[derive(Debug)]
pub(super) struct Staged {
    pub scene: Scene,
    /// Name and settings; the acceleration in them is the default one.
    pub views: Vec<(String, RenderSettings)>,
    /// How it was lit, and which rays are in the times.
    pub note: &'static str,
}

/// What a view needs to know of the benchmark.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame<'a> {
    pub settings: &'a BenchmarkSettings,
    pub width: u32,
    pub height: u32,
    /// Those to take when the settings name none.
    pub views: &'a [CameraChoice],
}

pub(super) fn stage(scene: &Scene, effect: &Effect, frame: Frame<'_>) -> Staged {
    let cameras = cameras(scene, frame);
    let bounds = scene.world_bounds();
    let room = Room::of(bounds, cameras.first().and_then(|(_, choice)| position(choice, scene)));
    let mut lit = scene.clone();
    let mut base = RenderSettings {
        width: frame.width,
        height: frame.height,
        spp: frame.settings.spp,
        seed: frame.settings.seed,
        device: frame.settings.device,
        adapter: frame.settings.adapter.clone(),
        ..RenderSettings::default()
    };
    let note = match *effect {
        Effect::Primary {} => {
            base.integrator = Integrator::Aov;
            "rays of the camera alone"
        }
        Effect::Whitted { reflections, lights } => {
            darken(&mut lit);
            make_mirrors(&mut lit);
            base.integrator = Integrator::Whitted;
            base.max_bounces = reflections;
            base.environment = Some(Environment::Grey(0.0));
            base.lights = (0..lights).map(|i| room.point_light(i, lights)).collect();
            "every surface is a mirror; each hit asks one of the lights, chosen at random, so a frame has one shadow \
             ray for each hit where the paper has one for each light; camera, mirror and shadow rays are in the times"
        }
        Effect::SoftShadow { samples } => {
            darken(&mut lit);
            room.hang_area_light(&mut lit);
            (base.integrator, base.max_bounces) = (Integrator::Whitted, 0);
            base.environment = Some(Environment::Grey(0.0));
            base.spp = frame.settings.spp.saturating_mul(samples);
            base.ground = room.ground();
            "one square light, and a floor under single objects; each shadow ray has a camera ray of its own, which is in the times"
        }
        Effect::Ao { samples, distance } => {
            base.integrator = Integrator::Ao;
            (base.ao_samples, base.ao_distance) = (samples, distance);
            base.ground = room.ground();
            "a floor under single objects; one camera ray for each pixel sample is in the times beside the occlusion rays"
        }
        Effect::Indirect { bounces: max_bounces } | Effect::Path { max_bounces } => {
            (base.integrator, base.max_bounces) = (Integrator::Path, max_bounces);
            "the scene's own light, or an even sky where it has none; camera rays, paths and a shadow ray for each \
             vertex are in the times"
        }
    };
    let views = cameras
        .into_iter()
        .map(|(name, camera)| (name, RenderSettings { camera: Some(camera), ..base.clone() }))
        .collect();
    Staged { scene: lit, views, note }
}

fn cameras(scene: &Scene, frame: Frame<'_>) -> Vec<(String, CameraChoice)> {
    let given = if frame.settings.views.is_empty() { frame.views } else { &frame.settings.views };
    if !given.is_empty() {
        let name = |i: usize, view: &CameraChoice| match view {
            CameraChoice::Index(index) => format!("camera {index}"),
            CameraChoice::Name(name) => name.clone(),
            CameraChoice::Custom(_) => format!("view {}", i + 1),
        };
        return given.iter().enumerate().map(|(i, view)| (name(i, view), view.clone())).collect();
    }
    if !scene.cameras.is_empty() {
        let own = scene.cameras.iter().zip(0..MOST_CAMERAS);
        return own.map(|(camera, i)| (camera.name.clone(), CameraChoice::Index(i))).collect();
    }
    let camera = scene::default_camera(scene, frame.width as f32 / frame.height as f32);
    let center = scene.world_bounds().center();
    (0..VIEWS_AROUND).map(|i| (format!("around {}", i + 1), around(&camera, center, i))).collect()
}

/// The camera, turned about the vertical axis through the centre.
fn around(camera: &Camera, center: Vec3, number: u32) -> CameraChoice {
    let center = if center.is_finite() { center } else { Vec3::ZERO };
    let turn = Quat::from_rotation_y(TAU * number as f32 / VIEWS_AROUND as f32);
    let position = center + turn * (camera.position - center);
    let fov_y_deg = match camera.projection {
        Projection::Perspective { fov_y_rad } => Some(fov_y_rad.to_degrees()),
        Projection::Orthographic { .. } => None,
    };
    let target = position + turn * camera.forward * (camera.position - center).length();
    CameraChoice::Custom(CustomCamera {
        position: position.to_array(),
        target: target.to_array(),
        up: Vec3::Y.to_array(),
        fov_y_deg,
        half_height: None,
    })
}

fn position(choice: &CameraChoice, scene: &Scene) -> Option<Vec3> {
    match choice {
        CameraChoice::Index(index) => scene.cameras.get(*index as usize).map(|camera| camera.position),
        CameraChoice::Name(name) => scene.cameras.iter().find(|camera| camera.name == *name).map(|c| c.position),
        CameraChoice::Custom(custom) => Some(Vec3::from(custom.position)),
    }
}

/// Takes every light of the scene's own away.
fn darken(scene: &mut Scene) {
    scene.lights.clear();
    for material in &mut scene.materials {
        material.emissive = Vec3::ZERO;
        material.emissive_texture = None;
    }
}

fn make_mirrors(scene: &mut Scene) {
    for material in &mut scene.materials {
        material.roughness = MIRROR_ROUGHNESS;
        material.metallic_roughness_texture = None;
        material.metallic = 0.5;
        material.specular_glossiness = false;
    }
}

/// Where lights hang: under the ceiling when the camera is inside of the scene, and above it otherwise.
#[derive(Clone, Copy, Debug)]
struct Room {
    center: Vec3,
    /// Half the scene's extent, never zero.
    half: Vec3,
    radius: f32,
    is_inside: bool,
}

impl Room {
    fn of(bounds: Aabb, camera: Option<Vec3>) -> Self {
        let usable = !bounds.is_empty() && bounds.extent().is_finite() && bounds.extent().length() > 0.0;
        let bounds = if usable { bounds } else { Aabb { min: Vec3::NEG_ONE, max: Vec3::ONE } };
        let half = 0.5 * bounds.extent();
        let inside = |p: Vec3| p.cmpge(bounds.min).all() && p.cmple(bounds.max).all();
        Self { center: bounds.center(), half, radius: half.length(), is_inside: camera.is_some_and(inside) }
    }

    /// Something for the shadows of single objects to fall on. Not wide: grids and N-trees have cells for all of it, and those of the
    /// thesis are filled by the object alone (table 5.1: 12,400 nodes in (8, 3), three for each of 64^2).
    fn ground(&self) -> Option<Ground> {
        (!self.is_inside).then(|| Ground { half_size: Some(self.radius), ..Ground::default() })
    }

    fn point_light(&self, number: u32, count: u32) -> Light {
        let angle = TAU * (number as f32 + 0.3) / count as f32;
        let around = Vec3::new(angle.cos(), 0.0, angle.sin());
        let place = if self.is_inside {
            self.center + self.half * (0.4 * around + 0.7 * Vec3::Y)
        } else {
            self.center + self.radius * (1.2 * around + 1.6 * Vec3::Y)
        };
        let distance = (place - self.center).length().max(f32::MIN_POSITIVE);
        Light {
            kind: LightKind::Point,
            color: [1.0; 3],
            // An irradiance of pi at the centre from all lights together.
            intensity: (PI * distance * distance / count as f32).min(f32::MAX),
            position: Some(place.to_array()),
            direction: None,
            range: None,
            inner_cone_deg: None,
            outer_cone_deg: None,
        }
    }

    /// A square that faces the centre of the scene. It hangs above the ground, for the same reason.
    fn hang_area_light(&self, scene: &mut Scene) {
        let (place, half_side) = if self.is_inside {
            (self.center + self.half * Vec3::new(0.1, 0.8, 0.1), 0.2 * self.half.x.min(self.half.z))
        } else {
            (self.center + self.radius * Vec3::new(0.5, 1.2, 0.4), 0.22 * self.radius)
        };
        let half_side = half_side.max(f32::MIN_POSITIVE);
        let towards = (self.center - place).normalize_or(Vec3::NEG_Y);
        let area = 4.0 * half_side * half_side;
        let radiance = PI * (place - self.center).length_squared() / area;
        let mesh = Arc::new(square());
        let index = scene.meshes.iter().position(|known| known.hash == mesh.hash).unwrap_or_else(|| {
            scene.meshes.push(mesh);
            scene.meshes.len() - 1
        });
        scene.materials.push(Material {
            name: "benchmark light".into(),
            base_color: [0.0, 0.0, 0.0, 1.0],
            metallic: 0.0,
            emissive: Vec3::splat(if radiance.is_finite() { radiance } else { 1.0 }),
            ..Material::default()
        });
        scene.instances.push(Instance {
            name: "benchmark light".into(),
            mesh: index as u32,
            transform: Affine3A::from_scale_rotation_translation(
                Vec3::new(half_side, 1.0, half_side),
                Quat::from_rotation_arc(Vec3::Y, towards),
                place,
            ),
            materials: Arc::new([(scene.materials.len() - 1) as u32]),
        });
    }
}

/// From (-1, 0, -1) to (1, 0, 1), facing +Y.
fn square() -> Mesh {
    let corner = |x: f32, z: f32| Vec3::new(x, 0.0, z);
    let mut mesh = Mesh {
        hash: MeshHash([0; 32]),
        name: "benchmark light".into(),
        positions: vec![corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        triangle_slots: vec![0, 0],
        normals: Vec::new(),
        tangents: Vec::new(),
        uv0: Vec::new(),
        uv1: Vec::new(),
        colors: Vec::new(),
        spheres: Vec::new(),
        slots: 1,
        bounds: Aabb { min: corner(-1.0, -1.0), max: corner(1.0, 1.0) },
    };
    mesh.hash = mesh_hash(&mesh);
    mesh
}

#[cfg(test)]
mod tests {
    use lightshaft_engine::scene::{Limits, Params, Source, generate, import};

    use super::*;
    use crate::settings::resolve;

    fn generated(kind: &str) -> Scene {
        let params = Params { count: (kind == "pile").then_some(5), triangles: None, seed: 1 };
        let glb = generate(kind, &params).unwrap();
        let source = Source::from_bytes("test", glb, &Limits::default()).unwrap();
        import(&source, &Limits::default(), &|| false).unwrap()
    }

    #[test]
    fn effects_light_the_scene_as_they_say() {
        let scene = generated("demo");
        let settings = BenchmarkSettings::default();
        let frame = Frame { settings: &settings, width: 64, height: 64, views: &[] };
        let staged = stage(&scene, &Effect::Whitted { reflections: 10, lights: 3 }, frame);
        assert!(staged.scene.lights.is_empty() && staged.scene.materials.iter().all(|m| m.emissive == Vec3::ZERO));
        assert!(staged.scene.materials.iter().all(|m| m.roughness < 0.25 && m.metallic_roughness_texture.is_none()));
        assert!(staged.views.iter().all(|(_, view)| view.lights.len() == 3 && view.max_bounces == 10));

        let staged = stage(&scene, &Effect::SoftShadow { samples: 25 }, frame);
        let glowing = staged.scene.materials.iter().filter(|m| m.emissive != Vec3::ZERO).count();
        assert_eq!((glowing, staged.scene.instances.len()), (1, scene.instances.len() + 1));
        assert!(staged.views.iter().all(|(_, view)| view.spp == 25));
        for (_, view) in &staged.views {
            assert_eq!(view.validate("/settings"), []);
            assert!(resolve(view, &staged.scene, None).is_ok());
        }
    }

    #[test]
    fn a_scene_without_cameras_is_seen_from_three_sides_and_one_with_cameras_through_them() {
        let mut scene = generated("demo");
        let settings = BenchmarkSettings::default();
        let frame = Frame { settings: &settings, width: 64, height: 64, views: &[] };
        let names = |scene: &Scene| {
            let staged = stage(scene, &Effect::Primary {}, frame);
            staged.views.into_iter().map(|(name, _)| name).collect::<Vec<_>>()
        };
        assert_eq!(names(&scene), ["main", "close"]);
        scene.cameras.clear();
        assert_eq!(names(&scene), ["around 1", "around 2", "around 3"]);
    }

    #[test]
    fn an_empty_scene_can_be_staged() {
        let settings = BenchmarkSettings::default();
        let frame = Frame { settings: &settings, width: 64, height: 64, views: &[] };
        for effect in [Effect::SoftShadow { samples: 1 }, Effect::Whitted { reflections: 1, lights: 1 }] {
            let staged = stage(&Scene::default(), &effect, frame);
            assert!(staged.views.iter().all(|(_, view)| view.validate("").is_empty()));
        }
    }
}
