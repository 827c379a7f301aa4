//! Four triangles or four spheres against one ray.
//!
//! Triangles: Woop, Benthin, Wald 2013, "Watertight ray/triangle intersection". Vertices are moved to the ray's origin
//! and sheared so that the ray becomes the z axis; then the signs of three 2D edge functions decide. The function of a
//! shared edge is the same number, negated, in both triangles, and where it rounds to zero it is computed again in
//! double precision, in which it is exact: so no ray slips between two triangles that share an edge or a vertex.
//!
//! Spheres: Haines, Günther, Akenine-Möller 2019, "Precision improvements for ray/sphere intersection" (Ray Tracing
//! Gems, chapter 7).

use super::Hit;
use super::kernel::Sink;
use super::object_ray::ObjectRay;
use super::simd::{Isa, Lanes};
use crate::accel::wide::{NO_PRIMITIVE, Packet};

/// A ray ready for the primitive tests.
pub(crate) struct PacketRay<I: Isa> {
    t_min: f32,
    /// The axis on which the direction is longest, and the others in an order that keeps the winding.
    axes: [usize; 3],
    /// Origin on those axes.
    origin: [I::F4; 3],
    shear: [I::F4; 3],
    object: ObjectRay,
}

impl<I: Isa> PacketRay<I> {
    #[inline(always)]
    pub(crate) fn new(ray: &ObjectRay) -> Self {
        let d = ray.direction.to_array();
        let kz = ray.direction.abs().max_position();
        let (mut kx, mut ky) = ((kz + 1) % 3, (kz + 2) % 3);
        if d[kz] < 0.0 {
            (kx, ky) = (ky, kx);
        }
        let o = ray.origin.to_array();
        Self {
            t_min: ray.t_min,
            axes: [kx, ky, kz],
            origin: [I::F4::splat(o[kx]), I::F4::splat(o[ky]), I::F4::splat(o[kz])],
            shear: [I::F4::splat(d[kx] / d[kz]), I::F4::splat(d[ky] / d[kz]), I::F4::splat(1.0 / d[kz])],
            object: *ray,
        }
    }
}

/// Offers the hits of a packet of triangles, or else of spheres. True when the sink wants no more.
#[inline(always)]
pub(crate) fn test_packet<I: Isa>(
    packet: &Packet,
    is_triangles: bool,
    ray: &PacketRay<I>,
    instance: u32,
    sink: &mut impl Sink,
) -> bool {
    if is_triangles { test_triangles(packet, ray, instance, sink) } else { test_spheres(packet, ray, instance, sink) }
}

#[inline(always)]
fn test_triangles<I: Isa>(packet: &Packet, ray: &PacketRay<I>, instance: u32, sink: &mut impl Sink) -> bool {
    let coordinate = |vertex: usize, axis: usize| {
        // SAFETY: vertices are 0 to 2 and axes a permutation of 0 to 2, so there are rows 0 to 8.
        let row = unsafe { packet.rows.get_unchecked(3 * vertex + ray.axes[axis]) };
        I::F4::load(row).sub(ray.origin[axis])
    };
    let sheared = |vertex: usize| {
        let z = coordinate(vertex, 2);
        let x = coordinate(vertex, 0).sub(ray.shear[0].mul(z));
        let y = coordinate(vertex, 1).sub(ray.shear[1].mul(z));
        [x, y, z]
    };
    let (a, b, c) = (sheared(0), sheared(1), sheared(2));
    let edge = |p: [I::F4; 3], q: [I::F4; 3]| p[0].mul(q[1]).sub(p[1].mul(q[0]));
    let (u, v, w) = (edge(c, b), edge(a, c), edge(b, a));

    let zero = I::F4::splat(0.0);
    let lowest = u.min(v).min(w);
    let highest = u.max(v).max(w);
    // Strictly different signs are a miss for certain. (A NaN only ever hides a sign here, so it stays a candidate.)
    let positive = lowest.less(zero) ^ 15;
    let negative = zero.less(highest) ^ 15;
    let candidates = positive | negative;
    if candidates == 0 {
        return false;
    }

    let determinant = u.add(v).add(w);
    let z = [a[2].mul(ray.shear[2]), b[2].mul(ray.shear[2]), c[2].mul(ray.shear[2])];
    let t = u.mul(z[0]).add(v.mul(z[1])).add(w.mul(z[2])).div(determinant);
    // All three signs certain: the products neither vanished nor overflowed.
    let infinity = I::F4::splat(f32::INFINITY);
    let certain = (zero.less(lowest) & determinant.less(infinity))
        | (highest.less(zero) & I::F4::splat(f32::NEG_INFINITY).less(determinant));
    let in_range = I::F4::splat(ray.t_min).less(t) & t.less_or_equal(I::F4::splat(sink.t_limit()));
    let mut hits = candidates & ((certain & in_range) | (certain ^ 15));
    if hits == 0 {
        return false;
    }

    let (v, w, t, determinant) = (v.store(), w.store(), t.store(), determinant.store());
    while hits != 0 {
        let lane = hits.trailing_zeros() as usize;
        hits &= hits - 1;
        let primitive = packet.ids[lane];
        if primitive == NO_PRIMITIVE {
            continue;
        }
        let hit = if certain >> lane & 1 == 1 {
            Hit { t: t[lane], u: v[lane] / determinant[lane], v: w[lane] / determinant[lane], instance, primitive }
        } else {
            let corner = |p: [I::F4; 3]| p.map(|values| f64::from(values.store()[lane]));
            let scale = f64::from(ray.shear[2].store()[0]);
            match exact_hit(corner(a), corner(b), corner(c), scale) {
                Some((t, u, v)) if t > ray.t_min && t <= sink.t_limit() => Hit { t, u, v, instance, primitive },
                _ => continue,
            }
        };
        if sink.offer(hit) {
            return true;
        }
    }
    false
}

/// The end of the test in double precision: `t`, and the barycentric coordinates of vertices 1 and 2.
#[cold]
fn exact_hit(a: [f64; 3], b: [f64; 3], c: [f64; 3], scale: f64) -> Option<(f32, f32, f32)> {
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    let mixed = (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0);
    let determinant = u + v + w;
    if mixed || determinant == 0.0 || !determinant.is_finite() {
        return None;
    }
    let t = scale * (u * a[2] + v * b[2] + w * c[2]) / determinant;
    Some((t as f32, (v / determinant) as f32, (w / determinant) as f32))
}

/// Offers where the ray enters and leaves each sphere.
#[inline(always)]
fn test_spheres<I: Isa>(packet: &Packet, ray: &PacketRay<I>, instance: u32, sink: &mut impl Sink) -> bool {
    let splat = I::F4::splat;
    let origin = ray.object.origin.to_array().map(splat);
    let d = ray.object.direction.to_array().map(splat);
    let dot = |p: [I::F4; 3], q: [I::F4; 3]| p[0].mul(q[0]).add(p[1].mul(q[1])).add(p[2].mul(q[2]));
    let row = |k: usize| I::F4::load(&packet.rows[k]);
    let f: [I::F4; 3] = [origin[0].sub(row(0)), origin[1].sub(row(1)), origin[2].sub(row(2))];
    let radius = row(3);
    let a = dot(d, d);
    let b = splat(0.0).sub(dot(f, d));
    let along = b.div(a);
    // From the centre to the point of the line that is nearest to it.
    let nearest = [f[0].add(along.mul(d[0])), f[1].add(along.mul(d[1])), f[2].add(along.mul(d[2]))];
    let radius2 = radius.mul(radius);
    let discriminant = radius2.sub(dot(nearest, nearest));
    let met = splat(0.0).less_or_equal(discriminant);
    if met == 0 {
        return false;
    }
    let root = a.mul(discriminant).sqrt().store();
    let (a, b, c) = (a.store(), b.store(), dot(f, f).sub(radius2).store());
    let mut met = met;
    while met != 0 {
        let lane = met.trailing_zeros() as usize;
        met &= met - 1;
        let primitive = packet.ids[lane];
        if primitive == NO_PRIMITIVE {
            continue;
        }
        let q = b[lane] + root[lane].copysign(b[lane]);
        let (first, second) = (c[lane] / q, q / a[lane]);
        for t in [first.min(second), first.max(second)] {
            if t > ray.t_min && t <= sink.t_limit() && sink.offer(Hit { t, u: 0.0, v: 0.0, instance, primitive }) {
                return true;
            }
        }
    }
    false
}
