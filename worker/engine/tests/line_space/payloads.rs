//! Sampled payloads against their definition, and every payload's stored form.

use std::sync::atomic::AtomicBool;

use glam::{DVec3, Vec3};
use lightshaft_engine::accel::line_space::shaft::{
    directed_count, directed_patches, symmetric_count, symmetric_patches,
};
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CastPattern, Class, ClassLayout, LineSpace, LineSpaceParams, Patch, Payload, Shafts,
};
use lightshaft_engine::accel::{BuildError, BuildParams, MeshStructure};
use lightshaft_engine::scene::Mesh;
use lightshaft_engine::trace::Ray;

use crate::classes::{BUDGET, line_space};
use crate::common::{ball, build, mesh, oracle, soup};

fn every_payload() -> Vec<LineSpaceParams> {
    let pattern = CastPattern::Nine;
    [
        Payload::Binary { builder: BinaryBuilder::Masking },
        Payload::Binary { builder: BinaryBuilder::Clipping },
        Payload::Binary { builder: BinaryBuilder::Casting(CastPattern::Centre) },
        Payload::Binary { builder: BinaryBuilder::Casting(pattern) },
        Payload::Candidates { pattern: CastPattern::Centre },
        Payload::Candidates { pattern },
        Payload::Classes { layout: ClassLayout::Table, resolution: 16 },
        Payload::Classes { layout: ClassLayout::Tree, resolution: 32 },
        Payload::Coverage { bits: 3, rays: 5 },
        Payload::Coverage { bits: 8, rays: 9 },
    ]
    .map(|payload| LineSpaceParams { n: 4, payload })
    .to_vec()
}

fn center_line(space: &LineSpace, start: Patch, end: Patch) -> Ray {
    let grid = space.grid().expect("has a grid");
    let center = |patch: Patch| {
        let [low, high]: [DVec3; 2] = patch.unit_bounds(grid.n());
        grid.from_unit(0.5 * (low + high))
    };
    let (from, to) = (center(start), center(end));
    Ray { origin: from.as_vec3(), t_min: 0.0, direction: (to - from).as_vec3(), t_max: 1.0 }
}

#[test]
fn candidates_are_what_the_centre_line_hits_first() {
    let mesh = soup(50, 0.5, 4);
    let structure = build(&mesh, BuildParams::default());
    for n in [1, 2, 3, 5] {
        let of = |pattern| {
            let params = LineSpaceParams { n, payload: Payload::Candidates { pattern } };
            line_space(&mesh, &structure, params)
        };
        let space = of(CastPattern::Centre);
        let Some(Shafts::Candidates(centre)) = space.shafts() else { panic!("candidates") };
        let nine = of(CastPattern::Nine);
        let Some(Shafts::Candidates(nine)) = nine.shafts() else { panic!("candidates") };
        let mut filled = 0;
        for index in 0..directed_count(n) as u32 {
            let (start, end) = directed_patches(n, index);
            let ray = center_line(&space, start, end);
            let found = centre.candidate(start, end);
            filled += usize::from(found.is_some());
            // At the very edge of a triangle, single precision may decide otherwise.
            if let Some((_, u, v, primitive)) =
                oracle(&mesh, &ray).filter(|(_, u, v, _)| u.min(*v).min(1.0 - u - v) > 1e-4)
            {
                let other = found.map(|candidate| oracle_on(&mesh, candidate, &ray));
                assert!(found == Some(primitive) || other.flatten().is_some(), "{start:?} {end:?} {u} {v}");
            }
            assert_eq!(found.is_some(), centre.filled().get(index));
            if found.is_some() {
                assert_eq!(nine.candidate(start, end), found);
            }
        }
        assert_eq!(filled, centre.primitives().len());
        assert!(nine.primitives().len() > filled && filled > 0);
        assert_eq!(centre.bytes() as u64, directed_count(n).div_ceil(32) * 8 + 4 * filled as u64);
    }
}

/// Whether the ray hits this primitive, nearly as far as the nearest.
fn oracle_on(source: &Mesh, primitive: u32, ray: &Ray) -> Option<f64> {
    let nearest = oracle(source, ray)?.0;
    let alone = mesh(source.positions.clone(), vec![source.triangles[primitive as usize]], vec![]);
    oracle(&alone, ray).map(|hit| hit.0).filter(|t| (t - nearest).abs() < 1e-5)
}

#[test]
fn coverage_agrees_with_what_is_proven() {
    let mesh = ball(10, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    let classes = LineSpaceParams { n: 6, payload: Payload::Classes { layout: ClassLayout::Table, resolution: 64 } };
    let classes = line_space(&mesh, &structure, classes);
    for bits in 2..=8 {
        let params = LineSpaceParams { n: 6, payload: Payload::Coverage { bits, rays: 16 } };
        let space = line_space(&mesh, &structure, params);
        let Some(Shafts::Coverage(coverage)) = space.shafts() else { panic!("coverage") };
        let mut partly = 0;
        for index in 0..symmetric_count(6) as u32 {
            let (a, b) = symmetric_patches(6, index);
            let blocked = coverage.blocked(a, b);
            assert_eq!(blocked, coverage.blocked(b, a));
            match classes.class(a, b) {
                Class::Empty => assert_eq!(blocked, 0.0),
                Class::Opaque => assert_eq!(blocked, 1.0),
                Class::Mixed => partly += usize::from(blocked > 0.0 && blocked < 1.0),
            }
        }
        assert!(partly > 100, "{partly}");
        assert_eq!(space.bytes() as u64, symmetric_count(6).div_ceil(u64::from(32 / bits)) * 4);
    }
}

#[test]
fn sizes_are_those_of_the_thesis() {
    let mesh = ball(4, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    for (n, bytes) in [(4, 480_u64), (6, 2430), (8, 7680), (10, 18_750)] {
        let builder = BinaryBuilder::Casting(CastPattern::Centre);
        let params = LineSpaceParams { n, payload: Payload::Binary { builder } };
        // In words of four bytes.
        assert_eq!(line_space(&mesh, &structure, params).bytes() as u64, bytes.next_multiple_of(4));
        assert_eq!(params.bytes_at_most(), bytes.next_multiple_of(4));
    }
}

#[test]
fn every_payload_survives_being_stored() {
    let mesh = ball(6, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    let point = mesh_of_one_point();
    let point_structure = build(&point, BuildParams::default());
    for params in every_payload() {
        for (mesh, structure) in [(&mesh, &structure), (&point, &point_structure)] {
            let space = line_space(mesh, structure, params);
            assert!(space.bytes() as u64 <= params.bytes_at_most());
            let stored = space.encode();
            let read = LineSpace::decode(&stored, mesh, structure, &params).expect("reads");
            assert_eq!(read, space);
            assert_eq!(read.encode(), stored);
        }
    }
}

fn mesh_of_one_point() -> Mesh {
    mesh(vec![Vec3::ONE; 3], vec![[0, 1, 2]], vec![])
}

fn read(bytes: &[u8], mesh: &Mesh, structure: &MeshStructure, params: &LineSpaceParams) -> Result<LineSpace, String> {
    LineSpace::decode(bytes, mesh, structure, params).map_err(|error| error.to_string())
}

#[test]
fn damaged_files_are_refused() {
    let mesh = ball(6, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    for params in every_payload() {
        let stored = line_space(&mesh, &structure, params).encode();
        for at in (0..stored.len()).step_by(7).chain([0, 8, 12, 16, 48, 79, 80]) {
            let mut damaged = stored.clone();
            damaged[at] ^= 0x10;
            assert!(read(&damaged, &mesh, &structure, &params).is_err(), "byte {at}");
        }
        for length in [0, 10, 79, 80, 90, stored.len() - 1] {
            assert!(read(&stored[..length], &mesh, &structure, &params).is_err(), "{length} bytes");
        }
        let other = LineSpaceParams { n: 8, ..params };
        let error = read(&stored, &mesh, &structure, &other).expect_err("other parameters");
        assert!(error.contains("n=4,") && error.contains("n=8,"), "{error}");
        let elsewhere = Mesh { hash: lightshaft_engine::scene::MeshHash([9; 32]), ..mesh.clone() };
        assert!(read(&stored, &elsewhere, &structure, &params).expect_err("another mesh").contains("mesh"));
    }
}

/// Content that is wrong under a right checksum: what a faulty builder or an attacker would store.
#[test]
fn contradictions_in_a_file_are_refused() {
    let mesh = ball(6, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    for params in every_payload() {
        let stored = line_space(&mesh, &structure, params).encode();
        let sealed = |mut bytes: Vec<u8>| {
            let mut hasher = blake3::Hasher::new();
            hasher.update(&bytes[..48]).update(&bytes[80..]);
            let checksum = *hasher.finalize().as_bytes();
            bytes[48..80].copy_from_slice(&checksum);
            bytes
        };
        assert!(read(&sealed(stored.clone()), &mesh, &structure, &params).is_ok());
        let first_array = (80 + params.canonical().len()).next_multiple_of(4);
        let mut longer = stored.clone();
        longer.extend_from_slice(&[0; 4]);
        let mut cut = stored.clone();
        cut.truncate(stored.len() - 4);
        let mut miscounted = stored.clone();
        miscounted[first_array] ^= 1;
        let without = stored[..first_array].to_vec();
        for wrong in [longer, cut, miscounted, without] {
            assert!(read(&sealed(wrong), &mesh, &structure, &params).is_err(), "{}", params.canonical());
        }
        // The last word: a class that is none, a candidate that is no primitive, a bit too many.
        let mut last = stored.clone();
        let end = last.len();
        last[end - 4..].fill(0xff);
        let has_invalid_words = matches!(params.payload, Payload::Candidates { .. } | Payload::Classes { .. });
        assert_eq!(
            read(&sealed(last), &mesh, &structure, &params).is_err(),
            has_invalid_words,
            "{}",
            params.canonical()
        );
    }
}

#[test]
fn builds_can_be_cancelled() {
    let mesh = ball(6, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    for params in every_payload() {
        let cancelled = AtomicBool::new(true);
        let result = LineSpace::build(&mesh, &structure, &params, BUDGET, &cancelled);
        assert!(matches!(result, Err(BuildError::Cancelled)), "{}", params.canonical());
    }
}

#[test]
fn what_exceeds_the_budget_or_the_ranges_is_refused_with_the_figure() {
    let mesh = ball(6, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    let error = |n: u32, payload: Payload, budget: u64| {
        let params = LineSpaceParams { n, payload };
        LineSpace::build(&mesh, &structure, &params, budget, &AtomicBool::new(false)).expect_err("refused").to_string()
    };
    let masking = Payload::Binary { builder: BinaryBuilder::Masking };
    let tree = |resolution| Payload::Classes { layout: ClassLayout::Tree, resolution };
    assert!(error(4, masking, 479).contains("may take 480 bytes; the budget is 479"));
    assert!(error(0, masking, BUDGET).contains("line_space.n is 0; it must be from 1 to 32"));
    assert!(error(33, masking, BUDGET).contains("from 1 to 32"));
    assert!(error(13, masking, BUDGET).contains("from 1 to 12"));
    assert!(error(12, tree(64), BUDGET).contains("4, 8, 16 or 32"));
    assert!(error(8, tree(100), BUDGET).contains("power of two"));
    assert!(error(8, tree(512), BUDGET).contains("line_space.resolution is 512; it must be from 16 to 256"));
    assert!(error(8, Payload::Coverage { bits: 1, rays: 4 }, BUDGET).contains("line_space.bits is 1"));
    assert!(error(8, Payload::Coverage { bits: 4, rays: 0 }, BUDGET).contains("line_space.rays is 0"));
}

#[test]
fn every_set_of_parameters_has_a_key_of_its_own() {
    let keys: Vec<String> = every_payload().iter().map(LineSpaceParams::canonical).collect();
    for (i, key) in keys.iter().enumerate() {
        assert!(!keys[..i].contains(key), "{key}");
    }
    assert_eq!(
        LineSpaceParams::DEFAULT_CLASSES.canonical(),
        "n=16,payload=classes,builder=layered,layout=tree,resolution=128"
    );
}
