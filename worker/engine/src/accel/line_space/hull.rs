//! The convex hull of a shaft, and what of a triangle lies in it (Keul 2020, section 3.2).

use glam::DVec3;

use super::{Patch, ShaftGrid};
use crate::scene::Mesh;

/// Relative size below which a normal is no normal: its corners lie on a line.
const FLAT: f64 = 1e-12;

/// A half-space: points with `normal . p <= offset`.
#[derive(Clone, Copy, Debug)]
struct HalfSpace {
    normal: DVec3,
    offset: f64,
}

/// A shaft in the unit cube, as half-spaces that bound it.
#[derive(Clone, Debug)]
pub(super) struct Hull {
    planes: Vec<HalfSpace>,
    pub low: DVec3,
    pub high: DVec3,
}

impl Hull {
    /// The hull of two patches on different faces, grown by `growth` on each axis.
    ///
    /// Algorithm 2 of the thesis orders the corners so that the mantle is two parallelograms, over the edges along the
    /// axis that both patches share, and four triangles.
    pub(super) fn new(n: u32, a: Patch, b: Patch, growth: f64) -> Self {
        Self::over_cells(n, 1, a, b, growth)
    }

    /// The same of patches that are `width` of the `n` cells along an edge wide; the last ones may be narrower.
    pub(super) fn over_cells(n: u32, width: u32, a: Patch, b: Patch, growth: f64) -> Self {
        let (corners_a, corners_b) = ordered_corners(n, width, a, b);
        let ([a0, a1, a2, a3], [b0, b1, b2, b3]) = (corners_a, corners_b);
        let faces = [
            [a0, a1, a2],
            [b0, b1, b2],
            [a0, a1, b0],
            [a2, a3, b2],
            [a2, a0, b2],
            [a0, b2, b0],
            [a1, b1, a3],
            [b1, a3, b3],
        ];
        let corners = [a0, a1, a2, a3, b0, b1, b2, b3];
        let low = corners.iter().copied().fold(DVec3::INFINITY, DVec3::min) - growth;
        let high = corners.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max) + growth;
        let mut planes = Vec::with_capacity(faces.len() + 6);
        for [p, q, r] in faces {
            let normal = (q - p).cross(r - p);
            let size = (q - p).length() * (r - p).length();
            if normal.length() <= FLAT * size {
                continue;
            }
            let normal = normal.normalize();
            let (least, most) = corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), &corner| {
                let height = normal.dot(corner - p);
                (least.min(height), most.max(height))
            });
            // Of a plane that bounds the corners on one side, that side is kept.
            let reach = growth * normal.abs().element_sum() + FLAT;
            if most <= FLAT {
                planes.push(HalfSpace { normal, offset: normal.dot(p) + reach });
            } else if least >= -FLAT {
                planes.push(HalfSpace { normal: -normal, offset: -normal.dot(p) + reach });
            }
        }
        for axis in DVec3::AXES {
            planes.push(HalfSpace { normal: axis, offset: axis.dot(high) + FLAT });
            planes.push(HalfSpace { normal: -axis, offset: -axis.dot(low) + FLAT });
        }
        Self { planes, low, high }
    }

    /// Whether anything of a triangle is in the hull.
    pub(super) fn meets_triangle(&self, triangle: [DVec3; 3]) -> bool {
        let mut polygon = triangle.to_vec();
        let mut kept = Vec::with_capacity(8);
        for plane in &self.planes {
            kept.clear();
            for (i, &p) in polygon.iter().enumerate() {
                let q = polygon[(i + 1) % polygon.len()];
                let (above_p, above_q) = (plane.normal.dot(p) - plane.offset, plane.normal.dot(q) - plane.offset);
                if above_p <= 0.0 {
                    kept.push(p);
                }
                if (above_p < 0.0 && above_q > 0.0) || (above_p > 0.0 && above_q < 0.0) {
                    kept.push(p + (q - p) * (above_p / (above_p - above_q)));
                }
            }
            if kept.is_empty() {
                return false;
            }
            std::mem::swap(&mut polygon, &mut kept);
        }
        true
    }

    /// Whether a box may meet the hull: never false when it does.
    pub(super) fn may_meet_box(&self, low: DVec3, high: DVec3) -> bool {
        self.planes.iter().all(|plane| {
            let nearest = DVec3::select(plane.normal.cmpgt(DVec3::ZERO), low, high);
            plane.normal.dot(nearest) <= plane.offset
        })
    }

    /// Whether a primitive may meet the hull: exact for triangles, and never false for a sphere that does.
    pub(super) fn meets_primitive(&self, grid: &ShaftGrid, mesh: &Mesh, primitive: u32) -> bool {
        if let Some(triangle) = mesh.triangles.get(primitive as usize) {
            let corners = triangle.map(|vertex| grid.to_unit(mesh.positions[vertex as usize].as_dvec3()));
            return corners.iter().all(|corner| corner.is_finite()) && self.meets_triangle(corners);
        }
        let sphere = &mesh.spheres[primitive as usize - mesh.triangles.len()];
        let center = grid.to_unit(sphere.center.as_dvec3());
        let radii = grid.unit_scale() * f64::from(sphere.radius.abs());
        // An ellipsoid in the unit cube: its reach along a normal.
        self.planes.iter().all(|plane| plane.normal.dot(center) - (plane.normal * radii).length() <= plane.offset)
    }
}

/// The corners a0..a3 and b0..b3 of the thesis' algorithm 2: index bit 0 adds the shared direction, bit 1 the other one.
fn ordered_corners(n: u32, width: u32, a: Patch, b: Patch) -> ([DVec3; 4], [DVec3; 4]) {
    let shared = a.tangents().into_iter().find(|axis| b.tangents().contains(axis)).unwrap_or(0);
    let cell = |face: u32, at: [u32; 2]| Patch { face, u: at[0].min(n - 1), v: at[1].min(n - 1) }.unit_bounds(n);
    let spans = |patch: Patch| {
        let first = [patch.u * width, patch.v * width];
        let ([low, _], [_, high]) = (cell(patch.face, first), cell(patch.face, first.map(|at| at + width - 1)));
        let [u, v] = patch.tangents();
        let other = if u == shared { v } else { u };
        let along = |axis: usize| DVec3::AXES[axis] * (high - low)[axis];
        (low, along(shared), along(other))
    };
    let ((mut a0, d, mut s), (mut b0, _, mut t)) = (spans(a), spans(b));
    // Between opposite faces the two directions stay the same.
    let is_turned = a.axis() != b.axis();
    if is_turned && (a0 - b0).dot(s) < 0.0 {
        a0 += s;
        s = -s;
    }
    if is_turned && (b0 - a0).dot(t) < 0.0 {
        b0 += t;
        t = -t;
    }
    if a0.dot(d) > b0.dot(d) {
        std::mem::swap(&mut a0, &mut b0);
        std::mem::swap(&mut s, &mut t);
    }
    ([a0, a0 + d, a0 + s, a0 + d + s], [b0, b0 + d, b0 + t, b0 + d + t])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::line_space::shaft::{symmetric_count, symmetric_patches};

    struct Random(u64);

    impl Random {
        fn unit(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        }

        fn point(&mut self) -> DVec3 {
            DVec3::new(self.unit(), self.unit(), self.unit())
        }
    }

    /// How deep a point is in the hull by its definition: the greatest `m` for which it is, on some section, at least
    /// `m` away from all sides.
    fn depth(n: u32, a: Patch, b: Patch, point: DVec3) -> f64 {
        let ([a_low, a_high], [b_low, b_high]) = (a.unit_bounds(n), b.unit_bounds(n));
        let at = |s: f64| {
            let (low, high) = (a_low + s * (b_low - a_low), a_high + s * (b_high - a_high));
            (point - low).min(high - point).min_element()
        };
        // A concave function of s.
        let (mut from, mut to) = (0.0, 1.0);
        for _ in 0..100 {
            let (third, two) = (from + (to - from) / 3.0, to - (to - from) / 3.0);
            if at(third) > at(two) {
                to = two;
            } else {
                from = third;
            }
        }
        at(0.5 * (from + to))
    }

    #[test]
    fn hulls_hold_exactly_the_points_of_their_sections() {
        let mut random = Random(1);
        let (mut inside, mut outside) = (0, 0);
        for n in [1, 2, 3, 5] {
            let count = symmetric_count(n);
            for _ in 0..600 {
                let (a, b) = symmetric_patches(n, (random.unit() * count as f64) as u32);
                let hull = Hull::new(n, a, b, 0.0);
                for i in 0..20 {
                    let point = match i % 2 {
                        0 => random.point(),
                        _ => hull.low + random.point() * (hull.high - hull.low),
                    };
                    let is_held = hull.meets_triangle([point; 3]);
                    let depth = depth(n, a, b, point);
                    if depth > 1e-9 {
                        inside += 1;
                        assert!(is_held, "{point} is in {a:?} {b:?}");
                    } else if depth < -1e-9 {
                        outside += 1;
                        assert!(!is_held, "{point} is not in {a:?} {b:?}: {depth}");
                    }
                }
            }
        }
        assert!(inside > 2000 && outside > 10_000, "{inside} {outside}");
    }

    #[test]
    fn a_triangle_meets_the_hull_when_one_of_its_points_does() {
        let mut random = Random(2);
        let mut met = 0;
        for _ in 0..3000 {
            let n = 4;
            let (a, b) = symmetric_patches(n, (random.unit() * symmetric_count(n) as f64) as u32);
            let hull = Hull::new(n, a, b, 0.0);
            let triangle = [random.point(), random.point(), random.point()];
            let is_met = hull.meets_triangle(triangle);
            met += usize::from(is_met);
            for _ in 0..50 {
                let (u, v) = (random.unit(), random.unit());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let point = triangle[0] + u * (triangle[1] - triangle[0]) + v * (triangle[2] - triangle[0]);
                assert!(is_met || depth(n, a, b, point) < 1e-9, "{point} of {triangle:?}");
            }
            if is_met {
                let [p, q, r] = triangle;
                assert!(hull.may_meet_box(p.min(q).min(r), p.max(q).max(r)));
            }
        }
        assert!(met > 300, "{met}");
    }

    #[test]
    fn growth_is_that_of_the_sections() {
        let (a, b) = symmetric_patches(3, 700);
        let [hull, grown] = [0.0, 0.05].map(|growth| Hull::new(3, a, b, growth));
        let corner = hull.low;
        assert!(!hull.meets_triangle([corner - 0.01; 3]));
        let center = 0.5 * (hull.low + hull.high);
        for axis in DVec3::AXES {
            for side in [-1.0, 1.0] {
                // A point of the hull, moved by less than the growth on every axis, is in the grown one.
                let point = center + side * axis * 0.049;
                assert!(!hull.meets_triangle([center; 3]) || grown.meets_triangle([point; 3]));
            }
        }
    }
}
