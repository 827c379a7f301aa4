//! Both devices give the same picture: the same random numbers, the same arithmetic.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use lightshaft_engine::accel::line_space::{Class, ClassLayout, LineSpaceParams, Payload};
use lightshaft_engine::device::cpu::CpuDevice;
use lightshaft_engine::device::gpu::{Context, GpuDevice, LineSpaceBuilder};
use lightshaft_engine::device::{Device, DeviceError, Pass, PassStats, Region};
use lightshaft_engine::film::{AovBuffers, AovLayer, PassFilm};
use lightshaft_engine::pack::PackedScene;
use lightshaft_engine::scene::{AlphaMode, Scene};
use lightshaft_engine::settings::{Aov, Integrator, RenderSettings};

use crate::scenes::{everything, many_bytes, opaque, packed, packed_with, settings, sky};
use crate::{context, context_within};

fn render(device: &mut dyn Device, scene: &Scene, settings: &RenderSettings) -> (Vec<[f32; 3]>, PassStats) {
    render_packed(device, packed(scene, settings), settings)
}

fn render_packed(
    device: &mut dyn Device,
    scene: Arc<PackedScene>,
    settings: &RenderSettings,
) -> (Vec<[f32; 3]>, PassStats) {
    let mut renderer = device.prepare(scene, settings).expect("prepares");
    let region = Region::full(settings);
    let mut film = PassFilm::new(region);
    let pass = Pass { region, first_sample: 0, samples: settings.spp };
    let stats = renderer.render(&pass, &mut film, &|| false).expect("renders");
    (film.mean(), stats)
}

/// Renders on both devices. Differences come from rays that graze an edge on one device only: few pixels, and no bias.
#[track_caller]
fn assert_same_picture(name: &str, scene: &Scene, settings: &RenderSettings) {
    assert_same_picture_on(context(), name, scene, settings);
}

#[track_caller]
fn assert_same_picture_on(context: Arc<Context>, name: &str, scene: &Scene, settings: &RenderSettings) {
    assert_same_picture_of(context, name, packed(scene, settings), settings);
}

#[track_caller]
pub(crate) fn assert_same_picture_of(
    context: Arc<Context>,
    name: &str,
    scene: Arc<PackedScene>,
    settings: &RenderSettings,
) {
    let (cpu, cpu_stats) = render_packed(&mut CpuDevice::new(), scene.clone(), settings);
    let (gpu, gpu_stats) = render_packed(&mut GpuDevice::with_context(context), scene, settings);
    let mean = |picture: &[[f32; 3]]| {
        picture.iter().flatten().map(|&c| f64::from(c)).sum::<f64>() / (3 * picture.len()) as f64
    };
    let pixel_error = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
    let errors: Vec<f32> = cpu.iter().zip(&gpu).map(pixel_error).collect();
    let total: f64 = errors.iter().map(|&e| f64::from(e)).sum();
    let relative = total / errors.len() as f64 / mean(&cpu).max(1e-6);
    let visible = errors.iter().filter(|&&e| e > 0.02).count();
    if relative >= 2e-4 || visible * 1000 > errors.len() || std::env::var_os("LIGHTSHAFT_KEEP_PICTURES").is_some() {
        save(&format!("{name}-cpu"), settings, &cpu);
        save(&format!("{name}-gpu"), settings, &gpu);
        eprintln!("{name}: mean error {relative:.2e} of the mean, {visible} pixels visibly differ");
    }
    assert!(mean(&cpu) > 0.05, "{name}: the picture is black");
    assert!(relative < 2e-4, "{name}: mean error {relative} of the mean");
    assert!(visible * 1000 <= errors.len(), "{name}: {visible} of {} pixels differ visibly", errors.len());
    let close = |a: u64, b: u64| a.abs_diff(b) * 200 <= a.max(b);
    let (a, b) = (cpu_stats.rays, gpu_stats.rays);
    assert_eq!(a.primary, b.primary, "{name}: primary rays");
    assert!(
        close(a.shadow, b.shadow) && close(a.ao, b.ao) && close(a.indirect, b.indirect),
        "{name}: rays {a:?} on the CPU, {b:?} on the GPU"
    );
}

fn save(name: &str, settings: &RenderSettings, picture: &[[f32; 3]]) {
    let bytes = picture.iter().flatten().map(|c| (255.0 * c.clamp(0.0, 1.0).powf(1.0 / 2.2)) as u8).collect();
    let image = image::RgbImage::from_raw(settings.width, settings.height, bytes).expect("has all pixels");
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.png"));
    image.save(&path).expect("saves");
    eprintln!("{}", path.display());
}

#[test]
fn path() {
    assert_same_picture("path", &everything(), &settings(Integrator::Path { max_bounces: 5 }));
}

#[test]
fn path_without_alpha_under_a_map() {
    let settings = RenderSettings { environment: sky(), ..settings(Integrator::Path { max_bounces: 3 }) };
    assert_same_picture("path-sky", &opaque(), &settings);
}

/// With no more bindings than WebGPU promises: every adapter has that many.
#[test]
fn path_with_eight_storage_buffers() {
    assert_same_picture_on(
        context_within(8, u64::MAX),
        "path-8",
        &everything(),
        &settings(Integrator::Path { max_bounces: 2 }),
    );
}

/// With every array over several bindings, as large scenes have it where an adapter binds little at once.
#[test]
fn ambient_occlusion_over_several_bindings() {
    const BYTES: u64 = 32 << 10;
    let settings = settings(Integrator::Ao { samples: 3, distance: 1.5 });
    let scene = many_bytes();
    let mut too_few = GpuDevice::with_context(context_within(8, BYTES));
    let Err(DeviceError::TooLarge(message)) = too_few.prepare(packed(&scene, &settings), &settings) else {
        panic!("one binding was enough for each array");
    };
    // Nodes, primitives, words, texels, and four buffers that are never split.
    assert!(message.contains(&format!("takes {} storage buffers", 2 + 4 + 3 + 2 + 1 + 3)), "{message}");
    let few_bytes = context_within(u32::MAX, BYTES);
    assert_same_picture_on(few_bytes.clone(), "ao-bindings", &scene, &settings);
    let [split, whole] = [few_bytes, context()].map(|c| render(&mut GpuDevice::with_context(c), &scene, &settings).0);
    assert!(split == whole, "the picture depends on how arrays are bound");
}

#[test]
fn direct() {
    assert_same_picture("direct", &everything(), &settings(Integrator::Direct));
}

#[test]
fn direct_under_a_map() {
    let settings = RenderSettings { environment: sky(), ..settings(Integrator::Direct) };
    assert_same_picture("direct-sky", &everything(), &settings);
}

#[test]
fn whitted() {
    assert_same_picture("whitted", &everything(), &settings(Integrator::Whitted { max_bounces: 4 }));
}

#[test]
fn ambient_occlusion() {
    let settings = RenderSettings { spp: 4, ..settings(Integrator::Ao { samples: 5, distance: 1.5 }) };
    assert_same_picture("ao", &everything(), &settings);
}

#[test]
fn normals() {
    assert_same_picture("normals", &everything(), &settings(Integrator::Aov));
}

#[test]
fn first_hit_layers() {
    let settings = settings(Integrator::Aov);
    let scene = packed(&everything(), &settings);
    let layers = |device: &mut dyn Device| {
        let mut out = AovBuffers::new(Region::full(&settings), Aov::OF_FIRST_HIT);
        let mut renderer = device.prepare(scene.clone(), &settings).expect("prepares");
        let stats = renderer.aovs(out.region, &mut out, &|| false).expect("renders");
        (out.layers, stats)
    };
    let (cpu, _) = layers(&mut CpuDevice::new());
    let (gpu, stats) = layers(&mut GpuDevice::with_context(context()));
    let pixels = Region::full(&settings).pixels();
    assert_eq!(stats.rays.primary, pixels as u64);
    assert!(stats.counters.box_tests > stats.counters.triangle_tests && stats.counters.triangle_tests > 0);
    for ((aov, a), (_, b)) in cpu.iter().zip(&gpu) {
        let differing = match (a, b) {
            (AovLayer::Scalar(a), AovLayer::Scalar(b)) => {
                a.iter().zip(b).filter(|(a, b)| a != b && (*a - *b).abs() > 1e-4).count()
            }
            (AovLayer::Vector(a), AovLayer::Vector(b)) => {
                let apart = |a: &[f32; 3], b: &[f32; 3]| (0..3).any(|c| (a[c] - b[c]).abs() > 2e-3);
                a.iter().zip(b).filter(|(a, b)| apart(a, b)).count()
            }
            // Work depends on the tree, which differs.
            _ if matches!(aov, Aov::BoxTests | Aov::TriangleTests) => 0,
            (AovLayer::Integer(a), AovLayer::Integer(b)) => a.iter().zip(b).filter(|(a, b)| a != b).count(),
            _ => panic!("{aov:?}: layers of different kinds"),
        };
        assert!(differing * 500 <= pixels, "{aov:?}: {differing} of {pixels} pixels differ");
    }
}

#[test]
fn pictures_do_not_depend_on_how_passes_are_cut() {
    let settings = settings(Integrator::Path { max_bounces: 3 });
    let scene = packed(&everything(), &settings);
    let region = Region::full(&settings);
    let mut device = GpuDevice::with_context(context());
    let mut whole = PassFilm::new(region);
    let mut renderer = device.prepare(scene.clone(), &settings).expect("prepares");
    renderer.render(&Pass { region, first_sample: 0, samples: 16 }, &mut whole, &|| false).expect("renders");

    let mut parts = PassFilm::new(region);
    let mut renderer = device.prepare(scene, &settings).expect("prepares");
    for (first_sample, samples) in [(0, 3), (3, 8), (11, 5)] {
        for (x, width) in [(40, 24), (0, 40)] {
            let region = Region { x, width, ..region };
            let mut part = PassFilm::new(region);
            renderer.render(&Pass { region, first_sample, samples }, &mut part, &|| false).expect("renders");
            for (i, sum) in part.sum.iter().enumerate() {
                let pixel = i / width as usize * 64 + x as usize + i % width as usize;
                (0..3).for_each(|c| parts.sum[pixel][c] += sum[c]);
            }
        }
        parts.samples += samples;
    }
    let differing: Vec<_> = whole.mean().into_iter().zip(parts.mean()).filter(|(a, b)| a != b).collect();
    assert!(
        differing.is_empty(),
        "{} of {} pixels differ, such as {:?}",
        differing.len(),
        region.pixels(),
        differing[0]
    );
}

/// The ball is cut out, or lets light through. Its shafts are OPAQUE all the same, for the device that builds them knows no materials:
/// whoever asks them must not believe it.
#[test]
fn what_lets_light_through_is_never_opaque_by_classes_that_the_device_built() {
    let (builder, never) = (LineSpaceBuilder::new(context()), AtomicBool::new(false));
    let params = LineSpaceParams { n: 8, payload: Payload::Classes { layout: ClassLayout::Tree, resolution: 64 } };
    let settings = RenderSettings { spp: 4, ..settings(Integrator::Direct) };
    for (alpha_mode, alpha) in [(AlphaMode::Mask, 0.0), (AlphaMode::Blend, 0.4), (AlphaMode::Opaque, 1.0)] {
        let mut scene = everything();
        let ball = scene.instances.iter().find(|instance| instance.mesh == 1).expect("a ball").materials[0];
        let material = &mut scene.materials[ball as usize];
        (material.alpha_mode, material.base_color[3]) = (alpha_mode, alpha);
        let asking = packed_with(&scene, &settings, |mesh, structure| {
            let built = builder.build(mesh, structure, &params, u64::MAX, &never).expect("builds");
            assert!(built.on_gpu || mesh.triangles.is_empty(), "{:?}", built.warning);
            Some(Arc::new(built.space))
        });
        let plain = packed(&scene, &settings);
        let mut gpu = GpuDevice::with_context(context());
        for device in [&mut CpuDevice::new() as &mut dyn Device, &mut gpu] {
            let (expected, _) = render_packed(device, plain.clone(), &settings);
            let (picture, stats) = render_packed(device, asking.clone(), &settings);
            assert!(picture == expected, "{alpha_mode:?}");
            assert!(stats.counters.gates.of_class(Class::Opaque) > 100, "{alpha_mode:?}: {:?}", stats.counters.gates);
        }
    }
}
