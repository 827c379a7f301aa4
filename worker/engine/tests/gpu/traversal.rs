//! Hits of the GPU kernel against the CPU's kernels, which their own tests hold against an oracle.

use std::sync::Arc;

use glam::{Affine3A, Quat, Vec3};
use lightshaft_engine::accel::{BuildParams, Placement, Quality, SceneAccel};
use lightshaft_engine::device::gpu::{HostStructure, Kernel, MeshView, PlacementView, Tracer};
use lightshaft_engine::scene::{Aabb, Mesh, Sphere};
use lightshaft_engine::trace::{Hit, Ray};

use crate::common::{Random, ball, build, closest, mesh, occluded, place, random_ray, soup, spheres};
use crate::context;

const PARAMS: BuildParams = BuildParams { quality: Quality::Medium, spatial_splits: true };

struct Pair {
    cpu: SceneAccel,
    gpu: HostStructure,
    bounds: Aabb,
}

fn pair(meshes: &[Mesh], placements: &[Placement]) -> Pair {
    let structures: Vec<_> = meshes.iter().map(|mesh| Arc::new(build(mesh, PARAMS))).collect();
    let positions: Vec<Vec<[f32; 3]>> =
        meshes.iter().map(|mesh| mesh.positions.iter().map(|p| p.to_array()).collect()).collect();
    let spheres: Vec<Vec<[f32; 4]>> =
        meshes.iter().map(|mesh| mesh.spheres.iter().map(|s| s.center.extend(s.radius).to_array()).collect()).collect();
    let cpu = SceneAccel::build(structures.clone(), placements);
    let views: Vec<_> = (0..meshes.len())
        .map(|i| MeshView {
            structure: &structures[i],
            positions: &positions[i],
            triangles: &meshes[i].triangles,
            spheres: &spheres[i],
        })
        .collect();
    let placed: Vec<_> = placements.iter().map(|p| PlacementView::new(p.mesh, p.transform, p.filtered)).collect();
    let gpu = HostStructure::wide(&cpu, &views, &placed);
    let bounds = cpu.top().bounds();
    Pair { cpu, gpu, bounds }
}

/// Compares closest and any hits of `rays`. Where single precision cannot tell a hit from a near miss, or two surfaces
/// apart, devices may differ: in `per_mille` of the rays.
#[track_caller]
fn assert_same(pair: &Pair, rays: &[Ray], per_mille: usize) {
    let context = context();
    let tracer = Tracer::new(&context, &pair.gpu, Kernel::Product).expect("uploads");
    let found = tracer.closest(rays).expect("traces");
    let blocked = tracer.occluded(rays).expect("traces");
    let (mut hits, mut differing, mut differing_any) = (0, 0, 0);
    for ((ray, gpu), any) in rays.iter().zip(found).zip(blocked) {
        let cpu = closest(&pair.cpu, ray);
        hits += usize::from(cpu.is_some());
        differing += usize::from(!alike(cpu, gpu));
        differing_any += usize::from(any != occluded(&pair.cpu, ray));
    }
    assert!(hits * 40 > rays.len(), "only {hits} of {} rays hit anything: the test says little", rays.len());
    assert!(differing * 1000 <= per_mille * rays.len(), "{differing} of {} closest hits differ", rays.len());
    assert!(differing_any * 1000 <= per_mille * rays.len(), "{differing_any} of {} any-hits differ", rays.len());
}

pub(crate) fn alike(a: Option<Hit>, b: Option<Hit>) -> bool {
    match (a, b) {
        (None, None) => true,
        (Some(a), Some(b)) => {
            a.instance == b.instance
                && a.primitive == b.primitive
                && (a.t - b.t).abs() <= 1e-4 * a.t.max(1e-3)
                && (a.u - b.u).abs().max((a.v - b.v).abs()) < 2e-3
        }
        _ => false,
    }
}

fn random_rays(bounds: &Aabb, count: usize, seed: u64) -> Vec<Ray> {
    let mut random = Random(seed);
    (0..count).map(|_| random_ray(&mut random, bounds)).collect()
}

#[test]
fn soup_of_triangles() {
    let pair = pair(&[soup(5000, 0.1, 1)], &[place(Affine3A::IDENTITY)]);
    assert_same(&pair, &random_rays(&pair.bounds, 20_000, 2), 1);
}

#[test]
fn slivers_and_degenerate_triangles() {
    let mut bad = soup(2000, 0.2, 3);
    for i in 0..500 {
        bad.positions[3 * i + 2] = bad.positions[3 * i];
        bad.positions[3 * (500 + i) + 2] =
            bad.positions[3 * (500 + i)].lerp(bad.positions[3 * (500 + i) + 1], 0.5) + 1e-6;
    }
    let pair = pair(&[bad], &[place(Affine3A::IDENTITY)]);
    assert_same(&pair, &random_rays(&pair.bounds, 20_000, 4), 1);
}

#[test]
fn closed_surface_has_no_holes() {
    let shape = ball(40, Vec3::ZERO, 1.0);
    let pair = pair(std::slice::from_ref(&shape), &[place(Affine3A::IDENTITY)]);
    let mut random = Random(5);
    // From inside, at vertices, at points on edges, and anywhere: nothing gets out.
    let rays: Vec<Ray> = (0..20_000)
        .map(|i| {
            let triangle = shape.triangles[random.next() as usize % shape.triangles.len()];
            let [a, b, _] = triangle.map(|v| shape.positions[v as usize]);
            let target = match i % 3 {
                0 => a,
                1 => a.lerp(b, random.unit()),
                _ => random.direction() * 2.0,
            };
            let origin = 0.3 * (random.point() - 0.5);
            Ray::new(origin, target - origin)
        })
        .collect();
    let context = context();
    let tracer = Tracer::new(&context, &pair.gpu, Kernel::Product).expect("uploads");
    let missed = tracer.closest(&rays).expect("traces").iter().filter(|hit| hit.is_none()).count();
    assert_eq!(missed, 0, "rays left a closed surface");
    let open = tracer.occluded(&rays).expect("traces").iter().filter(|blocked| !**blocked).count();
    assert_eq!(open, 0, "shadow rays left a closed surface");
}

#[test]
fn far_from_the_origin() {
    let pair = pair(&[ball(30, Vec3::new(1e5, -2e5, 3e5), 10.0)], &[place(Affine3A::IDENTITY)]);
    assert_same(&pair, &random_rays(&pair.bounds, 10_000, 6), 20);
}

#[test]
fn small_from_far_away() {
    let pair = pair(&[ball(30, Vec3::ZERO, 0.01)], &[place(Affine3A::IDENTITY)]);
    let mut random = Random(7);
    let rays: Vec<Ray> = (0..10_000)
        .map(|_| {
            let origin = 500.0 * random.direction();
            Ray::new(origin, 0.009 * random.direction() - origin)
        })
        .collect();
    let context = context();
    let tracer = Tracer::new(&context, &pair.gpu, Kernel::Product).expect("uploads");
    let found = tracer.closest(&rays).expect("traces");
    let differing =
        rays.iter().zip(found).filter(|(ray, hit)| closest(&pair.cpu, ray).is_some() != hit.is_some()).count();
    assert!(differing <= 10, "{differing} of 10000 rays hit on one device only");
}

#[test]
fn spheres_from_outside_and_inside() {
    let shape = mesh(vec![], vec![], spheres(2000, 0.03, 8));
    let pair = pair(&[shape], &[place(Affine3A::IDENTITY)]);
    assert_same(&pair, &random_rays(&pair.bounds, 20_000, 9), 1);
    let big = mesh(vec![], vec![], vec![Sphere { center: Vec3::ONE, radius: 3.0, slot: 0 }]);
    let pair = self::pair(&[big], &[place(Affine3A::IDENTITY)]);
    let mut random = Random(10);
    let rays: Vec<Ray> = (0..2000).map(|_| Ray::new(Vec3::ONE + random.point(), random.direction())).collect();
    assert_same(&pair, &rays, 0);
}

#[test]
fn instances_mirrored_sheared_and_overlapping() {
    let mut random = Random(11);
    let meshes = [ball(12, Vec3::ZERO, 0.5), soup(300, 0.3, 12), mesh(vec![], vec![], spheres(50, 0.2, 13))];
    let placements: Vec<Placement> = (0..200)
        .map(|i| {
            let scale = (0.3 + random.point()) * if i % 3 == 0 { Vec3::new(-1.0, 1.0, 1.0) } else { Vec3::ONE };
            let rotation = Quat::from_axis_angle(random.direction(), 6.0 * random.unit());
            let transform = Affine3A::from_scale_rotation_translation(scale, rotation, 5.0 * random.point());
            Placement { mesh: i % 3, transform, filtered: false }
        })
        .collect();
    let pair = pair(&meshes, &placements);
    assert_same(&pair, &random_rays(&pair.bounds, 20_000, 14), 2);
}

#[test]
fn equal_distances_go_to_the_lowest_ids() {
    let quad = |z: f32| [Vec3::new(0.0, 0.0, z), Vec3::new(1.0, 0.0, z), Vec3::new(0.0, 1.0, z)];
    // The same triangle five times, in three instances at one place.
    let positions: Vec<Vec3> = (0..5).flat_map(|_| quad(0.0)).collect();
    let stack = mesh(positions, (0..5).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(), vec![]);
    let pair = pair(&[stack], &[place(Affine3A::IDENTITY); 3]);
    let context = context();
    let tracer = Tracer::new(&context, &pair.gpu, Kernel::Product).expect("uploads");
    let rays = [Ray::new(Vec3::new(0.2, 0.2, 2.0), Vec3::NEG_Z), Ray::new(Vec3::new(0.6, 0.3, -2.0), Vec3::Z)];
    for hit in tracer.closest(&rays).expect("traces") {
        let hit = hit.expect("hits");
        assert_eq!((hit.instance, hit.primitive), (0, 0));
    }
}

#[test]
fn interval_ends_are_open() {
    let shape = mesh(vec![Vec3::ZERO, Vec3::X, Vec3::Y], vec![[0, 1, 2]], vec![]);
    let pair = pair(&[shape], &[place(Affine3A::IDENTITY)]);
    let ray = |t_min: f32, t_max: f32| Ray { origin: Vec3::new(0.25, 0.25, 1.0), t_min, direction: Vec3::NEG_Z, t_max };
    let rays = [ray(0.0, 1.0), ray(0.0, 1.000_001), ray(1.0, 2.0), ray(0.999_999, 2.0)];
    let context = context();
    let tracer = Tracer::new(&context, &pair.gpu, Kernel::Product).expect("uploads");
    assert_eq!(tracer.occluded(&rays).expect("traces"), [false, true, false, true]);
    let hit: Vec<bool> = tracer.closest(&rays).expect("traces").iter().map(Option::is_some).collect();
    assert_eq!(hit, [false, true, false, true]);
}

#[test]
fn nothing_is_hit_in_an_empty_scene() {
    let pair = pair(&[mesh(vec![], vec![], vec![])], &[place(Affine3A::IDENTITY)]);
    let context = context();
    let tracer = Tracer::new(&context, &pair.gpu, Kernel::Product).expect("uploads");
    let rays = [Ray::new(Vec3::ZERO, Vec3::X)];
    assert_eq!(tracer.closest(&rays).expect("traces"), [None]);
    assert_eq!(tracer.occluded(&rays).expect("traces"), [false]);
}

#[test]
fn a_million_triangles_fit() {
    let pair = pair(&[ball(710, Vec3::ZERO, 1.0)], &[place(Affine3A::IDENTITY)]);
    assert_same(&pair, &random_rays(&pair.bounds, 5000, 15), 2);
}
