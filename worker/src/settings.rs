//! From a job's settings to the engine's: choices that need the scene are made here.

mod acceleration;

use std::sync::Arc;

use glam::Vec3;
use lightshaft_api::problem::FieldError;
use lightshaft_api::settings as api;
use lightshaft_engine::film::ToneMap;
use lightshaft_engine::scene::{self, Camera, Material, Projection, PunctualKind, PunctualLight, Scene};
use lightshaft_engine::settings::{self as engine, Aov, HdrImage};

pub use acceleration::{LineSpaces, Structures, Wanted};

/// Vertical field of view of a camera that does not say its own.
const DEFAULT_FOV_Y_DEG: f32 = 40.0;

/// Everything that a picture needs. `map` is the decoded environment map, when the settings name one.
///
/// # Errors
/// A camera that the scene does not have, and lights that lack a field; the pointers begin with `/settings`.
pub fn resolve(
    settings: &api::RenderSettings,
    scene: &Scene,
    map: Option<Arc<HdrImage>>,
) -> Result<engine::RenderSettings, FieldError> {
    let extra_lights = settings.lights.iter().enumerate().map(|(i, l)| light(i, l)).collect::<Result<Vec<_>, _>>()?;
    Ok(engine::RenderSettings {
        integrator: integrator(settings, scene),
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        seed: settings.seed,
        camera: camera(settings, scene)?,
        environment: environment(settings, scene, map)?,
        extra_lights,
        ground: settings.ground.as_ref().map(|g| engine::Ground {
            height: g.height,
            half_size: g.half_size,
            albedo: Vec3::from(g.albedo),
            roughness: g.roughness,
        }),
        aovs: settings.aovs.iter().map(|&name| aov(name)).collect(),
    })
}

/// How pictures for people are tone mapped.
pub fn tone_map(tone_map: api::ToneMap) -> ToneMap {
    match tone_map {
        api::ToneMap::PbrNeutral => ToneMap::PbrNeutral,
        api::ToneMap::Agx => ToneMap::Agx,
        api::ToneMap::None => ToneMap::None,
    }
}

fn integrator(settings: &api::RenderSettings, scene: &Scene) -> engine::Integrator {
    let max_bounces = settings.max_bounces;
    match settings.integrator {
        api::Integrator::Aov => engine::Integrator::Aov,
        api::Integrator::Ao => engine::Integrator::Ao {
            samples: settings.ao_samples,
            distance: settings.ao_distance.unwrap_or_else(|| default_ao_distance(scene)),
        },
        api::Integrator::Direct => engine::Integrator::Direct,
        api::Integrator::Whitted => engine::Integrator::Whitted { max_bounces },
        api::Integrator::Path => engine::Integrator::Path { max_bounces },
    }
}

/// A tenth of the scene's diagonal.
fn default_ao_distance(scene: &Scene) -> f32 {
    let bounds = scene.world_bounds();
    let diagonal = if bounds.is_empty() { 0.0 } else { bounds.extent().length() };
    if diagonal > 0.0 && diagonal.is_finite() { 0.1 * diagonal } else { 1.0 }
}

fn camera(settings: &api::RenderSettings, scene: &Scene) -> Result<Camera, FieldError> {
    let aspect = settings.width as f32 / settings.height as f32;
    match &settings.camera {
        None => Ok(scene.cameras.first().cloned().unwrap_or_else(|| scene::default_camera(scene, aspect))),
        Some(api::CameraChoice::Index(index)) => {
            scene.cameras.get(*index as usize).cloned().ok_or_else(|| no_camera(&index.to_string(), scene))
        }
        Some(api::CameraChoice::Name(name)) => scene
            .cameras
            .iter()
            .find(|c| c.name == *name)
            .cloned()
            .ok_or_else(|| no_camera(&format!("`{name}`"), scene)),
        Some(api::CameraChoice::Custom(custom)) => Ok(custom_camera(custom)),
    }
}

fn no_camera(wanted: &str, scene: &Scene) -> FieldError {
    let there_are = match &scene.cameras[..] {
        [] => "it has none; leave it null for a view of the whole scene, or give position and target".to_owned(),
        cameras => {
            let names = cameras.iter().take(20).enumerate().map(|(i, c)| format!("{i} `{}`", c.name));
            format!("it has {}", names.collect::<Vec<_>>().join(", "))
        }
    };
    FieldError::new("/settings/camera", format!("the scene has no camera {wanted}: {there_are}"))
}

fn custom_camera(custom: &api::CustomCamera) -> Camera {
    let position = Vec3::from(custom.position);
    let forward = (Vec3::from(custom.target) - position).normalize_or(Vec3::NEG_Z);
    let up = Vec3::from(custom.up);
    let right = forward.cross(up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
    let projection = match custom.half_height {
        Some(half_height) => Projection::Orthographic { half_height },
        None => Projection::Perspective { fov_y_rad: custom.fov_y_deg.unwrap_or(DEFAULT_FOV_Y_DEG).to_radians() },
    };
    Camera { name: "custom".into(), position, forward, up: right.cross(forward), projection, frame_aspect: None }
}

fn environment(
    settings: &api::RenderSettings,
    scene: &Scene,
    map: Option<Arc<HdrImage>>,
) -> Result<engine::Environment, FieldError> {
    Ok(match &settings.environment {
        None if settings.lights.is_empty() && !has_lights(scene) => engine::Environment::Constant(Vec3::ONE),
        None => engine::Environment::Constant(Vec3::ZERO),
        Some(api::Environment::Grey(value)) => engine::Environment::Constant(Vec3::splat(*value)),
        Some(api::Environment::Color(color)) => engine::Environment::Constant(Vec3::from(*color)),
        Some(api::Environment::Map(choice)) => engine::Environment::Map {
            image: map.ok_or_else(|| FieldError::new("/settings/environment/map", "the map was not loaded"))?,
            intensity: choice.intensity,
            rotation_y_rad: choice.rotation_deg.to_radians(),
        },
    })
}

/// Whether something in the scene is there to light it. A texture of emission is not: it marks indicator lamps and screens,
/// in whose glow alone nothing would be seen.
fn has_lights(scene: &Scene) -> bool {
    let lights = |m: &Material| m.emissive != Vec3::ZERO && m.emissive_texture.is_none();
    let emits = |&material: &u32| scene.materials.get(material as usize).is_some_and(lights);
    !scene.lights.is_empty() || scene.instances.iter().any(|instance| instance.materials.iter().any(emits))
}

fn light(index: usize, light: &api::Light) -> Result<PunctualLight, FieldError> {
    let missing = |field: &str, kind: &str| {
        FieldError::new(format!("/settings/lights/{index}/{field}"), format!("a {kind} light needs it"))
    };
    let (kind, needs_position, needs_direction, name) = match light.kind {
        api::LightKind::Point => (PunctualKind::Point, true, false, "point"),
        api::LightKind::Directional => (PunctualKind::Directional, false, true, "directional"),
        api::LightKind::Spot => {
            let cone = |degrees: Option<f32>, default: f32| degrees.unwrap_or(default).to_radians();
            let kind = PunctualKind::Spot {
                inner_cone_rad: cone(light.inner_cone_deg, 0.0),
                outer_cone_rad: cone(light.outer_cone_deg, 45.0),
            };
            (kind, true, true, "spot")
        }
    };
    let position = match light.position {
        Some(position) => Vec3::from(position),
        None if needs_position => return Err(missing("position", name)),
        None => Vec3::ZERO,
    };
    let direction = match light.direction.and_then(|d| Vec3::from(d).try_normalize()) {
        Some(direction) => direction,
        None if needs_direction => return Err(missing("direction", name)),
        None => Vec3::NEG_Z,
    };
    Ok(PunctualLight {
        name: format!("job light {index}"),
        position,
        direction,
        intensity: Vec3::from(light.color) * light.intensity,
        range: light.range.unwrap_or(f32::INFINITY),
        kind,
    })
}

fn aov(name: api::AovName) -> Aov {
    match name {
        api::AovName::Depth => Aov::Depth,
        api::AovName::Position => Aov::Position,
        api::AovName::GeometricNormal => Aov::GeometricNormal,
        api::AovName::ShadingNormal => Aov::ShadingNormal,
        api::AovName::Albedo => Aov::Albedo,
        api::AovName::InstanceId => Aov::InstanceId,
        api::AovName::PrimitiveId => Aov::PrimitiveId,
        api::AovName::MaterialId => Aov::MaterialId,
        api::AovName::BoxTests => Aov::BoxTests,
        api::AovName::TriangleTests => Aov::TriangleTests,
        api::AovName::LineSpaceGamma => Aov::LineSpaceGamma,
        api::AovName::LineSpaceAnswer => Aov::LineSpaceAnswer,
        api::AovName::LineSpaceLookUps => Aov::LineSpaceLookUps,
        api::AovName::LineSpaceSkipped => Aov::LineSpaceSkipped,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lightshaft_api::settings::{CameraChoice, CustomCamera, LightKind, RenderSettings};

    fn named_camera(name: &str) -> Camera {
        Camera {
            name: name.into(),
            position: Vec3::ZERO,
            forward: Vec3::NEG_Z,
            up: Vec3::Y,
            projection: Projection::Perspective { fov_y_rad: 1.0 },
            frame_aspect: None,
        }
    }

    fn scene() -> Scene {
        Scene { cameras: vec![named_camera("left"), named_camera("right")], ..Scene::default() }
    }

    fn with_camera(camera: CameraChoice) -> RenderSettings {
        RenderSettings { camera: Some(camera), ..RenderSettings::default() }
    }

    #[test]
    fn cameras_are_found_by_number_and_name_and_the_first_is_the_default() {
        let name = |settings: &RenderSettings| resolve(settings, &scene(), None).unwrap().camera.name;
        assert_eq!(name(&RenderSettings::default()), "left");
        assert_eq!(name(&with_camera(CameraChoice::Index(1))), "right");
        assert_eq!(name(&with_camera(CameraChoice::Name("right".into()))), "right");
    }

    #[test]
    fn a_camera_that_is_not_there_is_an_error_that_lists_those_that_are() {
        let error = resolve(&with_camera(CameraChoice::Name("top".into())), &scene(), None).unwrap_err();
        assert_eq!(error.pointer, "/settings/camera");
        assert!(error.detail.contains("`top`") && error.detail.contains("1 `right`"), "{}", error.detail);
        let error = resolve(&with_camera(CameraChoice::Index(7)), &Scene::default(), None).unwrap_err();
        assert!(error.detail.contains("it has none"), "{}", error.detail);
    }

    #[test]
    fn a_camera_given_by_points_is_orthonormal_even_when_up_is_along_the_view() {
        for up in [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 2.0, 3.0]] {
            let custom = CustomCamera {
                position: [0.0, 0.0, 5.0],
                target: [0.0, 0.0, 0.0],
                up,
                fov_y_deg: None,
                half_height: None,
            };
            let camera = custom_camera(&custom);
            assert_eq!(camera.forward, Vec3::NEG_Z);
            assert!(camera.up.is_normalized() && camera.up.dot(camera.forward).abs() < 1e-6, "{up:?}");
            assert_eq!(camera.projection, Projection::Perspective { fov_y_rad: 40f32.to_radians() });
        }
    }

    #[test]
    fn a_scene_without_any_light_gets_a_grey_sky_and_one_with_a_light_stays_dark() {
        let sky = |settings: &RenderSettings| match resolve(settings, &scene(), None).unwrap().environment {
            engine::Environment::Constant(radiance) => radiance,
            engine::Environment::Map { .. } => panic!("no map was asked for"),
        };
        assert_eq!(sky(&RenderSettings::default()), Vec3::ONE);
        let lamp = api::Light {
            kind: LightKind::Point,
            color: [1.0, 0.5, 0.0],
            intensity: 10.0,
            position: Some([0.0; 3]),
            direction: None,
            range: None,
            inner_cone_deg: None,
            outer_cone_deg: None,
        };
        let lit = RenderSettings { lights: vec![lamp], ..RenderSettings::default() };
        assert_eq!(sky(&lit), Vec3::ZERO);
        let resolved = resolve(&lit, &scene(), None).unwrap();
        assert_eq!(resolved.extra_lights[0].intensity, Vec3::new(10.0, 5.0, 0.0));
        let dark = RenderSettings { environment: Some(api::Environment::Grey(0.0)), ..RenderSettings::default() };
        assert_eq!(sky(&dark), Vec3::ZERO);
    }

    #[test]
    fn emission_is_a_light_unless_a_texture_says_where() {
        let sky = |material: Material| {
            let instance = scene::Instance {
                name: "".into(),
                mesh: 0,
                transform: glam::Affine3A::IDENTITY,
                materials: [0].into(),
            };
            let scene = Scene { materials: vec![material], instances: vec![instance], ..scene() };
            match resolve(&RenderSettings::default(), &scene, None).unwrap().environment {
                engine::Environment::Constant(radiance) => radiance,
                engine::Environment::Map { .. } => panic!("no map was asked for"),
            }
        };
        let lamp = Material { emissive: Vec3::ONE, ..Material::default() };
        let texture = scene::TextureRef { texture: 0, uv_set: 0, transform: scene::TextureRef::IDENTITY };
        let screen = Material { emissive_texture: Some(texture), ..lamp.clone() };
        assert_eq!(sky(lamp), Vec3::ZERO);
        assert_eq!(sky(screen), Vec3::ONE);
        assert_eq!(sky(Material::default()), Vec3::ONE);
    }

    #[test]
    fn a_light_without_its_position_is_an_error_with_its_number() {
        let lamp = serde_json::from_str(r#"{ "kind": "spot", "direction": [0, -1, 0] }"#).unwrap();
        let settings = RenderSettings { lights: vec![lamp], ..RenderSettings::default() };
        assert_eq!(resolve(&settings, &scene(), None).unwrap_err().pointer, "/settings/lights/0/position");
    }
}
