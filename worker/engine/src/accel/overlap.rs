//! Which cells of a lattice a primitive's surface meets: conservative voxelisation.
//!
//! Triangles are tested against boxes by separating axes (Akenine-Möller 2001, "Fast 3D triangle-box overlap testing"),
//! arranged for many boxes of one size: Schwarz, Seidel 2010, "Fast parallel surface and solid voxelization on GPUs",
//! section 3. All of it is done in double precision over single-precision corners, and boxes are grown by far more than
//! that can round away: a cell may be named that the surface just misses, never the reverse.

use std::ops::RangeInclusive;

use glam::{DVec3, Vec3};

use crate::scene::{Aabb, Mesh};

/// Boxes grow by at least this part of the lattice's largest extent, which covers all rounding here.
const MIN_GROWTH: f64 = 1e-12;

/// Equal cells that fill a box; cell `(x, y, z)` spans `origin + (x, y, z) * cell` to `origin + (x + 1, …) * cell`.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    pub origin: Vec3,
    /// Edges of one cell; where the box is flat, 0.
    pub cell: DVec3,
    pub dims: [u32; 3],
    /// By how much every cell is grown to all sides when it is tested.
    pub growth: f64,
}

/// Cells from the first to the last corner, both within.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellRange {
    pub first: [u32; 3],
    pub last: [u32; 3],
}

impl CellRange {
    fn axis(&self, axis: usize) -> RangeInclusive<u32> {
        self.first[axis]..=self.last[axis]
    }

    fn intersection(&self, other: &Self) -> Option<Self> {
        let range = Self {
            first: std::array::from_fn(|k| self.first[k].max(other.first[k])),
            last: std::array::from_fn(|k| self.last[k].min(other.last[k])),
        };
        (0..3).all(|k| range.first[k] <= range.last[k]).then_some(range)
    }
}

impl Lattice {
    /// `dims` cells (each at least 1) over `bounds`, which must be finite; cells are grown by `growth` world units.
    pub fn new(bounds: &Aabb, dims: [u32; 3], growth: f64) -> Self {
        let extent = bounds.max.as_dvec3() - bounds.min.as_dvec3();
        let cell = extent / DVec3::from_array(dims.map(f64::from));
        Self { origin: bounds.min, cell, dims, growth: growth.max(MIN_GROWTH * extent.max_element()) }
    }

    pub fn all(&self) -> CellRange {
        CellRange { first: [0; 3], last: self.dims.map(|dim| dim - 1) }
    }

    /// Names the cells of `within` that the surface of a mesh's primitive meets, x running fastest.
    pub fn primitive_cells(&self, mesh: &Mesh, primitive: usize, within: CellRange, visit: impl FnMut([u32; 3])) {
        match mesh.triangles.get(primitive) {
            Some(triangle) => {
                self.triangle_cells(triangle.map(|vertex| mesh.positions[vertex as usize]), within, visit);
            }
            None => {
                let sphere = &mesh.spheres[primitive - mesh.triangles.len()];
                self.sphere_cells(sphere.center, sphere.radius, within, visit);
            }
        }
    }

    /// Names the cells of `within` that a triangle meets. One with a corner that is not finite meets none.
    pub fn triangle_cells(&self, corners: [Vec3; 3], within: CellRange, mut visit: impl FnMut([u32; 3])) {
        let corners = corners.map(|corner| corner.as_dvec3() - self.origin.as_dvec3());
        let (min, max) = (corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2]));
        let Some((range, is_one_row)) = self.range(min, max, within) else { return };
        if is_one_row {
            for_each_cell(range, visit);
            return;
        }
        let test = TriangleTest::new(corners, self.cell + 2.0 * self.growth);
        for_each_cell(range, |cell| {
            if test.meets(self.low_corner(cell)) {
                visit(cell);
            }
        });
    }

    /// Names the cells of `within` that a sphere's surface meets.
    pub fn sphere_cells(&self, center: Vec3, radius: f32, within: CellRange, mut visit: impl FnMut([u32; 3])) {
        let center = center.as_dvec3() - self.origin.as_dvec3();
        let radius = f64::from(radius.abs());
        let Some((range, _)) = self.range(center - radius, center + radius, within) else { return };
        for_each_cell(range, |cell| {
            let low = self.low_corner(cell);
            let high = low + self.cell + 2.0 * self.growth;
            let nearest = center.clamp(low, high);
            let farthest = (low - center).abs().max((high - center).abs());
            if (nearest - center).length() <= radius + self.growth && radius <= farthest.length() + self.growth {
                visit(cell);
            }
        });
    }

    /// The grown cell's lowest corner, relative to the origin.
    fn low_corner(&self, cell: [u32; 3]) -> DVec3 {
        DVec3::from_array(cell.map(f64::from)) * self.cell - self.growth
    }

    /// The cells of `within` that a box relative to the origin meets, and whether the box lies in a single row of the
    /// (endless) lattice: then whatever is connected and as long as the box meets each of them. None where the box is
    /// not finite.
    fn range(&self, min: DVec3, max: DVec3, within: CellRange) -> Option<(CellRange, bool)> {
        if !(min.is_finite() && max.is_finite()) {
            return None;
        }
        // The casts saturate, also for the infinities of a flat axis; NaN, which is 0 / 0, becomes 0.
        let low: [i64; 3] = std::array::from_fn(|k| ((min[k] - self.growth) / self.cell[k]).floor() as i64);
        let high: [i64; 3] = std::array::from_fn(|k| ((max[k] + self.growth) / self.cell[k]).floor() as i64);
        let is_one_row = (0..3).filter(|&k| low[k] == high[k]).count() >= 2;
        if (0..3).any(|k| high[k] < 0 || low[k] >= i64::from(self.dims[k])) {
            return None;
        }
        let clamp = |at: i64, axis: usize| at.clamp(0, i64::from(self.dims[axis]) - 1) as u32;
        let range = CellRange {
            first: std::array::from_fn(|k| clamp(low[k], k)),
            last: std::array::from_fn(|k| clamp(high[k], k)),
        };
        Some((range.intersection(&within)?, is_one_row))
    }
}

#[inline(always)]
fn for_each_cell(range: CellRange, mut f: impl FnMut([u32; 3])) {
    for z in range.axis(2) {
        for y in range.axis(1) {
            for x in range.axis(0) {
                f([x, y, z]);
            }
        }
    }
}

/// A triangle against boxes of one size, each given by its lowest corner.
struct TriangleTest {
    normal: DVec3,
    /// The box's corners that are nearest and farthest along the normal lie on both sides of the plane, or on it, when
    /// `(normal . low + nearest) * (normal . low + farthest) <= 0`.
    nearest: f64,
    farthest: f64,
    /// For each projection (along z, x, y) and edge the inward normal and the offset: the box reaches the inside of the
    /// edge where `normal . low + offset >= 0`.
    edges: [[([f64; 2], f64); 3]; 3],
}

/// The axes that are left in each projection, in cyclic order.
const PROJECTIONS: [(usize, usize, usize); 3] = [(0, 1, 2), (1, 2, 0), (2, 0, 1)];

impl TriangleTest {
    /// Corners with more than half of the exponent range of an `f64` left, as all from an `f32` have.
    fn new(corners: [DVec3; 3], size: DVec3) -> Self {
        let sides = [corners[1] - corners[0], corners[2] - corners[1], corners[0] - corners[2]];
        let normal = sides[0].cross(sides[1]);
        let critical = DVec3::select(normal.cmpgt(DVec3::ZERO), size, DVec3::ZERO);
        let edges = PROJECTIONS.map(|(a, b, along)| {
            // Seen along a positive normal the corners run counter-clockwise. (A triangle that is a line from here is
            // bounded by its edges' lines either way.)
            let sign = if normal[along] < 0.0 { -1.0 } else { 1.0 };
            std::array::from_fn(|i| {
                let inward = [-sides[i][b] * sign, sides[i][a] * sign];
                let reach = (inward[0] * size[a]).max(0.0) + (inward[1] * size[b]).max(0.0);
                (inward, reach - inward[0] * corners[i][a] - inward[1] * corners[i][b])
            })
        });
        Self {
            normal,
            nearest: normal.dot(critical - corners[0]),
            farthest: normal.dot(size - critical - corners[0]),
            edges,
        }
    }

    #[inline(always)]
    fn meets(&self, low: DVec3) -> bool {
        let height = self.normal.dot(low);
        if (height + self.nearest) * (height + self.farthest) > 0.0 {
            return false;
        }
        PROJECTIONS
            .iter()
            .zip(&self.edges)
            .all(|(&(a, b, _), edges)| edges.iter().all(|([x, y], offset)| x * low[a] + y * low[b] + offset >= 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Random(u64);

    impl Random {
        fn unit(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 40) as f32 / (1 << 24) as f32
        }

        fn point(&mut self, scale: f32) -> Vec3 {
            scale * Vec3::new(self.unit(), self.unit(), self.unit())
        }
    }

    fn unit_lattice(dims: [u32; 3]) -> Lattice {
        Lattice::new(&Aabb { min: Vec3::ZERO, max: Vec3::ONE }, dims, 0.0)
    }

    fn triangle(lattice: &Lattice, corners: [Vec3; 3]) -> Vec<[u32; 3]> {
        let mut cells = vec![];
        lattice.triangle_cells(corners, lattice.all(), |cell| cells.push(cell));
        cells
    }

    fn cell_of(lattice: &Lattice, point: DVec3) -> [u32; 3] {
        std::array::from_fn(|k| {
            let at = (point[k] - f64::from(lattice.origin[k])) / lattice.cell[k];
            (at.max(0.0) as u32).min(lattice.dims[k] - 1)
        })
    }

    /// Clips a convex polygon to one side of a plane.
    fn clip(polygon: &[DVec3], axis: usize, at: f64, keep_above: bool) -> Vec<DVec3> {
        let height = |p: &DVec3| if keep_above { p[axis] - at } else { at - p[axis] };
        let mut kept = vec![];
        for (i, p) in polygon.iter().enumerate() {
            let q = &polygon[(i + 1) % polygon.len()];
            let (a, b) = (height(p), height(q));
            if a >= 0.0 {
                kept.push(*p);
            }
            if (a > 0.0 && b < 0.0) || (a < 0.0 && b > 0.0) {
                kept.push(*p + (*q - *p) * (a / (a - b)));
            }
        }
        kept
    }

    /// Whether anything is left of the triangle when it is clipped to a cell that is `more` larger to all sides.
    fn clipping_leaves_something(lattice: &Lattice, corners: [Vec3; 3], cell: [u32; 3], more: f64) -> bool {
        let mut polygon = corners.map(|c| c.as_dvec3()).to_vec();
        for (axis, &number) in cell.iter().enumerate() {
            let low = f64::from(lattice.origin[axis]) + f64::from(number) * lattice.cell[axis];
            polygon = clip(&polygon, axis, low - more, true);
            polygon = clip(&polygon, axis, low + lattice.cell[axis] + more, false);
        }
        !polygon.is_empty()
    }

    #[test]
    fn exactly_the_cells_that_clipping_leaves_are_named() {
        let mut random = Random(1);
        for round in 0..400 {
            let lattice = unit_lattice([5, 7, 4]);
            let base = random.point(1.0);
            let size = if round % 2 == 0 { 1.5 } else { 0.2 };
            let corners = [base, base + random.point(size) - 0.5 * size, base + random.point(size) - 0.5 * size];
            let named = triangle(&lattice, corners);
            for_each_cell(lattice.all(), |cell| {
                let is_named = named.contains(&cell);
                if clipping_leaves_something(&lattice, corners, cell, -1e-9) {
                    assert!(is_named, "{corners:?} meets {cell:?}");
                }
                if !clipping_leaves_something(&lattice, corners, cell, 1e-9) {
                    assert!(!is_named, "{corners:?} misses {cell:?}");
                }
            });
        }
    }

    #[test]
    fn points_of_degenerate_triangles_lie_in_named_cells() {
        let mut random = Random(2);
        for round in 0..600 {
            let lattice = unit_lattice([9, 3, 8]);
            let (a, b) = (random.point(1.0), random.point(1.0));
            let corners = match round % 4 {
                0 => [a, a, a],
                1 => [a, b, a],
                2 => [a, b, a + (b - a) * random.unit()],
                // In a plane of the lattice.
                _ => [a, b, random.point(1.0)].map(|p| Vec3::new(p.x, 1.0 / 3.0, p.z)),
            };
            let named = triangle(&lattice, corners);
            for _ in 0..50 {
                let (u, v) = (random.unit(), random.unit());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let [a, b, c] = corners.map(|c| c.as_dvec3());
                let point = a + f64::from(u) * (b - a) + f64::from(v) * (c - a);
                assert!(named.contains(&cell_of(&lattice, point)), "{point} of {corners:?}");
            }
        }
    }

    #[test]
    fn spheres_are_hollow() {
        let lattice = unit_lattice([16; 3]);
        let (center, radius) = (Vec3::new(0.5, 0.4, 0.6), 0.3);
        let mut named = vec![];
        lattice.sphere_cells(center, radius, lattice.all(), |cell| named.push(cell));
        assert!(!named.contains(&cell_of(&lattice, center.as_dvec3())));
        let mut random = Random(3);
        for _ in 0..2000 {
            let direction = (random.point(2.0) - 1.0).normalize_or(Vec3::X).as_dvec3();
            let point = center.as_dvec3() + f64::from(radius) * direction;
            assert!(named.contains(&cell_of(&lattice, point)), "{point}");
        }
        // About the sphere's area in faces of cells, times the thickness of a digital surface.
        assert!((300..900).contains(&named.len()), "{}", named.len());
    }

    #[test]
    fn what_lies_outside_or_is_not_finite_names_no_cell() {
        let lattice = unit_lattice([4; 3]);
        let far = [Vec3::splat(2.0), Vec3::splat(3.0), Vec3::new(2.0, 3.0, 2.0)];
        assert!(triangle(&lattice, far).is_empty());
        assert!(triangle(&lattice, [Vec3::NAN, Vec3::ZERO, Vec3::ONE]).is_empty());
        assert!(triangle(&lattice, [Vec3::INFINITY, Vec3::ZERO, Vec3::ONE]).is_empty());
        lattice.sphere_cells(Vec3::ZERO, f32::INFINITY, lattice.all(), |_| panic!("no cell is met"));
    }

    #[test]
    fn flat_and_huge_lattices_work() {
        let flat = Lattice::new(&Aabb { min: Vec3::ZERO, max: Vec3::new(1.0, 0.0, 1.0) }, [4, 1, 4], 0.0);
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Z];
        assert_eq!(triangle(&flat, corners).len(), 13);
        let huge = Aabb { min: Vec3::splat(-3e38), max: Vec3::splat(3e38) };
        let huge = Lattice::new(&huge, [4; 3], 0.0);
        let diagonal = [Vec3::splat(-3e38), Vec3::splat(3e38), Vec3::splat(3e38)];
        let cells = triangle(&huge, diagonal);
        assert!((0..4).all(|i| cells.contains(&[i; 3])));
    }

    #[test]
    fn only_cells_within_the_range_are_named() {
        let lattice = unit_lattice([8; 3]);
        let corners = [Vec3::ZERO, Vec3::ONE, Vec3::new(1.0, 0.0, 1.0)];
        let within = CellRange { first: [2, 0, 3], last: [6, 7, 4] };
        let all = triangle(&lattice, corners);
        let mut part = vec![];
        lattice.triangle_cells(corners, within, |cell| part.push(cell));
        let expected: Vec<_> =
            all.into_iter().filter(|cell| (0..3).all(|k| within.axis(k).contains(&cell[k]))).collect();
        assert!(!part.is_empty());
        assert_eq!(part, expected);
    }
}
