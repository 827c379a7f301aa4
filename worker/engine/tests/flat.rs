//! Trees of cells, and scenes as one structure: every form finds what every other finds, to the last bit.

mod common;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use common::*;
use glam::{Affine3A, Quat, Vec3};
use lightshaft_engine::accel::line_space::MAX_MASK_N;
use lightshaft_engine::accel::{
    BuildError, BuildParams, CellShaftParams, CellShafts, CellTree, GridParams, GridResolution, HitFilter, NTreeParams,
    OctreeParams, Placement, SceneAccel, Structure, StructureParams, flat_hash, flatten,
};
use lightshaft_engine::scene::{Mesh, MeshHash, Sphere};
use lightshaft_engine::trace::{Counters, Hit, Kernels, Ray};
use proptest::prelude::*;

const BUDGET: u64 = 1 << 30;

fn grid(resolution: GridResolution) -> StructureParams {
    StructureParams::Grid(GridParams { resolution, budget_bytes: BUDGET })
}

fn octree(depth: u32, max_leaf: u32) -> StructureParams {
    StructureParams::Octree(OctreeParams { depth, max_leaf, budget_bytes: BUDGET })
}

fn ntree(n: u32, depth: u32, max_leaf: u32) -> StructureParams {
    StructureParams::NTree(NTreeParams { n, depth, max_leaf, budget_bytes: BUDGET })
}

fn all_params() -> Vec<StructureParams> {
    vec![
        grid(GridResolution::PerPrimitive(4)),
        grid(GridResolution::Cells([1; 3])),
        grid(GridResolution::Cells([7, 1, 13])),
        octree(1, 1),
        octree(7, 3),
        octree(16, 6),
        ntree(2, 6, 2),
        ntree(3, 4, 1),
        ntree(5, 2, 0),
        ntree(6, 3, 4),
        ntree(16, 1, 1),
        ntree(16, 2, 8),
    ]
}

fn build_any(mesh: &Mesh, params: &StructureParams) -> Structure {
    let structure = Structure::build(mesh, params, &AtomicBool::new(false)).expect("builds");
    structure.validate(mesh).unwrap_or_else(|error| panic!("{params:?}: {error}"));
    structure
}

/// The mesh alone, where it is, in each structure and for each of this CPU's kernels; the BVH first.
fn all_scenes(mesh: &Mesh) -> Vec<(StructureParams, SceneAccel)> {
    let bvh = StructureParams::Bvh(BuildParams::default());
    let mut scenes = vec![];
    for params in std::iter::once(bvh).chain(all_params()) {
        let structure = build_any(mesh, &params);
        for kernels in Kernels::available() {
            let scene = SceneAccel::build(vec![structure.clone()], &[place(Affine3A::IDENTITY)]);
            scenes.push((params, scene.with_kernels(kernels)));
        }
        let StructureParams::NTree(NTreeParams { n, .. }) = params else { continue };
        for patches in [Some(n.min(MAX_MASK_N)), None] {
            for kernels in Kernels::available() {
                scenes.push((params, gated(mesh, &params, patches, kernels)));
            }
        }
    }
    scenes
}

/// The same in an N-tree with the Line Spaces of all of its nodes.
fn gated(mesh: &Mesh, params: &StructureParams, patches: Option<u32>, kernels: Kernels) -> SceneAccel {
    let (flat, names) = flatten(&[Arc::new(mesh.clone())], &[place(Affine3A::IDENTITY)]).expect("flattens");
    let structure = build_any(&flat, params);
    let tree = structure.cells().expect("a tree of cells");
    let shafts = cell_shafts(tree, CellShaftParams { levels: tree.levels(), patches });
    let scene = SceneAccel::flat(structure, names).with_cell_shafts(Arc::new(shafts)).expect("of this tree");
    scene.with_kernels(kernels)
}

fn cell_shafts(tree: &CellTree, params: CellShaftParams) -> CellShafts {
    CellShafts::build(tree, &params, BUDGET, &AtomicBool::new(false)).expect("builds")
}

/// Random rays, rays through corners and along edges of cells, and rays that start far away.
fn rays(mesh: &Mesh, count: usize, seed: u64) -> Vec<Ray> {
    let mut random = Random(seed);
    let bounds = mesh.bounds;
    (0..count)
        .map(|i| {
            let ray = random_ray(&mut random, &bounds);
            match i % 6 {
                0 => {
                    // Between lattice points of the box: through corners, and along planes where an axis agrees.
                    let lattice_point = |random: &mut Random| {
                        let steps = Vec3::from_array([(); 3].map(|()| (random.next() % 13) as f32 / 12.0));
                        bounds.min + steps * bounds.extent()
                    };
                    let (from, to) = (lattice_point(&mut random), lattice_point(&mut random));
                    Ray::new(from, if from == to { Vec3::X } else { to - from })
                }
                1 => {
                    let far = 1.0 + 1000.0 * random.unit() * random.unit();
                    Ray { origin: ray.origin - far * ray.direction, ..ray }
                }
                2 => Ray { t_min: 0.3 * random.unit(), ..ray },
                _ => ray,
            }
        })
        .collect()
}

fn assert_same_hits(mesh: &Mesh, count: usize, seed: u64) {
    let scenes = all_scenes(mesh);
    let mut hits = 0;
    for ray in rays(mesh, count, seed) {
        let expected = closest(&scenes[0].1, &ray);
        hits += usize::from(expected.is_some());
        for (params, scene) in &scenes {
            assert_eq!(closest(scene, &ray), expected, "{params:?} differs on {ray:?}");
            assert_eq!(occluded(scene, &ray), expected.is_some(), "any-hit of {params:?} differs on {ray:?}");
        }
    }
    assert!(hits > count / 40, "only {hits} of {count} rays hit anything: the test says little");
}

#[test]
fn soups_of_all_sizes_have_the_same_hits() {
    for (count, size, seed) in [(1, 1.0, 1), (3, 0.8, 2), (40, 0.5, 3), (900, 0.15, 4), (5000, 0.03, 5)] {
        assert_same_hits(&soup(count, size, seed), 2000, seed);
    }
}

#[test]
fn spheres_and_closed_surfaces_have_the_same_hits() {
    let triangles = soup(300, 0.2, 8);
    assert_same_hits(&mesh(triangles.positions, triangles.triangles, spheres(300, 0.05, 9)), 2000, 13);
    assert_same_hits(&mesh(vec![], vec![], spheres(500, 0.06, 3)), 2000, 14);
    assert_same_hits(&ball(24, Vec3::new(0.3, -0.2, 5.0), 2.0), 2000, 15);
}

#[test]
fn extreme_places_and_sizes_have_the_same_hits() {
    for (scale, offset) in [(1e-12_f32, 0.0), (1e-6, 0.0), (1e6, 0.0), (1e12, 0.0), (1.0, 1e4), (1e-3, -30.0)] {
        let mut mesh = soup(300, 0.3, 21);
        mesh.positions.iter_mut().for_each(|p| *p = scale * *p + offset);
        mesh.bounds.min = scale * mesh.bounds.min + offset;
        mesh.bounds.max = scale * mesh.bounds.max + offset;
        assert_same_hits(&mesh, 1200, 16);
    }
}

#[test]
fn flat_walls_on_the_planes_of_cells_have_the_same_hits() {
    // Axis-parallel squares at multiples of an eighth, some of them twice.
    let mut positions = vec![];
    let mut triangles = vec![];
    for i in 0..9 {
        for axis in 0..3 {
            let at = i as f32 / 8.0;
            let base = positions.len() as u32;
            for (u, v) in [(0.0, 0.0), (1.0, 0.0), (1.0, 0.75), (0.0, 0.75)] {
                let mut corner = Vec3::ZERO;
                corner[axis] = at;
                corner[(axis + 1) % 3] = u;
                corner[(axis + 2) % 3] = v;
                positions.push(corner);
            }
            triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
            if i % 2 == 0 {
                triangles.push([base, base + 1, base + 2]);
            }
        }
    }
    assert_same_hits(&mesh(positions, triangles, vec![]), 3000, 17);
}

#[test]
fn odd_meshes_build_and_are_read_back() {
    let point = Vec3::new(1.0, 2.0, 3.0);
    let same = |count: usize| mesh(vec![point; 3], vec![[0, 1, 2]; count], vec![]);
    let mut plane = soup(200, 0.1, 1);
    plane.positions.iter_mut().for_each(|p| p.y = 4.0);
    let line =
        mesh((0..30).map(|i| Vec3::X * i as f32).collect(), (0..28).map(|i| [i, i + 1, i + 2]).collect(), vec![]);
    let nothing_finite = mesh(vec![Vec3::NAN; 3], vec![[0, 1, 2]; 9], vec![]);
    let dot = Sphere { center: point, radius: 0.0, slot: 0 };
    for mesh in [
        mesh(vec![], vec![], vec![]),
        mesh(vec![], vec![], vec![dot]),
        same(1),
        same(100),
        plane,
        line,
        nothing_finite,
        soup(500, 0.2, 3),
    ] {
        for params in all_params() {
            let structure = build_any(&mesh, &params);
            let stored = structure.encode();
            let read = params.decode(&stored, &mesh).expect("reads back");
            read.validate(&mesh).expect("is valid");
            assert_eq!(read.encode(), stored);
            assert_eq!((read.bytes(), read.node_count()), (structure.bytes(), structure.node_count()));
            let scene = SceneAccel::build(vec![read], &[place(Affine3A::IDENTITY)]);
            closest(&scene, &Ray::new(Vec3::ZERO, point));
        }
    }
}

#[test]
fn stored_trees_that_are_damaged_are_refused() {
    let mesh = soup(60, 0.3, 10);
    let params = ntree(4, 2, 2);
    let bytes = build_any(&mesh, &params).encode();
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        assert!(params.decode(&damaged, &mesh).is_err(), "byte {at}");
    }
    let other = Mesh { hash: MeshHash([9; 32]), ..mesh.clone() };
    assert!(params.decode(&bytes, &other).expect_err("other").to_string().contains("it is for mesh"));
    let bvh = StructureParams::Bvh(BuildParams::default());
    assert!(bvh.decode(&bytes, &mesh).expect_err("another kind").to_string().contains("LSHTBVH2"));
}

#[test]
fn damage_under_a_right_checksum_never_panics() {
    // As a hostile worker could publish it: every index may be anything.
    let mesh = soup(40, 0.3, 11);
    let params = [ntree(3, 2, 2), grid(GridResolution::PerPrimitive(2))];
    let mut random = Random(12);
    for params in params {
        let bytes = build_any(&mesh, &params).encode();
        for _ in 0..1500 {
            let mut damaged = bytes.clone();
            let at = 80 + random.next() as usize % (bytes.len() - 80);
            damaged[at] = random.next() as u8;
            let mut hasher = blake3::Hasher::new();
            hasher.update(&damaged[..48]).update(&damaged[80..]);
            damaged[48..80].copy_from_slice(hasher.finalize().as_bytes());
            if let Ok(read) = params.decode(&damaged, &mesh) {
                let scene = SceneAccel::build(vec![read], &[place(Affine3A::IDENTITY)]);
                for _ in 0..4 {
                    closest(&scene, &random_ray(&mut random, &mesh.bounds));
                }
            }
        }
    }
}

#[test]
fn validation_finds_a_mesh_that_is_not_the_one_built_over() {
    let mesh = soup(100, 0.1, 8);
    let structure = build_any(&mesh, &ntree(8, 2, 4));
    let mut moved = mesh.clone();
    moved.positions[15..18].iter_mut().for_each(|p| p.x = (p.x + 0.5).fract());
    assert!(structure.validate(&moved).expect_err("moved").contains("primitive 5"));
}

#[test]
fn what_is_built_does_not_depend_on_the_number_of_threads() {
    let mesh = soup(30_000, 0.03, 4);
    for params in [grid(GridResolution::PerPrimitive(8)), octree(8, 4), ntree(6, 3, 8)] {
        let built = [1, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| build_any(&mesh, &params)).encode()
        });
        assert!(built[0] == built[1], "{params:?}");
    }
}

#[test]
fn a_tree_over_its_budget_is_refused_with_the_figure() {
    let mesh = soup(2000, 0.1, 3);
    let error = |params| match Structure::build(&mesh, &params, &AtomicBool::new(false)) {
        Err(BuildError::Unsupported(why)) => why,
        other => panic!("{other:?}"),
    };
    let budget_bytes = 1 << 20;
    let grid = GridParams { resolution: GridResolution::Cells([400; 3]), budget_bytes };
    let why = error(StructureParams::Grid(grid));
    assert!(why.contains("16000000 bytes") && why.contains("budget is 1048576"), "{why}");
    let why = error(StructureParams::NTree(NTreeParams { n: 10, depth: 3, max_leaf: 0, budget_bytes }));
    assert!(why.contains("N-tree") && why.contains("budget is 1048576"), "{why}");
    let why = error(StructureParams::Grid(GridParams { resolution: GridResolution::Cells([4096; 3]), budget_bytes }));
    assert!(why.contains("68719476736 cells"), "{why}");
}

#[test]
fn a_cancelled_build_stops_soon() {
    let mesh = soup(200_000, 0.02, 7);
    for params in [grid(GridResolution::PerPrimitive(64)), octree(12, 1), ntree(10, 3, 0)] {
        let cancel = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let build = scope.spawn(|| (Structure::build(&mesh, &params, &cancel).err(), Instant::now()));
            std::thread::sleep(Duration::from_millis(30));
            let cancelled_at = Instant::now();
            cancel.store(true, Ordering::Relaxed);
            let (error, stopped_at) = build.join().expect("no panic");
            assert!(matches!(error, Some(BuildError::Cancelled)), "{params:?}: {error:?}");
            let waited = stopped_at.duration_since(cancelled_at);
            assert!(waited < Duration::from_millis(1000), "{params:?} took {waited:?} to stop");
        });
    }
}

#[test]
fn rays_pass_empty_nodes_by_and_budgets_are_known_before() {
    let mesh = ball(40, Vec3::ZERO, 1.0);
    let (flat, names) = flatten(&[Arc::new(mesh)], &[place(Affine3A::IDENTITY)]).expect("flattens");
    let structure = build_any(&flat, &ntree(6, 3, 4));
    let tree = structure.cells().expect("a tree of cells");
    let never = AtomicBool::new(false);
    let fine = CellShaftParams { levels: 2, patches: Some(6) };
    let needed = CellShafts::bytes_at_most(tree, &fine);
    // 2,430 bytes in words, and the number of its place.
    assert_eq!(needed, (tree.node_count() - 1) as u64 * (2432 + 4));
    let error = CellShafts::build(tree, &fine, needed - 1, &never).expect_err("one byte too few");
    assert!(error.to_string().contains(&needed.to_string()), "{error}");
    let cancelled = CellShafts::build(tree, &fine, BUDGET, &AtomicBool::new(true));
    assert!(matches!(cancelled, Err(BuildError::Cancelled)));
    let too_fine = CellShaftParams { patches: Some(MAX_MASK_N + 1), ..fine };
    assert!(CellShafts::build(tree, &too_fine, BUDGET, &never).expect_err("too fine").to_string().contains("1 to 12"));

    let other = build_any(&flat, &ntree(6, 2, 4));
    let shafts = Arc::new(cell_shafts(tree, fine));
    assert!(shafts.bytes() as u64 <= needed && shafts.count() > 0 && (0.0..1.0).contains(&shafts.marked_share()));
    assert!(SceneAccel::flat(other, names.clone()).with_cell_shafts(shafts.clone()).is_err(), "another tree");
    let plain = SceneAccel::flat(structure.clone(), names.clone());
    let rays = rays(&flat, 5000, 77);
    let mut without = Counters::default();
    let expected: Vec<_> = rays.iter().map(|ray| plain.closest(ray, &AcceptAll, &mut without)).collect();
    let mut skipped = vec![];
    for (levels, patches) in [(2, Some(6)), (2, Some(4)), (2, Some(1)), (1, None), (0, None)] {
        let shafts = cell_shafts(tree, CellShaftParams { levels, patches });
        let (bytes, count) = (shafts.bytes(), shafts.count());
        let gated = SceneAccel::flat(structure.clone(), names.clone()).with_cell_shafts(Arc::new(shafts));
        let gated = gated.expect("of this tree");
        let mut with = Counters::default();
        for (ray, expected) in rays.iter().zip(&expected) {
            assert_eq!(gated.closest(ray, &AcceptAll, &mut with), *expected, "{patches:?}: {ray:?}");
        }
        let gates = with.gates;
        assert!(gates.skipped_nodes <= gates.node_look_ups && (gates.node_look_ups > 0) == (count > 0), "{gates:?}");
        assert!(with.box_tests <= without.box_tests && with.triangle_tests <= without.triangle_tests);
        assert!(patches.is_some() || bytes * 8 < needed as usize, "{bytes} bytes by default");
        skipped.push(gates.skipped_nodes);
    }
    let [fine, coarser, coarsest, default, none] = skipped[..] else { panic!("five") };
    assert!(fine > 500 && fine > coarser && coarser > coarsest, "{skipped:?}");
    assert!(default > 500 && none == 0, "{skipped:?}");
}

#[test]
fn nodes_are_shown_with_their_boxes_and_cells() {
    let mesh = soup(3000, 0.05, 6);
    let structure = build_any(&mesh, &ntree(5, 3, 2));
    let tree = structure.cells().expect("a tree of cells");
    let (mut count, mut cells, mut lowest, mut last_but_one) = (0, 0, u32::MAX, 0);
    tree.for_each_node(|node| {
        assert_eq!(node.number, count);
        count += 1;
        cells += node.occupied().map(|bits| bits.count_ones() as usize).sum::<usize>();
        lowest = lowest.min(node.level);
        last_but_one += usize::from(node.has_only_leaves());
        let (bounds, root) = (node.bounds(), tree.bounds());
        let edge = root.extent().x / 5_f32.powi(node.level as i32);
        assert!((bounds.extent() - edge).abs().max_element() < 1e-5, "{bounds:?}");
        assert!(bounds.min.cmpge(root.min - 1e-6).all() && bounds.max.cmple(root.max + 1e-6).all());
        assert!(node.level < 2 || node.has_only_leaves());
    });
    assert_eq!((count as usize, cells, lowest, tree.levels()), (tree.node_count(), tree.occupied_cells(), 0, 3));
    assert!(last_but_one > 50 && last_but_one < count as usize);
}

fn placed_meshes() -> (Vec<Arc<Mesh>>, Vec<Placement>) {
    let mut meshes = vec![soup(200, 0.3, 1), ball(6, Vec3::splat(0.5), 0.5), mesh(vec![], vec![], spheres(30, 0.2, 2))];
    for (i, mesh) in meshes.iter_mut().enumerate() {
        mesh.hash = MeshHash([i as u8 + 1; 32]);
    }
    let mut random = Random(77);
    let placements = (0..40)
        .map(|i| {
            let turn = Quat::from_axis_angle(random.direction(), 6.0 * random.unit());
            let scale = if i % 3 == 2 { Vec3::splat(0.2 + random.unit()) } else { 0.2 + random.point() };
            let transform = match i {
                7 => Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0)),
                _ => Affine3A::from_scale_rotation_translation(scale, turn, 6.0 * random.point()),
            };
            Placement { mesh: i % 3, transform, filtered: false }
        })
        .collect();
    (meshes.into_iter().map(Arc::new).collect(), placements)
}

#[test]
fn flat_scenes_find_what_two_levels_find() {
    let (meshes, placements) = placed_meshes();
    let structures: Vec<_> = meshes.iter().map(|mesh| Arc::new(build(mesh, BuildParams::default()))).collect();
    let two_level = SceneAccel::build(structures, &placements);
    let (flat, names) = flatten(&meshes, &placements).expect("flattens");
    let mut scenes = vec![];
    for params in [BuildParams::default().into()].into_iter().chain(all_params()) {
        scenes.push(SceneAccel::flat(build_any(&flat, &params), names.clone()));
    }
    let (mut hits, mut close_calls) = (0, 0);
    for ray in rays(&flat, 3000, 5) {
        let (expected, found) = (closest(&two_level, &ray), closest(&scenes[0], &ray));
        for scene in &scenes {
            assert_eq!(closest(scene, &ray), found, "{ray:?}");
            assert_eq!(occluded(scene, &ray), found.is_some(), "{ray:?}");
        }
        hits += usize::from(found.is_some());
        let same = match (expected, found) {
            (Some(a), Some(b)) => {
                (a.instance, a.primitive) == (b.instance, b.primitive) && (a.t - b.t).abs() < 1e-3 * a.t.max(1e-2)
            }
            (a, b) => a.is_none() && b.is_none(),
        };
        close_calls += usize::from(!same);
    }
    assert!(hits > 150 && close_calls <= 12, "{hits} hits, {close_calls} differences");
}

#[test]
fn one_instance_at_rest_has_the_same_hits_to_the_last_bit() {
    let triangles = soup(300, 0.2, 8);
    let mesh = Arc::new(mesh(triangles.positions, triangles.triangles, spheres(100, 0.05, 9)));
    let placements = [place(Affine3A::IDENTITY)];
    let two_level = SceneAccel::build(vec![Arc::new(build(&mesh, BuildParams::default()))], &placements);
    let (flat, names) = flatten(std::slice::from_ref(&mesh), &placements).expect("flattens");
    for params in all_params() {
        let scene = SceneAccel::flat(build_any(&flat, &params), names.clone());
        for ray in rays(&mesh, 1500, 6) {
            assert_eq!(closest(&scene, &ray), closest(&two_level, &ray), "{params:?}: {ray:?}");
        }
    }
}

#[test]
fn flat_filters_are_asked_with_the_names_of_instances() {
    struct OnlyEven;
    impl HitFilter for OnlyEven {
        fn accept(&self, _: &Ray, hit: &Hit) -> bool {
            assert_eq!(hit.instance, 1);
            hit.primitive.is_multiple_of(2)
        }
    }
    let wall = |z: f32| [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]].map(|[x, y]| Vec3::new(x, y, z));
    let walls = mesh(
        (0..4).flat_map(|z| wall(z as f32)).collect(),
        (0..4).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        vec![],
    );
    let behind = place(Affine3A::from_translation(Vec3::Z * 10.0));
    let placements = [behind, Placement { filtered: true, ..place(Affine3A::from_translation(Vec3::NEG_Z)) }];
    let (flat, names) = flatten(&[Arc::new(walls)], &placements).expect("flattens");
    let scene = SceneAccel::flat(build_any(&flat, &ntree(4, 2, 1)), names);
    let ray = |from: f32| Ray::new(Vec3::new(0.0, 0.0, from), Vec3::Z);
    let hit =
        |from: f32| scene.closest(&ray(from), &OnlyEven, &mut Counters::default()).map(|h| (h.instance, h.primitive));
    assert_eq!([-5.0, -0.5, 1.5, 10.5].map(hit), [Some((1, 0)), Some((1, 2)), Some((0, 0)), Some((0, 1))]);
}

#[test]
fn uneven_spheres_are_refused_and_hashes_follow_geometry() {
    let spheres = Arc::new(mesh(vec![], vec![], spheres(3, 0.1, 1)));
    let uneven = place(Affine3A::from_scale(Vec3::new(1.0, 2.0, 1.0)));
    let Err(BuildError::Unsupported(why)) = flatten(std::slice::from_ref(&spheres), &[uneven]) else {
        panic!("spheres became ellipsoids")
    };
    assert!(why.contains("instance 0") && why.contains("two_level"), "{why}");
    let meshes = [spheres];
    let at = |x: f32| place(Affine3A::from_translation(Vec3::X * x));
    let hash = |placements: &[Placement]| flat_hash(&meshes, placements);
    assert_eq!(hash(&[at(1.0)]), hash(&[Placement { filtered: true, ..at(1.0) }]));
    assert_ne!(hash(&[at(1.0)]), hash(&[at(2.0)]));
    assert_ne!(hash(&[at(1.0), at(2.0)]), hash(&[at(2.0), at(1.0)]));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn random_trees_over_random_soups_agree(
        seed in any::<u64>(), count in 1_usize..150, size in 0.01_f32..1.5, exponent in -20_i32..20,
        n in 2_u32..=16, depth in 1_u32..=4, max_leaf in 0_u32..6, cells in 1_u32..=16,
    ) {
        let mut mesh = soup(count, size, seed);
        let scale = 2.0_f32.powi(exponent);
        mesh.positions.iter_mut().for_each(|p| *p *= scale);
        mesh.bounds.min *= scale;
        mesh.bounds.max *= scale;
        // Deep trees of many cells would take their time to fill.
        let depth = if n > 6 { depth.min(2) } else if n > 3 { depth.min(3) } else { depth };
        let params = [
            BuildParams::default().into(), ntree(n, depth, max_leaf), grid(GridResolution::PerPrimitive(cells)),
            octree(2 * depth, max_leaf.max(1)),
        ];
        let scenes = params.map(|params| {
            SceneAccel::build(vec![build_any(&mesh, &params)], &[place(Affine3A::IDENTITY)])
        });
        for ray in rays(&mesh, 120, seed) {
            let found = closest(&scenes[0], &ray);
            for scene in &scenes {
                prop_assert_eq!(closest(scene, &ray), found, "{:?}", ray);
                prop_assert_eq!(occluded(scene, &ray), found.is_some());
            }
        }
    }
}
