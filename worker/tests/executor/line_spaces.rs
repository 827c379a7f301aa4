//! Line Spaces with policy exact: the same picture, caches and budgets.

use std::sync::atomic::AtomicBool;

use lightshaft_api::job::{BuiltOn, CacheSource, TaskWork};
use lightshaft_api::lease::RetryClass;
use lightshaft_api::settings::{
    Acceleration, Ask, DeviceChoice, Integrator, LineSpace, LineSpaceBuilder, LineSpacePayload, OnOverBudget,
    RenderSettings, StructureKind,
};
use lightshaft_engine::scene::KINDS;
use lightshaft_worker::executor::{Executor, Outputs, TaskError};

use crate::common::*;

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

/// On every scene, each integrator with another payload: all of them come by. What the device has kernels for, it also builds.
#[test]
fn with_exact_the_picture_on_the_gpu_is_that_of_the_structure_alone_on_every_scene() {
    let executor = executor_on(DeviceChoice::Auto);
    let mut payloads = payloads().into_iter().cycle();
    let mut answered = 0;
    for kind in KINDS.iter().map(|kind| kind.name) {
        let inputs = small_scene(kind);
        for integrator in [Integrator::Path, Integrator::Ao, Integrator::Direct, Integrator::Whitted] {
            let on_gpu = |acceleration| RenderSettings {
                device: DeviceChoice::Gpu,
                integrator,
                acceleration,
                ..with_line_space(LineSpace::default())
            };
            let expected = run(&executor, &TaskWork::Frame, &on_gpu(Acceleration::default()), &inputs);
            let line_space = payloads.next().expect("without end");
            let asked = Acceleration { line_space: Some(line_space.clone()), ..Acceleration::default() };
            let outputs = run(&executor, &TaskWork::Frame, &on_gpu(asked), &inputs);
            assert_eq!(outputs.metrics.device_kind, "gpu");
            assert!(pixels(&outputs) == pixels(&expected), "{kind}: {line_space:?} changes the picture");
            let used = outputs.metrics.line_space.expect("a job with line spaces");
            answered += used.empty + used.opaque;
            let told = used.starts_inside + used.beside + used.empty + used.opaque + used.mixed + used.too_far;
            assert_eq!(used.rays, told, "{used:?}");
        }
    }
    assert!(answered > 1000, "only {answered} rays were answered: the test says little");
}

/// What pays on the CPU says nothing of a GPU.
#[test]
fn a_gpu_asks_none_where_only_what_pays_is_asked() {
    let executor = executor_on(DeviceChoice::Auto);
    let line_space = LineSpace { ask: Ask::WhereItPays, ..LineSpace::default() };
    let settings = RenderSettings { device: DeviceChoice::Gpu, ..with_line_space(line_space) };
    let used = run(&executor, &TaskWork::Frame, &settings, &small_scene("pile")).metrics.line_space;
    assert_eq!(used.map(|used| (used.asked, used.rays)), Some((0, 0)));
}

/// One cache serves both: what one device built, the other finds, and it is the same to the last byte.
#[test]
fn both_devices_build_the_same_line_spaces_under_one_key() {
    let inputs = small_scene("pile");
    for line_space in payloads() {
        let spaces = |executor: &Executor, device| {
            let settings = RenderSettings { device, ..with_line_space(line_space.clone()) };
            let outputs = run(executor, &TaskWork::Frame, &settings, &inputs);
            let reports =
                outputs.metrics.cache.into_iter().filter(|report| report.structure.starts_with("line_space "));
            let (reports, built_on): (Vec<_>, Vec<_>) = reports
                .map(|report| ((report.mesh, report.structure, report.source, report.bytes), report.built_on))
                .unzip();
            (reports, built_on)
        };
        let (first, second) = (executor_on(DeviceChoice::Auto), executor_on(DeviceChoice::Auto));
        let (on_gpu, built_on) = spaces(&first, DeviceChoice::Gpu);
        assert!(!on_gpu.is_empty() && on_gpu.iter().all(|(_, _, source, _)| *source == CacheSource::Built));
        let has_kernel =
            line_space.payload != LineSpacePayload::Coverage && line_space.builder != Some(LineSpaceBuilder::Clip);
        let expected = if has_kernel { BuiltOn::Gpu } else { BuiltOn::Cpu };
        // Spheres are the CPU's.
        assert!(built_on.contains(&Some(expected)) && !built_on.contains(&None), "{line_space:?}: {built_on:?}");
        let (on_cpu, built_on) = spaces(&second, DeviceChoice::Cpu);
        assert_eq!(on_gpu, on_cpu, "{line_space:?}");
        assert!(built_on.iter().all(|on| *on == Some(BuiltOn::Cpu)), "{line_space:?}: {built_on:?}");
        let (found, built_on) = spaces(&first, DeviceChoice::Cpu);
        assert!(found.iter().all(|(_, _, source, _)| *source == CacheSource::Memory), "{line_space:?}: {found:?}");
        assert!(built_on.iter().all(Option::is_none), "{line_space:?}: {built_on:?}");
    }
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
            let asked = LineSpace {
                payload: LineSpacePayload::Binary,
                depth: Some(2),
                ask: Ask::Always,
                ..LineSpace::default()
            };
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
