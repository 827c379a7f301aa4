//! No submit holds the device for long, whatever the picture shows and in whatever order.

use std::sync::Arc;

use glam::{Affine3A, Vec3};
use lightshaft_engine::device::gpu::GpuDevice;
use lightshaft_engine::device::{Device, Pass, Region};
use lightshaft_engine::film::PassFilm;
use lightshaft_engine::scene::{Camera, Instance, Material, Projection, Scene};
use lightshaft_engine::settings::{Integrator, RenderSettings};

use crate::common::soup;
use crate::context;
use crate::scenes::{packed, settings};

/// Ten times what a submit should take: lavapipe shares the machine's cores with whatever else runs.
const LONGEST_S: f64 = 0.25;

#[test]
fn much_sky_above_a_little_of_something_dense() {
    let scene = Scene {
        meshes: vec![Arc::new(soup(20_000, 0.4, 3))],
        instances: vec![Instance {
            name: "".into(),
            mesh: 0,
            transform: Affine3A::from_scale(Vec3::new(4.0, 1.0, 1.0)),
            materials: [0].into(),
        }],
        materials: vec![Material { metallic: 0.0, ..Material::default() }],
        ..Scene::default()
    };
    let settings = RenderSettings {
        width: 160,
        height: 1280,
        spp: 4,
        camera: Camera {
            position: Vec3::new(2.0, 8.0, 6.0),
            forward: Vec3::NEG_Z,
            projection: Projection::Orthographic { half_height: 9.0 },
            ..settings(Integrator::Direct).camera
        },
        ground: None,
        ..settings(Integrator::Path { max_bounces: 3 })
    };
    let mut device = GpuDevice::with_context(context());
    let mut renderer = device.prepare(packed(&scene, &settings), &settings).expect("prepares");
    let region = Region::full(&settings);
    let mut film = PassFilm::new(region);
    let pass = Pass { region, first_sample: 0, samples: settings.spp };
    let stats = renderer.render(&pass, &mut film, &|| false).expect("renders");
    eprintln!("longest submit {:.3} s of {:.2} s, {:?}", stats.longest_submit_s, stats.seconds, stats.rays);
    assert!(stats.rays.indirect > 20_000, "the soup is not in the picture: {:?}", stats.rays);
    assert!(stats.longest_submit_s < LONGEST_S, "a submit took {} s", stats.longest_submit_s);
}
