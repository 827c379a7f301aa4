//! The uniform grid: one box cut into equal cells, walked from cell to cell (3D-DDA).
//!
//! With a number of cells in proportion to the primitives (Cleary, Wyvill 1988), about as long as they are wide.

use std::sync::atomic::AtomicBool;

use super::cells::{CellTree, Layout, Limits, MAX_DIM};
use super::{BuildError, build};
use crate::scene::{Aabb, Mesh};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct GridParams {
    pub resolution: GridResolution,
    /// The build gives up when the grid needs more; no part of the cache's key.
    pub budget_bytes: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GridResolution {
    /// Cells for each primitive, roughly; 1 to 64.
    PerPrimitive(u32),
    /// Cells on the longest axis, 1 to [`MAX_DIM`]; on the others as many cubes as it takes.
    LongestAxis(u32),
    /// Cells on each axis, 1 to [`MAX_DIM`].
    Cells([u32; 3]),
}

impl GridParams {
    pub(super) fn canonical(&self) -> String {
        match self.resolution {
            GridResolution::PerPrimitive(cells) => format!("cells_per_primitive={cells}"),
            GridResolution::LongestAxis(cells) => format!("resolution={cells}"),
            GridResolution::Cells([x, y, z]) => format!("resolution={x}x{y}x{z}"),
        }
    }

    pub(super) fn build(&self, mesh: &Mesh, cancel: &AtomicBool) -> Result<CellTree, BuildError> {
        let bounds = build::traceable_bounds(mesh);
        let dims = match self.resolution {
            GridResolution::PerPrimitive(cells) => dims_for(&bounds, u64::from(cells) * mesh.primitive_count() as u64),
            GridResolution::LongestAxis(cells) => cubes(&bounds, longest_edge(&bounds) / f64::from(cells)),
            GridResolution::Cells(dims) => dims,
        };
        if let Some(dim) = dims.iter().find(|&&dim| !(1..=MAX_DIM).contains(&dim)) {
            return Err(BuildError::Unsupported(format!("{dim} cells on an axis; a grid has 1 to {MAX_DIM}")));
        }
        let layout = Layout::new(&bounds, dims, false, 1, 1)?;
        CellTree::build(mesh, layout, &Limits { max_leaf: 0, budget_bytes: self.budget_bytes, name: "grid" }, cancel)
    }
}

/// As many cells as cubes of one size need to fill the box, of the size at which they are `cells` or just fewer.
fn dims_for(bounds: &Aabb, cells: u64) -> [u32; 3] {
    let mut coarse = longest_edge(bounds);
    let mut fine = coarse / f64::from(MAX_DIM);
    for _ in 0..40 {
        let middle = (fine * coarse).sqrt();
        let count: u64 = cubes(bounds, middle).iter().map(|&dim| u64::from(dim)).product();
        if count > cells { fine = middle } else { coarse = middle }
    }
    cubes(bounds, coarse)
}

fn longest_edge(bounds: &Aabb) -> f64 {
    (bounds.max.as_dvec3() - bounds.min.as_dvec3()).max_element()
}

/// Cubes that fill the box, at most [`MAX_DIM`] on each axis; one where the box or the cube is nothing.
fn cubes(bounds: &Aabb, edge: f64) -> [u32; 3] {
    let extent = bounds.max.as_dvec3() - bounds.min.as_dvec3();
    // A hair less, so that a whole number of cubes stays one. The cast makes 0 of NaN, and saturates.
    (extent / edge * (1.0 - 1e-9)).to_array().map(|dim| (dim.ceil() as u32).clamp(1, MAX_DIM))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn cells_are_about_cubes_and_as_many_as_asked_for() {
        let bounds = |x, y, z| Aabb { min: Vec3::ZERO, max: Vec3::new(x, y, z) };
        assert_eq!(dims_for(&bounds(1.0, 1.0, 1.0), 1000), [10; 3]);
        assert_eq!(dims_for(&bounds(4.0, 2.0, 1.0), 64_000), [80, 40, 20]);
        assert_eq!(dims_for(&bounds(3.0, 0.0, 3.0), 10_000), [100, 1, 100]);
        assert_eq!(dims_for(&bounds(0.0, 0.0, 0.0), 10_000), [1; 3]);
        assert_eq!(dims_for(&Aabb::EMPTY, 10), [1; 3]);
        assert_eq!(dims_for(&bounds(1e30, 1e-30, 1e-30), u64::MAX), [MAX_DIM, 1, 1]);
        assert_eq!(cubes(&bounds(4.0, 2.0, 0.1), 4.0 / 100.0), [100, 50, 3]);
    }
}
