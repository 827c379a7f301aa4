//! Surface shafts: proven ones change no answer, sampled ones few.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, Quat, Vec3};
use lightshaft_engine::accel::line_space::{Evidence, SurfaceShaftParams, SurfaceShafts};
use lightshaft_engine::accel::{BuildError, BuildParams, MeshStructure, Placement, SceneAccel, SurfaceStart};
use lightshaft_engine::scene::Mesh;
use lightshaft_engine::trace::{Counters, Ray};

use crate::classes::BUDGET;
use crate::common::{AcceptAll, Random, ball, build, occluded, place};
use crate::meshes;

const PROVEN: SurfaceShaftParams = SurfaceShaftParams { n: 4, cluster: 16, evidence: Evidence::Proven };
const SAMPLED: SurfaceShaftParams = SurfaceShaftParams { n: 6, cluster: 8, evidence: Evidence::Sampled { rays: 24 } };

fn shafts(mesh: &Mesh, structure: &MeshStructure, params: &SurfaceShaftParams) -> SurfaceShafts {
    SurfaceShafts::build(mesh, structure, params, BUDGET, &AtomicBool::new(false)).expect("builds")
}

/// A round ball. Each ring is turned by half a column against the last, so that no two triangles lie in one plane: there,
/// rounding decides whether an edge is convex.
fn round_ball(rings: u32, radius: f32) -> Mesh {
    let mut round = ball(rings, Vec3::ZERO, 1.0);
    round.positions.iter_mut().for_each(|position| {
        let direction = position.normalize();
        *position = radius * (Quat::from_rotation_z(0.5 * direction.z.acos()) * direction);
    });
    round
}

/// A ray from just above a random triangle of an instance, to whichever side.
fn ray_from(random: &mut Random, mesh: &Mesh, placement: &Placement, instance: u32) -> Option<(Ray, SurfaceStart)> {
    let triangle = (random.next() % mesh.triangles.len().max(1) as u64) as u32;
    let corners = mesh.triangles.get(triangle as usize)?.map(|v| mesh.positions[v as usize]);
    let [a, b, c] = corners.map(|corner| placement.transform.transform_point3(corner));
    let (u, v) = (random.unit(), random.unit());
    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
    // Under a mirroring transform the front is where the corners are seen clockwise.
    let mirrored = placement.transform.matrix3.determinant() < 0.0;
    let normal = (b - a).cross(c - a).normalize_or_zero() * if mirrored { -1.0 } else { 1.0 };
    let size = mesh.bounds.extent().length();
    let direction = random.direction();
    let is_front = direction.dot(normal) > 0.0;
    let side = if is_front { normal } else { -normal };
    let origin = a + u * (b - a) + v * (c - a) + side * size * 1e-5;
    let t_max = if random.next().is_multiple_of(2) { f32::INFINITY } else { 2.0 * size * random.unit() };
    let ray = Ray { origin, t_min: 0.0, direction, t_max };
    (normal != Vec3::ZERO).then_some((ray, SurfaceStart { instance, triangle, is_front }))
}

#[test]
fn proven_shafts_change_no_answer_on_any_mesh() {
    let mut random = Random(51);
    let mut known = [0; 3];
    for (name, mesh) in meshes::all() {
        if mesh.bounds.extent().length() > 1e20 || name == "far ball" || name == "tiny ball" {
            // Starts above the surface by a part of the size are not above it in single precision, or not finite.
            continue;
        }
        let structure = Arc::new(build(&mesh, BuildParams::default()));
        let surface = Arc::new(shafts(&mesh, &structure, &PROVEN));
        assert!(surface.is_exact());
        let placement = place(Affine3A::IDENTITY);
        let scene =
            SceneAccel::build(vec![structure], &[placement]).with_surface_shafts(vec![Some(surface)]).expect("fits");
        let mut counters = Counters::default();
        for _ in 0..20_000 {
            let Some((ray, start)) = ray_from(&mut random, &mesh, &placement, 0) else { continue };
            let found = scene.occluded_from(&ray, &start, &AcceptAll, &mut counters);
            assert_eq!(found, occluded(&scene, &ray), "{name}: {ray:?} from {start:?}");
        }
        (0..3).for_each(|k| known[k] += counters.gates.own_mesh[k]);
    }
    assert!(known[0] > 30_000 && known[1] == 0 && known[2] > 10_000, "{known:?}");
}

#[test]
fn proven_shafts_change_no_answer_among_instances() {
    let mut random = Random(52);
    let meshes = [round_ball(12, 1.0), round_ball(5, 0.7)];
    let structures: Vec<_> = meshes.iter().map(|mesh| Arc::new(build(mesh, BuildParams::default()))).collect();
    let surfaces =
        meshes.iter().zip(&structures).map(|(mesh, structure)| Some(Arc::new(shafts(mesh, structure, &PROVEN))));
    let placements: Vec<Placement> = (0..30)
        .map(|i| {
            let scale = (0.5 + random.point()) * Vec3::new(if i % 3 == 0 { -1.0 } else { 1.0 }, 1.0, 1.0);
            let turn = Quat::from_axis_angle(random.direction(), 6.0 * random.unit());
            let transform = Affine3A::from_scale_rotation_translation(scale, turn, 4.0 * random.point());
            Placement { mesh: i % 2, transform, filtered: i % 5 == 0 }
        })
        .collect();
    let scene =
        SceneAccel::build(structures.clone(), &placements).with_surface_shafts(surfaces.collect()).expect("fits");
    let mut counters = Counters::default();
    for _ in 0..40_000 {
        let instance = (random.next() % 30) as u32;
        let placement = &placements[instance as usize];
        let mesh = &meshes[placement.mesh as usize];
        let Some((ray, start)) = ray_from(&mut random, mesh, placement, instance) else { continue };
        let found = scene.occluded_from(&ray, &start, &AcceptAll, &mut counters);
        assert_eq!(found, occluded(&scene, &ray), "{ray:?} from {start:?}");
    }
    assert!(counters.gates.own_mesh[0] > 5000, "{:?}", counters.gates);
}

#[test]
fn more_samples_make_fewer_mistakes() {
    let mesh = ball(24, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    let share = |rays| {
        let params = SurfaceShaftParams { evidence: Evidence::Sampled { rays }, ..SAMPLED };
        shafts(&mesh, &structure, &params).wrong_share(&mesh, &structure, 100_000, 1)
    };
    let (few, many) = (share(2), share(64));
    assert!(many < 0.01 && many < few, "{few} {many}");
    let mesh = round_ball(24, 1.0);
    let structure = build(&mesh, BuildParams::default());
    let proven = shafts(&mesh, &structure, &PROVEN);
    assert_eq!(proven.wrong_share(&mesh, &structure, 100_000, 1), 0.0);
    let [empty, _, mixed] = proven.census();
    assert!(empty > mixed / 2, "{empty} {mixed}");
}

#[test]
fn surface_shafts_survive_being_stored_and_damage_is_refused() {
    let mesh = ball(8, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    for params in [PROVEN, SAMPLED] {
        let surface = shafts(&mesh, &structure, &params);
        assert!(surface.bytes() as u64 <= params.bytes_at_most(mesh.primitive_count()));
        let stored = surface.encode();
        let read = SurfaceShafts::decode(&stored, &mesh, &structure, &params).expect("reads");
        assert_eq!(read, surface);
        for at in (0..stored.len()).step_by(13) {
            let mut damaged = stored.clone();
            damaged[at] ^= 4;
            assert!(SurfaceShafts::decode(&damaged, &mesh, &structure, &params).is_err(), "byte {at}");
        }
        // Wrong content under a right checksum: a cluster that is not there.
        let mut wrong = stored.clone();
        let clusters = (80 + params.canonical().len()).next_multiple_of(4) + 4;
        wrong[clusters..clusters + 2].copy_from_slice(&[0xfe, 0xff]);
        let mut hasher = blake3::Hasher::new();
        hasher.update(&wrong[..48]).update(&wrong[80..]);
        let checksum = *hasher.finalize().as_bytes();
        wrong[48..80].copy_from_slice(&checksum);
        let error = SurfaceShafts::decode(&wrong, &mesh, &structure, &params).expect_err("refused").to_string();
        assert!(error.contains("cluster 65534 of"), "{error}");
    }
}

#[test]
fn surface_shafts_are_refused_with_the_reason() {
    let mesh = ball(6, Vec3::ZERO, 1.0);
    let structure = build(&mesh, BuildParams::default());
    let error = |params: SurfaceShaftParams, budget: u64| {
        let result = SurfaceShafts::build(&mesh, &structure, &params, budget, &AtomicBool::new(false));
        result.expect_err("refused").to_string()
    };
    assert!(
        error(SurfaceShaftParams { n: 17, ..PROVEN }, BUDGET)
            .contains("surface_shafts.n is 17; it must be from 1 to 16")
    );
    assert!(error(SurfaceShaftParams { cluster: 0, ..PROVEN }, BUDGET).contains("surface_shafts.cluster is 0"));
    let rays = Evidence::Sampled { rays: 0 };
    assert!(error(SurfaceShaftParams { evidence: rays, ..PROVEN }, BUDGET).contains("surface_shafts.rays is 0"));
    assert!(error(PROVEN, 100).contains("the budget is 100"));
    let cancelled = SurfaceShafts::build(&mesh, &structure, &PROVEN, BUDGET, &AtomicBool::new(true));
    assert!(matches!(cancelled, Err(BuildError::Cancelled)));
}
