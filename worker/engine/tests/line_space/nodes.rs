//! Line Spaces of the nodes of a BVH, and the policies that ask them.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, Quat, Vec3};
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CastPattern, ClassLayout, LineSpaceParams, NodeSpaceParams, NodeSpaces, Payload,
};
use lightshaft_engine::accel::{
    AdaptiveRules, Approximation, BouncePolicy, BuildError, BuildParams, MeshStructure, Placement, Purpose, SceneAccel,
    flatten,
};
use lightshaft_engine::scene::Mesh;
use lightshaft_engine::trace::{Counters, Ray};

use crate::common::{AcceptAll, Random, ball, build, closest, mesh, occluded, place, random_ray, soup};
use crate::judge::{self, SHADOW, rules};
use crate::meshes;

const BUDGET: u64 = 1 << 30;
const MASKS: Payload = Payload::Binary { builder: BinaryBuilder::Masking };
const CANDIDATES: Payload = Payload::Candidates { pattern: CastPattern::Nine };

fn params(n: u32, payload: Payload, depth: u32) -> NodeSpaceParams {
    NodeSpaceParams { each: LineSpaceParams { n, payload }, depth }
}

fn spaces(mesh: &Mesh, structure: &MeshStructure, params: &NodeSpaceParams) -> NodeSpaces {
    NodeSpaces::build(mesh, structure, params, BUDGET, &AtomicBool::new(false)).expect("builds")
}

/// Some instances of a mesh, turned, mirrored and stretched; plain and approximated.
fn scenes(mesh: &Mesh, params: &NodeSpaceParams, rules: Approximation) -> (SceneAccel, SceneAccel) {
    let structure = Arc::new(build(mesh, BuildParams::default()));
    let nodes = Arc::new(spaces(mesh, &structure, params));
    let placements: Vec<Placement> = (0..5)
        .map(|i| {
            let turn = Quat::from_rotation_y(i as f32) * Quat::from_rotation_x(0.4 * i as f32);
            let scale = Vec3::new(if i % 2 == 0 { 1.0 } else { -0.8 }, 1.0 + 0.1 * i as f32, 0.9);
            place(Affine3A::from_scale_rotation_translation(
                scale,
                turn,
                2.2 * Vec3::new(i as f32, (i % 2) as f32, 0.3),
            ))
        })
        .collect();
    let plain = SceneAccel::build(vec![structure.clone()], &placements);
    let approximating = SceneAccel::build(vec![structure], &placements).approximating(vec![Some(nodes)], rules);
    (plain, approximating.expect("one for the structure"))
}

fn rays(scene: &SceneAccel, count: usize, seed: u64) -> Vec<Ray> {
    let (mut random, bounds) = (Random(seed), scene.top().bounds());
    (0..count)
        .map(|i| {
            let ray = random_ray(&mut random, &bounds);
            if i % 2 == 0 { ray } else { Ray { origin: ray.origin - 3.0 * ray.direction, t_max: f32::INFINITY, ..ray } }
        })
        .collect()
}

/// Share of rays that are taken wrongly; none may be let through where `conservative`.
fn wrong(scenes: &(SceneAccel, SceneAccel), purpose: Purpose, conservative: bool) -> f64 {
    let (wrong, _) = judge::wrong(&scenes.0, &scenes.1, &rays(&scenes.0, 20_000, 5), purpose);
    assert!(wrong.let_through == 0.0 || !conservative, "{wrong:?}");
    wrong.total()
}

#[test]
fn binary_nodes_take_what_the_thesis_says() {
    let mesh = ball(60, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    let nodes = spaces(&mesh, &structure, &params(6, MASKS, 6));
    // Table 8.1: 127 Line Spaces of 2,430 bytes, 0.3 MB.
    assert_eq!(nodes.count(), 127);
    assert!((300_000..420_000).contains(&nodes.bytes()), "{}", nodes.bytes());
    assert!(nodes.bytes() as u64 <= params(6, MASKS, 6).bytes_at_most(mesh.primitive_count()) + 100_000);
    let one = spaces(&mesh, &structure, &params(6, CANDIDATES, 3));
    assert_eq!(one.count(), 8, "of candidates one depth alone");
    assert!((0.05..0.95).contains(&one.filled_share()), "{}", one.filled_share());
}

#[test]
fn occlusion_by_masks_lets_nothing_through_and_deeper_boxes_are_nearer_the_truth() {
    let mesh = ball(24, Vec3::ZERO, 1.0);
    let mut last = 1.0;
    for depth in [0, 3, 6] {
        let scenes = scenes(&mesh, &params(4, MASKS, depth), rules(BouncePolicy::Occlusion));
        let wrong = wrong(&scenes, SHADOW, true);
        assert!(wrong > 0.0 && wrong < 0.8 * last, "depth {depth}: {wrong} after {last}");
        last = wrong;
    }
}

#[test]
fn delta_zero_is_exact_and_more_delta_costs_truth() {
    let mesh = ball(24, Vec3::ZERO, 1.0);
    let of = |delta, exact_origin| {
        let adaptive = AdaptiveRules { delta, exact_origin, ..AdaptiveRules::default() };
        scenes(&mesh, &params(6, MASKS, 4), Approximation { adaptive, ..rules(BouncePolicy::Adaptive) })
    };
    for exact_origin in [true, false] {
        let exact = of(0.0, exact_origin);
        assert_eq!(wrong(&exact, SHADOW, true), 0.0);
        for ray in rays(&exact.0, 5000, 6) {
            let hit = exact.1.nearest(&ray, 3, &AcceptAll, &mut Counters::default());
            assert_eq!(hit, closest(&exact.0, &ray), "nearest hits stay exact");
        }
    }
    let scenes = of(4.0, true);
    let some = wrong(&scenes, SHADOW, false);
    let more = wrong(&of(1000.0, true), SHADOW, false);
    assert!(0.0 < some && some < more && more < 0.3, "{some} {more}");
    assert_eq!(wrong(&scenes, Purpose { light: 0.0, ..SHADOW }, true), 0.0, "a point light's shadows are hard");
}

#[test]
fn policies_are_of_their_bounce_and_the_last_repeats() {
    let mesh = ball(24, Vec3::ZERO, 1.0);
    let bounces = vec![BouncePolicy::Exact, BouncePolicy::Occlusion];
    let scenes = scenes(&mesh, &params(2, MASKS, 0), Approximation { bounces, ..rules(BouncePolicy::Exact) });
    assert_eq!(wrong(&scenes, SHADOW, true), 0.0);
    let first = wrong(&scenes, Purpose { bounce: 1, ..SHADOW }, true);
    assert!(first > 0.05);
    assert_eq!(wrong(&scenes, Purpose { bounce: 9, ..SHADOW }, true), first);
}

fn candidate_errors(scenes: &(SceneAccel, SceneAccel)) -> [f64; 2] {
    judge::candidate_errors(&scenes.0, &scenes.1, &rays(&scenes.0, 10_000, 7))
}

#[test]
fn candidates_come_nearer_with_depth() {
    let mut round = ball(24, Vec3::ZERO, 1.0);
    round.normals = round.positions.iter().map(|position| position.normalize()).collect();
    let at =
        |depth| candidate_errors(&scenes(&round, &params(6, CANDIDATES, depth), rules(BouncePolicy::Representative)));
    let [coarse, fine] = [at(0), at(6)];
    assert!(fine[0] < 0.7 * coarse[0] && fine[0] < 0.05, "{coarse:?} {fine:?}");
    assert!(fine[1] < 0.5 * coarse[1] && fine[1] < 0.1, "{coarse:?} {fine:?}");
}

#[test]
fn a_candidates_plane_is_the_wall_that_it_is_part_of() {
    // A wall of 32 x 32 quads across its box: whatever the candidate, its plane is the wall.
    let at = |x: u32, y: u32| y * 33 + x;
    let positions = (0..33 * 33).map(|i| Vec3::new((i % 33) as f32, (i / 33) as f32, 0.0)).collect();
    let quads = (0..32 * 32).flat_map(|i| {
        let (x, y) = (i % 32, i / 32);
        [[at(x, y), at(x + 1, y), at(x, y + 1)], [at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]]
    });
    let wall = mesh(positions, quads.collect(), vec![]);
    let scenes = scenes(&wall, &params(4, CANDIDATES, 2), rules(BouncePolicy::Representative));
    let (mut same, mut found) = (0, 0);
    for ray in rays(&scenes.0, 10_000, 8) {
        let hit = scenes.1.nearest(&ray, 1, &AcceptAll, &mut Counters::default());
        let Some((hit, truth)) = hit.zip(closest(&scenes.0, &ray)) else { continue };
        found += 1;
        same += u32::from((hit.t - truth.t).abs() <= 1e-3 * truth.t.abs().max(1.0));
    }
    assert!(found > 300 && same * 50 > found * 49, "{same} of {found}");
}

#[test]
fn flat_scenes_are_asked_alike() {
    let mesh = Arc::new(ball(24, Vec3::ZERO, 1.0));
    let (flat, names) = flatten(&[mesh], &[place(Affine3A::IDENTITY)]).expect("flattens");
    let structure = Arc::new(build(&flat, BuildParams::default()));
    for (policy, payload) in [(BouncePolicy::Occlusion, MASKS), (BouncePolicy::Representative, CANDIDATES)] {
        let nodes = Arc::new(spaces(&flat, &structure, &params(6, payload, 5)));
        let plain = SceneAccel::flat(structure.clone(), names.clone());
        let scene = SceneAccel::flat(structure.clone(), names.clone());
        let scene = scene.approximating(vec![Some(nodes)], rules(policy)).expect("of this structure");
        let (mut random, mut counters, mut wrong) = (Random(9), Counters::default(), 0);
        for _ in 0..5000 {
            let ray = random_ray(&mut random, &flat.bounds);
            let truth = occluded(&plain, &ray);
            let blocked = match policy {
                BouncePolicy::Occlusion => scene.blocked(&ray, SHADOW, &AcceptAll, &mut counters),
                _ => scene.nearest(&ray, 1, &AcceptAll, &mut counters).is_some(),
            };
            wrong += u32::from(blocked != truth);
        }
        assert!(wrong < 500 && counters.gates.approximated > 500, "{policy:?}: {wrong} wrong, {:?}", counters.gates);
    }
}

#[test]
fn nodes_are_stored_and_checked() {
    for (name, mesh) in meshes::all() {
        let structure = build(&mesh, BuildParams::default());
        for payload in [MASKS, CANDIDATES, Payload::Coverage { bits: 4, rays: 3 }] {
            let params = params(3, payload, 2);
            let built = spaces(&mesh, &structure, &params);
            let bytes = built.encode();
            let read = NodeSpaces::decode(&bytes, &mesh, &structure, &params).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(
                (read.encode(), read.count(), read.bytes()),
                (bytes.clone(), built.count(), built.bytes()),
                "{name}"
            );
            let other = NodeSpaceParams { depth: 1, ..params };
            assert!(NodeSpaces::decode(&bytes, &mesh, &structure, &other).is_err());
            for at in [0, 40, bytes.len() / 2, bytes.len() - 1] {
                let mut damaged = bytes.clone();
                damaged[at] ^= 4;
                assert!(NodeSpaces::decode(&damaged, &mesh, &structure, &params).is_err(), "{name}: byte {at}");
            }
            assert!(NodeSpaces::decode(&bytes[..bytes.len() - 4], &mesh, &structure, &params).is_err());
        }
    }
}

#[test]
fn what_cannot_be_built_is_refused() {
    let mesh = soup(500, 0.1, 3);
    let structure = build(&mesh, BuildParams::default());
    let refuse = |params: NodeSpaceParams, budget, cancel| {
        let built = NodeSpaces::build(&mesh, &structure, &params, budget, &AtomicBool::new(cancel));
        built.expect_err("refused")
    };
    let needed = params(6, MASKS, 3).bytes_at_most(mesh.primitive_count());
    let error = refuse(params(6, MASKS, 3), needed - 1, false).to_string();
    assert!(error.contains(&needed.to_string()), "{error}");
    assert!(refuse(params(6, MASKS, 13), BUDGET, false).to_string().contains("depth is 13"));
    let classes = Payload::Classes { layout: ClassLayout::Table, resolution: 32 };
    assert!(refuse(params(6, classes, 1), BUDGET, false).to_string().contains("payload is classes"));
    assert!(matches!(refuse(params(6, MASKS, 3), BUDGET, true), BuildError::Cancelled));
    let nodes = Arc::new(spaces(&mesh, &structure, &params(2, MASKS, 1)));
    let other = ball(6, Vec3::ZERO, 1.0);
    let other = Mesh { hash: lightshaft_engine::scene::MeshHash([8; 32]), ..other };
    let scene = SceneAccel::build(vec![build(&other, BuildParams::default())].into_iter().map(Arc::new).collect(), &[]);
    assert!(scene.approximating(vec![Some(nodes)], rules(BouncePolicy::Occlusion)).is_err());
}
