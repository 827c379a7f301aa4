//! Whole tasks through the executor, on the CPU device and generated scenes.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use lightshaft_api::job::{CacheSource, Metrics, Phase, TaskWork};
use lightshaft_api::lease::RetryClass;
use lightshaft_api::settings::{
    Acceleration, Adaptive, AovName, Ask, BouncePolicy, CameraChoice, DeviceChoice, Environment, EnvironmentMap,
    Integrator, LineSpace, LineSpaceBuilder, LineSpacePayload, OnOverBudget, OriginNode, Policy, RenderSettings,
    StructureKind,
};
use lightshaft_engine::film::{encode_exr, read_environment};
use lightshaft_engine::scene::{KINDS, Limits, Params, Source, generate};
use lightshaft_worker::cache::{StructureCache, StructureStore};
use lightshaft_worker::executor::{
    Artifact, Budgets, Devices, Executor, Inputs, Observer, Outputs, Progress, TaskError,
};

/// A generated scene, kept under its kind's name.
struct Generated {
    kind: &'static str,
    opened: AtomicUsize,
    params: Params,
    map: Vec<u8>,
    parts: Vec<(TaskWork, Vec<u8>)>,
}

fn generated(kind: &'static str) -> Generated {
    Generated { kind, opened: AtomicUsize::new(0), params: Params::default(), map: Vec::new(), parts: Vec::new() }
}

/// Few triangles and few objects, where the kind lets us choose.
fn small_scene(kind: &'static str) -> Generated {
    let known = KINDS.iter().find(|known| known.name == kind).expect("a kind");
    let choose = |default: u32, value: u32| (default > 0).then_some(value);
    let (triangles, count) = (choose(known.default_triangles, 600), choose(known.default_count, 12));
    Generated { params: Params { triangles, count, ..Params::default() }, ..generated(kind) }
}

impl Inputs for Generated {
    fn waited_s(&self) -> Option<f64> {
        Some(1.5)
    }

    fn scene_key(&self) -> Option<String> {
        Some(self.kind.to_owned())
    }

    fn open_scene(&self, limits: &Limits) -> Result<Source, TaskError> {
        self.opened.fetch_add(1, Ordering::Relaxed);
        let glb = generate(self.kind, &self.params).unwrap();
        Source::from_bytes("scene.glb", glb, limits).map_err(|error| TaskError::bad_input(error.to_string()))
    }

    fn environment_map(&self, _name: &str) -> Result<Vec<u8>, TaskError> {
        Ok(self.map.clone())
    }

    fn parts(&self) -> Vec<TaskWork> {
        self.parts.iter().map(|(work, _)| work.clone()).collect()
    }

    fn part(&self, index: usize) -> Result<Vec<u8>, TaskError> {
        Ok(self.parts[index].1.clone())
    }

    fn structures(&self) -> Option<&dyn StructureStore> {
        None
    }
}

#[derive(Default)]
struct Recorder {
    progress: Mutex<Vec<Progress>>,
    log: Mutex<Vec<String>>,
    previews: Mutex<Vec<Vec<u8>>>,
}

impl Observer for Recorder {
    fn progress(&self, progress: Progress) {
        self.progress.lock().unwrap().push(progress);
    }

    fn log(&self, line: String) {
        self.log.lock().unwrap().push(line);
    }

    fn wants_preview(&self) -> bool {
        true
    }

    fn preview(&self, png: Vec<u8>) {
        self.previews.lock().unwrap().push(png);
    }
}

fn executor() -> Executor {
    executor_on(DeviceChoice::Cpu)
}

fn executor_on(device: DeviceChoice) -> Executor {
    let structures = StructureCache::new(1 << 30, None);
    Executor::new(structures, Devices::new(device), Budgets { scenes_bytes: 1 << 30 }, Limits::default())
}

fn small() -> RenderSettings {
    RenderSettings { width: 37, height: 23, spp: 6, ..RenderSettings::default() }
}

fn run(executor: &Executor, work: &TaskWork, settings: &RenderSettings, inputs: &Generated) -> Outputs {
    executor.run(work, settings, inputs, &Recorder::default(), &AtomicBool::new(false)).unwrap()
}

fn fails(settings: &RenderSettings) -> (RetryClass, bool, String) {
    let result = executor().run(
        &TaskWork::Frame,
        settings,
        &generated("cornell-box"),
        &Recorder::default(),
        &AtomicBool::new(false),
    );
    match result {
        Err(TaskError::Failed { class, fatal, message }) => (class, fatal, message),
        other => panic!("expected a failure, got {other:?}"),
    }
}

fn artifact<'a>(outputs: &'a Outputs, name: &str) -> &'a Artifact {
    outputs.artifacts.iter().find(|artifact| artifact.name == name).unwrap_or_else(|| panic!("no {name}"))
}

fn pixels(outputs: &Outputs) -> Vec<[f32; 3]> {
    read_environment(&artifact(outputs, "image.exr").bytes, 1 << 20).unwrap().rgb
}

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

fn with_line_space(line_space: LineSpace) -> RenderSettings {
    let acceleration = Acceleration { line_space: Some(line_space), ..Acceleration::default() };
    RenderSettings { width: 24, height: 18, spp: 2, acceleration, ..RenderSettings::default() }
}

/// Every payload that can be asked for, coarse.
fn payloads() -> Vec<LineSpace> {
    let payload = |payload, n| LineSpace { payload, n: Some(n), ask: Ask::Always, ..LineSpace::default() };
    let binary = |builder| LineSpace { builder: Some(builder), ..payload(LineSpacePayload::Binary, 4) };
    let classes = |n, hierarchical| LineSpace {
        hierarchical: Some(hierarchical),
        resolution: Some(32),
        ..payload(LineSpacePayload::TriState, n)
    };
    vec![
        classes(8, true),
        classes(6, false),
        binary(LineSpaceBuilder::Mask),
        binary(LineSpaceBuilder::Clip),
        binary(LineSpaceBuilder::RayCast),
        payload(LineSpacePayload::Candidate, 3),
        LineSpace { bits: Some(4), rays: Some(4), ..payload(LineSpacePayload::Coverage, 4) },
    ]
}

#[test]
fn with_exact_every_payload_gives_the_picture_of_the_structure_alone_on_every_scene() {
    let executor = executor();
    let mut answered = 0;
    for kind in KINDS.iter().map(|kind| kind.name) {
        let inputs = small_scene(kind);
        for integrator in [Integrator::Path, Integrator::Ao] {
            let plain = RenderSettings {
                acceleration: Acceleration::default(),
                integrator,
                ..with_line_space(LineSpace::default())
            };
            let expected = run(&executor, &TaskWork::Frame, &plain, &inputs);
            assert_eq!((expected.metrics.line_space_bytes, expected.metrics.line_space), (0, None));
            for line_space in payloads() {
                let settings = RenderSettings { integrator, ..with_line_space(line_space.clone()) };
                let outputs = run(&executor, &TaskWork::Frame, &settings, &inputs);
                assert!(pixels(&outputs) == pixels(&expected), "{kind}: {line_space:?} changes the picture");
                let used = outputs.metrics.line_space.expect("a job with line spaces");
                answered += used.empty + used.opaque;
                assert_eq!(
                    used.rays,
                    used.starts_inside + used.beside + used.empty + used.opaque + used.mixed + used.too_far
                );
                assert_eq!((used.meshes > 0, used.asked), (outputs.metrics.line_space_bytes > 0, used.meshes));
                assert_eq!(outputs.metrics.structure_bytes, expected.metrics.structure_bytes, "told apart");
            }
        }
    }
    assert!(answered > 10_000, "only {answered} rays were answered: the test says little");
}

/// The GPU reads the Line Spaces that the CPU built: one payload of each kind of record.
#[test]
fn with_exact_the_picture_on_the_gpu_is_that_of_the_structure_alone_too() {
    let executor = executor_on(DeviceChoice::Auto);
    let mut answered = 0;
    for kind in ["forest", "pile", "foliage-cards"] {
        let inputs = small_scene(kind);
        let plain = RenderSettings {
            device: DeviceChoice::Gpu,
            acceleration: Acceleration::default(),
            ..with_line_space(LineSpace::default())
        };
        let expected = run(&executor, &TaskWork::Frame, &plain, &inputs);
        for line_space in payloads().into_iter().take(3) {
            let settings = RenderSettings { device: DeviceChoice::Gpu, ..with_line_space(line_space.clone()) };
            let outputs = run(&executor, &TaskWork::Frame, &settings, &inputs);
            assert_eq!(outputs.metrics.device_kind, "gpu");
            assert!(pixels(&outputs) == pixels(&expected), "{kind}: {line_space:?} changes the picture");
            let used = outputs.metrics.line_space.expect("a job with line spaces");
            answered += used.empty + used.opaque;
            let told = used.starts_inside + used.beside + used.empty + used.opaque + used.mixed + used.too_far;
            assert_eq!(used.rays, told, "{used:?}");
            // What pays on the CPU says nothing of a GPU.
            let line_space = LineSpace { ask: Ask::WhereItPays, ..line_space };
            let settings = RenderSettings { device: DeviceChoice::Gpu, ..with_line_space(line_space) };
            let used = run(&executor, &TaskWork::Frame, &settings, &inputs).metrics.line_space;
            assert_eq!(used.map(|used| (used.asked, used.rays)), Some((0, 0)));
        }
    }
    assert!(answered > 1000, "only {answered} rays were answered: the test says little");
}

#[test]
fn a_second_job_finds_every_line_space() {
    let (executor, inputs) = (executor(), small_scene("forest"));
    let settings = with_line_space(LineSpace::default());
    let first = run(&executor, &TaskWork::Frame, &settings, &inputs);
    let spaces = |outputs: &Outputs| -> Vec<_> {
        let reports = outputs.metrics.cache.iter().filter(|report| report.structure.starts_with("line_space "));
        reports.map(|report| (report.mesh.clone(), report.source, report.bytes)).collect()
    };
    assert!(!spaces(&first).is_empty() && spaces(&first).iter().all(|(_, source, _)| *source == CacheSource::Built));
    assert_eq!(spaces(&first).iter().map(|(_, _, bytes)| bytes).sum::<u64>(), first.metrics.line_space_bytes);
    // Another view has to pack the scene anew.
    let second = run(&executor, &TaskWork::Frame, &RenderSettings { width: 25, ..settings }, &inputs);
    assert!(second.metrics.cache.iter().all(|report| report.source == CacheSource::Memory));
    assert_eq!(spaces(&second).len(), spaces(&first).len());
    // Where it does not pay to ask them they are kept all the same.
    let used = first.metrics.line_space.expect("a job with line spaces");
    assert!(used.meshes > 0 && used.asked <= used.meshes && (used.asked > 0) == (used.rays > 0), "{used:?}");
}

#[test]
fn line_spaces_keep_to_their_budgets() {
    let (executor, inputs) = (executor(), small_scene("forest"));
    let with = |mesh_budget_bytes, job_budget_bytes, on_over_budget| {
        let line_space = LineSpace { mesh_budget_bytes, job_budget_bytes, on_over_budget, ..LineSpace::default() };
        let settings = with_line_space(line_space);
        executor.run(&TaskWork::Frame, &settings, &inputs, &Recorder::default(), &AtomicBool::new(false))
    };
    let refused = |result: Result<Outputs, TaskError>, field: &str| match result {
        Err(TaskError::Failed { class: RetryClass::Task, fatal: true, message }) => {
            assert!(message.starts_with(&format!("/settings/acceleration/line_space/{field}: n=16")), "{message}");
        }
        other => panic!("expected a refusal, got {:?}", other.map(|outputs| outputs.metrics.line_space_bytes)),
    };
    refused(with(Some(5000), None, OnOverBudget::Refuse), "mesh_budget_bytes");
    refused(with(None, Some(5000), OnOverBudget::Refuse), "job_budget_bytes");
    let whole = with(None, None, OnOverBudget::Refuse).unwrap().metrics;
    let shrunk = with(Some(5000), None, OnOverBudget::Shrink).unwrap().metrics;
    assert!(shrunk.line_space_bytes > 0 && shrunk.line_space_bytes < whole.line_space_bytes);
    assert!(shrunk.warnings.iter().any(|warning| warning.contains("n = 4, not 16")), "{:?}", shrunk.warnings);
    let budget = whole.line_space_bytes - 1;
    let skipped = with(None, Some(budget), OnOverBudget::Skip).unwrap().metrics;
    assert!((1..=budget).contains(&skipped.line_space_bytes), "{} of {budget}", skipped.line_space_bytes);
    assert_eq!(skipped.line_space.unwrap().meshes, whole.line_space.unwrap().meshes - 1);
    let none = with(Some(2000), None, OnOverBudget::Skip).unwrap().metrics;
    assert!(none.line_space_bytes == 0 && none.warnings[0].contains("no mesh has a line space"), "{:?}", none.warnings);
}

/// Root of the mean squared difference, over pixels and channels.
fn rmse(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let squares = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| f64::from(a - b).powi(2));
    (squares.sum::<f64>() / (3 * a.len()) as f64).sqrt()
}

#[test]
fn rays_pass_nodes_of_an_ntree_by_without_a_change_of_the_picture() {
    for kind in ["forest", "pile"] {
        let (executor, inputs) = (executor(), small_scene(kind));
        for integrator in [Integrator::Path, Integrator::Ao] {
            let ntree = |line_space| {
                let structure = StructureKind::NTree;
                let acceleration = Acceleration { structure, n: Some(4), line_space, ..Acceleration::default() };
                RenderSettings { integrator, acceleration, ..with_line_space(LineSpace::default()) }
            };
            let asked = LineSpace { payload: LineSpacePayload::Binary, ask: Ask::Always, ..LineSpace::default() };
            let expected = run(&executor, &TaskWork::Frame, &ntree(None), &inputs);
            let outputs = run(&executor, &TaskWork::Frame, &ntree(Some(asked)), &inputs);
            assert!(pixels(&outputs) == pixels(&expected), "{kind}");
            let used = outputs.metrics.line_space.expect("a job with line spaces");
            assert_eq!((used.meshes, used.asked), (1, 1));
            assert!(outputs.metrics.line_space_bytes > 0 && used.skipped_nodes > 0, "{kind}: {used:?}");
            assert!(used.skipped_nodes < used.node_look_ups);
        }
    }
}

#[test]
fn approximate_occlusion_comes_near_the_picture_and_nearer_with_more_patches() {
    let (executor, inputs) = (executor(), small_scene("forest"));
    let ao = |acceleration| RenderSettings {
        integrator: Integrator::Ao,
        ao_distance: Some(1e6),
        spp: 16,
        acceleration,
        ..with_line_space(LineSpace::default())
    };
    let expected = pixels(&run(&executor, &TaskWork::Frame, &ao(Acceleration::default()), &inputs));
    let error = |n| {
        let line_space = Some(LineSpace { n: Some(n), ..LineSpace::default() });
        let policy = Policy::ApproximateOcclusion;
        let outputs = run(
            &executor,
            &TaskWork::Frame,
            &ao(Acceleration { line_space, policy, ..Acceleration::default() }),
            &inputs,
        );
        assert!(outputs.metrics.line_space.expect("a job with line spaces").approximated > 0);
        rmse(&pixels(&outputs), &expected)
    };
    let (coarse, fine) = (error(4), error(32));
    assert!(fine > 0.0 && fine < 0.8 * coarse && fine < 0.1, "{coarse} with 4 patches, {fine} with 32");
}

/// How far the pictures of some policies are from the structure's, with what their metrics count.
fn distances(integrator: Integrator, of: &[(&str, Acceleration)]) -> Vec<f64> {
    let (executor, inputs) = (executor(), small_scene("forest"));
    let render = |acceleration: Acceleration| {
        let settings = RenderSettings {
            integrator,
            acceleration,
            spp: 16,
            max_bounces: 2,
            ao_distance: Some(1e6),
            ..with_line_space(LineSpace::default())
        };
        run(&executor, &TaskWork::Frame, &settings, &inputs)
    };
    let distance = |(name, acceleration): &(&str, Acceleration)| {
        let structure = Acceleration { line_space: None, policy: Policy::Exact, ..acceleration.clone() };
        let (expected, outputs) = (render(structure), render(acceleration.clone()));
        let used = outputs.metrics.line_space.expect("a job with line spaces");
        assert!(used.meshes > 0 && outputs.metrics.line_space_bytes > 0, "{name}: {used:?}");
        let distance = rmse(&pixels(&outputs), &pixels(&expected));
        assert_eq!(distance > 0.0, used.approximated > 0, "{name}: {used:?}");
        distance
    };
    of.iter().map(distance).collect()
}

fn asking(policy: Policy, payload: LineSpacePayload, depth: u32) -> Acceleration {
    let line_space = LineSpace { payload, depth: Some(depth), n: Some(6), ..LineSpace::default() };
    Acceleration { line_space: Some(line_space), policy, ..Acceleration::default() }
}

#[test]
fn adaptive_pictures_are_exact_without_delta_and_near_the_truth_with_it() {
    let adaptive = |delta, depth| Acceleration {
        adaptive: Adaptive { delta, ..Adaptive::default() },
        ..asking(Policy::Adaptive, LineSpacePayload::Binary, depth)
    };
    let all = [("delta 0", adaptive(0.0, 3)), ("delta 1", adaptive(1.0, 3)), ("delta 1000", adaptive(1000.0, 3))];
    let [none, some, most] = distances(Integrator::Ao, &all)[..] else { panic!("three") };
    assert!(none == 0.0 && some < 0.1 * most && some < 0.01 && most < 0.3, "{none} {some} {most}");
}

#[test]
fn occlusion_is_approximated_by_the_nodes_of_both_kinds_of_bvh() {
    let occlusion = |payload, depth| asking(Policy::ApproximateOcclusion, payload, depth);
    let flat = Acceleration { structure: StructureKind::Bvh, ..occlusion(LineSpacePayload::Binary, 8) };
    let skipping = Acceleration { origin_node: OriginNode::Skip, ..occlusion(LineSpacePayload::Coverage, 4) };
    let two_level = occlusion(LineSpacePayload::Binary, 4);
    let all = [("flat", flat), ("skipping", skipping), ("two_level", two_level)];
    let [flat, skipping, two_level] = distances(Integrator::Ao, &all)[..] else { panic!("three") };
    assert!(flat < 0.2 && skipping < 0.2 && two_level < 0.2, "{flat} {skipping} {two_level}");
}

#[test]
fn indirect_rays_end_on_candidates_bounce_by_bounce() {
    let representative = |depth| asking(Policy::Representative, LineSpacePayload::Candidate, depth);
    let later = Policy::PerBounce(vec![BouncePolicy::Exact, BouncePolicy::Exact, BouncePolicy::Representative]);
    let later = Acceleration { policy: later, ..representative(0) };
    let all = [("root", representative(0)), ("deep", representative(6)), ("later", later)];
    let [root, deep, later] = distances(Integrator::Path, &all)[..] else { panic!("three") };
    assert!(deep < root && later < root && root < 0.1, "{root} {deep} {later}");
}

#[test]
fn line_spaces_of_nodes_are_cached_and_keep_to_their_budgets() {
    let (executor, inputs) = (executor(), small_scene("forest"));
    let settings = |on_over_budget, mesh_budget_bytes| {
        let mut acceleration = asking(Policy::Adaptive, LineSpacePayload::Binary, 3);
        acceleration.line_space = acceleration.line_space.map(|l| LineSpace { on_over_budget, mesh_budget_bytes, ..l });
        RenderSettings { acceleration, ..with_line_space(LineSpace::default()) }
    };
    let whole = settings(OnOverBudget::Refuse, None);
    for source in [CacheSource::Built, CacheSource::Memory] {
        let outputs = run(&executor, &TaskWork::Frame, &whole, &inputs);
        let mut spaces = outputs.metrics.cache.iter().filter(|r| r.structure.starts_with("line_space n=6")).peekable();
        assert!(spaces.peek().is_some() && spaces.all(|report| report.source == source), "{:?}", outputs.metrics.cache);
    }
    let budget = Some(4000);
    let over = settings(OnOverBudget::Refuse, budget);
    let refused = executor.run(&TaskWork::Frame, &over, &inputs, &Recorder::default(), &AtomicBool::new(false));
    let Err(TaskError::Failed { message, fatal: true, .. }) = refused else { panic!("over its budget") };
    assert!(message.contains("/settings/acceleration/line_space/mesh_budget_bytes: n=6"), "{message}");
    let shrunk = run(&executor, &TaskWork::Frame, &settings(OnOverBudget::Shrink, budget), &inputs).metrics;
    assert!(
        shrunk.line_space_bytes > 0 && shrunk.warnings[0].contains("line spaces have n = 3"),
        "{:?}",
        shrunk.warnings
    );
}
