//! One structure over the whole scene, of each kind: the GPU finds what the CPU does.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, Quat, Vec3};
use lightshaft_engine::accel::{
    BuildParams, GridParams, GridResolution, NTreeParams, OctreeParams, Placement, SceneAccel, Structure,
    StructureParams, flatten,
};
use lightshaft_engine::device::gpu::{HostStructure, Kernel, Tracer};
use lightshaft_engine::pack::{pack, placements};
use lightshaft_engine::scene::{Aabb, Mesh};
use lightshaft_engine::settings::Integrator;
use lightshaft_engine::trace::Ray;

use crate::common::{Random, closest, mesh, occluded, place, random_ray, soup, spheres};
use crate::context;
use crate::pictures::assert_same_picture_of;
use crate::scenes::{everything, opaque, settings};
use crate::traversal::alike;

const BUDGET: u64 = 1 << 30;

fn kinds() -> [StructureParams; 6] {
    let ntree = |n, depth| StructureParams::NTree(NTreeParams { n, depth, max_leaf: 4, budget_bytes: BUDGET });
    [
        StructureParams::Bvh(BuildParams { spatial_splits: true, ..BuildParams::default() }),
        StructureParams::Grid(GridParams { resolution: GridResolution::PerPrimitive(4), budget_bytes: BUDGET }),
        StructureParams::Grid(GridParams { resolution: GridResolution::Cells([7, 1, 13]), budget_bytes: BUDGET }),
        StructureParams::Octree(OctreeParams { depth: 9, max_leaf: 3, budget_bytes: BUDGET }),
        ntree(5, 3),
        ntree(16, 2),
    ]
}

fn accel(meshes: &[Arc<Mesh>], placements: &[Placement], params: &StructureParams) -> SceneAccel {
    let (flat, names) = flatten(meshes, placements).expect("flattens");
    SceneAccel::flat(Structure::build(&flat, params, &AtomicBool::new(false)).expect("builds"), names)
}

/// Compares all rays, near ones and those from so far away that trees of cells walk them with care.
#[track_caller]
fn assert_same(meshes: &[Arc<Mesh>], placements: &[Placement], per_mille: usize) {
    for params in kinds() {
        let cpu = accel(meshes, placements, &params);
        let bounds = cpu.structures()[0].bounds();
        let context = context();
        let host = HostStructure::flat(&cpu).expect("flat");
        let tracer = Tracer::new(&context, &host, Kernel::Product).expect("uploads");
        for far in [false, true] {
            let rays = rays(&bounds, far);
            let found = tracer.closest(&rays).expect("traces");
            let blocked = tracer.occluded(&rays).expect("traces");
            let (mut hits, mut differing, mut differing_any) = (0, 0, 0);
            for ((ray, gpu), any) in rays.iter().zip(found).zip(blocked) {
                let cpu_hit = closest(&cpu, ray);
                hits += usize::from(cpu_hit.is_some());
                differing += usize::from(!alike(cpu_hit, gpu));
                differing_any += usize::from(any != occluded(&cpu, ray));
            }
            let count = rays.len();
            assert!(hits * 40 > count, "{params:?}: only {hits} of {count} rays hit anything: the test says little");
            assert!(differing * 1000 <= per_mille * count, "{params:?}, far {far}: {differing} of {count} differ");
            assert!(differing_any * 1000 <= per_mille * count, "{params:?}, far {far}: {differing_any} any-hits");
        }
    }
}

/// Rays of all kinds, one in four between corners of cells.
fn rays(bounds: &Aabb, far: bool) -> Vec<Ray> {
    let mut random = Random(5);
    let corner = |random: &mut Random| {
        let steps = Vec3::from_array([(); 3].map(|()| (random.next() % 13) as f32 / 12.0));
        bounds.min + steps * bounds.extent()
    };
    (0..6000)
        .map(|i| {
            let ray = random_ray(&mut random, bounds);
            if far {
                let away = bounds.extent().max_element() * (10.0 + 90.0 * random.unit());
                return Ray { origin: ray.origin - away * ray.direction.normalize(), ..ray };
            }
            let (from, to) = (corner(&mut random), corner(&mut random));
            if i % 4 == 0 && from != to { Ray::new(from, to - from) } else { ray }
        })
        .collect()
}

#[test]
fn instances_of_triangles_and_spheres() {
    let objects = soup(2000, 0.15, 1);
    let both = mesh(objects.positions, objects.triangles, spheres(300, 0.05, 2));
    let turned = |x: f32, scale: f32| {
        Affine3A::from_scale_rotation_translation(
            Vec3::splat(scale),
            Quat::from_rotation_y(x),
            Vec3::new(x, 0.3 * x, -0.2),
        )
    };
    let placements = [place(Affine3A::IDENTITY), place(turned(0.7, 1.5)), place(turned(-1.1, -0.8))];
    assert_same(&[Arc::new(both)], &placements, 3);
}

#[test]
fn flat_and_tiny_scenes() {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
    let quad = mesh(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]], vec![]);
    // Rays within the plane hit by a last bit, or not.
    assert_same(&[Arc::new(quad)], &[place(Affine3A::from_scale(Vec3::splat(1e-3)))], 20);
}

#[test]
fn pictures_of_flat_scenes() {
    for (name, mut scene) in [("flat-alpha", everything()), ("flat-opaque", opaque())] {
        // Flat structures hold no ellipsoids.
        for instance in &mut scene.instances {
            if !scene.meshes[instance.mesh as usize].spheres.is_empty() {
                instance.transform = Affine3A::from_translation(instance.transform.translation.into());
            }
        }
        let settings = settings(Integrator::Path { max_bounces: 3 });
        // Each kernel takes seconds to compile: one of each kind, with the alpha filter and without.
        for params in if name == "flat-alpha" { [0, 1] } else { [0, 4] }.map(|kind| kinds()[kind]) {
            let accel = accel(&scene.meshes, &placements(&scene), &params);
            let packed = pack(&scene, &settings, Arc::new(accel)).expect("packs");
            assert_same_picture_of(context(), &format!("{name}-{}", params.kind()), Arc::new(packed), &settings);
        }
    }
}
