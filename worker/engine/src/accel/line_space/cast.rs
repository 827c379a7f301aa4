//! Payloads from sampled lines (Keul 2020, sections 6.2.1, 7.2.1 and 8.3.1): precise where they look, and blind beside it.
//! They serve approximations, never exact skipping.

use std::sync::atomic::AtomicBool;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::bits::{BinaryShafts, BitSet, Coverage, NO_CANDIDATE, SparseCandidates};
use super::shaft::{directed_count, directed_patches, symmetric_count, symmetric_patches};
use super::{CastPattern, Patch, ShaftGrid};
use crate::accel::BuildError;
use crate::accel::build::check;
use crate::trace::{Hit, Ray, Sink};

/// Shafts that one task looks at before it asks for a cancellation.
const CHUNK: usize = 1024;

/// Offsets of the lines from the patches' centres, in patches: the centre, then its neighbours in a 3 x 3 pattern.
const OFFSETS: [[f64; 2]; 9] = {
    const T: f64 = 1.0 / 3.0;
    [[0.0, 0.0], [-T, -T], [0.0, -T], [T, -T], [-T, 0.0], [T, 0.0], [-T, T], [0.0, T], [T, T]]
};

impl CastPattern {
    fn offsets(self) -> &'static [[f64; 2]] {
        match self {
            Self::Centre => &OFFSETS[..1],
            Self::Nine => &OFFSETS,
        }
    }

    /// Where the pattern's lines begin or end on a patch.
    pub(crate) fn points(self, grid: &ShaftGrid, patch: Patch) -> impl Iterator<Item = Vec3> {
        self.offsets().iter().map(move |[u, v]| point(grid, patch, [0.5 + u, 0.5 + v]))
    }
}

/// A point of a patch, in patches from its lower corner.
fn point(grid: &ShaftGrid, patch: Patch, [u, v]: [f64; 2]) -> Vec3 {
    let [low, _] = patch.unit_bounds(grid.n());
    let [u_axis, v_axis] = patch.tangents().map(|axis| DVec3::AXES[axis]);
    grid.from_unit(low + (u_axis * u + v_axis * v) / f64::from(grid.n())).as_vec3()
}

/// What lines are cast through.
pub(crate) trait Target: Sync {
    /// Offers the sink what is hit.
    fn trace(&self, ray: &Ray, sink: &mut impl Sink);
}

/// Finds what lines between patches hit.
pub(crate) struct Caster<'a, T> {
    target: &'a T,
    grid: &'a ShaftGrid,
}

impl<'a, T: Target> Caster<'a, T> {
    pub(crate) fn new(target: &'a T, grid: &'a ShaftGrid) -> Self {
        Self { target, grid }
    }

    /// The first primitive on the line between two points, given in patches from the patches' lower corners.
    fn cast(&self, start: Patch, end: Patch, from: [f64; 2], to: [f64; 2]) -> Option<u32> {
        let (from, to) = (point(self.grid, start, from), point(self.grid, end, to));
        // One difference, so that a device comes to the same line.
        let ray = Ray { origin: from, t_min: 0.0, direction: to - from, t_max: 1.0 };
        let mut sink = Nearest { t: 1.0, primitive: None };
        self.target.trace(&ray, &mut sink);
        sink.primitive
    }

    /// What the first line of the pattern that hits something hits.
    pub(crate) fn candidate(&self, start: Patch, end: Patch, pattern: CastPattern) -> Option<u32> {
        pattern.offsets().iter().find_map(|&[u, v]| {
            let at = [0.5 + u, 0.5 + v];
            self.cast(start, end, at, at)
        })
    }
}

struct Nearest {
    t: f32,
    primitive: Option<u32>,
}

impl Sink for Nearest {
    fn t_limit(&self) -> f32 {
        self.t
    }

    fn offer(&mut self, hit: Hit) -> bool {
        // Of several at one distance the lowest number counts, so that the structure does not matter.
        if hit.t < self.t || (hit.t == self.t && self.primitive.is_none_or(|primitive| hit.primitive < primitive)) {
            *self = Self { t: hit.t, primitive: Some(hit.primitive) };
        }
        false
    }
}

/// A value for each of `count` shafts.
fn for_shafts<T: Send>(count: u64, cancel: &AtomicBool, value: impl Fn(u32) -> T + Sync) -> Result<Vec<T>, BuildError> {
    let starts: Vec<u32> = (0..count as u32).step_by(CHUNK).collect();
    let chunks = starts
        .into_par_iter()
        .map(|start| {
            check(cancel)?;
            Ok((start..(start + CHUNK as u32).min(count as u32)).map(&value).collect())
        })
        .collect::<Result<Vec<Vec<T>>, BuildError>>()?;
    Ok(chunks.into_iter().flatten().collect())
}

/// Marks the symmetric shafts of which a line of the pattern is blocked.
pub(super) fn marks(
    target: &impl Target,
    grid: &ShaftGrid,
    pattern: CastPattern,
    cancel: &AtomicBool,
) -> Result<BinaryShafts, BuildError> {
    let caster = Caster::new(target, grid);
    let n = grid.n();
    let blocked = for_shafts(symmetric_count(n), cancel, |index| {
        let (a, b) = symmetric_patches(n, index);
        caster.candidate(a, b, pattern).is_some()
    })?;
    let mut bits = BitSet::new(symmetric_count(n));
    (0..).zip(blocked).filter(|(_, blocked)| *blocked).for_each(|(index, _)| bits.set(index));
    Ok(BinaryShafts { n, bits })
}

/// The candidate of each directed shaft, dense: [`NO_CANDIDATE`] where no line of the pattern hits.
pub(super) fn dense_candidates(
    target: &impl Target,
    grid: &ShaftGrid,
    pattern: CastPattern,
    cancel: &AtomicBool,
) -> Result<Vec<u32>, BuildError> {
    let caster = Caster::new(target, grid);
    let n = grid.n();
    for_shafts(directed_count(n), cancel, |index| {
        let (start, end) = directed_patches(n, index);
        caster.candidate(start, end, pattern).unwrap_or(NO_CANDIDATE)
    })
}

pub(super) fn candidates(
    target: &impl Target,
    grid: &ShaftGrid,
    pattern: CastPattern,
    cancel: &AtomicBool,
) -> Result<SparseCandidates, BuildError> {
    Ok(SparseCandidates::from_dense(grid.n(), &dense_candidates(target, grid, pattern, cancel)?))
}

/// The blocked part of `rays` lines of each symmetric shaft, which are spread evenly over both patches.
pub(super) fn coverage(
    target: &impl Target,
    grid: &ShaftGrid,
    bits: u32,
    rays: u32,
    cancel: &AtomicBool,
) -> Result<Coverage, BuildError> {
    let caster = Caster::new(target, grid);
    let n = grid.n();
    let parts = for_shafts(symmetric_count(n), cancel, |index| {
        let (a, b) = symmetric_patches(n, index);
        let is_blocked = |ray: &u32| {
            let [au, av, bu, bv] = spread(*ray, index);
            caster.cast(a, b, [au, av], [bu, bv]).is_some()
        };
        (0..rays).filter(is_blocked).count() as f32 / rays as f32
    })?;
    Ok(Coverage::from_parts(n, bits, &parts))
}

/// Point `i` of a sequence that is even in four dimensions (Roberts' R4, from the root of x^5 = x + 1), turned by `seed`.
fn spread(i: u32, seed: u32) -> [f64; 4] {
    const ROOT: f64 = 1.167_303_978_261_418_7;
    let turn = f64::from(seed.wrapping_mul(0x9e37_79b9)) / 4_294_967_296.0;
    std::array::from_fn(|axis| (turn + f64::from(i + 1) / ROOT.powi(axis as i32 + 1)).fract())
}
