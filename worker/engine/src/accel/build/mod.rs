//! Builders of the binary tree.
//!
//! [`build`] sorts primitives top-down by the surface area heuristic: object splits over bins ([`object`], Wald 2007,
//! "On fast construction of SAH-based bounding volume hierarchies"), and on request spatial splits ([`spatial`]). Large
//! nodes are split in parallel; the best quality then moves subtrees ([`reinsertion`]). What is built never depends on the number of threads.

mod object;
mod reinsertion;
mod spatial;

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{Vec3, Vec4};

use super::bvh2::{Bvh2, Bvh2Node};
use super::{BuildError, BuildParams, Quality};
use crate::scene::{Aabb, Mesh};

/// More primitives than this cannot be numbered in a [`PrimRef`].
const MAX_PRIMITIVES: usize = 1 << 29;

/// What a builder may do.
#[derive(Clone, Copy, Debug)]
pub(super) struct Options {
    /// Bins of each axis.
    pub bins: usize,
    /// Nodes with more primitives are always split.
    pub max_leaf: usize,
    /// Improve the tree by reinsertion.
    pub reinsert: bool,
}

impl Options {
    fn new(params: &BuildParams) -> Self {
        let bins = match params.quality {
            Quality::Fast => 8,
            Quality::Medium => 16,
            Quality::High => 32,
        };
        Self { bins, max_leaf: 4, reinsert: params.quality == Quality::High }
    }
}

/// The tree over a mesh's triangles and spheres. Primitives with a coordinate that is not finite are left out: no ray
/// can hit them.
pub(super) fn build(mesh: &Mesh, params: &BuildParams, cancel: &AtomicBool) -> Result<Bvh2, BuildError> {
    if mesh.primitive_count() > MAX_PRIMITIVES {
        return Err(BuildError::Unsupported(format!(
            "the mesh has {} primitives; a structure holds at most {MAX_PRIMITIVES}",
            mesh.primitive_count()
        )));
    }
    let mut refs = Vec::with_capacity(mesh.primitive_count());
    for primitive in 0..mesh.primitive_count() {
        if primitive.is_multiple_of(65536) {
            check(cancel)?;
        }
        let bounds = primitive_bounds(mesh, primitive);
        if bounds.min.is_finite() && bounds.max.is_finite() {
            refs.push(PrimRef::new(bounds, primitive as u32));
        }
    }
    build_over(refs, params.spatial_splits.then_some(mesh), &Options::new(params), cancel)
}

/// The tree over given boxes: box `i` is primitive `i`. Empty boxes are left out.
pub(super) fn build_over_boxes(boxes: &[Aabb], max_leaf: usize) -> Bvh2 {
    let refs = (0_u32..).zip(boxes).filter(|(_, b)| !b.is_empty()).map(|(i, b)| PrimRef::new(*b, i)).collect();
    let options = Options { bins: 16, max_leaf, reinsert: false };
    build_over(refs, None, &options, &AtomicBool::new(false)).expect("nobody cancels")
}

/// With spatial splits where `splittable` gives the mesh, unless it is so large or small that it must be scaled.
fn build_over(
    mut refs: Vec<PrimRef>,
    splittable: Option<&Mesh>,
    options: &Options,
    cancel: &AtomicBool,
) -> Result<Bvh2, BuildError> {
    if refs.is_empty() {
        return Ok(Bvh2::default());
    }
    let context = object::Context { options, cancel };
    let scale = normalising_scale(&refs);
    if let (Some(mesh), 1.0) = (splittable, scale) {
        let tree = spatial::SpatialContext::build(context, mesh, refs)?.flatten();
        return if options.reinsert { reinsertion::optimize(tree, cancel) } else { Ok(tree) };
    }
    if scale != 1.0 {
        refs.iter_mut().for_each(|r| r.scale(scale));
    }
    let mut tree = context.build(&mut refs)?.flatten();
    if options.reinsert {
        tree = reinsertion::optimize(tree, cancel)?;
    }
    if scale != 1.0 {
        refs.iter_mut().for_each(|r| r.scale(1.0 / scale));
        refit(&mut tree, &refs);
    }
    Ok(tree)
}

/// A power of two that brings extreme coordinates to where products of three of them neither overflow nor vanish.
fn normalising_scale(refs: &[PrimRef]) -> f32 {
    let bounds = refs.iter().fold(Bounds::EMPTY, |b, r| b.union(r.bounds()));
    let largest = bounds.min.truncate().abs().max(bounds.max.truncate().abs()).max_element();
    if largest == 0.0 || (1e-10..1e12).contains(&largest) {
        return 1.0;
    }
    2.0_f32.powi(-(largest.log2().floor() as i32).clamp(-120, 120))
}

/// Recomputes all boxes from the primitives' exact ones (scaling may round the smallest coordinates).
fn refit(tree: &mut Bvh2, refs: &[PrimRef]) {
    let highest = refs.iter().map(|r| r.id() as usize + 1).max().unwrap_or(0);
    let mut boxes = vec![Bounds::EMPTY; highest];
    refs.iter().for_each(|r| boxes[r.id() as usize] = r.bounds());
    for index in (0..tree.nodes.len()).rev() {
        let node = tree.nodes[index];
        let bounds = if node.is_leaf() {
            let range = node.right_or_first as usize..(node.right_or_first + node.count) as usize;
            tree.primitives[range].iter().fold(Bounds::EMPTY, |b, &p| b.union(boxes[p as usize]))
        } else {
            Bounds::of(&tree.nodes[index + 1]).union(Bounds::of(&tree.nodes[node.right_or_first as usize]))
        };
        (tree.nodes[index].min, tree.nodes[index].max) = bounds.to_arrays();
    }
}

/// The exact box of a triangle, or a sphere's box rounded outwards.
pub(super) fn primitive_bounds(mesh: &Mesh, primitive: usize) -> Aabb {
    if let Some(triangle) = mesh.triangles.get(primitive) {
        let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
        // `min` and `max` drop a NaN, the sum does not.
        if !(a + b + c).is_nan() && a.is_finite() && b.is_finite() && c.is_finite() {
            return Aabb { min: a.min(b).min(c), max: a.max(b).max(c) };
        }
        return Aabb { min: Vec3::NAN, max: Vec3::NAN };
    }
    let sphere = &mesh.spheres[primitive - mesh.triangles.len()];
    let reach = Vec3::splat(sphere.radius.abs());
    let (min, max) = (sphere.center - reach, sphere.center + reach);
    Aabb { min: min.map(f32::next_down), max: max.map(f32::next_up) }
}

/// The box around all primitives that a ray can hit.
pub(super) fn traceable_bounds(mesh: &Mesh) -> Aabb {
    (0..mesh.primitive_count())
        .map(|primitive| primitive_bounds(mesh, primitive))
        .filter(|bounds| bounds.min.is_finite() && bounds.max.is_finite())
        .fold(Aabb::EMPTY, Aabb::union)
}

pub(super) fn check(cancel: &AtomicBool) -> Result<(), BuildError> {
    if cancel.load(Ordering::Relaxed) { Err(BuildError::Cancelled) } else { Ok(()) }
}

/// A box in two SIMD registers; the fourth lanes mean nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub min: Vec4,
    pub max: Vec4,
}

impl Bounds {
    pub(super) const EMPTY: Self = Self { min: Vec4::INFINITY, max: Vec4::NEG_INFINITY };

    fn of(node: &Bvh2Node) -> Self {
        Self { min: Vec3::from_array(node.min).extend(0.0), max: Vec3::from_array(node.max).extend(0.0) }
    }

    #[inline]
    pub(super) fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    #[inline]
    pub(super) fn intersection(self, other: Self) -> Self {
        Self { min: self.min.max(other.min), max: self.max.min(other.max) }
    }

    #[inline]
    pub(super) fn grow(&mut self, point: Vec4) {
        self.min = self.min.min(point);
        self.max = self.max.max(point);
    }

    /// Half the surface; of no use on the empty box.
    #[inline]
    pub(super) fn half_area(&self) -> f32 {
        let e = self.max - self.min;
        e.x * e.y + e.y * e.z + e.z * e.x
    }

    fn to_arrays(self) -> ([f32; 3], [f32; 3]) {
        (self.min.truncate().to_array(), self.max.truncate().to_array())
    }

    fn leaf(self, first: usize, count: usize) -> Bvh2Node {
        let (min, max) = self.to_arrays();
        Bvh2Node { min, right_or_first: first as u32, max, count: count as u32 }
    }

    fn inner(self, right: usize) -> Bvh2Node {
        let (min, max) = self.to_arrays();
        Bvh2Node { min, right_or_first: right as u32, max, count: 0 }
    }
}

/// A primitive's box and number. The number sits in the fourth lane of `min` with a bit set that makes it a normal
/// float, so that arithmetic on all four lanes at once stays fast.
#[derive(Clone, Copy, Debug)]
pub(super) struct PrimRef {
    min: Vec4,
    max: Vec4,
}

const ID_TAG: u32 = 0x2000_0000;

impl PrimRef {
    fn new(bounds: Aabb, id: u32) -> Self {
        Self { min: bounds.min.extend(f32::from_bits(ID_TAG | id)), max: bounds.max.extend(0.0) }
    }

    fn with_bounds(bounds: Bounds, id: u32) -> Self {
        Self::new(Aabb { min: bounds.min.truncate(), max: bounds.max.truncate() }, id)
    }

    #[inline]
    fn id(&self) -> u32 {
        self.min.w.to_bits() & !ID_TAG
    }

    #[inline]
    fn bounds(&self) -> Bounds {
        Bounds { min: self.min, max: self.max }
    }

    /// Twice the centre.
    #[inline]
    fn center2(&self) -> Vec4 {
        self.min + self.max
    }

    fn scale(&mut self, factor: f32) {
        *self = Self::new(Aabb { min: factor * self.min.truncate(), max: factor * self.max.truncate() }, self.id());
    }
}

/// A part of the tree while it is built in parallel; numbers in a built part start at 0.
pub(super) enum Subtree {
    Built(Bvh2),
    Inner { bounds: Bounds, children: Box<[Subtree; 2]> },
}

impl Subtree {
    fn flatten(self) -> Bvh2 {
        if let Subtree::Built(tree) = self {
            return tree;
        }
        let (nodes, primitives) = self.sizes();
        let mut tree = Bvh2 { nodes: Vec::with_capacity(nodes), primitives: Vec::with_capacity(primitives) };
        self.append_to(&mut tree);
        tree
    }

    fn sizes(&self) -> (usize, usize) {
        match self {
            Subtree::Built(tree) => (tree.nodes.len(), tree.primitives.len()),
            Subtree::Inner { children, .. } => {
                let [left, right] = [children[0].sizes(), children[1].sizes()];
                (1 + left.0 + right.0, left.1 + right.1)
            }
        }
    }

    fn append_to(self, tree: &mut Bvh2) {
        match self {
            Subtree::Built(part) => {
                let (node_base, primitive_base) = (tree.nodes.len() as u32, tree.primitives.len() as u32);
                tree.nodes.extend(part.nodes.iter().map(|node| {
                    let base = if node.is_leaf() { primitive_base } else { node_base };
                    Bvh2Node { right_or_first: node.right_or_first + base, ..*node }
                }));
                tree.primitives.extend_from_slice(&part.primitives);
            }
            Subtree::Inner { bounds, children } => {
                let index = tree.nodes.len();
                let [left, right] = *children;
                tree.nodes.push(bounds.inner(0));
                left.append_to(tree);
                tree.nodes[index].right_or_first = tree.nodes.len() as u32;
                right.append_to(tree);
            }
        }
    }
}
