//! Layers that tell what Line Spaces did.

use lightshaft_api::job::TaskWork;
use lightshaft_api::lease::NewArtifact;
use lightshaft_api::settings::{
    Acceleration, Adaptive, AovName, Ask, DeviceChoice, Integrator, LineSpace, LineSpacePayload, Policy,
    RenderSettings, Split, StructureKind,
};
use lightshaft_engine::film::{AovLayer, ExrLayers};
use lightshaft_worker::executor::{Outputs, TaskError};

use crate::common::*;
use crate::policies::asking;

const LAYERS: [AovName; 4] =
    [AovName::LineSpaceGamma, AovName::LineSpaceAnswer, AovName::LineSpaceLookUps, AovName::LineSpaceSkipped];

/// What the layers of a job's EXR say of each pixel.
struct Layers {
    gamma: Vec<f64>,
    /// By approximation, by EMPTY and by OPAQUE shafts.
    answer: [Vec<f64>; 3],
    look_ups: Vec<f64>,
    skipped: Vec<f64>,
}

fn layers(outputs: &Outputs) -> Layers {
    let file = ExrLayers::open(&artifact(outputs, "image.exr").bytes, 1 << 20).unwrap();
    let layer = |name: &str| {
        let index = file.layers().iter().position(|layer| layer.name == name);
        index.map(|index| file.read(index).unwrap())
    };
    let numbers = |name: &str| match layer(name) {
        Some(AovLayer::Scalar(values)) => values.into_iter().map(f64::from).collect(),
        Some(AovLayer::Integer(values)) => values.into_iter().map(f64::from).collect(),
        Some(AovLayer::Vector(_)) => panic!("{name} has several channels"),
        None => Vec::new(),
    };
    let Some(AovLayer::Vector(answer)) = layer("line_space_answer") else { panic!("no answers") };
    Layers {
        gamma: numbers("line_space_gamma"),
        answer: [0, 1, 2].map(|way| answer.iter().map(|shares| f64::from(shares[way])).collect()),
        look_ups: numbers("line_space_look_ups"),
        skipped: numbers("line_space_skipped"),
    }
}

/// Ambient occlusion without a limit, one sample a pixel, with the layers.
fn with_layers(acceleration: Acceleration) -> RenderSettings {
    RenderSettings {
        integrator: Integrator::Ao,
        ao_distance: Some(1e6),
        spp: 1,
        aovs: LAYERS.to_vec(),
        acceleration,
        ..with_line_space(LineSpace::default())
    }
}

fn sum(values: &[f64]) -> f64 {
    values.iter().sum()
}

#[test]
fn layers_tell_of_the_rays_of_the_first_sample() {
    let (executor, inputs) = (executor(), small_scene("forest"));
    let adaptive = |delta| Acceleration {
        adaptive: Adaptive { delta, ..Adaptive::default() },
        ..asking(Policy::Adaptive, LineSpacePayload::Binary, 3)
    };
    let render = |delta| run(&executor, &TaskWork::Frame, &with_layers(adaptive(delta)), &inputs);
    let outputs = render(2.0);
    let (all, used) = (layers(&outputs), outputs.metrics.line_space.expect("a job with line spaces"));
    // The one sample is traced twice: for the layers and for the picture.
    assert_eq!(2.0 * sum(&all.look_ups), used.node_look_ups as f64);
    assert_eq!(2.0 * sum(&all.skipped), used.skipped_nodes as f64);
    assert!(used.node_look_ups > 0 && used.skipped_nodes > 0);
    // Where gamma is below 1 nothing is approximated; rays that look shafts up say so.
    let pixels = || 0..all.gamma.len();
    assert!(pixels().all(|i| all.gamma[i] >= 1.0 || (all.answer[0][i] == 0.0 && all.look_ups[i] == 0.0)));
    assert!(pixels().all(|i| (all.look_ups[i] > 0.0) == (all.answer[0][i] > 0.0)));
    assert!(pixels().any(|i| all.gamma[i] > 0.0 && all.gamma[i] < 1.0));
    // Gamma is in proportion to delta.
    let twice = layers(&render(4.0)).gamma;
    assert!(pixels().all(|i| (twice[i] - 2.0 * all.gamma[i]).abs() <= 1e-5 * twice[i]));
}

#[test]
fn layers_show_where_empty_and_opaque_shafts_answer() {
    let (executor, inputs) = (executor(), small_scene("forest"));
    let classes = LineSpace { ask: Ask::Always, n: Some(16), ..LineSpace::default() };
    let exact = Acceleration { line_space: Some(classes), ..Acceleration::default() };
    let mut settings = with_layers(exact);
    settings.aovs.remove(0);
    let outputs = run(&executor, &TaskWork::Frame, &settings, &inputs);
    let (all, used) = (layers(&outputs), outputs.metrics.line_space.expect("a job with line spaces"));
    let [approximated, empty, opaque] = all.answer.each_ref().map(|part| sum(part));
    assert!(approximated == 0.0 && empty > 0.0 && opaque > 0.0);
    assert!((0..all.skipped.len()).all(|i| all.answer.iter().map(|part| part[i]).sum::<f64>() <= 1.0 + 1e-6));
    assert_eq!(2.0 * sum(&all.look_ups), (used.empty + used.opaque + used.mixed) as f64);
    assert_eq!(2.0 * sum(&all.skipped), used.empty as f64);
}

#[test]
fn the_camera_s_rays_and_nodes_of_an_ntree_are_told_of_too() {
    let (executor, inputs) = (executor(), small_scene("forest"));
    // Patches of one cell: wider ones of so few cells have no empty shaft here.
    let (payload, n) = (LineSpacePayload::Binary, Some(4));
    let line_space = LineSpace { payload, n, depth: Some(2), ask: Ask::Always, ..LineSpace::default() };
    let structure = StructureKind::NTree;
    let ntree = Acceleration { structure, n: Some(4), line_space: Some(line_space), ..Acceleration::default() };
    let settings = RenderSettings { integrator: Integrator::Aov, ..with_layers(ntree) };
    let outputs = run(&executor, &TaskWork::Frame, &settings, &inputs);
    let (all, used) = (layers(&outputs), outputs.metrics.line_space.expect("a job with line spaces"));
    assert!(used.skipped_nodes > 0);
    assert_eq!(2.0 * sum(&all.skipped), used.skipped_nodes as f64);
    // One ray a pixel: it is answered in one way.
    let is_empty = |i: usize| all.answer[1][i] == 1.0 && all.skipped[i] > 0.0;
    assert!((0..all.skipped.len()).all(|i| all.answer[1][i] == 0.0 || is_empty(i)));
    assert!(sum(&all.answer[0]) == 0.0 && sum(&all.answer[2]) == 0.0);
}

#[test]
fn layers_of_parts_merge_into_those_of_the_whole() {
    let (executor, mut inputs) = (executor(), small_scene("forest"));
    let settings = with_layers(asking(Policy::Adaptive, LineSpacePayload::Binary, 2));
    let whole = run(&executor, &TaskWork::Frame, &settings, &inputs);
    let settings = RenderSettings { split: Some(Split::Tiles([2, 1])), ..settings };
    let (width, height) = (settings.width / 2, settings.height);
    inputs.parts = [0, width]
        .map(|x| TaskWork::Tile { x, y: 0, width, height })
        .map(|work| {
            let part = artifact(&run(&executor, &work, &settings, &inputs), NewArtifact::PART).bytes.clone();
            (work, part)
        })
        .into();
    let merged = run(&executor, &TaskWork::Merge, &settings, &inputs);
    assert!(artifact(&merged, "image.exr").bytes == artifact(&whole, "image.exr").bytes);
}

#[test]
fn a_gpu_refuses_layers_that_it_does_not_make() {
    let settings = RenderSettings { device: DeviceChoice::Gpu, ..with_layers(Acceleration::default()) };
    let result = executor_on(DeviceChoice::Auto).run(
        &TaskWork::Frame,
        &settings,
        &small_scene("pile"),
        &Recorder::default(),
        &Default::default(),
    );
    let Err(TaskError::Failed { message, .. }) = result else { panic!("{result:?}") };
    assert!(message.contains("line_space_gamma is made by the CPU"), "{message}");
}
