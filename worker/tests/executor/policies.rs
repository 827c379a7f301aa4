//! Policies that approximate: how far their pictures are from the truth, caches and budgets.

use std::sync::atomic::AtomicBool;

use lightshaft_api::job::{CacheSource, TaskWork};
use lightshaft_api::settings::{
    Acceleration, Adaptive, BouncePolicy, Integrator, LineSpace, LineSpacePayload, OnOverBudget, OriginNode, Policy,
    RenderSettings, StructureKind,
};
use lightshaft_worker::executor::TaskError;

use crate::common::*;

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

pub(crate) fn asking(policy: Policy, payload: LineSpacePayload, depth: u32) -> Acceleration {
    let line_space = LineSpace { payload, depth: Some(depth), n: Some(6), ..LineSpace::default() };
    // Near nodes are asked too: in such small pictures hardly anything would be wrong without.
    Acceleration { line_space: Some(line_space), policy, origin_reach: 0.0, ..Acceleration::default() }
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
fn nodes_of_an_ntree_answer_for_what_is_in_them() {
    let ntree =
        |acceleration| Acceleration { structure: StructureKind::NTree, n: Some(6), depth: Some(3), ..acceleration };
    let without_depth = |mut acceleration: Acceleration| {
        acceleration.line_space = acceleration.line_space.map(|l| LineSpace { depth: None, n: None, ..l });
        ntree(acceleration)
    };
    let occlusion = |payload, depth| asking(Policy::ApproximateOcclusion, payload, depth);
    let deepest = without_depth(occlusion(LineSpacePayload::Binary, 1));
    let upper = ntree(occlusion(LineSpacePayload::Binary, 1));
    let mut coverage = ntree(occlusion(LineSpacePayload::Coverage, 1));
    coverage.line_space = coverage.line_space.map(|l| LineSpace { n: Some(4), rays: Some(4), ..l });
    let all = [("deepest", deepest), ("upper", upper), ("coverage", coverage)];
    let [deepest, upper, coverage] = distances(Integrator::Ao, &all)[..] else { panic!("three") };
    assert!(deepest < upper && upper < 0.5 && coverage < upper, "{deepest} {upper} {coverage}");
    let mut candidates = asking(Policy::Representative, LineSpacePayload::Candidate, 1);
    candidates.line_space = candidates.line_space.map(|l| LineSpace { depth: None, n: Some(4), ..l });
    let candidates = Acceleration { structure: StructureKind::NTree, n: Some(4), ..candidates };
    let [indirect] = distances(Integrator::Path, &[("candidates", candidates)])[..] else { panic!("one") };
    assert!(indirect < 0.25, "{indirect}");
}

#[test]
fn line_spaces_of_an_ntrees_nodes_keep_to_their_budgets() {
    let (executor, inputs) = (executor(), small_scene("forest"));
    let with = |on_over_budget| {
        let mut acceleration = asking(Policy::ApproximateOcclusion, LineSpacePayload::Binary, 2);
        let of = |l: LineSpace| LineSpace { on_over_budget, mesh_budget_bytes: Some(20_000), ..l };
        acceleration.line_space = acceleration.line_space.map(of);
        acceleration = Acceleration { structure: StructureKind::NTree, n: Some(6), ..acceleration };
        let settings = RenderSettings { acceleration, ..with_line_space(LineSpace::default()) };
        executor.run(&TaskWork::Frame, &settings, &inputs, &Recorder::default(), &AtomicBool::new(false))
    };
    let Err(TaskError::Failed { message, fatal: true, .. }) = with(OnOverBudget::Refuse) else {
        panic!("over its budget")
    };
    assert!(message.contains("/line_space/mesh_budget_bytes: ") && message.contains("n=6,payload=binary"), "{message}");
    let shrunk = with(OnOverBudget::Shrink).unwrap().metrics;
    let is_told = |warning: &String| warning.contains("line spaces have n = ") && !warning.contains("n = 6");
    assert!(shrunk.line_space.unwrap().meshes == 1 && shrunk.warnings.iter().any(is_told), "{:?}", shrunk.warnings);
    let skipped = with(OnOverBudget::Skip).unwrap().metrics;
    assert!(skipped.line_space_bytes == 0 && skipped.line_space.is_none(), "{:?}", skipped.line_space);
    assert!(
        skipped.warnings.iter().any(|warning| warning.contains("no node has a line space")),
        "{:?}",
        skipped.warnings
    );
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
