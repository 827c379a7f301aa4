//! Where in a box the surface is, and where it has holes: two voxel grids that answer "is there anything in this range
//! of cells?" from eight numbers, by summed tables (Crow 1984, "Summed-area tables for texture mapping", in three
//! dimensions).

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::ShaftGrid;
use crate::accel::BuildError;
use crate::accel::build::{check, primitive_bounds};
use crate::accel::overlap::Lattice;
use crate::scene::{Aabb, Mesh};

/// Triangles and edges that span more cells along an axis are halved before their cells are looked for.
const LONG: f64 = 6.0;
/// Whoever cancels is asked after so many primitives.
const CHECKED: usize = 8192;

/// Which cells of a cube of voxels hold something.
#[derive(Debug)]
pub(crate) struct Occupancy {
    resolution: usize,
    /// Occupied cells below and left of and in front of each lattice point.
    sums: Vec<u32>,
}

impl Occupancy {
    fn new(resolution: u32, is_occupied: impl Fn(usize) -> bool + Sync) -> Self {
        let r = resolution as usize;
        let row = r + 1;
        let mut sums = vec![0_u32; row * row * row];
        sums.par_chunks_mut(row * row).enumerate().skip(1).for_each(|(z, layer)| {
            for y in 0..r {
                let mut along = 0;
                for x in 0..r {
                    let cell = ((z - 1) * r + y) * r + x;
                    along += u32::from(is_occupied(cell));
                    layer[(y + 1) * row + x + 1] = layer[y * row + x + 1] + along;
                }
            }
        });
        for z in 1..row {
            let (below, layer) = sums.split_at_mut(z * row * row);
            let below = &below[(z - 1) * row * row..];
            layer[..row * row].iter_mut().zip(below).for_each(|(sum, below)| *sum += below);
        }
        Self { resolution: r, sums }
    }

    /// For each lattice point, x running fastest, the occupied cells before it on all axes.
    pub(crate) fn sums(&self) -> &[u32] {
        &self.sums
    }

    /// Whether a cell that the box from `low` to `high` reaches (in a unit cube of voxels) holds something.
    #[inline]
    pub(super) fn any(&self, low: DVec3, high: DVec3) -> bool {
        let r = self.resolution as f64;
        let cell = |value: f64| (value * r).max(0.0) as usize;
        let from = [cell(low.x), cell(low.y), cell(low.z)];
        let to = [cell(high.x) + 1, cell(high.y) + 1, cell(high.z) + 1].map(|to| to.min(self.resolution));
        if (0..3).any(|k| from[k] >= to[k]) {
            return false;
        }
        let row = self.resolution + 1;
        let sum = |x: usize, y: usize, z: usize| self.sums[(z * row + y) * row + x];
        let layer = |z: usize| {
            sum(to[0], to[1], z)
                .wrapping_sub(sum(from[0], to[1], z))
                .wrapping_sub(sum(to[0], from[1], z))
                .wrapping_add(sum(from[0], from[1], z))
        };
        layer(to[2]) != layer(from[2])
    }
}

/// The two grids of a mesh, over the unit cube of a [`ShaftGrid`].
#[derive(Debug)]
pub(crate) struct Voxels {
    /// Cells that the surface meets.
    pub surface: Occupancy,
    /// Cells that meet an edge where an odd number of triangles end: holes and borders.
    pub rim: Occupancy,
}

impl Voxels {
    /// Memory that [`Self::build`] takes at most, in bytes, for a mesh of so many triangles.
    pub(crate) fn bytes_needed(resolution: u32, triangles: usize) -> u64 {
        let r = u64::from(resolution);
        2 * ((r + 1).pow(3) * 4 + r.pow(3) / 8) + triangles as u64 * 3 * 12
    }

    /// `bounds` are those of all primitives that a ray can hit.
    pub(super) fn build(
        mesh: &Mesh,
        bounds: &Aabb,
        grid: &ShaftGrid,
        resolution: u32,
        cancel: &AtomicBool,
    ) -> Result<Self, BuildError> {
        let cells = (resolution as usize).pow(3);
        let fresh = || (0..cells.div_ceil(64)).map(|_| AtomicU64::new(0)).collect::<Vec<_>>();
        let rasterizer = Rasterizer::new(bounds, grid, resolution);

        let surface = fresh();
        let set = |bits: &[AtomicU64], cell: [u32; 3]| {
            let cell = ((cell[2] * resolution + cell[1]) * resolution + cell[0]) as usize;
            let (word, bit) = (&bits[cell / 64], 1 << (cell % 64));
            if word.load(Ordering::Relaxed) & bit == 0 {
                word.fetch_or(bit, Ordering::Relaxed);
            }
        };
        (0..mesh.primitive_count()).into_par_iter().with_min_len(CHECKED).try_for_each(|primitive| {
            if primitive.is_multiple_of(CHECKED) {
                check(cancel)?;
            }
            match mesh.triangles.get(primitive) {
                Some(triangle) => {
                    let corners = triangle.map(|vertex| mesh.positions[vertex as usize]);
                    rasterizer.triangle(corners, &mut |cell| set(&surface, cell));
                }
                None => {
                    let sphere = &mesh.spheres[primitive - mesh.triangles.len()];
                    let all = rasterizer.lattice.all();
                    rasterizer.lattice.sphere_cells(sphere.center, sphere.radius, all, |cell| set(&surface, cell));
                }
            }
            Ok(())
        })?;

        let edges = rim_edges(mesh);
        check(cancel)?;
        let rim = fresh();
        edges.par_iter().with_min_len(CHECKED).for_each(|&[a, b]| {
            rasterizer.triangle([a, b, b], &mut |cell| set(&rim, cell));
        });
        check(cancel)?;
        let occupancy = |bits: Vec<AtomicU64>| {
            Occupancy::new(resolution, |cell| bits[cell / 64].load(Ordering::Relaxed) >> (cell % 64) & 1 == 1)
        };
        Ok(Self { surface: occupancy(surface), rim: occupancy(rim) })
    }

    /// From a bit for each cell, x running fastest.
    pub(crate) fn from_words(resolution: u32, surface: &[u32], rim: &[u32]) -> Self {
        let occupancy = |words: &[u32]| Occupancy::new(resolution, |cell| words[cell / 32] >> (cell % 32) & 1 == 1);
        Self { surface: occupancy(surface), rim: occupancy(rim) }
    }
}

/// `resolution` cells along each axis of the grid's unit cube, each grown by more than halving a triangle or an edge of a
/// mesh with such `bounds` rounds away.
pub(crate) fn lattice(bounds: &Aabb, grid: &ShaftGrid, resolution: u32) -> Lattice {
    let origin = grid.from_unit(DVec3::ZERO).as_vec3();
    let cell = 1.0 / (grid.unit_scale() * f64::from(resolution));
    let largest = f64::from(bounds.min.abs().max(bounds.max.abs()).max_element());
    let growth = (largest * 4.0 * f64::from(f32::EPSILON)).max(cell.min_element() * 1e-6);
    Lattice { origin, cell, dims: [resolution; 3], growth }
}

/// Finds the cells that triangles meet, in pieces that do not span many.
pub(crate) struct Rasterizer {
    pub lattice: Lattice,
}

impl Rasterizer {
    pub(crate) fn new(bounds: &Aabb, grid: &ShaftGrid, resolution: u32) -> Self {
        Self { lattice: lattice(bounds, grid, resolution) }
    }

    /// Names the cells of a triangle, some of them several times.
    fn triangle(&self, corners: [Vec3; 3], visit: &mut impl FnMut([u32; 3])) {
        self.pieces(corners, &mut |piece| self.lattice.triangle_cells(piece, self.lattice.all(), &mut *visit));
    }

    /// Cuts a triangle into such pieces.
    pub(crate) fn pieces(&self, corners: [Vec3; 3], visit: &mut impl FnMut([Vec3; 3])) {
        let sides = [corners[1] - corners[0], corners[2] - corners[1], corners[0] - corners[2]];
        let cells = |side: Vec3| (side.as_dvec3().abs() / self.lattice.cell).max_element();
        let lengths = sides.map(cells);
        let longest = (0..3).max_by(|&a, &b| lengths[a].total_cmp(&lengths[b])).unwrap_or(0);
        if lengths[longest] <= LONG || !lengths[longest].is_finite() {
            visit(corners);
            return;
        }
        let (a, b, c) = (corners[longest], corners[(longest + 1) % 3], corners[(longest + 2) % 3]);
        let middle = 0.5 * a + 0.5 * b;
        self.pieces([a, middle, c], visit);
        self.pieces([middle, b, c], visit);
    }
}

/// Edges that an odd number of triangles share, after vertices at one place are made one. Triangles that no ray can hit
/// do not count.
pub(crate) fn rim_edges(mesh: &Mesh) -> Vec<[Vec3; 2]> {
    let places = welded(&mesh.positions);
    let mut edges: Vec<u64> = (0..mesh.triangles.len())
        .into_par_iter()
        .filter(|&triangle| primitive_bounds(mesh, triangle).min.is_finite())
        .flat_map_iter(|triangle| {
            let [a, b, c] = mesh.triangles[triangle].map(|vertex| places[vertex as usize]);
            [(a, b), (b, c), (c, a)]
        })
        .filter(|(a, b)| a != b)
        .map(|(a, b)| u64::from(a.min(b)) << 32 | u64::from(a.max(b)))
        .collect();
    edges.par_sort_unstable();
    let odd = edges.chunk_by(|a, b| a == b).filter(|run| run.len() % 2 == 1);
    odd.map(|run| [run[0] >> 32, run[0] & 0xffff_ffff].map(|vertex| mesh.positions[vertex as usize])).collect()
}

/// For each vertex the first of those at its place.
fn welded(positions: &[Vec3]) -> Vec<u32> {
    // Adding 0 makes one zero of two.
    let place = |vertex: u32| positions[vertex as usize].to_array().map(|value| (value + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.par_sort_unstable_by_key(|&vertex| (place(vertex), vertex));
    let mut first = vec![0; positions.len()];
    for run in order.chunk_by(|&a, &b| place(a) == place(b)) {
        run.iter().for_each(|&vertex| first[vertex as usize] = run[0]);
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::line_space::tests::{cube, quad};

    fn voxels(mesh: &Mesh) -> (ShaftGrid, Voxels) {
        let grid = ShaftGrid::new(&mesh.bounds, 4).expect("usable");
        let voxels = Voxels::build(mesh, &mesh.bounds, &grid, 32, &AtomicBool::new(false)).expect("builds");
        (grid, voxels)
    }

    #[test]
    fn a_cube_is_hollow_and_has_no_rim() {
        let (_, voxels) = voxels(&cube());
        let any = |low: f64, high: f64| voxels.surface.any(DVec3::splat(low), DVec3::splat(high));
        assert!(any(0.0, 1.0) && any(-1.0, 0.04) && any(0.96, 2.0));
        assert!(!any(0.1, 0.9));
        assert!(rim_edges(&cube()).is_empty());
        assert!(!voxels.rim.any(DVec3::ZERO, DVec3::ONE));
    }

    #[test]
    fn a_quad_has_a_rim_around_it_but_not_across() {
        let (grid, voxels) = voxels(&quad());
        assert_eq!(rim_edges(&quad()).len(), 4);
        let middle = grid.to_unit(DVec3::new(0.5, 0.5, 0.0));
        assert!(voxels.surface.any(middle, middle));
        assert!(!voxels.rim.any(middle - DVec3::new(0.3, 0.3, 0.4), middle + DVec3::new(0.3, 0.3, 0.4)));
        let corner = grid.to_unit(DVec3::ZERO);
        assert!(voxels.rim.any(corner, corner));
    }

    #[test]
    fn vertices_at_one_place_are_one() {
        assert_eq!(welded(&[Vec3::ZERO, Vec3::X, -Vec3::ZERO, Vec3::X, Vec3::Y]), [0, 1, 0, 1, 4]);
        assert!(welded(&[]).is_empty());
    }
}
