//! Object splits: binned SAH on all three axes, in place.

use std::sync::atomic::AtomicBool;

use glam::Vec4;
use rayon::prelude::*;

use super::{Bounds, Options, PrimRef, Subtree, check};
use crate::accel::BuildError;
use crate::accel::bvh2::{Bvh2, MAX_DEPTH};

/// Subtrees with fewer primitives are built by one thread.
const PARALLEL_SUBTREE: usize = 8192;
/// Nodes with more primitives are binned by several threads, in chunks of this many primitives.
const BIN_CHUNK: usize = 65536;
const MAX_BINS: usize = 32;

/// SAH cost of a visit to an inner node, in units of one primitive test.
const TRAVERSAL_COST: f32 = 1.0;

pub(super) struct Context<'a> {
    pub options: &'a Options,
    pub cancel: &'a AtomicBool,
}

/// What the split of a node needs to know: the box of its primitives and that of their (doubled) centres.
#[derive(Clone, Copy)]
pub(super) struct Extent {
    pub bounds: Bounds,
    pub centers: Bounds,
}

impl Extent {
    const EMPTY: Self = Self { bounds: Bounds::EMPTY, centers: Bounds::EMPTY };

    pub(super) fn of(refs: &[PrimRef]) -> Self {
        let mut extent = Self::EMPTY;
        refs.iter().for_each(|r| extent.add(r));
        extent
    }

    #[inline]
    fn add(&mut self, r: &PrimRef) {
        self.bounds = self.bounds.union(r.bounds());
        self.centers.grow(r.center2());
    }
}

/// The cheapest split found: primitives in bins below `bin` of `axis` go left.
#[derive(Clone, Copy)]
pub(super) struct Split {
    axis: usize,
    bin: u32,
    /// Sum over both sides of half area times primitive count.
    pub cost: f32,
}

/// How centres map to bins. The same arithmetic bins and partitions, so both always agree.
#[derive(Clone, Copy)]
struct Mapping {
    origin: Vec4,
    scale: Vec4,
}

impl Mapping {
    fn new(centers: &Bounds, bins: usize) -> Self {
        let extent = centers.max - centers.min;
        // A little less than `bins`, so that the largest centre falls into the last bin.
        let scale = Vec4::splat(bins as f32 * 0.999_99) / extent;
        let usable = extent.cmpgt(Vec4::ZERO) & scale.cmplt(Vec4::splat(f32::MAX));
        Self { origin: centers.min, scale: Vec4::select(usable, scale, Vec4::ZERO) }
    }

    #[inline]
    fn bins(&self, r: &PrimRef) -> [usize; 3] {
        let [x, y, z, _] = ((r.center2() - self.origin) * self.scale).to_array();
        // Not negative, and below MAX_BINS: the cast of what rounding leaves is exact enough, and it saturates.
        [x, y, z].map(|v| (v as i32 as usize) & (MAX_BINS - 1))
    }
}

#[derive(Clone, Copy)]
pub(super) struct Bin {
    bounds: Bounds,
    count: u32,
}

pub(super) type Bins = [[Bin; MAX_BINS]; 3];
const EMPTY_BINS: Bins = [[Bin { bounds: Bounds::EMPTY, count: 0 }; MAX_BINS]; 3];

impl Context<'_> {
    pub(super) fn build(&self, refs: &mut [PrimRef]) -> Result<Subtree, BuildError> {
        let extent = if refs.len() > BIN_CHUNK {
            refs.par_chunks(BIN_CHUNK).map(Extent::of).reduce(
                || Extent::EMPTY,
                |a, b| Extent { bounds: a.bounds.union(b.bounds), centers: a.centers.union(b.centers) },
            )
        } else {
            Extent::of(refs)
        };
        self.build_parallel(refs, extent, 0)
    }

    pub(super) fn build_parallel(
        &self,
        refs: &mut [PrimRef],
        extent: Extent,
        depth: u32,
    ) -> Result<Subtree, BuildError> {
        check(self.cancel)?;
        if refs.len() < PARALLEL_SUBTREE {
            let mut tree =
                Bvh2 { nodes: Vec::with_capacity(2 * refs.len()), primitives: Vec::with_capacity(refs.len()) };
            self.build_serial(refs, extent, depth, &mut tree);
            return Ok(Subtree::Built(tree));
        }
        let (split, _) = self.find_split(refs, &extent)?;
        let (middle, left, right) = self.divide(refs, &extent, split, depth);
        let (low, high) = refs.split_at_mut(middle);
        let (low, high) =
            rayon::join(|| self.build_parallel(low, left, depth + 1), || self.build_parallel(high, right, depth + 1));
        Ok(Subtree::Inner { bounds: extent.bounds, children: Box::new([low?, high?]) })
    }

    fn build_serial(&self, refs: &mut [PrimRef], extent: Extent, depth: u32, tree: &mut Bvh2) {
        let split = if refs.len() > 1 { binned_split(refs, &extent, self.bins(refs.len())) } else { None };
        if refs.len() <= self.options.max_leaf {
            let area = extent.bounds.half_area();
            let leaf_cost = area * refs.len() as f32;
            if split.is_none_or(|split| leaf_cost <= TRAVERSAL_COST * area + split.cost) || refs.len() == 1 {
                tree.nodes.push(extent.bounds.leaf(tree.primitives.len(), refs.len()));
                tree.primitives.extend(refs.iter().map(PrimRef::id));
                return;
            }
        }
        let (middle, left, right) = self.divide(refs, &extent, split, depth);
        let (low, high) = refs.split_at_mut(middle);
        let index = tree.nodes.len();
        tree.nodes.push(extent.bounds.inner(0));
        self.build_serial(low, left, depth + 1, tree);
        tree.nodes[index].right_or_first = tree.nodes.len() as u32;
        self.build_serial(high, right, depth + 1, tree);
    }

    /// Fewer bins for small nodes, whose cost would else be in clearing and sweeping bins.
    fn bins(&self, count: usize) -> usize {
        self.options.bins.min(4 + count / 2)
    }

    /// The best split, and the bins from which it was chosen.
    pub(super) fn find_split(
        &self,
        refs: &[PrimRef],
        extent: &Extent,
    ) -> Result<(Option<Split>, Box<Bins>), BuildError> {
        let bins = self.bins(refs.len());
        let filled = refs
            .par_chunks(BIN_CHUNK)
            .map(|chunk| check(self.cancel).map(|()| Box::new(fill_bins(chunk, extent, bins))))
            .try_reduce_with(|mut a, b| {
                for (into, from) in a.iter_mut().flatten().zip(b.iter().flatten()) {
                    into.bounds = into.bounds.union(from.bounds);
                    into.count += from.count;
                }
                Ok(a)
            })
            .expect("there are chunks")?;
        Ok((best_split(&filled, bins), filled))
    }

    /// Moves the primitives of the left side to the front; gives their number and both sides' extents.
    pub(super) fn divide(
        &self,
        refs: &mut [PrimRef],
        extent: &Extent,
        split: Option<Split>,
        depth: u32,
    ) -> (usize, Extent, Extent) {
        // From here on only halving keeps the tree within its depth.
        let must_halve = depth + refs.len().next_power_of_two().ilog2() >= MAX_DEPTH;
        match split {
            Some(split) if !must_halve => {
                let mapping = Mapping::new(&extent.centers, self.bins(refs.len()));
                partition(refs, |r| (mapping.bins(r)[split.axis] as u32) < split.bin)
            }
            _ => halve(refs, extent),
        }
    }
}

/// Never inlined: the bins must not stay on the stack while the builder descends.
#[inline(never)]
fn binned_split(refs: &[PrimRef], extent: &Extent, bins: usize) -> Option<Split> {
    best_split(&fill_bins(refs, extent, bins), bins)
}

fn fill_bins(refs: &[PrimRef], extent: &Extent, bins: usize) -> Bins {
    let mapping = Mapping::new(&extent.centers, bins);
    let mut filled = EMPTY_BINS;
    for r in refs {
        for (axis, bin) in mapping.bins(r).into_iter().enumerate() {
            let bin = &mut filled[axis][bin];
            bin.bounds = bin.bounds.union(r.bounds());
            bin.count += 1;
        }
    }
    filled
}

/// Sweeps the bins of each axis from the right, then from the left. None when all centres fall into one bin.
fn best_split(filled: &Bins, bins: usize) -> Option<Split> {
    let mut best: Option<Split> = None;
    for (axis, filled) in filled.iter().enumerate() {
        let mut right_costs = [f32::INFINITY; MAX_BINS];
        let (mut bounds, mut count) = (Bounds::EMPTY, 0);
        for bin in (1..bins).rev() {
            bounds = bounds.union(filled[bin].bounds);
            count += filled[bin].count;
            if count > 0 {
                right_costs[bin] = bounds.half_area() * count as f32;
            }
        }
        let (mut bounds, mut count) = (Bounds::EMPTY, 0);
        for bin in 1..bins {
            bounds = bounds.union(filled[bin - 1].bounds);
            count += filled[bin - 1].count;
            if count == 0 {
                continue;
            }
            let cost = bounds.half_area() * count as f32 + right_costs[bin];
            if cost < best.map_or(f32::INFINITY, |best| best.cost) {
                best = Some(Split { axis, bin: bin as u32, cost });
            }
        }
    }
    best
}

/// Half the area in which the boxes of both sides of a split overlap.
pub(super) fn overlap(filled: &Bins, split: &Split) -> f32 {
    let (low, high) = filled[split.axis].split_at(split.bin as usize);
    let bounds = |bins: &[Bin]| bins.iter().fold(Bounds::EMPTY, |b, bin| b.union(bin.bounds));
    let shared = bounds(low).intersection(bounds(high));
    let is_empty = shared.min.truncate().cmpgt(shared.max.truncate()).any();
    if is_empty { 0.0 } else { shared.half_area() }
}

fn partition(refs: &mut [PrimRef], goes_left: impl Fn(&PrimRef) -> bool) -> (usize, Extent, Extent) {
    let (mut left, mut right) = (Extent::EMPTY, Extent::EMPTY);
    let (mut low, mut high) = (0, refs.len());
    loop {
        while low < high && goes_left(&refs[low]) {
            left.add(&refs[low]);
            low += 1;
        }
        while low < high && !goes_left(&refs[high - 1]) {
            right.add(&refs[high - 1]);
            high -= 1;
        }
        if low >= high {
            return (low, left, right);
        }
        refs.swap(low, high - 1);
    }
}

/// Half of the primitives to each side, in order of their centres on the longest axis.
fn halve(refs: &mut [PrimRef], extent: &Extent) -> (usize, Extent, Extent) {
    let axis = (extent.centers.max - extent.centers.min).truncate().max_position();
    let middle = refs.len() / 2;
    refs.select_nth_unstable_by(middle, |a, b| {
        a.center2()[axis].total_cmp(&b.center2()[axis]).then(a.id().cmp(&b.id()))
    });
    (middle, Extent::of(&refs[..middle]), Extent::of(&refs[middle..]))
}
