//! What is computed once per ray and object space, before any box or primitive is tested.

use glam::Vec3;

use super::Ray;
use super::simd::{Isa, Lanes};
use crate::accel::wide::Node;
use crate::scene::Aabb;

/// A valid ray in the space of one tree.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObjectRay {
    pub origin: Vec3,
    pub direction: Vec3,
    pub t_min: f32,
    /// From the origin to the far side of the tree's box, on the axis on which that is farthest.
    pub reach: f32,
    /// By how much boxes must grow so that none is missed that holds a hit: see [`Self::new`].
    slack: f32,
}

impl ObjectRay {
    /// None for a ray that hits nothing by definition: a number that is not finite (`t_max` may be infinite), an empty
    /// interval, or no direction.
    ///
    /// `bounds` is the box of the tree. Primitive tests round coordinates relative to the origin to half an ulp some
    /// four times, box tests as often; the boxes grow by twice that, so that a primitive that the rounded test hits
    /// is never lost because its box was missed. (Ize 2013, "Robust BVH ray traversal", bounds the error along the ray;
    /// this also covers the error across it.)
    ///
    /// Always inline: written to memory by one function in pieces and read by the next as a whole, it would wait for the
    /// stores, which costs more than all of this.
    #[inline(always)]
    pub(crate) fn new(ray: &Ray, bounds: &Aabb) -> Option<Self> {
        // Components below the smallest normal number have no reciprocal; they cannot move a ray either.
        let flush = |v: f32| if v.abs() < f32::MIN_POSITIVE { 0.0 } else { v };
        let direction = Vec3::new(flush(ray.direction.x), flush(ray.direction.y), flush(ray.direction.z));
        let valid = ray.origin.is_finite()
            && direction.is_finite()
            && direction != Vec3::ZERO
            && ray.t_min.max(0.0) < ray.t_max
            && !ray.t_min.is_nan();
        if !valid {
            return None;
        }
        let reach = (bounds.min - ray.origin).abs().max((bounds.max - ray.origin).abs()).max_element();
        let slack = reach * (8.0 * 0.5 * f32::EPSILON);
        Some(Self { origin: ray.origin, direction, t_min: ray.t_min.max(0.0), reach, slack })
    }
}

/// A ray ready for [`Self::slabs`].
pub(crate) struct BoxRay<I: Isa> {
    /// Rows of [`Node::bounds`] where the ray enters and leaves each axis' slab.
    near_rows: [usize; 3],
    far_rows: [usize; 3],
    near_origin: [I::F8; 3],
    far_origin: [I::F8; 3],
    inverse: [I::F8; 3],
    pub octant_shift: u32,
}

impl<I: Isa> BoxRay<I> {
    #[inline(always)]
    pub(crate) fn new(ray: &ObjectRay) -> Self {
        let origin = ray.origin.to_array();
        let direction = ray.direction.to_array();
        let negative = direction.map(f32::is_sign_negative);
        // At least one ulp, so that no difference below is zero times infinity on the inside of a slab.
        let raised = origin.map(|o| (o + ray.slack).max(o.next_up()));
        let lowered = origin.map(|o| (o - ray.slack).min(o.next_down()));
        let pick = |k: usize, back: bool| I::F8::splat(if negative[k] != back { lowered[k] } else { raised[k] });
        Self {
            near_rows: std::array::from_fn(|k| k + 3 * usize::from(negative[k])),
            far_rows: std::array::from_fn(|k| k + 3 * usize::from(!negative[k])),
            near_origin: [pick(0, false), pick(1, false), pick(2, false)],
            far_origin: [pick(0, true), pick(1, true), pick(2, true)],
            inverse: [
                I::F8::splat(1.0 / direction[0]),
                I::F8::splat(1.0 / direction[1]),
                I::F8::splat(1.0 / direction[2]),
            ],
            octant_shift: 3 * (u32::from(negative[0]) | u32::from(negative[1]) << 1 | u32::from(negative[2]) << 2),
        }
    }

    /// Where the ray enters and leaves the node's boxes; a box is met where `near <= far`.
    ///
    /// A component of zero makes its distances plus or minus infinity, and NaN exactly on the grown slab's border,
    /// which counts as a miss: there is nothing so far out.
    #[inline(always)]
    pub(crate) fn slabs(&self, node: &Node, t_min: I::F8, t_limit: I::F8) -> (I::F8, I::F8) {
        let distance = |row: usize, origin: I::F8, axis: usize| {
            // SAFETY: rows are 0 to 5 by construction.
            I::F8::load(unsafe { node.bounds.get_unchecked(row) }).sub(origin).mul(self.inverse[axis])
        };
        let near = |axis: usize| distance(self.near_rows[axis], self.near_origin[axis], axis);
        let far = |axis: usize| distance(self.far_rows[axis], self.far_origin[axis], axis);
        (near(0).max(near(1)).max(near(2).max(t_min)), far(0).min(far(1)).min(far(2).min(t_limit)))
    }
}
