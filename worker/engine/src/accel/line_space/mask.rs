//! Building binary payloads from voxels (masking) and from triangles (clipping).
//!
//! Masking (Keul 2020, section 4.2.3): an atlas holds, for each of N^3 cells of a box, the shafts that the cell meets. The
//! marks of a box are the union over its cells that hold surface: quick, and conservative, for a shaft may meet a cell
//! but not what is in it.
//!
//! Clipping (section 3.2): each triangle is clipped to the shaft's hull. Slow, and exact.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use glam::DVec3;
use rayon::prelude::*;

use super::ShaftGrid;
use super::bits::{BinaryShafts, BitSet};
use super::hull::Hull;
use super::nodes::Below;
use super::shaft::{DILATION, symmetric_count, symmetric_patches};
use super::voxels::lattice;
use crate::accel::BuildError;
use crate::accel::build::check;
use crate::scene::Mesh;

/// The finest N that has an atlas: its masks take 67 MB. It grows with N^7.
pub const MAX_MASK_N: u32 = 12;

/// For each cell of a box, x running fastest, the shafts that it meets. Patches are one cell wide, or several.
pub(crate) struct MaskAtlas {
    words_per_cell: usize,
    masks: Vec<u32>,
}

/// What an atlas is made for.
#[derive(Clone, Copy)]
pub(crate) struct AtlasParams {
    /// Cells along an edge, at most 16.
    pub cells: u32,
    /// Cells that a patch is wide; the last one may be narrower. There are at most [`MAX_MASK_N`] patches along an edge.
    pub width: u32,
    /// By how much of the box's edges shafts are grown.
    pub growth: f64,
}

impl AtlasParams {
    /// Patches along an edge.
    pub(crate) fn patches(&self) -> u32 {
        self.cells.div_ceil(self.width)
    }
}

impl MaskAtlas {
    /// Bytes of the atlas for `n`.
    pub(crate) fn bytes_needed(n: u32) -> u64 {
        u64::from(n).pow(3) * symmetric_count(n).div_ceil(32) * 4
    }

    /// Made once in a process, and kept.
    pub(crate) fn get(params: &AtlasParams, cancel: &AtomicBool) -> Result<Arc<Self>, BuildError> {
        /// By cells, width and the bits of the growth.
        type Atlases = BTreeMap<(u32, u32, u64), Arc<MaskAtlas>>;
        static ATLASES: OnceLock<Mutex<Atlases>> = OnceLock::new();
        let atlases = ATLASES.get_or_init(Mutex::default);
        let key = (params.cells, params.width, params.growth.to_bits());
        let known = atlases.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(atlas) = known {
            return Ok(atlas);
        }
        // Not under the lock: a second builder may do it twice, but can be cancelled.
        let atlas = Arc::new(Self::build(params, cancel)?);
        atlases.lock().unwrap_or_else(PoisonError::into_inner).insert(key, atlas.clone());
        Ok(atlas)
    }

    fn build(params: &AtlasParams, cancel: &AtomicBool) -> Result<Self, BuildError> {
        let (n, patches) = (params.cells, params.patches());
        let words_per_cell = symmetric_count(patches).div_ceil(32) as usize;
        let cells = n.pow(3) as usize;
        // Written by word of shafts, so that no two threads write one word.
        let columns: Vec<Vec<u32>> = (0..words_per_cell as u32)
            .into_par_iter()
            .map(|word| {
                check(cancel)?;
                let mut column = vec![0_u32; cells];
                let shafts = 32 * word..(32 * word + 32).min(symmetric_count(patches) as u32);
                for index in shafts {
                    let (a, b) = symmetric_patches(patches, index);
                    let hull = Hull::over_cells(n, params.width, a, b, params.growth);
                    for_each_cell(n, &hull, |cell| column[cell] |= 1 << (index % 32));
                }
                Ok(column)
            })
            .collect::<Result<_, BuildError>>()?;
        let mut masks = vec![0; cells * words_per_cell];
        masks.par_chunks_mut(words_per_cell).enumerate().for_each(|(cell, mask)| {
            mask.iter_mut().zip(&columns).for_each(|(word, column)| *word = column[cell]);
        });
        Ok(Self { words_per_cell, masks })
    }

    /// The masks of all cells, one after the other.
    pub(crate) fn masks(&self) -> &[u32] {
        &self.masks
    }

    pub(crate) fn mask(&self, cell: usize) -> &[u32] {
        &self.masks[cell * self.words_per_cell..][..self.words_per_cell]
    }
}

/// Names the cells of an N^3 lattice over the unit cube that may meet the hull.
fn for_each_cell(n: u32, hull: &Hull, mut visit: impl FnMut(usize)) {
    let size = f64::from(n);
    let first = |value: f64| ((value * size).floor().max(0.0) as u32).min(n - 1);
    let (from, to) = (hull.low.to_array().map(first), hull.high.to_array().map(first));
    for z in from[2]..=to[2] {
        for y in from[1]..=to[1] {
            for x in from[0]..=to[0] {
                let low = DVec3::new(f64::from(x), f64::from(y), f64::from(z)) / size;
                if hull.may_meet_box(low, low + 1.0 / size) {
                    visit(((z * n + y) * n + x) as usize);
                }
            }
        }
    }
}

/// Marks by masking. `n` is at most [`MAX_MASK_N`].
pub(super) fn by_masking(
    mesh: &Mesh,
    below: &Below<'_>,
    grid: &ShaftGrid,
    cancel: &AtomicBool,
) -> Result<BinaryShafts, BuildError> {
    let n = grid.n();
    let atlas = MaskAtlas::get(&AtlasParams { cells: n, width: 1, growth: DILATION }, cancel)?;
    let lattice = lattice(&below.bounds(), grid, n);
    let filled: Vec<AtomicU64> = (0..n.pow(3).div_ceil(64)).map(|_| AtomicU64::new(0)).collect();
    below.primitives.par_chunks(4096).try_for_each(|primitives| {
        check(cancel)?;
        for &primitive in primitives {
            lattice.primitive_cells(mesh, primitive as usize, lattice.all(), |[x, y, z]| {
                let cell = (z * n + y) * n + x;
                filled[cell as usize / 64].fetch_or(1 << (cell % 64), Ordering::Relaxed);
            });
        }
        Ok(())
    })?;
    let mut bits = BitSet::new(symmetric_count(n));
    for cell in 0..n.pow(3) as usize {
        if filled[cell / 64].load(Ordering::Relaxed) >> (cell % 64) & 1 == 1 {
            bits.union(atlas.mask(cell));
        }
    }
    Ok(BinaryShafts { n, bits })
}

/// Marks by clipping.
pub(super) fn by_clipping(
    mesh: &Mesh,
    below: &Below<'_>,
    grid: &ShaftGrid,
    cancel: &AtomicBool,
) -> Result<BinaryShafts, BuildError> {
    let n = grid.n();
    let shafts: Vec<u32> = (0..symmetric_count(n) as u32).collect();
    let words = shafts
        .par_chunks(32)
        .map(|chunk| {
            check(cancel)?;
            let is_met = |&index: &u32| {
                let (a, b) = symmetric_patches(n, index);
                meets_mesh(&Hull::new(n, a, b, DILATION), mesh, below, grid)
            };
            Ok((0..).zip(chunk).fold(0, |word, (bit, index)| word | u32::from(is_met(index)) << bit))
        })
        .collect::<Result<Vec<u32>, BuildError>>()?;
    Ok(BinaryShafts { n, bits: BitSet::from_words(symmetric_count(n), words).expect("a bit for each shaft") })
}

/// Whether any primitive is in the hull.
fn meets_mesh(hull: &Hull, mesh: &Mesh, below: &Below<'_>, grid: &ShaftGrid) -> bool {
    let bvh2 = below.structure.bvh2();
    let mut pending = vec![below.node];
    while let Some(index) = pending.pop() {
        let node = &bvh2.nodes[index];
        let bounds = node.bounds();
        if !hull.may_meet_box(grid.to_unit(bounds.min.as_dvec3()), grid.to_unit(bounds.max.as_dvec3())) {
            continue;
        }
        if node.is_leaf() {
            let range = node.right_or_first as usize..(node.right_or_first + node.count) as usize;
            if bvh2.primitives[range].iter().any(|&primitive| hull.meets_primitive(grid, mesh, primitive)) {
                return true;
            }
        } else {
            pending.extend([index + 1, node.right_or_first as usize]);
        }
    }
    false
}
