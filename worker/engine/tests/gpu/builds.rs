//! Line Spaces that the device builds: bit for bit the CPU's, on generated and on hard meshes; what ends a build, and what it
//! leaves to the CPU.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use glam::Vec3;
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CastPattern, ClassLayout, LineSpace, LineSpaceParams, Payload,
};
use lightshaft_engine::accel::{BuildError, BuildParams, MeshStructure, Quality};
use lightshaft_engine::device::gpu::{BuiltLineSpace, Context, LineSpaceBuilder};
use lightshaft_engine::scene::{KINDS, Limits, Mesh, Params, generate, import_file};

use crate::common::{ball, build, mesh, soup};
use crate::hard_meshes;
use crate::{context, context_within};

static NEVER: AtomicBool = AtomicBool::new(false);

fn with(n: u32, payload: Payload) -> LineSpaceParams {
    LineSpaceParams { n, payload }
}

fn classes(n: u32, layout: ClassLayout, resolution: u32) -> LineSpaceParams {
    with(n, Payload::Classes { layout, resolution })
}

fn masking(n: u32) -> LineSpaceParams {
    with(n, Payload::Binary { builder: BinaryBuilder::Masking })
}

fn casting(n: u32, pattern: CastPattern) -> LineSpaceParams {
    with(n, Payload::Binary { builder: BinaryBuilder::Casting(pattern) })
}

/// All that the device has kernels for, coarse.
fn kinds() -> Vec<LineSpaceParams> {
    vec![
        masking(1),
        masking(5),
        masking(8),
        casting(6, CastPattern::Centre),
        casting(5, CastPattern::Nine),
        with(5, Payload::Candidates { pattern: CastPattern::Centre }),
        with(4, Payload::Candidates { pattern: CastPattern::Nine }),
        classes(8, ClassLayout::Tree, 64),
        classes(7, ClassLayout::Table, 32),
        classes(12, ClassLayout::Table, 128),
    ]
}

fn builder() -> LineSpaceBuilder {
    LineSpaceBuilder::new(context())
}

/// Both, and whether they are the same.
#[track_caller]
fn built_alike(
    builder: &LineSpaceBuilder,
    name: &str,
    mesh: &Mesh,
    structure: &Arc<MeshStructure>,
    params: &LineSpaceParams,
) -> BuiltLineSpace {
    let expected = LineSpace::build(mesh, structure, params, u64::MAX, &NEVER).expect("builds");
    let built = builder.build(mesh, structure, params, u64::MAX, &NEVER).expect("builds");
    assert!(built.space == expected, "{name}: {params:?} differs, on the GPU: {}", built.on_gpu);
    built
}

#[test]
fn hard_meshes_become_what_the_cpu_makes_of_them() {
    let builder = builder();
    for (name, mesh) in hard_meshes::all() {
        let structure = Arc::new(build(&mesh, BuildParams { quality: Quality::Medium, spatial_splits: true }));
        for params in kinds() {
            let built = built_alike(&builder, name, &mesh, &structure, &params);
            // Products of such numbers overflow or vanish, a box so far away has no voxels; and of spheres the device knows nothing.
            let is_beyond = ["huge ball", "tiny ball", "spheres"].contains(&name);
            if name != "far ball" {
                assert_eq!(built.on_gpu, !is_beyond, "{name}: {params:?}, {:?}", built.warning);
                assert_eq!(built.warning, None, "{name}");
            }
        }
    }
}

#[test]
fn random_meshes_become_what_the_cpu_makes_of_them() {
    let builder = builder();
    let (mut shafts, mut left) = (0, 0);
    for seed in 0..6 {
        let soup = soup(3 << seed, 0.6 / (1 << (seed / 2)) as f32, 900 + seed);
        let structure = Arc::new(build(&soup, BuildParams { spatial_splits: seed % 2 == 0, ..BuildParams::default() }));
        for params in kinds() {
            let built = built_alike(&builder, "soup", &soup, &structure, &params);
            assert!(built.on_gpu, "{params:?}: {:?}", built.warning);
            if !matches!(params.payload, Payload::Binary { builder: BinaryBuilder::Masking }) {
                shafts += 15 * u64::from(params.n).pow(4);
                left += built.left_to_cpu;
            }
        }
    }
    assert!(left * 20 < shafts, "{left} of {shafts} were left to the CPU: the device did not build them");
}

#[test]
fn every_generated_scene_becomes_what_the_cpu_makes_of_it() {
    let builder = builder();
    for kind in KINDS.iter().map(|kind| kind.name) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("scene.glb");
        std::fs::write(&file, generate(kind, &Params::default()).expect("a kind")).expect("writes");
        let scene = import_file(&file, &Limits::default()).expect("our own file");
        let mesh = scene.meshes.iter().max_by_key(|mesh| mesh.primitive_count()).expect("a mesh");
        let structure = Arc::new(build(mesh, BuildParams::default()));
        for params in [masking(6), casting(5, CastPattern::Nine), classes(8, ClassLayout::Tree, 64)] {
            built_alike(&builder, kind, mesh, &structure, &params);
        }
    }
}

#[test]
fn fine_trees_are_the_same_to_the_last_block() {
    let ball = ball(40, Vec3::new(3.0, -1.0, 2.0), 1.7);
    let structure = Arc::new(build(&ball, BuildParams::default()));
    for params in [
        LineSpaceParams::DEFAULT_CLASSES,
        classes(16, ClassLayout::Tree, 256),
        with(10, Payload::Candidates { pattern: CastPattern::Nine }),
        masking(12),
    ] {
        let built = built_alike(&builder(), "fine ball", &ball, &structure, &params);
        assert!(built.on_gpu && built.warning.is_none(), "{params:?}: {:?}", built.warning);
    }
}

/// Walls of few triangles, where one of them covers a shaft; and an N whose sections can end on a voxel's border.
#[test]
fn covering_triangles_and_borders_are_told_apart_as_on_the_cpu() {
    let corner = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let walls = mesh(
        vec![
            corner(-1.0, 0.1, -1.0),
            corner(1.0, 0.12, -1.0),
            corner(1.0, 0.08, 1.0),
            corner(-1.0, 0.1, 1.0),
            corner(0.3, -1.0, -1.0),
            corner(0.31, 1.0, -0.9),
            corner(0.29, 0.0, 1.0),
        ],
        vec![[0, 1, 2], [0, 2, 3], [4, 5, 6]],
        vec![],
    );
    let structure = Arc::new(build(&walls, BuildParams::default()));
    for (params, on_gpu) in [
        (classes(16, ClassLayout::Tree, 32), true),
        (classes(24, ClassLayout::Table, 128), true),
        (classes(24, ClassLayout::Table, 256), false),
    ] {
        assert_eq!(built_alike(&builder(), "walls", &walls, &structure, &params).on_gpu, on_gpu, "{params:?}");
    }
}

#[test]
fn what_has_no_kernel_is_the_cpus() {
    let ball = ball(6, Vec3::ZERO, 1.0);
    let structure = Arc::new(build(&ball, BuildParams::default()));
    for params in
        [with(3, Payload::Binary { builder: BinaryBuilder::Clipping }), with(3, Payload::Coverage { bits: 4, rays: 4 })]
    {
        let built = built_alike(&builder(), "ball", &ball, &structure, &params);
        assert!(!built.on_gpu && built.warning.is_none());
    }
}

#[test]
fn parameters_and_budgets_are_checked_as_on_the_cpu() {
    let ball = ball(6, Vec3::ZERO, 1.0);
    let structure = Arc::new(build(&ball, BuildParams::default()));
    let refused = |params: LineSpaceParams, budget_bytes| {
        let refuse = |result: Result<(), BuildError>| result.expect_err("refused").to_string();
        let on_gpu = refuse(builder().build(&ball, &structure, &params, budget_bytes, &NEVER).map(|_| ()));
        assert_eq!(on_gpu, refuse(LineSpace::build(&ball, &structure, &params, budget_bytes, &NEVER).map(|_| ())));
        on_gpu
    };
    assert!(refused(masking(13), u64::MAX).contains("must be from 1 to 12"));
    assert!(refused(classes(16, ClassLayout::Tree, 64), 100).contains("the budget is 100"));
}

#[test]
fn a_cancelled_build_ends_between_submits() {
    let soup = soup(20_000, 0.02, 5);
    let structure = Arc::new(build(&soup, BuildParams::default()));
    let builder = builder();
    let cancelled = |result: Result<BuiltLineSpace, BuildError>| matches!(result, Err(BuildError::Cancelled));
    for params in kinds() {
        assert!(cancelled(builder.build(&soup, &structure, &params, u64::MAX, &AtomicBool::new(true))), "{params:?}");
    }
    // Kernels are compiled by now, so that a submit is short.
    let params = with(20, Payload::Candidates { pattern: CastPattern::Nine });
    let warm = with(4, Payload::Candidates { pattern: CastPattern::Nine });
    builder.build(&soup, &structure, &warm, u64::MAX, &NEVER).expect("builds");
    let cancel = AtomicBool::new(false);
    let (ended, asked) = std::thread::scope(|scope| {
        let build = scope.spawn(|| {
            let result = builder.build(&soup, &structure, &params, u64::MAX, &cancel);
            (cancelled(result), Instant::now())
        });
        std::thread::sleep(Duration::from_millis(300));
        let asked = Instant::now();
        cancel.store(true, Ordering::Relaxed);
        let (was_cancelled, ended) = build.join().expect("ends");
        assert!(was_cancelled, "4,800,000 shafts were cast in 0.3 s");
        (ended, asked)
    });
    assert!(ended.duration_since(asked) < Duration::from_secs(5), "it went on for {:?}", ended.duration_since(asked));
}

#[test]
fn a_lost_device_is_opened_again_and_a_build_begins_anew() {
    let ball = ball(16, Vec3::ZERO, 1.0);
    let structure = Arc::new(build(&ball, BuildParams::default()));
    let doomed: Arc<Context> = context_within(u32::MAX, u64::MAX);
    let builder = LineSpaceBuilder::new(doomed.clone());
    for params in [masking(4), casting(4, CastPattern::Nine), classes(8, ClassLayout::Tree, 32)] {
        doomed.destroy();
        let built = built_alike(&builder, "ball", &ball, &structure, &params);
        assert!(built.on_gpu && built.warning.is_none(), "{:?}", built.warning);
    }
}

/// The CPU takes over where the device has no room, and says so.
#[test]
fn a_device_without_room_leaves_it_to_the_cpu() {
    let ball = ball(16, Vec3::ZERO, 1.0);
    let structure = Arc::new(build(&ball, BuildParams::default()));
    let builder = LineSpaceBuilder::new(context_within(8, 16 << 10));
    for params in [classes(8, ClassLayout::Tree, 64), masking(8)] {
        let built = built_alike(&builder, "ball", &ball, &structure, &params);
        let warning = built.warning.expect("told");
        assert!(!built.on_gpu && warning.contains("on the CPU instead"), "{warning}");
    }
}

#[test]
fn submits_of_builds_are_short() {
    let soup = soup(20_000, 0.02, 6);
    let structure = Arc::new(build(&soup, BuildParams::default()));
    let builder = builder();
    for params in [
        casting(10, CastPattern::Nine),
        with(8, Payload::Candidates { pattern: CastPattern::Centre }),
        classes(16, ClassLayout::Tree, 128),
    ] {
        // Not alone on the machine: the best of three.
        let longest = |_| builder.build(&soup, &structure, &params, u64::MAX, &NEVER).expect("builds").longest_submit_s;
        let best = (0..3).map(longest).fold(f64::INFINITY, f64::min);
        assert!(best < 0.5, "{params:?} held the device for {best} s");
    }
}
