//! Line Spaces of the nodes of an N-tree, and the policies that ask them.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, Vec3};
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CandidateRules, CastPattern, CellSpaceParams, CellSpaces, ClassLayout, LineSpaceParams, Payload,
};
use lightshaft_engine::accel::{
    AdaptiveRules, Approximation, BouncePolicy, BuildError, CellTree, NTreeParams, Names, Placement, Purpose,
    SceneAccel, Structure, StructureParams, flatten,
};
use lightshaft_engine::scene::Mesh;
use lightshaft_engine::trace::{Counters, Ray};

use crate::common::{AcceptAll, Random, ball, closest, occluded, place, random_ray, soup, spheres};

const BUDGET: u64 = 1 << 30;
const MASKS: Payload = Payload::Binary { builder: BinaryBuilder::Masking };
const CAST: Payload = Payload::Binary { builder: BinaryBuilder::Casting(CastPattern::Nine) };
const CANDIDATES: Payload = Payload::Candidates { pattern: CastPattern::Nine };
const SHADOW: Purpose = Purpose { bounce: 0, light: 1.0, is_ambient: false };

/// A mesh as one N-tree.
struct Flat {
    mesh: Mesh,
    names: Names,
    structure: Structure,
}

impl Flat {
    fn new(mesh: Mesh, n: u32, depth: u32, filtered: bool) -> Self {
        let placement = Placement { filtered, ..place(Affine3A::IDENTITY) };
        let (mesh, names) = flatten(&[Arc::new(mesh)], &[placement]).expect("flattens");
        let params = StructureParams::NTree(NTreeParams { n, depth, max_leaf: 2, budget_bytes: BUDGET });
        let structure = Structure::build(&mesh, &params, &AtomicBool::new(false)).expect("builds");
        Self { mesh, names, structure }
    }

    fn tree(&self) -> &CellTree {
        self.structure.cells().expect("a tree of cells")
    }

    fn plain(&self) -> SceneAccel {
        SceneAccel::flat(self.structure.clone(), self.names.clone())
    }

    fn spaces(&self, n: u32, payload: Payload, level: u32) -> CellSpaces {
        let params = CellSpaceParams { each: LineSpaceParams { n, payload }, level };
        CellSpaces::build(&self.mesh, self.tree(), &params, BUDGET, &AtomicBool::new(false)).expect("builds")
    }

    fn approximating(&self, spaces: CellSpaces, rules: Approximation) -> SceneAccel {
        self.plain().approximating_in_cells(Arc::new(spaces), rules).expect("of this tree")
    }

    fn rays(&self, count: usize) -> Vec<Ray> {
        let mut random = Random(51);
        let rays = (0..count).map(|i| {
            let ray = random_ray(&mut random, &self.mesh.bounds);
            if i % 2 == 0 { ray } else { Ray { t_max: f32::INFINITY, ..ray } }
        });
        rays.collect()
    }
}

fn rules(policy: BouncePolicy) -> Approximation {
    Approximation {
        bounces: vec![policy],
        exact_origin: true,
        adaptive: AdaptiveRules::default(),
        candidates: CandidateRules::default(),
    }
}

/// Shares of the occlusion rays that are let through, and that are blocked without reason.
fn wrong(flat: &Flat, scene: &SceneAccel) -> [f64; 2] {
    let (plain, rays) = (flat.plain(), flat.rays(10_000));
    let mut counters = Counters::default();
    let mut found = [0; 2];
    for ray in &rays {
        let truth = occluded(&plain, ray);
        let blocked = scene.blocked(ray, SHADOW, &AcceptAll, &mut counters);
        found[0] += u32::from(truth && !blocked);
        found[1] += u32::from(blocked && !truth);
        assert_eq!(closest(scene, ray), closest(&plain, ray), "what asks no policy is exact");
    }
    assert!(counters.gates.approximated > 1000, "{:?}", counters.gates);
    found.map(|count| f64::from(count) / rays.len() as f64)
}

#[test]
fn masks_let_nothing_through_and_smaller_nodes_are_nearer_the_truth() {
    let flat = Flat::new(ball(24, Vec3::ZERO, 1.0), 4, 4, false);
    let mut last = 1.0;
    for level in 1..=3 {
        let scene = flat.approximating(flat.spaces(4, MASKS, level), rules(BouncePolicy::Occlusion));
        let [let_through, blocked] = wrong(&flat, &scene);
        assert!(let_through == 0.0 && blocked > 0.0 && blocked < 0.7 * last, "level {level}: {let_through} {blocked}");
        last = blocked;
    }
    assert!(last < 0.03, "{last}");
}

#[test]
fn other_payloads_err_to_both_sides_and_a_skipped_origin_lets_more_through() {
    let flat = Flat::new(ball(20, Vec3::ZERO, 1.0), 4, 3, false);
    let of = |n, payload, exact_origin| {
        let rules = Approximation { exact_origin, ..rules(BouncePolicy::Occlusion) };
        wrong(&flat, &flat.approximating(flat.spaces(n, payload, 1), rules))
    };
    let [_, masked] = of(4, MASKS, true);
    for payload in [CAST, CANDIDATES, Payload::Coverage { bits: 6, rays: 8 }] {
        let [let_through, blocked] = of(4, payload, true);
        assert!(let_through < 0.05 && blocked < masked, "{payload:?}: {let_through} {blocked}, masks {masked}");
    }
    let [skipping, _] = of(4, MASKS, false);
    assert!(skipping > 0.01, "what is near casts no shadow: {skipping}");
}

/// Share of rays that hit something in one scene alone, and the mean error of the distance of the others.
fn candidate_errors(flat: &Flat, level: u32) -> [f64; 2] {
    let scene = flat.approximating(flat.spaces(4, CANDIDATES, level), rules(BouncePolicy::Representative));
    let (plain, rays) = (flat.plain(), flat.rays(10_000));
    let (mut missed, mut hits, mut error) = (0, 0, 0.0);
    for ray in &rays {
        let truth = closest(&plain, ray);
        assert_eq!(scene.nearest(ray, 0, &AcceptAll, &mut Counters::default()), truth, "the camera's are exact");
        match (truth, scene.nearest(ray, 1, &AcceptAll, &mut Counters::default())) {
            (Some(truth), Some(found)) => {
                hits += 1;
                error += f64::from(ray.direction.length() * (truth.t - found.t).abs());
            }
            (None, None) => {}
            _ => missed += 1,
        }
    }
    assert!(hits > 1000);
    [f64::from(missed) / rays.len() as f64, error / f64::from(hits)]
}

#[test]
fn candidates_come_nearer_in_smaller_nodes() {
    let flat = Flat::new(ball(20, Vec3::ZERO, 1.0), 4, 3, false);
    let [coarse, fine] = [1, 2].map(|level| candidate_errors(&flat, level));
    assert!(fine[0] < coarse[0] && coarse[0] < 0.15, "{coarse:?} {fine:?}");
    assert!(fine[1] < coarse[1] && coarse[1] < 0.1, "{coarse:?} {fine:?}");
}

#[test]
fn filtered_scenes_trees_without_nodes_and_spheres_as_candidates_are_exact() {
    let filtered = Flat::new(ball(24, Vec3::ZERO, 1.0), 4, 3, true);
    let root_alone = Flat::new(ball(24, Vec3::ZERO, 1.0), 8, 1, false);
    let mut mixed = soup(300, 0.2, 3);
    mixed.spheres = spheres(200, 0.05, 4);
    let with_spheres = Flat::new(mixed, 4, 3, false);
    for (flat, payload) in [(filtered, MASKS), (root_alone, MASKS), (with_spheres, CANDIDATES)] {
        let scene = flat.approximating(flat.spaces(4, payload, 2), rules(BouncePolicy::Occlusion));
        for ray in flat.rays(2000) {
            let blocked = scene.blocked(&ray, SHADOW, &AcceptAll, &mut Counters::default());
            assert_eq!(blocked, occluded(&flat.plain(), &ray), "{ray:?}");
        }
    }
}

#[test]
fn what_cannot_be_built_is_refused() {
    let flat = Flat::new(ball(24, Vec3::ZERO, 1.0), 4, 3, false);
    let refuse = |payload, level, budget, cancel| {
        let params = CellSpaceParams { each: LineSpaceParams { n: 4, payload }, level };
        let built = CellSpaces::build(&flat.mesh, flat.tree(), &params, budget, &AtomicBool::new(cancel));
        built.expect_err("refused")
    };
    let spaces = flat.spaces(4, MASKS, 2);
    assert!(spaces.count() > 20 && spaces.bytes() >= 480 * spaces.count());
    let error = refuse(MASKS, 2, 480 * spaces.count() as u64 - 1, false).to_string();
    assert!(error.contains("n=4,payload=binary") && error.contains("take more than"), "{error}");
    assert!(refuse(MASKS, 0, BUDGET, false).to_string().contains("depth is 0"));
    let classes = Payload::Classes { layout: ClassLayout::Table, resolution: 32 };
    assert!(refuse(classes, 1, BUDGET, false).to_string().contains("payload is classes"));
    let clipped = Payload::Binary { builder: BinaryBuilder::Clipping };
    assert!(refuse(clipped, 1, BUDGET, false).to_string().contains("builder is clipping"));
    assert!(matches!(refuse(CAST, 1, BUDGET, true), BuildError::Cancelled));
    let other = Flat::new(ball(24, Vec3::ZERO, 1.0), 5, 3, false);
    let given = other.plain().approximating_in_cells(Arc::new(spaces), rules(BouncePolicy::Occlusion));
    assert!(given.expect_err("another tree").contains("another"));
}
