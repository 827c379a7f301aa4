//! Building, storing and placing structures.

mod common;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use common::*;
use glam::{Affine3A, Mat3, Quat, Vec3};
use lightshaft_engine::accel::{
    BUILDER_VERSION, BuildError, BuildParams, HitFilter, MAX_DEPTH, MeshStructure, Placement, Quality, SceneAccel,
};
use lightshaft_engine::scene::{Mesh, MeshHash};
use lightshaft_engine::trace::{Counters, Hit, Kernels, Ray};
use proptest::prelude::*;

#[test]
fn keys_name_mesh_parameters_and_version() {
    let params = BuildParams { quality: Quality::High, spatial_splits: true };
    let key = params.key(MeshHash([3; 32]));
    assert_eq!((key.mesh, key.kind, key.builder_version), (MeshHash([3; 32]), "bvh", BUILDER_VERSION));
    assert_eq!(key.parameters, "quality=high,spatial_splits=true");
    assert_eq!(BuildParams::default().canonical(), "quality=medium,spatial_splits=false");
}

#[test]
fn odd_meshes_build() {
    let point = Vec3::new(1.0, 2.0, 3.0);
    let same = |count: usize| mesh(vec![point; 3], vec![[0, 1, 2]; count], vec![]);
    let line = (0..300).map(|i| Vec3::X * (i as f32).exp2().min(f32::MAX)).collect::<Vec<_>>();
    let mut flat = soup(500, 0.1, 1);
    flat.positions.iter_mut().for_each(|p| p.y = 4.0);
    let mut huge = soup(500, 0.1, 2);
    huge.positions.iter_mut().for_each(|p| *p = (*p - 0.5) * 3e38 * 1.9);
    let mut far = soup(500, 0.1, 3);
    far.positions.iter_mut().for_each(|p| *p += 1e9);
    let nothing_finite = mesh(vec![Vec3::NAN; 3], vec![[0, 1, 2]; 9], vec![]);
    let growing = mesh(line, (0..298).map(|i| [i, i + 1, i + 2]).collect(), vec![]);
    for mesh in
        [mesh(vec![], vec![], vec![]), same(1), same(100), same(10_000), flat, huge, far, growing, nothing_finite]
    {
        for params in ALL_PARAMS {
            let structure = build(&mesh, params);
            assert!(structure.bvh2().depth() <= MAX_DEPTH);
            let read = MeshStructure::decode(&structure.encode(), &mesh).expect("reads back");
            assert_eq!(read.bvh2(), structure.bvh2());
            let scene = SceneAccel::build(vec![Arc::new(structure)], &[place(Affine3A::IDENTITY)]);
            closest(&scene, &Ray::new(Vec3::ZERO, point));
        }
    }
}

#[test]
fn a_tree_that_wants_to_be_deep_is_kept_within_its_depth() {
    // Each triangle is half as large and half as far as the one before: SAH peels them off one by one.
    let positions = (0..240).flat_map(|i| {
        let scale = 0.5_f32.powi(i / 2);
        [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| (axis + Vec3::ONE) * scale)
    });
    let mesh = mesh(positions.collect(), (0..240).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(), vec![]);
    for params in ALL_PARAMS {
        assert!(build(&mesh, params).bvh2().depth() <= MAX_DEPTH);
    }
}

#[test]
fn what_is_built_does_not_depend_on_the_number_of_threads() {
    let mesh = soup(60_000, 0.03, 4);
    for params in ALL_PARAMS {
        let trees = [1, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| build(&mesh, params))
        });
        assert_eq!(trees[0].bvh2(), trees[1].bvh2(), "{params:?}");
    }
}

#[test]
fn better_quality_costs_less_to_trace() {
    let mesh = soup(20_000, 0.05, 9);
    let cost = |quality, spatial_splits| build(&mesh, BuildParams { quality, spatial_splits }).bvh2().sah_cost();
    let [fast, medium, high] = [Quality::Fast, Quality::Medium, Quality::High].map(|quality| cost(quality, false));
    assert!(medium < fast && high < 0.98 * medium, "{fast} {medium} {high}");
}

#[test]
fn spatial_splits_part_long_triangles() {
    // Among small triangles some long slivers on diagonals, whose boxes hold little else than air.
    let mut mesh = soup(3000, 0.01, 5);
    for triangle in mesh.positions.chunks_mut(3).step_by(30) {
        triangle[2] = triangle[0] + 0.3;
    }
    let [whole, split] =
        [false, true].map(|spatial_splits| build(&mesh, BuildParams { quality: Quality::Medium, spatial_splits }));
    assert_eq!(whole.bvh2().primitives.len(), 3000);
    assert!((3100..=3900).contains(&split.bvh2().primitives.len()), "{}", split.bvh2().primitives.len());
    let ratio = split.bvh2().sah_cost() / whole.bvh2().sah_cost();
    assert!(ratio < 0.98, "cost is {ratio} of what it is without");
    let scenes = [whole, split].map(|s| SceneAccel::build(vec![Arc::new(s)], &[place(Affine3A::IDENTITY)]));
    let mut random = Random(6);
    for _ in 0..20_000 {
        let ray = random_ray(&mut random, &mesh.bounds);
        assert_eq!(closest(&scenes[0], &ray), closest(&scenes[1], &ray), "{ray:?}");
    }
}

#[test]
fn a_cancelled_build_stops() {
    let mesh = soup(3000, 0.01, 7);
    for params in ALL_PARAMS {
        let result = MeshStructure::build(&mesh, &params, &AtomicBool::new(true));
        assert!(matches!(result, Err(BuildError::Cancelled)), "{params:?}");
    }
}

#[test]
fn validation_finds_a_mesh_that_is_not_the_one_built_over() {
    let mesh = soup(100, 0.2, 8);
    let structure = build(&mesh, BuildParams::default());
    let mut moved = mesh.clone();
    moved.positions[17] += 0.5;
    assert!(structure.validate(&moved).expect_err("moved").contains("primitive 5"));
    let mut longer = mesh.clone();
    longer.triangles.push([0, 1, 2]);
    assert!(structure.validate(&longer).is_err());
    let other = Mesh { hash: MeshHash([9; 32]), ..mesh };
    assert!(structure.validate(&other).expect_err("other").contains("0909"));
}

#[test]
fn stored_structures_that_are_damaged_are_refused() {
    let mesh = soup(60, 0.3, 10);
    let bytes = build(&mesh, BuildParams::default()).encode();
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        assert!(MeshStructure::decode(&damaged, &mesh).is_err(), "byte {at}");
    }
    for length in [0, 5, 79, 80, bytes.len() - 1] {
        assert!(MeshStructure::decode(&bytes[..length], &mesh).is_err(), "cut to {length}");
    }
    let other = Mesh { hash: MeshHash([9; 32]), ..mesh };
    let error = MeshStructure::decode(&bytes, &other).expect_err("another mesh").to_string();
    assert!(error.starts_with("corrupt structure: it is for mesh 0707"), "{error}");
}

#[test]
fn indices_are_checked_even_under_a_good_checksum() {
    // What a malicious cache could hold: any word of the arrays replaced, and the checksum made to match.
    let mesh = soup(40, 0.3, 11);
    let bytes = build(&mesh, BuildParams::default()).encode();
    let mut random = Random(12);
    let mut refused = 0;
    for word in (80..bytes.len()).step_by(4) {
        for value in [0, 1, 7, 0x7fff_ffff, u32::MAX, random.next() as u32 % 64, random.next() as u32] {
            let mut forged = bytes.clone();
            forged[word..word + 4].copy_from_slice(&value.to_le_bytes());
            let mut hasher = blake3::Hasher::new();
            hasher.update(&forged[..48]).update(&forged[80..]);
            forged[48..80].copy_from_slice(hasher.finalize().as_bytes());
            match MeshStructure::decode(&forged, &mesh) {
                Err(_) => refused += 1,
                // Only boxes or the choice of primitives are wrong: hits may be, but nothing else.
                Ok(structure) => {
                    let scene = SceneAccel::build(vec![Arc::new(structure)], &[place(Affine3A::IDENTITY)]);
                    for _ in 0..5 {
                        closest(&scene, &random_ray(&mut random, &mesh.bounds));
                    }
                }
            }
        }
    }
    assert!(refused > 100, "{refused}");
}

/// The same instances as one mesh in world space.
fn flatten(meshes: &[Mesh], placements: &[Placement]) -> (Mesh, Vec<u32>) {
    let (mut positions, mut triangles, mut first) = (vec![], vec![], vec![]);
    for placement in placements {
        let (from, base) = (&meshes[placement.mesh as usize], positions.len() as u32);
        first.push(triangles.len() as u32);
        positions.extend(from.positions.iter().map(|&p| placement.transform.transform_point3(p)));
        triangles.extend(from.triangles.iter().map(|t| t.map(|v| v + base)));
    }
    (mesh(positions, triangles, vec![]), first)
}

fn random_transform(random: &mut Random) -> Affine3A {
    let mut scale = 0.2 + random.point();
    if random.next().is_multiple_of(3) {
        scale.x = -scale.x;
    }
    let turn = Quat::from_axis_angle(random.direction(), 6.0 * random.unit());
    Affine3A::from_scale_rotation_translation(scale, turn, 6.0 * random.point())
}

#[test]
fn two_levels_find_what_one_flat_mesh_holds() {
    let meshes = [soup(200, 0.3, 1), ball(6, Vec3::splat(0.5), 0.5), soup(1, 1.0, 2)];
    let structures: Vec<_> = meshes.iter().map(|mesh| Arc::new(build(mesh, BuildParams::default()))).collect();
    let mut random = Random(77);
    for count in [1, 2, 9, 150] {
        let placements: Vec<_> = (0..count)
            .map(|i| Placement { mesh: i % 3, transform: random_transform(&mut random), filtered: false })
            .collect();
        let (flat, first) = flatten(&meshes, &placements);
        let flat_scene = scene(&flat, BuildParams::default());
        for kernels in Kernels::available() {
            let scene = SceneAccel::build(structures.clone(), &placements).with_kernels(kernels);
            let mut hits = 0;
            let mut close_calls = 0;
            for _ in 0..5000 {
                let ray = random_ray(&mut random, &flat.bounds);
                let (expected, found) = (closest(&flat_scene, &ray), closest(&scene, &ray));
                assert_eq!(found.is_some(), occluded(&scene, &ray));
                hits += usize::from(found.is_some());
                let same = match (expected, found) {
                    (Some(a), Some(b)) => {
                        first[b.instance as usize] + b.primitive == a.primitive
                            && (a.t - b.t).abs() < 1e-3 * a.t.max(1e-2)
                    }
                    (a, b) => a.is_none() && b.is_none(),
                };
                close_calls += usize::from(!same);
            }
            assert!(hits > 50 && close_calls <= 10, "{hits} hits, {close_calls} differences");
        }
    }
}

#[test]
fn instances_without_volume_are_left_out() {
    let mesh = ball(6, Vec3::ZERO, 1.0);
    let structure = Arc::new(build(&mesh, BuildParams::default()));
    let flat = Affine3A::from_mat3(Mat3::from_diagonal(Vec3::new(1.0, 0.0, 1.0)));
    let broken = Affine3A::from_translation(Vec3::new(f32::NAN, 0.0, 0.0));
    let good = Affine3A::from_translation(Vec3::Z * 5.0);
    let scene = SceneAccel::build(vec![structure.clone()], &[place(flat), place(broken), place(good)]);
    let hit = closest(&scene, &Ray::new(Vec3::NEG_Z * 3.0, Vec3::Z)).expect("the good one");
    assert_eq!(hit.instance, 2);
    assert_eq!(closest(&SceneAccel::build(vec![structure], &[]), &Ray::new(Vec3::ZERO, Vec3::Z)), None);
}

#[test]
fn of_instances_in_one_place_the_lowest_counts() {
    let mesh = soup(50, 0.5, 3);
    let structure = Arc::new(build(&mesh, BuildParams::default()));
    let scene = SceneAccel::build(vec![structure], &[place(Affine3A::from_translation(Vec3::X)); 20]);
    let mut random = Random(5);
    let hits =
        (0..500).filter_map(|_| closest(&scene, &Ray::new(random.point() + Vec3::X + Vec3::Z * 4.0, Vec3::NEG_Z)));
    assert!(hits.map(|hit| assert_eq!(hit.instance, 0)).count() > 50);
}

#[test]
fn filters_are_asked_in_world_space_and_only_for_their_instances() {
    struct NoEvenPrimitives;
    impl HitFilter for NoEvenPrimitives {
        fn accept(&self, ray: &Ray, hit: &Hit) -> bool {
            assert_eq!(ray.origin.z, -10.0);
            assert_eq!(hit.instance, 1);
            hit.primitive % 2 == 1
        }
    }
    // Four squares one behind the other, in steps of one.
    let positions =
        (0..4).flat_map(|z| [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]].map(|[x, y]| Vec3::new(x, y, z as f32)));
    let mesh = mesh(positions.collect(), (0..4).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(), vec![]);
    let structure = Arc::new(build(&mesh, BuildParams::default()));
    let double = Affine3A::from_scale(Vec3::splat(2.0));
    let behind = Affine3A::from_translation(Vec3::Z * 3.0);
    let placements = [place(behind), Placement { filtered: true, ..place(double) }];
    for kernels in Kernels::available() {
        let scene = SceneAccel::build(vec![structure.clone()], &placements).with_kernels(kernels);
        let ray = Ray::new(Vec3::new(0.0, 0.0, -10.0), Vec3::Z);
        let hit = scene.closest(&ray, &NoEvenPrimitives, &mut Counters::default()).expect("hits");
        // Squares at z = 0, 2, 4, 6 of which 0 and 4 are holes, and others at z = 3, 4, 5, 6.
        assert_eq!((hit.t, hit.instance, hit.primitive), (12.0, 1, 1));
        let within = |t_min, t_max| Ray { t_min, t_max, ..ray };
        let occluded = |ray: Ray| scene.occluded(&ray, &NoEvenPrimitives, &mut Counters::default());
        assert!(!occluded(within(0.0, 11.0)) && occluded(within(0.0, 12.5)) && occluded(within(12.5, 13.5)));
    }
}

#[test]
fn ten_thousand_instances_are_placed() {
    let mesh = ball(12, Vec3::ZERO, 0.5);
    let structure = Arc::new(build(&mesh, BuildParams::default()));
    let mut random = Random(3);
    let placements: Vec<_> = (0..10_000).map(|_| place(random_transform(&mut random))).collect();
    let scene = SceneAccel::build(vec![structure], &placements);
    assert_eq!(scene.top().primitives.len(), 10_000);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn random_soups_agree_between_builders_and_kernels(
        seed in any::<u64>(), count in 1_usize..120, size in 0.01_f32..1.5, exponent in -20_i32..20,
    ) {
        let mut mesh = soup(count, size, seed);
        let scale = 2.0_f32.powi(exponent);
        mesh.positions.iter_mut().for_each(|p| *p *= scale);
        mesh.bounds.min *= scale;
        mesh.bounds.max *= scale;
        let scenes: Vec<_> = ALL_PARAMS.into_iter().flat_map(|params| scenes(&mesh, params)).collect();
        let mut random = Random(seed);
        for _ in 0..60 {
            let ray = random_ray(&mut random, &mesh.bounds);
            let found = closest(&scenes[0], &ray);
            if let (Some(hit), Some((t, ..))) = (found, oracle(&mesh, &ray)) {
                prop_assert!((f64::from(hit.t) - t).abs() <= 1e-3 * t.max(1e-2), "{} instead of {t}", hit.t);
            }
            for scene in &scenes {
                prop_assert_eq!(closest(scene, &ray), found);
                prop_assert_eq!(occluded(scene, &ray), found.is_some());
            }
        }
    }
}
