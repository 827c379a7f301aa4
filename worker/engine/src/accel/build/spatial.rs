//! Spatial splits: Stich, Friedrich, Dietrich 2009, "Spatial splits in bounding volume hierarchies".
//!
//! Where the best object split leaves two boxes that overlap, a plane may part the node instead; a primitive on both
//! sides of it gets a reference in either child, with the box of its part. Deeper nodes whose boxes hardly overlap are
//! left to the object builder.

use glam::Vec4;
use rayon::prelude::*;

use super::object::{Context, Extent, overlap};
use super::{Bounds, PrimRef, Subtree, check};
use crate::accel::BuildError;
use crate::accel::bvh2::MAX_DEPTH;
use crate::scene::Mesh;

/// Overlap of an object split's boxes, relative to the root's area, above which a spatial split is tried (alpha).
const MIN_OVERLAP: f32 = 1e-5;
/// References that may be added, relative to the number of primitives.
const GROWTH: f64 = 0.3;
/// A node may use one part in so many of what its subtree may add: the rest is for the nodes below.
const NODE_SHARE: usize = 4;
const BINS: usize = 24;
/// Nodes with more references are binned by several threads.
const CHUNK: usize = 16384;
/// Children with more references are built by two threads.
const PARALLEL_SUBTREE: usize = 4096;

pub(super) struct SpatialContext<'a> {
    pub objects: Context<'a>,
    pub mesh: &'a Mesh,
    /// Half area of the root.
    pub root_area: f32,
}

#[derive(Clone, Copy)]
struct Bin {
    bounds: Bounds,
    /// References that begin and that end here.
    enter: u32,
    leave: u32,
}

type Bins = [[Bin; BINS]; 3];
const EMPTY_BINS: Bins = [[Bin { bounds: Bounds::EMPTY, enter: 0, leave: 0 }; BINS]; 3];

#[derive(Clone, Copy)]
struct Plane {
    axis: usize,
    position: f32,
    /// As for object splits: half areas times reference counts.
    cost: f32,
}

impl<'a> SpatialContext<'a> {
    pub(super) fn build(objects: Context<'a>, mesh: &'a Mesh, refs: Vec<PrimRef>) -> Result<Subtree, BuildError> {
        let extent = Extent::of(&refs);
        let budget = (refs.len() as f64 * GROWTH) as usize;
        let context = Self { objects, mesh, root_area: extent.bounds.half_area() };
        context.build_node(refs, extent, 0, budget)
    }

    /// `budget`: how many references this subtree may add.
    fn build_node(
        &self,
        mut refs: Vec<PrimRef>,
        extent: Extent,
        depth: u32,
        budget: usize,
    ) -> Result<Subtree, BuildError> {
        check(self.objects.cancel)?;
        // The object builder takes over early enough to keep within the depth.
        let shallow = depth + 2 + refs.len().next_power_of_two().ilog2() < MAX_DEPTH;
        if refs.len() <= self.objects.options.max_leaf || !shallow || budget == 0 {
            return self.objects.build_parallel(&mut refs, extent, depth);
        }
        let (object, bins) = self.objects.find_split(&refs, &extent)?;
        if object.is_none_or(|split| overlap(&bins, &split) <= MIN_OVERLAP * self.root_area) {
            return self.objects.build_parallel(&mut refs, extent, depth);
        }
        let total = refs.len();
        let plane = self.best_plane(&refs, &extent.bounds)?;
        let plane = plane.filter(|plane| object.is_none_or(|object| plane.cost < object.cost));
        let parted = plane.and_then(|plane| {
            let (low, high, cost) = self.part(&refs, plane, budget.div_ceil(NODE_SHARE));
            let left_over = budget - (low.len() + high.len() - total);
            let pays = object.is_none_or(|object| cost < object.cost) && low.len().max(high.len()) < total;
            pays.then_some((low, high, left_over))
        });
        let (low, high, budget) = parted.unwrap_or_else(|| {
            let (middle, ..) = self.objects.divide(&mut refs, &extent, object, depth);
            let high = refs.split_off(middle);
            (std::mem::take(&mut refs), high, budget)
        });
        drop(refs);
        // Each child gets its share of what is left, so that the order of building does not matter.
        let low_budget = (budget as u128 * low.len() as u128 / (low.len() + high.len()) as u128) as usize;
        let high_budget = budget - low_budget;
        let build = |refs: Vec<PrimRef>, budget| {
            let extent = Extent::of(&refs);
            self.build_node(refs, extent, depth + 1, budget)
        };
        let (low, high) = if total > PARALLEL_SUBTREE {
            rayon::join(|| build(low, low_budget), || build(high, high_budget))
        } else {
            (build(low, low_budget), build(high, high_budget))
        };
        Ok(Subtree::Inner { bounds: extent.bounds, children: Box::new([low?, high?]) })
    }

    fn best_plane(&self, refs: &[PrimRef], bounds: &Bounds) -> Result<Option<Plane>, BuildError> {
        let width = (bounds.max - bounds.min) / BINS as f32;
        let position = |axis: usize, bin: usize| bounds.min[axis] + bin as f32 * width[axis];
        let bins = refs
            .par_chunks(CHUNK)
            .map(|chunk| check(self.objects.cancel).map(|()| Box::new(self.fill_bins(chunk, bounds.min, width))))
            .try_reduce_with(|mut a, b| {
                for (into, from) in a.iter_mut().flatten().zip(b.iter().flatten()) {
                    into.bounds = into.bounds.union(from.bounds);
                    into.enter += from.enter;
                    into.leave += from.leave;
                }
                Ok(a)
            })
            .expect("there are chunks")?;
        let mut best: Option<Plane> = None;
        for (axis, bins) in bins.iter().enumerate() {
            let mut right_costs = [f32::INFINITY; BINS];
            let (mut bounds, mut count) = (Bounds::EMPTY, 0);
            for bin in (1..BINS).rev() {
                bounds = bounds.union(bins[bin].bounds);
                count += bins[bin].leave;
                if count > 0 {
                    right_costs[bin] = bounds.half_area() * count as f32;
                }
            }
            let (mut bounds, mut count) = (Bounds::EMPTY, 0);
            for bin in 1..BINS {
                bounds = bounds.union(bins[bin - 1].bounds);
                count += bins[bin - 1].enter;
                let cost = bounds.half_area() * count as f32 + right_costs[bin];
                if count > 0 && cost < best.map_or(f32::INFINITY, |best| best.cost) {
                    best = Some(Plane { axis, position: position(axis, bin), cost });
                }
            }
        }
        Ok(best)
    }

    fn fill_bins(&self, refs: &[PrimRef], origin: Vec4, width: Vec4) -> Bins {
        let mut bins = EMPTY_BINS;
        for r in refs {
            for (axis, bins) in bins.iter_mut().enumerate() {
                if width[axis] <= 0.0 {
                    continue;
                }
                let bin_of = |x: f32| (((x - origin[axis]) / width[axis]) as usize).min(BINS - 1);
                let (first, last) = (bin_of(r.min[axis]), bin_of(r.max[axis]));
                bins[first].enter += 1;
                bins[last].leave += 1;
                let mut rest = *r;
                for (bin, into) in bins.iter_mut().enumerate().take(last).skip(first) {
                    let (below, above) = self.cut(&rest, axis, origin[axis] + (bin + 1) as f32 * width[axis]);
                    if let Some(below) = below {
                        into.bounds = into.bounds.union(below.bounds());
                    }
                    let Some(above) = above else { break };
                    rest = above;
                }
                bins[last].bounds = bins[last].bounds.union(rest.bounds());
            }
        }
        bins
    }

    /// Sorts references to the sides of a plane. At most `allowance` of those on both sides are split, so the cost, which
    /// is the third result, may be more than the plane's.
    fn part(&self, refs: &[PrimRef], plane: Plane, allowance: usize) -> (Vec<PrimRef>, Vec<PrimRef>, f32) {
        let (mut low, mut high) = (Vec::with_capacity(refs.len()), Vec::with_capacity(refs.len()));
        let mut both = Vec::new();
        let (mut low_bounds, mut high_bounds) = (Bounds::EMPTY, Bounds::EMPTY);
        for r in refs {
            if r.max[plane.axis] <= plane.position {
                low.push(*r);
                low_bounds = low_bounds.union(r.bounds());
            } else if r.min[plane.axis] >= plane.position {
                high.push(*r);
                high_bounds = high_bounds.union(r.bounds());
            } else {
                both.push(*r);
            }
        }
        // Without any split, this many will have been sorted once the loop gets there.
        let settled_before = low.len() + high.len();
        for (number, r) in both.into_iter().enumerate() {
            let settled = settled_before + number;
            let (below, above) = match self.cut(&r, plane.axis, plane.position) {
                (Some(below), Some(above)) => (below, above),
                (Some(below), None) => {
                    low_bounds = low_bounds.union(below.bounds());
                    low.push(below);
                    continue;
                }
                (None, Some(above)) => {
                    high_bounds = high_bounds.union(above.bounds());
                    high.push(above);
                    continue;
                }
                // Rounding left nothing of either part: the reference stays as it was.
                (None, None) => {
                    low_bounds = low_bounds.union(r.bounds());
                    low.push(r);
                    continue;
                }
            };
            // A reference stays whole where one larger box is cheaper than one reference more (section 4.4).
            let (low_count, high_count) = (low.len() as f32 + 1.0, high.len() as f32 + 1.0);
            let area = |a: Bounds, b: &PrimRef| a.union(b.bounds()).half_area();
            let high_area = if high.is_empty() { 0.0 } else { high_bounds.half_area() };
            let low_area = if low.is_empty() { 0.0 } else { low_bounds.half_area() };
            let split = area(low_bounds, &below) * low_count + area(high_bounds, &above) * high_count;
            let all_low = area(low_bounds, &r) * low_count + high_area * (high_count - 1.0);
            let all_high = low_area * (low_count - 1.0) + area(high_bounds, &r) * high_count;
            let may_split = low.len() + high.len() < settled + allowance;
            let (to_low, to_high) = if may_split && split <= all_low.min(all_high) {
                (Some(below), Some(above))
            } else if all_low <= all_high {
                (Some(r), None)
            } else {
                (None, Some(r))
            };
            if let Some(r) = to_low {
                low.push(r);
                low_bounds = low_bounds.union(r.bounds());
            }
            if let Some(r) = to_high {
                high.push(r);
                high_bounds = high_bounds.union(r.bounds());
            }
        }
        let cost = |side: &[PrimRef], bounds: Bounds| {
            if side.is_empty() { 0.0 } else { bounds.half_area() * side.len() as f32 }
        };
        let cost = cost(&low, low_bounds) + cost(&high, high_bounds);
        (low, high, cost)
    }

    /// The boxes of the reference's parts on either side of a plane, None for a side on which nothing is.
    fn cut(&self, r: &PrimRef, axis: usize, position: f32) -> (Option<PrimRef>, Option<PrimRef>) {
        let (mut below, mut above) = (r.bounds(), r.bounds());
        if let Some(triangle) = self.mesh.triangles.get(r.id() as usize) {
            let corners = triangle.map(|vertex| self.mesh.positions[vertex as usize].extend(0.0));
            (below, above) = (Bounds::EMPTY, Bounds::EMPTY);
            for (a, b) in [(corners[0], corners[1]), (corners[1], corners[2]), (corners[2], corners[0])] {
                if a[axis] <= position {
                    below.grow(a);
                }
                if a[axis] >= position {
                    above.grow(a);
                }
                if (a[axis] < position && b[axis] > position) || (a[axis] > position && b[axis] < position) {
                    let point = a + (position - a[axis]) / (b[axis] - a[axis]) * (b - a);
                    // More than the interpolation can have rounded away.
                    let slack = a.abs().max(b.abs()) * (4.0 * f32::EPSILON);
                    for bounds in [&mut below, &mut above] {
                        bounds.grow(point - slack);
                        bounds.grow(point + slack);
                    }
                }
            }
        }
        below.max[axis] = position;
        above.min[axis] = position;
        let within = |part: Bounds| {
            let part = PrimRef::with_bounds(part.intersection(r.bounds()), r.id());
            part.min.truncate().cmple(part.max.truncate()).all().then_some(part)
        };
        (within(below), within(above))
    }
}
