//! Patches, shafts and their numbers; the shaft of a ray against double precision.

use glam::{DVec3, Vec3};
use lightshaft_engine::accel::line_space::shaft::{
    self, DILATION, MAX_N, directed_index, directed_patches, symmetric_index, symmetric_patches,
};
use lightshaft_engine::accel::line_space::{Location, Patch, ShaftGrid};
use lightshaft_engine::scene::Aabb;
use lightshaft_engine::trace::Ray;

use crate::common::{Random, hard_ray, random_ray};

fn boxes() -> Vec<Aabb> {
    let aabb = |min: [f32; 3], max: [f32; 3]| Aabb { min: min.into(), max: max.into() };
    vec![
        aabb([0.0; 3], [1.0; 3]),
        aabb([-3.0, 2.0, -0.5], [4.0, 2.1, 11.0]),
        aabb([-5.0, 1.0, -5.0], [5.0, 1.0, 5.0]),
        aabb([2.0, 0.0, 3.0], [2.0, 9.0, 3.0]),
        aabb([1.0e6, -2.0e6, 3.0e5], [1.000_01e6, -1.999_99e6, 3.0001e5]),
        aabb([-1.0e30; 3], [2.0e30, 1.0e30, 3.0e30]),
        aabb([-1.0e-20; 3], [2.0e-20, 1.0e-20, 3.0e-20]),
    ]
}

#[test]
fn shaft_numbers_and_patch_pairs_stand_for_each_other() {
    for n in 1..=6 {
        assert_eq!(shaft::symmetric_count(n), 15 * u64::from(n).pow(4));
        for index in 0..shaft::symmetric_count(n) as u32 {
            let (a, b) = symmetric_patches(n, index);
            assert!(a.face < b.face && a.u.max(a.v).max(b.u).max(b.v) < n);
            assert_eq!((symmetric_index(n, a, b), symmetric_index(n, b, a)), (index, index));
        }
        for index in 0..shaft::directed_count(n) as u32 {
            let (start, end) = directed_patches(n, index);
            assert_ne!(start.face, end.face);
            assert_eq!(directed_index(n, start, end), index);
        }
        for index in 0..6 * n * n {
            assert_eq!(Patch::from_index(n, index).index(n), index);
        }
    }
}

#[test]
fn the_line_between_two_patch_centres_is_located_in_their_shaft() {
    for (bounds, n) in boxes().iter().zip([1, 2, 3, 4, 5, 6, 2]) {
        let grid = ShaftGrid::new(bounds, n).expect("usable");
        for index in 0..shaft::directed_count(n) as u32 {
            let (start, end) = directed_patches(n, index);
            let center = |patch: Patch| {
                let [low, high] = patch.unit_bounds(n);
                grid.from_unit(0.5 * (low + high))
            };
            let (from, to) = (center(start), center(end));
            let direction = to - from;
            let origin = (from - 0.5 * direction).as_vec3();
            let Location::Through(chord) = grid.locate(&Ray::new(origin, direction.as_vec3())) else {
                panic!("{start:?} {end:?} in {bounds:?}")
            };
            assert_eq!((chord.entry, chord.exit), (start, end), "{bounds:?}");
            assert!(chord.starts_outside && chord.reaches_exit);
        }
    }
}

/// Where the line enters and leaves the padded box scaled to the unit cube, in double precision.
fn exact_chord(grid: &ShaftGrid, ray: &Ray) -> Option<[DVec3; 2]> {
    let origin = grid.to_unit(ray.origin.as_dvec3());
    let direction = ray.direction.as_dvec3() * grid.unit_scale();
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for k in 0..3 {
        if direction[k] == 0.0 {
            if !(0.0..=1.0).contains(&origin[k]) {
                return None;
            }
            continue;
        }
        let (a, b) = (-origin[k] / direction[k], (1.0 - origin[k]) / direction[k]);
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    (near <= far).then(|| [origin + near * direction, origin + far * direction])
}

/// How far the line from `a` to `b` passes by the patch, at most on any axis.
fn distance(grid: &ShaftGrid, patch: Patch, a: DVec3, b: DVec3) -> f64 {
    let [low, high] = patch.unit_bounds(grid.n());
    let outside = |t: f64| {
        let point = a + t * (b - a);
        (low - point).max(point - high).max_element().max(0.0)
    };
    // The distance is a convex function along the line.
    let (mut from, mut to) = (-2.0, 3.0);
    for _ in 0..200 {
        let (third, two) = (from + (to - from) / 3.0, to - (to - from) / 3.0);
        if outside(third) < outside(two) {
            to = two;
        } else {
            from = third;
        }
    }
    outside(0.5 * (from + to))
}

#[test]
fn located_rays_pass_through_their_patches() {
    let mut random = Random(3);
    let mut located = 0;
    for bounds in boxes() {
        for n in [1, 2, 6, 10, 16, MAX_N] {
            let grid = ShaftGrid::new(&bounds, n).expect("usable");
            for _ in 0..2000 {
                let ray = hard_ray(&mut random, &grid, &bounds);
                match grid.locate(&ray) {
                    Location::Through(chord) => {
                        located += 1;
                        assert_ne!(chord.entry.face, chord.exit.face);
                        let a = grid.to_unit(ray.origin.as_dvec3());
                        let direction = ray.direction.as_dvec3() * grid.unit_scale();
                        // From a point near the box, so that the search below is precise.
                        let a = a + direction * ((DVec3::splat(0.5) - a).dot(direction) / direction.length_squared());
                        let b = a + direction / direction.abs().max_element();
                        for patch in [chord.entry, chord.exit] {
                            let off = distance(&grid, patch, a, b);
                            assert!(off <= 0.5 * DILATION, "{ray:?} passes {patch:?} of {grid:?} by {off}");
                        }
                    }
                    Location::Beside => {
                        // Then nothing of the box inside its padding is met.
                        if let Some([from, to]) = exact_chord(&grid, &ray).filter(|_| ray.t_max.is_infinite()) {
                            let inside = (0.5 * (from + to) - 0.5).abs().max_element() < 0.5 - 4.0 * DILATION;
                            let behind = (to - grid.to_unit(ray.origin.as_dvec3()))
                                .dot(ray.direction.as_dvec3() * grid.unit_scale())
                                <= f64::from(ray.t_min)
                                    * (ray.direction.as_dvec3() * grid.unit_scale()).length_squared()
                                    * 1.0001;
                            assert!(!inside || behind, "{ray:?} goes through {grid:?}");
                        }
                    }
                    Location::TooFar => {}
                }
            }
        }
    }
    assert!(located > 30_000, "only {located} rays were located: the test says little");
}

#[test]
fn turning_a_ray_around_swaps_its_patches() {
    let mut random = Random(5);
    let bounds = boxes()[1];
    let grid = ShaftGrid::new(&bounds, 12).expect("usable");
    let mut turned = 0;
    for _ in 0..20_000 {
        let ray = Ray { t_max: f32::INFINITY, ..random_ray(&mut random, &bounds) };
        let back = Ray { direction: -ray.direction, t_min: 0.0, t_max: f32::INFINITY, ..ray };
        // From inside, both directions see the same line.
        if let (Location::Through(there), Location::Through(back)) = (grid.locate(&ray), grid.locate(&back)) {
            turned += 1;
            assert_eq!((there.entry, there.exit), (back.exit, back.entry));
        }
    }
    assert!(turned > 5000);
}

#[test]
fn boxes_that_single_precision_cannot_divide_have_no_grid() {
    let point = Aabb { min: Vec3::ONE, max: Vec3::ONE };
    let huge = Aabb { min: Vec3::splat(f32::MIN), max: Vec3::splat(f32::MAX) };
    let tiny = Aabb { min: Vec3::ZERO, max: Vec3::splat(1e-44) };
    for bounds in [Aabb::EMPTY, point, huge, tiny] {
        assert_eq!(ShaftGrid::new(&bounds, 4), None, "{bounds:?}");
    }
}
