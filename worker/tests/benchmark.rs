//! Benchmarks and builds through the executor, on the CPU and tiny scenes. Nothing here depends on how fast anything is.

use std::fmt::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use lightshaft_api::benchmark::BenchmarkResults;
use lightshaft_api::job::{CacheSource, TaskWork};
use lightshaft_api::settings::{BenchmarkPreset, BenchmarkSettings, BuildSettings, DeviceChoice};
use lightshaft_engine::scene::{Limits, Params, Source, generate};
use lightshaft_worker::benchmark::{BenchmarkOutputs, SceneInput, Scenes, load, report};
use lightshaft_worker::cache::{StructureCache, StructureStore};
use lightshaft_worker::executor::{Budgets, Devices, Executor, Inputs, Observer, Progress, TaskError};
use serde_json::{Value, json};

/// One small generated scene under a name.
struct Small(&'static str);

impl Scenes for Small {
    fn list(&self) -> Vec<SceneInput> {
        vec![SceneInput { name: self.0.into(), measured: "a pile".into(), stand_in: true, views: Vec::new() }]
    }

    fn open(&self, _: usize, limits: &Limits) -> Result<Source, TaskError> {
        let params = Params { seed: 1, triangles: Some(2000), count: Some(3) };
        let glb = generate("pile", &params).unwrap();
        Ok(Source::from_bytes("scene.glb", glb, limits)?)
    }
}

impl Inputs for Small {
    fn waited_s(&self) -> Option<f64> {
        None
    }

    fn scene_key(&self) -> Option<String> {
        Some(self.0.to_owned())
    }

    fn open_scene(&self, limits: &Limits) -> Result<Source, TaskError> {
        self.open(0, limits)
    }

    fn environment_map(&self, name: &str) -> Result<Vec<u8>, TaskError> {
        panic!("nobody asked for {name}")
    }

    fn parts(&self) -> Vec<TaskWork> {
        Vec::new()
    }

    fn part(&self, index: usize) -> Result<Vec<u8>, TaskError> {
        panic!("nobody asked for part {index}")
    }

    fn structures(&self) -> Option<&dyn StructureStore> {
        None
    }
}

/// Notes progress; sets the flag at the first line that contains a word.
#[derive(Default)]
struct Watcher {
    progress: Mutex<Vec<f64>>,
    log: Mutex<Vec<String>>,
    stop_after: Option<(f64, Arc<AtomicBool>)>,
}

impl Observer for Watcher {
    fn progress(&self, progress: Progress) {
        self.progress.lock().unwrap().push(progress.fraction);
        if let Some((fraction, stop)) = &self.stop_after
            && progress.fraction >= *fraction
        {
            stop.store(true, Ordering::Relaxed);
        }
    }

    fn log(&self, line: String) {
        self.log.lock().unwrap().push(line);
    }

    fn wants_preview(&self) -> bool {
        false
    }

    fn preview(&self, _: Vec<u8>) {}
}

fn executor() -> Executor {
    let structures = StructureCache::new(1 << 30, None);
    Executor::new(structures, Devices::new(DeviceChoice::Cpu), Budgets { scenes_bytes: 1 << 30 }, Limits::default())
}

/// As small as can be.
fn quick(mut settings: Value) -> BenchmarkSettings {
    let least = json!({ "width": 32, "height": 16, "repetitions": 3, "min_sample_s": 0.001, "picture_spp": 2 });
    for (key, value) in least.as_object().unwrap() {
        settings.as_object_mut().unwrap().insert(key.clone(), value.clone());
    }
    let settings: BenchmarkSettings = serde_json::from_value(settings).unwrap();
    assert_eq!(settings.validate("/settings"), []);
    settings
}

fn run(settings: &BenchmarkSettings, scene: &'static str) -> BenchmarkOutputs {
    executor().benchmark(settings, &Small(scene), &Watcher::default(), &AtomicBool::new(false)).unwrap()
}

fn own() -> BenchmarkSettings {
    quick(json!({
        "effects": [{ "kind": "primary" }, { "kind": "ao", "samples": 3 }],
        "configurations": [
            { "name": "base" },
            { "name": "N-tree", "acceleration": { "structure": "ntree", "n": 4, "depth": 2 } },
            { "name": "LS", "acceleration": { "line_space": { "payload": "tri_state", "n": 4, "resolution": 16, "ask": "always" } } },
        ],
    }))
}

#[test]
fn every_configuration_is_timed_over_the_same_rays_and_judged_by_the_reference() {
    let outputs = run(&own(), "pile");
    let results = &outputs.results;
    let comparisons = &results.scenes[0].comparisons;
    assert_eq!((results.device_kind.as_str(), comparisons.len()), ("cpu", 2));
    for comparison in comparisons {
        assert_eq!(comparison.reference.as_deref(), Some("base"));
        let views = comparison.views.len();
        let rays = comparison.rows[0].timed.as_ref().unwrap().rays;
        for row in &comparison.rows {
            let (timed, built) = (row.timed.as_ref().unwrap(), row.built.as_ref().unwrap());
            let is_reference = row.configuration == "base";
            // The reference runs before the first and after each of the other two.
            let times = if is_reference { 3 * 3 } else { 3 };
            assert_eq!(timed.samples.len(), views * times, "{}", row.configuration);
            assert_eq!(timed.ratio.is_none(), is_reference);
            assert_eq!(timed.rays.primary, rays.primary);
            assert!(timed.rays.total().abs_diff(rays.total()) <= rays.total() / 100, "the same hits, the same rays");
            assert!(timed.mrays_per_s.lower <= timed.mrays_per_s.median && timed.frames_per_s.median > 0.0);
            assert!(timed.per_ray.box_tests > 0.0 && built.init_s > 0.0 && built.structure_bytes > 0);
            assert!(built.cache.iter().all(|report| report.source == CacheSource::Built));
            match &row.picture {
                // One structure over all instances rounds their corners once more.
                Some(picture) if row.configuration == "N-tree" => assert!(picture.rmse < 1e-5 && picture.flip < 1e-3),
                Some(picture) => assert_eq!((picture.rmse, picture.flip, picture.differing_pixels), (0.0, 0.0, 0)),
                None => assert!(is_reference),
            }
        }
        let ls = &comparison.rows[2];
        assert!(ls.built.as_ref().unwrap().line_space_bytes > 0 && ls.built.as_ref().unwrap().line_spaces > 0);
        assert!(ls.timed.as_ref().unwrap().per_ray.look_ups > 0.0);
    }
    let rays = comparisons[1].rows[0].timed.as_ref().unwrap().rays;
    assert_eq!((rays.primary, rays.shadow, rays.indirect), (32 * 16, 0, 0));
    assert!(rays.ao > 0 && rays.ao.is_multiple_of(3));
}

#[test]
fn a_benchmark_leaves_tables_pictures_and_heat_maps() {
    let outputs = run(&own(), "pile");
    let names: Vec<&str> = outputs.artifacts.iter().map(|artifact| &*artifact.name).collect();
    let expected = [
        "results.json",
        "results.csv",
        "results.md",
        "metrics.json",
        "picture-1-base.png",
        "picture-1-n-tree.png",
        "heatmap-1-n-tree.png",
        "picture-1-ls.png",
        "heatmap-1-ls.png",
        "picture-2-base.png",
    ];
    assert_eq!(names[..10], expected);
    let json: BenchmarkResults = serde_json::from_slice(&outputs.artifacts[0].bytes).unwrap();
    assert_eq!(report::markdown(&json).as_bytes(), outputs.artifacts[2].bytes);
    assert_eq!(report::csv(&json).lines().count(), 1 + 6);
    assert!(outputs.artifacts[4..].iter().all(|artifact| artifact.bytes.starts_with(b"\x89PNG")));
    assert!(outputs.metrics.rays.primary > 0 && outputs.metrics.render_s > 0.0 && outputs.metrics.build_s > 0.0);
}

#[test]
fn a_benchmark_tells_how_far_it_is_and_stops_when_asked() {
    let stop = Arc::new(AtomicBool::new(false));
    let watcher = Watcher { stop_after: Some((0.5, Arc::clone(&stop))), ..Watcher::default() };
    let error = executor().benchmark(&own(), &Small("pile"), &watcher, &stop).unwrap_err();
    assert_eq!(error, TaskError::Stopped);
    let progress = watcher.progress.into_inner().unwrap();
    assert!(
        progress.is_sorted() && progress[0] < 0.1 && progress.iter().all(|&fraction| fraction < 0.8),
        "{progress:?}"
    );
}

#[test]
fn views_that_are_not_there_are_named() {
    let mut settings = own();
    settings.views = serde_json::from_value(json!(["no such camera"])).unwrap();
    let error = executor().benchmark(&settings, &Small("pile"), &Watcher::default(), &AtomicBool::new(false));
    let message = error.unwrap_err().to_string();
    assert!(message.starts_with("/settings/views: the scene has no camera `no such camera`"), "{message}");
}

/// The tables of the presets: titles, columns and rows, without any figure that is measured.
#[test]
fn presets_have_the_papers_columns_and_rows() {
    let mut found = String::new();
    for preset in BenchmarkPreset::ALL {
        let scene = load(preset).unwrap().scenes.swap_remove(0).name;
        let mut settings = quick(json!({ "preset": preset }));
        (settings.device, settings.spp, settings.picture_spp) = (DeviceChoice::Cpu, 1, 1);
        (settings.width, settings.height) = (Some(16), Some(16));
        let outputs = run(&settings, Box::leak(scene.into_boxed_str()));
        writeln!(found, "# {}", outputs.results.title).unwrap();
        for (table, comparison) in report::tables(&outputs.results).iter().zip(&outputs.results.scenes[0].comparisons) {
            writeln!(found, "\n## {}", table.title).unwrap();
            writeln!(found, "{}", table.headings.join(" | ")).unwrap();
            let papers = |row: &Vec<String>| -> Vec<String> {
                let cells = row.iter().zip(&table.headings);
                cells.filter(|(_, heading)| heading.starts_with("paper")).map(|(cell, _)| cell.clone()).collect()
            };
            for (cells, row) in table.rows.iter().zip(&comparison.rows) {
                writeln!(found, "{}: {}", cells[0], papers(cells).join(" | ")).unwrap();
                // Whatever this build can or cannot do, a row is measured or says why not.
                assert_ne!(row.built.is_some(), row.unavailable.is_some(), "{}", row.configuration);
                assert_eq!(row.timed.is_some(), row.built.is_some() && comparison.effect.is_some());
            }
        }
        found.push('\n');
    }
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/presets.txt");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(file, &found).unwrap();
    }
    let expected = std::fs::read_to_string(file).unwrap();
    for (found, expected) in found.lines().zip(expected.lines()) {
        assert_eq!(found, expected);
    }
    assert_eq!(found.lines().count(), expected.lines().count());
}

#[test]
fn a_build_makes_every_structure_once() {
    let executor = executor();
    let settings: BuildSettings =
        serde_json::from_value(json!({ "acceleration": { "line_space": { "payload": "binary", "n": 2 } } })).unwrap();
    let build = || {
        let watcher = Watcher::default();
        let outputs = executor.build(&settings, &Small("pile"), &watcher, &AtomicBool::new(false)).unwrap();
        let progress = watcher.progress.into_inner().unwrap();
        assert!(progress.iter().all(|fraction| (0.0..=1.0).contains(fraction)));
        outputs
    };
    let first = build().metrics;
    let from = |metrics: &lightshaft_api::job::Metrics, source| metrics.cache.iter().all(|r| r.source == source);
    assert!(first.cache.len() >= 2 && from(&first, CacheSource::Built), "{:?}", first.cache);
    assert!(first.cache.iter().any(|report| report.structure.contains("binary")), "{:?}", first.cache);
    assert!(first.structure_bytes > 0 && first.line_space_bytes > 0 && first.build_s > 0.0);
    let again = build();
    assert!(from(&again.metrics, CacheSource::Memory));
    assert_eq!(again.artifacts.len(), 1);
}

#[test]
fn a_build_that_goes_over_its_budget_says_so() {
    let settings: BuildSettings = serde_json::from_value(json!({ "acceleration":
        { "line_space": { "payload": "tri_state", "n": 31, "mesh_budget_bytes": 1024 } } }))
    .unwrap();
    let error = executor().build(&settings, &Small("pile"), &Watcher::default(), &AtomicBool::new(false)).unwrap_err();
    assert!(error.to_string().contains("/settings/acceleration/line_space/mesh_budget_bytes"), "{error}");
}
