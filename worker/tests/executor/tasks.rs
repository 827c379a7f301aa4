//! Frames, tiles, passes and merges: pictures, metrics, stopping, failing; structures.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use lightshaft_api::job::{CacheSource, Metrics, Phase, TaskWork};
use lightshaft_api::lease::RetryClass;
use lightshaft_api::settings::{
    Acceleration, AovName, CameraChoice, DeviceChoice, Environment, EnvironmentMap, RenderSettings, StructureKind,
};
use lightshaft_engine::film::encode_exr;
use lightshaft_engine::scene::{Limits, Source};
use lightshaft_worker::executor::TaskError;

use crate::common::*;

#[test]
fn a_frame_leaves_pictures_and_metrics() {
    let recorder = Recorder::default();
    let outputs = executor()
        .run(&TaskWork::Frame, &small(), &generated("cornell-box"), &recorder, &AtomicBool::new(false))
        .unwrap();
    let names: Vec<&str> = outputs.artifacts.iter().map(|artifact| &*artifact.name).collect();
    assert_eq!(names, ["image.png", "image.exr", "metrics.json"]);
    let png = image_size(&artifact(&outputs, "image.png").bytes);
    assert_eq!(png, (37, 23));
    let mean: f32 = pixels(&outputs).iter().flatten().sum::<f32>() / (37.0 * 23.0 * 3.0);
    assert!(mean > 0.05, "the box is lit: {mean}");

    let metrics = &outputs.metrics;
    assert_eq!(metrics.rays.primary, 37 * 23 * 6);
    assert!(metrics.rays.indirect > 0 && metrics.mrays_per_s > 0.0 && metrics.render_s > 0.0);
    assert!(metrics.total_s >= metrics.render_s + metrics.build_s);
    assert!(metrics.structure_bytes > 0 && metrics.peak_bytes > 0);
    assert_eq!((metrics.spp, metrics.device_kind.as_str()), (6, "cpu"));
    assert!(metrics.cache.iter().all(|report| report.source == CacheSource::Built));
    let written: Metrics = serde_json::from_slice(&artifact(&outputs, "metrics.json").bytes).unwrap();
    assert_eq!(written.rays, metrics.rays);

    let progress = recorder.progress.lock().unwrap();
    assert!(progress.windows(2).all(|pair| pair[0].fraction <= pair[1].fraction), "{progress:?}");
    assert_eq!(progress.last().unwrap().phase, Phase::Output);
    assert!(!recorder.previews.lock().unwrap().is_empty());
    assert!(!recorder.log.lock().unwrap().is_empty());
}

/// Width and height of a PNG (PNG specification, 11.2.2).
fn image_size(png: &[u8]) -> (u32, u32) {
    let number = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
    assert_eq!(&png[12..16], b"IHDR");
    (number(16), number(20))
}

#[test]
fn the_second_task_on_a_scene_imports_and_builds_nothing_and_gives_the_same_bytes() {
    let (executor, inputs) = (executor(), generated("cornell-box"));
    let first = run(&executor, &TaskWork::Frame, &small(), &inputs);
    let second = run(&executor, &TaskWork::Frame, &small(), &inputs);
    assert_eq!(inputs.opened.load(Ordering::Relaxed), 1);
    assert_eq!(second.metrics.cache.len(), first.metrics.cache.len());
    assert!(second.metrics.cache.iter().all(|report| report.source == CacheSource::Memory));
    assert_eq!(second.metrics.structure_bytes, first.metrics.structure_bytes);
    for name in ["image.png", "image.exr"] {
        assert_eq!(artifact(&first, name), artifact(&second, name), "{name}");
    }
    // Another camera needs another packed scene, but the same structures.
    let moved = RenderSettings { width: 20, ..small() };
    let third = run(&executor, &TaskWork::Frame, &moved, &inputs);
    assert!(third.metrics.cache.iter().all(|report| report.source == CacheSource::Memory));
}

/// The first task on a GPU gives each structure a layout of its own, which later ones find with it.
#[test]
fn the_layout_for_a_gpu_counts_in_the_cache_and_is_found_there() {
    let (executor, inputs) = (executor_on(DeviceChoice::Auto), generated("cornell-box"));
    let on = |device| RenderSettings { device, ..small() };
    let held = || executor.structures().holdings(0).1.memory_bytes;
    let cpu = run(&executor, &TaskWork::Frame, &on(DeviceChoice::Cpu), &inputs).metrics;
    let held_for_cpu = held();
    let gpu = run(&executor, &TaskWork::Frame, &on(DeviceChoice::Gpu), &inputs).metrics;
    assert_eq!((cpu.device_kind.as_str(), gpu.device_kind.as_str()), ("cpu", "gpu"));
    assert!(gpu.structure_bytes > cpu.structure_bytes);
    assert_eq!(held() - held_for_cpu, gpu.structure_bytes - cpu.structure_bytes);
    let moved = RenderSettings { width: 20, ..on(DeviceChoice::Gpu) };
    let again = run(&executor, &TaskWork::Frame, &moved, &inputs).metrics;
    assert!(again.cache.iter().all(|report| report.source == CacheSource::Memory));
    assert_eq!(again.structure_bytes, gpu.structure_bytes);
}

#[test]
fn tiles_merge_into_exactly_the_whole_picture_and_passes_into_nearly_it() {
    let (executor, mut inputs) = (executor(), generated("cornell-box"));
    let settings = RenderSettings { aovs: vec![AovName::Depth, AovName::InstanceId], ..small() };
    let whole = run(&executor, &TaskWork::Frame, &settings, &inputs);
    let merged = |inputs: &mut Generated, works: Vec<TaskWork>| {
        inputs.parts = works
            .into_iter()
            .map(|work| {
                let outputs = run(&executor, &work, &settings, inputs);
                assert_eq!(outputs.artifacts.len(), 1);
                let part = artifact(&outputs, "part").bytes.clone();
                (work, part)
            })
            .collect();
        run(&executor, &TaskWork::Merge, &settings, inputs)
    };
    let tile = |x, y, width, height| TaskWork::Tile { x, y, width, height };
    let tiles = merged(&mut inputs, vec![tile(20, 10, 17, 13), tile(0, 0, 20, 23), tile(20, 0, 17, 10)]);
    assert_eq!(artifact(&tiles, "image.exr"), artifact(&whole, "image.exr"));
    assert_eq!(artifact(&tiles, "image.png"), artifact(&whole, "image.png"));
    let summed: Metrics = serde_json::from_slice(&artifact(&tiles, "metrics.json").bytes).unwrap();
    assert_eq!(summed.rays, whole.metrics.rays, "the merge's report is about the whole job");

    let pass = |first_sample, samples| TaskWork::Pass { first_sample, samples };
    let passes = merged(&mut inputs, vec![pass(4, 2), pass(0, 2), pass(2, 2)]);
    assert_eq!(passes.metrics.spp, 6);
    for (a, b) in pixels(&passes).iter().flatten().zip(pixels(&whole).iter().flatten()) {
        assert!((a - b).abs() <= 1e-6 * b.abs().max(1e-3), "{a} {b}");
    }
}

#[test]
fn a_task_stops_soon_after_it_is_told() {
    let settings = RenderSettings { width: 640, height: 480, spp: 1 << 20, ..RenderSettings::default() };
    let (executor, inputs, stop) = (executor(), generated("cornell-box"), AtomicBool::new(false));
    let (result, waited) = std::thread::scope(|scope| {
        let work = scope.spawn(|| executor.run(&TaskWork::Frame, &settings, &inputs, &Recorder::default(), &stop));
        std::thread::sleep(Duration::from_millis(500));
        let told = Instant::now();
        stop.store(true, Ordering::Relaxed);
        (work.join().unwrap(), told.elapsed())
    });
    assert_eq!(result.unwrap_err(), TaskError::Stopped);
    // To the end it would take days.
    assert!(waited < Duration::from_secs(60), "{waited:?}");
}

#[test]
fn a_time_limit_ends_the_passes_with_the_samples_there_are() {
    let settings = RenderSettings { spp: 1 << 20, time_limit_s: Some(0.5), ..small() };
    let outputs = run(&executor(), &TaskWork::Frame, &settings, &generated("cornell-box"));
    assert!((1..1 << 20).contains(&outputs.metrics.spp), "{}", outputs.metrics.spp);
    assert_eq!(outputs.metrics.rays.primary, 37 * 23 * u64::from(outputs.metrics.spp));
}

#[test]
fn an_environment_map_lights_the_scene() {
    let red = encode_exr(4, 2, &[[2.0, 0.0, 0.0]; 8], None, &[]).unwrap();
    let inputs = Generated { map: red, ..generated("furnace-sphere") };
    let map = EnvironmentMap { map: "0".repeat(64), intensity: 1.0, rotation_deg: 0.0 };
    let settings = RenderSettings { environment: Some(Environment::Map(map)), ..small() };
    let pixels = pixels(&run(&executor(), &TaskWork::Frame, &settings, &inputs));
    assert!(pixels.iter().any(|p| p[0] > 1.0) && pixels.iter().all(|p| p[1] == 0.0 && p[2] == 0.0));
}

#[test]
fn failures_say_what_is_wrong_and_who_may_try_again() {
    let (class, fatal, message) = fails(&RenderSettings { camera: Some(CameraChoice::Name("no".into())), ..small() });
    assert!(class == RetryClass::Task && fatal && message.contains("`no`"), "{message}");
    let (class, fatal, message) = fails(&RenderSettings { device: DeviceChoice::Gpu, ..small() });
    assert!(class == RetryClass::Worker && !fatal && message.contains("--device cpu"), "{message}");
    let map = EnvironmentMap { map: "0".repeat(64), intensity: 1.0, rotation_deg: 0.0 };
    let (class, _, message) = fails(&RenderSettings { environment: Some(Environment::Map(map)), ..small() });
    assert!(class == RetryClass::Task && message.contains("/settings/environment/map"), "{message}");
}

#[test]
fn a_scene_file_that_cannot_be_read_is_the_worker_s_trouble_and_no_verdict_on_the_job() {
    let folder = std::env::temp_dir();
    for unreadable in [folder.join("there-is-no-such-scene.glb"), folder] {
        let error = Source::open(&unreadable, &Limits::default()).unwrap_err();
        assert!(matches!(error.into(), TaskError::Failed { class: RetryClass::Worker, fatal: false, .. }));
    }
    let garbage = Source::from_bytes("scene.zip", b"PK\x03\x04 garbage".to_vec(), &Limits::default()).unwrap_err();
    assert!(matches!(garbage.into(), TaskError::Failed { class: RetryClass::Task, fatal: true, .. }));
}

#[test]
fn a_merge_of_damaged_parts_fails() {
    let mut inputs = generated("cornell-box");
    inputs.parts = vec![(TaskWork::Pass { first_sample: 0, samples: 1 }, b"garbage".to_vec())];
    let result = executor().run(&TaskWork::Merge, &small(), &inputs, &Recorder::default(), &AtomicBool::new(false));
    assert!(matches!(result, Err(TaskError::Failed { ref message, .. }) if message.contains("part")), "{result:?}");
}

fn over(structure: StructureKind) -> RenderSettings {
    RenderSettings { acceleration: Acceleration { structure, ..Acceleration::default() }, ..small() }
}

#[test]
fn every_structure_gives_the_same_picture_and_is_found_again() {
    let (executor, inputs) = (executor(), generated("cornell-box"));
    let expected = pixels(&run(&executor, &TaskWork::Frame, &small(), &inputs));
    for (structure, name) in [
        (StructureKind::Bvh, "bvh quality=medium,spatial_splits=false"),
        (StructureKind::Grid, "grid cells_per_primitive=4"),
        (StructureKind::Octree, "octree depth=12,max_leaf=8"),
        (StructureKind::NTree, "ntree n=6,depth=3,max_leaf=8"),
    ] {
        let first = run(&executor, &TaskWork::Frame, &over(structure), &inputs);
        let [report] = &first.metrics.cache[..] else { panic!("{:?}", first.metrics.cache) };
        assert_eq!((report.structure.as_str(), report.source), (name, CacheSource::Built));
        assert!(first.metrics.structure_nodes > 0 && first.metrics.structure_bytes >= report.bytes);
        // Corners are rounded once more on their way into a flat scene: a path may turn out otherwise at an edge.
        let differs = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).any(|c| (a[c] - b[c]).abs() > 1e-3 * (1.0 + a[c].abs()));
        let picture = pixels(&first);
        let different = expected.iter().zip(&picture).filter(|&pair| differs(pair)).count();
        assert!(different * 50 <= expected.len(), "{name}: {different} of {} pixels differ", expected.len());

        // Another view has to pack the scene anew, but builds nothing.
        let wider = RenderSettings { width: 41, ..over(structure) };
        let second = run(&executor, &TaskWork::Frame, &wider, &inputs);
        assert_eq!(second.metrics.cache[0].source, CacheSource::Memory, "{name}");
    }
}

#[test]
fn a_structure_over_its_budget_is_bad_input_that_names_the_figure() {
    let acceleration = Acceleration {
        structure: StructureKind::Grid,
        resolution: Some(512),
        budget_bytes: Some(1 << 20),
        ..Acceleration::default()
    };
    let (class, fatal, message) = fails(&RenderSettings { acceleration, ..small() });
    assert_eq!((class, fatal), (RetryClass::Task, true));
    assert!(message.contains("/settings/acceleration") && message.contains("1048576"), "{message}");
}
