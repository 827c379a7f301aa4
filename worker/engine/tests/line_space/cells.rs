//! Line Spaces of the nodes of an N-tree, and the policies that ask them.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, Vec3};
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CastPattern, CellSpaceParams, CellSpaces, ClassLayout, LineSpaceParams, Payload,
};
use lightshaft_engine::accel::{
    Approximation, BouncePolicy, BuildError, CellTree, NTreeParams, Names, Placement, SceneAccel, Structure,
    StructureParams, flatten,
};
use lightshaft_engine::scene::Mesh;
use lightshaft_engine::trace::{Counters, Ray};

use crate::common::{AcceptAll, Random, ball, closest, occluded, place, random_ray, soup, spheres};
use crate::judge::{self, SHADOW, Wrong, rules};

const BUDGET: u64 = 1 << 30;
const MASKS: Payload = Payload::Binary { builder: BinaryBuilder::Masking };
const CAST: Payload = Payload::Binary { builder: BinaryBuilder::Casting(CastPattern::Nine) };
const CANDIDATES: Payload = Payload::Candidates { pattern: CastPattern::Nine };

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

/// Of the occlusion rays.
fn wrong(flat: &Flat, scene: &SceneAccel) -> Wrong {
    let (plain, rays) = (flat.plain(), flat.rays(10_000));
    let (wrong, counters) = judge::wrong(&plain, scene, &rays, SHADOW);
    assert!(counters.gates.approximated > 1000, "{:?}", counters.gates);
    for ray in &rays {
        assert_eq!(closest(scene, ray), closest(&plain, ray), "what asks no policy is exact");
    }
    wrong
}

#[test]
fn masks_let_nothing_through_and_smaller_nodes_are_nearer_the_truth() {
    let flat = Flat::new(ball(24, Vec3::ZERO, 1.0), 4, 4, false);
    let mut last = 1.0;
    for level in 1..=3 {
        let scene = flat.approximating(flat.spaces(4, MASKS, level), rules(BouncePolicy::Occlusion));
        let Wrong { let_through, blocked } = wrong(&flat, &scene);
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
    let masked = of(4, MASKS, true).blocked;
    for payload in [CAST, CANDIDATES, Payload::Coverage { bits: 6, rays: 8 }] {
        let Wrong { let_through, blocked } = of(4, payload, true);
        assert!(let_through < 0.05 && blocked < masked, "{payload:?}: {let_through} {blocked}, masks {masked}");
    }
    let skipping = of(4, MASKS, false).let_through;
    assert!(skipping > 0.01, "what is near casts no shadow: {skipping}");
}

fn candidate_errors(flat: &Flat, level: u32) -> [f64; 2] {
    let scene = flat.approximating(flat.spaces(4, CANDIDATES, level), rules(BouncePolicy::Representative));
    judge::candidate_errors(&flat.plain(), &scene, &flat.rays(10_000))
}

#[test]
fn candidates_come_nearer_in_smaller_nodes() {
    let flat = Flat::new(ball(20, Vec3::ZERO, 1.0), 4, 3, false);
    let [coarse, fine] = [1, 2].map(|level| candidate_errors(&flat, level));
    assert!(fine[0] < coarse[0] && coarse[0] < 0.15, "{coarse:?} {fine:?}");
    assert!(fine[1] < coarse[1] && coarse[1] < 0.1, "{coarse:?} {fine:?}");
}

#[test]
fn nodes_near_a_rays_start_count_as_its_own() {
    // Rays that leave a smooth surface, as shadow rays do: where they enter the next node, its surface is still near.
    let flat = Flat::new(ball(40, Vec3::ZERO, 1.0), 4, 3, false);
    let mut random = Random(52);
    let rays: Vec<Ray> = std::iter::repeat_with(|| {
        let mut surface = Ray::new(3.0 * random.direction(), Vec3::ZERO);
        surface.direction = -surface.origin;
        let at = closest(&flat.plain(), &surface).map(|hit| surface.origin + 0.999 * hit.t * surface.direction)?;
        let away = random.direction();
        Some(Ray::new(at, if away.dot(at) < 0.0 { -away } else { away }))
    })
    .flatten()
    .take(10_000)
    .collect();
    let of = |origin_reach, exact_origin| {
        let rules = Approximation { exact_origin, origin_reach, ..rules(BouncePolicy::Occlusion) };
        let scene = flat.approximating(flat.spaces(4, MASKS, 2), rules);
        judge::wrong(&flat.plain(), &scene, &rays, SHADOW).0
    };
    let [none, half, one] = [0.0, 0.5, 1.0].map(|reach| of(reach, true));
    assert!(none.let_through == 0.0 && half.let_through == 0.0 && one.let_through == 0.0);
    assert!(half.blocked < 0.6 * none.blocked && one.blocked < 0.5 * half.blocked, "{none:?} {half:?} {one:?}");
    assert!(of(1.0, false).let_through > of(0.0, false).let_through, "more is skipped");
    assert_eq!(of(1e6, true).total(), 0.0, "nothing is far enough");
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
