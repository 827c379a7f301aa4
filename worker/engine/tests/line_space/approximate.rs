//! Approximate occlusion: wrong where it may be, less so with more patches, and never elsewhere.

use std::sync::Arc;

use glam::{Affine3A, Vec3};
use lightshaft_engine::accel::line_space::{BinaryBuilder, CastPattern, ClassLayout, LineSpaceParams, Payload};
use lightshaft_engine::accel::{BuildParams, Placement, SceneAccel};
use lightshaft_engine::scene::Mesh;
use lightshaft_engine::trace::{Counters, Ray};

use crate::classes::line_space;
use crate::common::{AcceptAll, Random, ball, build, closest, occluded, place};

/// The bumpy ball, as it is and approximated.
fn scenes(mesh: &Mesh, n: u32, payload: Payload, filtered: bool) -> (SceneAccel, SceneAccel) {
    let structure = Arc::new(build(mesh, BuildParams::default()));
    let space = Arc::new(line_space(mesh, &structure, LineSpaceParams { n, payload }));
    let placements = [Placement { filtered, ..place(Affine3A::from_translation(Vec3::new(3.0, 1.0, -2.0))) }];
    let plain = SceneAccel::build(vec![structure.clone()], &placements);
    let approximate =
        SceneAccel::build(vec![structure], &placements).with_line_spaces(vec![Some(space)]).expect("fits");
    (plain, approximate.approximating_occlusion())
}

/// Rays across the whole scene.
fn crossing(scene: &SceneAccel, count: usize) -> Vec<Ray> {
    let mut random = Random(61);
    let bounds = scene.top().bounds();
    let ray = |_| {
        let origin = bounds.center() + 3.0 * bounds.extent().length() * random.direction();
        Ray::new(origin, bounds.center() + bounds.extent() * (random.point() - 0.5) - origin)
    };
    (0..count).map(ray).collect()
}

/// Shares of the rays that are blocked in truth, blocked as approximated, and taken wrongly.
fn shares((plain, approximate): &(SceneAccel, SceneAccel), rays: &[Ray], may_let_through: bool) -> [f64; 3] {
    let mut found = [0; 3];
    for ray in rays {
        let truth = occluded(plain, ray);
        let blocked = occluded(approximate, ray);
        assert!(blocked || !truth || may_let_through, "{ray:?} is let through");
        assert_eq!(closest(approximate, ray), closest(plain, ray), "nearest hits stay exact");
        [truth, blocked, truth != blocked].iter().zip(&mut found).for_each(|(is, found)| *found += u32::from(*is));
    }
    found.map(|found| f64::from(found) / rays.len() as f64)
}

#[test]
fn more_patches_make_fewer_mistakes_and_none_lets_light_through() {
    let mesh = ball(24, Vec3::ZERO, 1.0);
    let mut last = 1.0;
    for n in [2, 4, 8, 16] {
        let classes = Payload::Classes { layout: ClassLayout::Table, resolution: 64 };
        let scenes = scenes(&mesh, n, classes, false);
        let [_, _, wrong] = shares(&scenes, &crossing(&scenes.0, 20_000), false);
        assert!(wrong < 0.8 * last, "n = {n}: {wrong} after {last}");
        last = wrong;
    }
    assert!(last > 0.0 && last < 0.12, "{last}");
    let masks = Payload::Binary { builder: BinaryBuilder::Masking };
    let scenes = scenes(&mesh, 8, masks, false);
    shares(&scenes, &crossing(&scenes.0, 20_000), false);
}

#[test]
fn coverage_blocks_as_many_rays_as_the_mesh_does() {
    let mesh = ball(24, Vec3::ZERO, 1.0);
    let of = |payload| {
        let scenes = scenes(&mesh, 6, payload, false);
        shares(&scenes, &crossing(&scenes.0, 40_000), true)
    };
    let [truth, by_coverage, _] = of(Payload::Coverage { bits: 8, rays: 64 });
    let [_, by_casting, _] = of(Payload::Binary { builder: BinaryBuilder::Casting(CastPattern::Nine) });
    assert!((by_coverage - truth).abs() < 0.02, "{by_coverage}, not {truth}");
    assert!(by_casting - truth > 2.0 * (by_coverage - truth).abs(), "one bit darkens: {by_casting} for {truth}");
}

#[test]
fn rays_that_start_inside_and_filtered_instances_are_exact() {
    let mesh = ball(24, Vec3::ZERO, 1.0);
    let classes = Payload::Classes { layout: ClassLayout::Table, resolution: 64 };
    let mut random = Random(62);
    let (plain, approximate) = scenes(&mesh, 2, classes, false);
    let bounds = plain.top().bounds();
    for _ in 0..20_000 {
        let ray = Ray::new(bounds.min + bounds.extent() * random.point(), random.direction());
        assert_eq!(occluded(&approximate, &ray), occluded(&plain, &ray), "{ray:?}");
    }
    let (plain, approximate) = scenes(&mesh, 2, classes, true);
    let mut counters = Counters::default();
    for ray in crossing(&plain, 20_000) {
        assert_eq!(approximate.occluded(&ray, &AcceptAll, &mut counters), occluded(&plain, &ray), "{ray:?}");
    }
    assert!(counters.gates.rays() > 0 && counters.gates.approximated == 0);
}
