//! What the tri-state payload claims, attacked.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, DVec3, Quat, Vec3};
use lightshaft_engine::accel::line_space::shaft::{DILATION, symmetric_count, symmetric_patches};
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CastPattern, Class, ClassLayout, GateCounters, LineSpace, LineSpaceParams, Patch, Payload, Shafts,
};
use lightshaft_engine::accel::{BuildParams, MeshStructure, Placement, SceneAccel};
use lightshaft_engine::scene::{Mesh, Sphere};
use lightshaft_engine::trace::{Counters, Hit, Ray};

use crate::common::{AcceptAll, Random, ball, build, closest, hard_ray, mesh, occluded, place, random_ray};
use crate::meshes;

pub(crate) const BUDGET: u64 = 1 << 30;

pub(crate) fn line_space(mesh: &Mesh, structure: &MeshStructure, params: LineSpaceParams) -> LineSpace {
    LineSpace::build(mesh, structure, &params, BUDGET, &AtomicBool::new(false)).expect("builds")
}

fn classes(n: u32, layout: ClassLayout, resolution: u32) -> LineSpaceParams {
    LineSpaceParams { n, payload: Payload::Classes { layout, resolution } }
}

/// How many shafts are EMPTY, OPAQUE and MIXED.
fn census(space: &LineSpace) -> [u32; 3] {
    let n = space.params().n;
    let mut found = [0; 3];
    for index in 0..symmetric_count(n) as u32 {
        let (a, b) = symmetric_patches(n, index);
        found[space.class(a, b) as usize] += 1;
    }
    found
}

/// A line from a point on one patch, grown by most of what shafts are grown by, to one on the other.
fn line_of(space: &LineSpace, a: Patch, b: Patch, random: &mut Random) -> Ray {
    let grid = space.grid().expect("has a grid");
    let mut point = |patch: Patch| {
        let [low, high] = patch.unit_bounds(grid.n());
        let grown = [low - 0.4 * DILATION, high + 0.4 * DILATION];
        let part = DVec3::from_array([(); 3].map(|()| match random.next() % 8 {
            0 => 0.0,
            1 => 1.0,
            _ => f64::from(random.unit()),
        }));
        grid.from_unit(grown[0] + part * (grown[1] - grown[0]))
    };
    let (from, to) = (point(a), point(b));
    Ray { origin: from.as_vec3(), t_min: 0.0, direction: (to - from).as_vec3(), t_max: 1.0 }
}

#[test]
fn every_line_of_a_decided_shaft_does_what_its_class_says() {
    let mut random = Random(21);
    let mut attacked = [0; 3];
    for (name, mesh) in meshes::all() {
        let structure = Arc::new(build(&mesh, BuildParams::default()));
        let space = line_space(&mesh, &structure, classes(8, ClassLayout::Tree, 64));
        let scene = SceneAccel::build(vec![structure], &[place(Affine3A::IDENTITY)]);
        if space.grid().is_none() {
            continue;
        }
        let mut left = [4, 4];
        for _ in 0..20_000 {
            let index = (random.next() % symmetric_count(8)) as u32;
            let (a, b) = symmetric_patches(8, index);
            let class = space.class(a, b);
            // 10,000 lines for some shafts, a few for all others.
            let lines = match left.get_mut(class as usize) {
                None => continue,
                Some(0) => 4,
                Some(left) => {
                    *left -= 1;
                    10_000
                }
            };
            attacked[class as usize] += lines;
            for _ in 0..lines {
                let ray = line_of(&space, a, b, &mut random);
                assert_eq!(occluded(&scene, &ray), class == Class::Opaque, "{name}: {ray:?} from {a:?} to {b:?}");
            }
        }
    }
    assert!(attacked[0] > 500_000 && attacked[1] > 300_000, "only {attacked:?} lines: the test says little");
}

#[test]
fn closed_meshes_are_mostly_decided() {
    for (name, mesh) in meshes::all() {
        let structure = build(&mesh, BuildParams::default());
        let [empty, opaque, mixed] = census(&line_space(&mesh, &structure, classes(16, ClassLayout::Tree, 64)));
        let all = f64::from(empty + opaque + mixed);
        let share = |part: u32| f64::from(part) / all;
        match name {
            "ball" | "huge ball" | "tiny ball" | "balls through each other" | "ball in a ball" | "spheres" => {
                assert!(
                    share(empty) > 0.1 && share(opaque) > 0.3 && share(mixed) < 0.4,
                    "{name}: {empty} {opaque} {mixed}"
                );
            }
            "box" => assert!(share(opaque) > 0.5, "{name}: {empty} {opaque} {mixed}"),
            "flat quad" | "one triangle" | "turned quad" => {
                assert!(opaque > 0 && empty > 0, "{name}: {empty} {opaque} {mixed}")
            }
            "dust" => assert_eq!(opaque, 0),
            _ => assert!(empty > 0, "{name}: {empty} {opaque} {mixed}"),
        }
    }
}

#[test]
fn trees_answer_as_tables_do() {
    for (name, mesh) in meshes::all() {
        let structure = build(&mesh, BuildParams::default());
        // The finest takes its time, and one mesh shows as much of it as all.
        let sizes = if name == "torn ball" { &[4, 8, 16][..] } else { &[4, 8][..] };
        for &n in sizes {
            let tree = line_space(&mesh, &structure, classes(n, ClassLayout::Tree, 32));
            let table = line_space(&mesh, &structure, classes(n, ClassLayout::Table, 32));
            for index in 0..symmetric_count(n) as u32 {
                let (a, b) = symmetric_patches(n, index);
                assert_eq!(tree.class(a, b), table.class(b, a), "{name}: {a:?} {b:?}");
            }
        }
    }
}

#[test]
fn finer_shafts_know_what_coarser_ones_know() {
    let mesh = ball(12, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    // Not a multiple of 4: each shaft is classified for itself.
    for n in [1, 2, 3, 5] {
        let coarse = line_space(&mesh, &structure, classes(n, ClassLayout::Table, 64));
        let fine = line_space(&mesh, &structure, classes(2 * n, ClassLayout::Table, 64));
        for index in 0..symmetric_count(2 * n) as u32 {
            let (a, b) = symmetric_patches(2 * n, index);
            let known = coarse.class(a.coarser(1), b.coarser(1));
            assert!(known == Class::Mixed || fine.class(a, b) == known, "{a:?} {b:?}");
        }
    }
}

#[test]
fn empty_by_layers_is_empty_by_clipping_and_clipping_is_masked() {
    for (name, mesh) in meshes::all() {
        let structure = build(&mesh, BuildParams::default());
        for n in [1, 3, 4] {
            let binary = |builder| {
                let space = line_space(&mesh, &structure, LineSpaceParams { n, payload: Payload::Binary { builder } });
                match space.shafts() {
                    Some(Shafts::Binary(binary)) => Some(binary.clone()),
                    _ => None,
                }
            };
            let layered = line_space(&mesh, &structure, classes(n, ClassLayout::Table, 64));
            let Some(clipped) = binary(BinaryBuilder::Clipping) else { continue };
            let masked = binary(BinaryBuilder::Masking).expect("has a grid");
            let centre = binary(BinaryBuilder::Casting(CastPattern::Centre)).expect("has a grid");
            let nine = binary(BinaryBuilder::Casting(CastPattern::Nine)).expect("has a grid");
            for index in 0..symmetric_count(n) as u32 {
                let (a, b) = symmetric_patches(n, index);
                let is_clipped = clipped.is_marked(a, b);
                // Of spheres, clipping only knows the hull's planes.
                let is_empty = layered.class(a, b) == Class::Empty && mesh.spheres.is_empty();
                assert!(!(is_empty && is_clipped), "{name}: EMPTY {a:?} {b:?}");
                assert!(layered.class(a, b) != Class::Opaque || is_clipped, "{name}: OPAQUE {a:?} {b:?}");
                assert!(!is_clipped || masked.is_marked(a, b), "{name}: not masked {a:?} {b:?}");
                assert!(!centre.is_marked(a, b) || nine.is_marked(a, b), "{name}: fewer of nine {a:?} {b:?}");
                assert!(!nine.is_marked(a, b) || is_clipped, "{name}: hit in {a:?} {b:?}");
            }
        }
    }
}

/// Instances of all meshes, turned, mirrored, stretched and through each other.
fn crowd(seed: u64) -> (Vec<Mesh>, Vec<Placement>) {
    let mut random = Random(seed);
    let meshes: Vec<Mesh> = meshes::all()
        .into_iter()
        .filter(|(name, _)| !["huge ball", "tiny ball", "far ball"].contains(name))
        .map(|(_, mesh)| mesh)
        .collect();
    let placements = (0..60)
        .map(|i| {
            let mut scale = 0.4 + 1.2 * random.point();
            if i % 5 == 0 {
                scale.x = -scale.x;
            }
            let turn = Quat::from_axis_angle(random.direction(), 6.0 * random.unit());
            let transform = Affine3A::from_scale_rotation_translation(scale, turn, 6.0 * random.point());
            Placement { mesh: i % meshes.len() as u32, transform, filtered: i % 7 == 0 }
        })
        .collect();
    (meshes, placements)
}

#[test]
fn gated_scenes_answer_bit_for_bit_as_without_gates() {
    let (meshes, placements) = crowd(31);
    let structures: Vec<_> = meshes.iter().map(|mesh| Arc::new(build(mesh, BuildParams::default()))).collect();
    let plain = SceneAccel::build(structures.clone(), &placements);
    let bounds = plain.top().bounds();
    let masks = LineSpaceParams { n: 4, payload: Payload::Binary { builder: BinaryBuilder::Masking } };
    for params in [classes(8, ClassLayout::Tree, 32), classes(6, ClassLayout::Table, 32), masks] {
        let gates =
            meshes.iter().zip(&structures).map(|(mesh, structure)| Some(Arc::new(line_space(mesh, structure, params))));
        let gated = SceneAccel::build(structures.clone(), &placements)
            .with_line_spaces(gates.collect())
            .expect("one for each structure");
        let mut random = Random(32);
        let mut counters = Counters::default();
        for i in 0..30_000 {
            let mut ray = random_ray(&mut random, &bounds);
            if i % 4 == 0 {
                ray.t_max = f32::INFINITY;
                ray.origin -= ray.direction;
            }
            let found = gated.closest(&ray, &AcceptAll, &mut counters);
            assert_eq!(found, closest(&plain, &ray), "{ray:?}");
            let blocked = gated.occluded(&ray, &AcceptAll, &mut counters);
            assert_eq!(blocked, occluded(&plain, &ray), "{ray:?}");
            assert_eq!(blocked, found.is_some());
        }
        let GateCounters { full_chord, starts_inside, .. } = counters.gates;
        let least = |class: usize| if params == masks { [50, 0, 5000][class] } else { 5000 };
        assert!((0..3).all(|class| full_chord[class] >= least(class)), "{params:?}: {full_chord:?}");
        assert!(starts_inside > 1000);
    }
}

#[test]
fn hard_rays_meet_gates_as_they_meet_meshes() {
    let mut random = Random(41);
    for (name, mesh) in meshes::all() {
        let structure = Arc::new(build(&mesh, BuildParams::default()));
        let space = Arc::new(line_space(&mesh, &structure, classes(8, ClassLayout::Tree, 32)));
        let Some(&grid) = space.grid() else { continue };
        let placement = [place(Affine3A::IDENTITY)];
        let plain = SceneAccel::build(vec![structure.clone()], &placement);
        let gated = SceneAccel::build(vec![structure], &placement).with_line_spaces(vec![Some(space)]).expect("fits");
        for _ in 0..10_000 {
            let ray = hard_ray(&mut random, &grid, &mesh.bounds);
            assert_eq!(closest(&gated, &ray), closest(&plain, &ray), "{name}: {ray:?}");
            assert_eq!(occluded(&gated, &ray), occluded(&plain, &ray), "{name}: {ray:?}");
        }
    }
}

#[test]
fn filtered_instances_are_never_opaque() {
    struct Glass;
    impl lightshaft_engine::accel::HitFilter for Glass {
        fn accept(&self, _: &Ray, _: &Hit) -> bool {
            false
        }
    }
    let mesh = ball(12, Vec3::ZERO, 1.0);
    let structure = Arc::new(build(&mesh, BuildParams::default()));
    let space = Arc::new(line_space(&mesh, &structure, classes(8, ClassLayout::Tree, 64)));
    let placement = Placement { filtered: true, ..place(Affine3A::IDENTITY) };
    let scene = SceneAccel::build(vec![structure], &[placement]).with_line_spaces(vec![Some(space)]).expect("fits");
    let ray = Ray::new(Vec3::new(0.1, 0.2, -5.0), Vec3::Z);
    let mut counters = Counters::default();
    assert!(!scene.occluded(&ray, &Glass, &mut counters));
    assert!(scene.occluded(&ray, &AcceptAll, &mut counters));
    assert_eq!(counters.gates.full_chord, [0, 2, 0]);
}

#[test]
fn line_spaces_of_other_meshes_are_refused() {
    let one = ball(6, Vec3::ZERO, 1.0);
    let other = Mesh { hash: lightshaft_engine::scene::MeshHash([8; 32]), ..one.clone() };
    let structures = [&one, &other].map(|mesh| Arc::new(build(mesh, BuildParams::default())));
    let space = Arc::new(line_space(&one, &structures[0], classes(4, ClassLayout::Tree, 16)));
    let scene = || SceneAccel::build(vec![structures[1].clone()], &[place(Affine3A::IDENTITY)]);
    let error = scene().with_line_spaces(vec![Some(space)]).expect_err("another mesh");
    assert!(error.contains("0707") && error.contains("0808"), "{error}");
    let error = scene().with_line_spaces(vec![]).expect_err("too few");
    assert!(error.contains("0 line spaces for 1"), "{error}");
}

#[test]
fn spheres_block_as_closed_surfaces() {
    let ball = mesh(vec![], vec![], vec![Sphere { center: Vec3::ONE, radius: 0.5, slot: 0 }]);
    let structure = build(&ball, BuildParams::default());
    let [empty, opaque, mixed] = census(&line_space(&ball, &structure, classes(8, ClassLayout::Tree, 128)));
    assert!(opaque * 5 > empty + opaque + mixed, "{empty} {opaque} {mixed}");
}
