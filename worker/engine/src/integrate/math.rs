//! Small vector arithmetic shared by all shading code.
//!
//! Everything here is `f32` in a fixed order of operations and has a twin of the same name in
//! `shaders/shared/math.wgsl`.

use glam::Vec3;

pub const PI: f32 = std::f32::consts::PI;
pub const TWO_PI: f32 = 2.0 * PI;
pub const INV_PI: f32 = std::f32::consts::FRAC_1_PI;

/// Rounding error of a hit point and of the next ray's intersection with the same primitive, relative to the
/// primitive's extent around its object's origin: 16 half units in the last place.
pub const LOCAL_ERROR: f32 = 1.0 / 1_048_576.0;
/// The same relative to the distance from the world's origin, where only additions round: 4 half units.
pub const WORLD_ERROR: f32 = 1.0 / 4_194_304.0;

/// Rec. 709 luminance of a linear colour.
pub fn luminance(c: Vec3) -> f32 {
    0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z
}

/// Rows of a 3x4 matrix times a point.
pub fn transform_point(rows: &[[f32; 4]; 3], p: Vec3) -> Vec3 {
    Vec3::new(
        rows[0][0] * p.x + rows[0][1] * p.y + rows[0][2] * p.z + rows[0][3],
        rows[1][0] * p.x + rows[1][1] * p.y + rows[1][2] * p.z + rows[1][3],
        rows[2][0] * p.x + rows[2][1] * p.y + rows[2][2] * p.z + rows[2][3],
    )
}

/// Rows of a 3x4 matrix times a direction.
pub fn transform_vector(rows: &[[f32; 4]; 3], v: Vec3) -> Vec3 {
    Vec3::new(
        rows[0][0] * v.x + rows[0][1] * v.y + rows[0][2] * v.z,
        rows[1][0] * v.x + rows[1][1] * v.y + rows[1][2] * v.z,
        rows[2][0] * v.x + rows[2][1] * v.y + rows[2][2] * v.z,
    )
}

/// A normal through the inverse transpose, given the rows of the *inverse* matrix. Not normalised.
pub fn transform_normal(inverse_rows: &[[f32; 4]; 3], n: Vec3) -> Vec3 {
    Vec3::new(
        inverse_rows[0][0] * n.x + inverse_rows[1][0] * n.y + inverse_rows[2][0] * n.z,
        inverse_rows[0][1] * n.x + inverse_rows[1][1] * n.y + inverse_rows[2][1] * n.z,
        inverse_rows[0][2] * n.x + inverse_rows[1][2] * n.y + inverse_rows[2][2] * n.z,
    )
}

/// Bound on how far a ray that leaves a primitive must start from it, in world units. `extent` is the largest absolute
/// object-space coordinate on each axis of the primitive. One number for all directions: the error of an intersection
/// is proportional to the whole primitive, also where it is axis-aligned.
pub fn surface_error(rows: &[[f32; 4]; 3], extent: Vec3, position: Vec3) -> f32 {
    let x = rows[0][0].abs() * extent.x + rows[0][1].abs() * extent.y + rows[0][2].abs() * extent.z;
    let y = rows[1][0].abs() * extent.x + rows[1][1].abs() * extent.y + rows[1][2].abs() * extent.z;
    let z = rows[2][0].abs() * extent.x + rows[2][1].abs() * extent.y + rows[2][2].abs() * extent.z;
    let world = (rows[0][3].abs() + position.x.abs())
        .max(rows[1][3].abs() + position.y.abs())
        .max(rows[2][3].abs() + position.z.abs());
    x.max(y).max(z) * LOCAL_ERROR + world * WORLD_ERROR
}

/// `v` as a unit vector, or `fallback` where it has no direction.
pub fn normalize_or(v: Vec3, fallback: Vec3) -> Vec3 {
    let length = v.dot(v).sqrt();
    if length > 0.0 && length < f32::INFINITY { v * (1.0 / length) } else { fallback }
}

/// Two unit vectors that make a right-handed frame with the unit vector `n` (Duff et al. 2017, "Building an
/// Orthonormal Basis, Revisited").
pub fn basis(n: Vec3) -> (Vec3, Vec3) {
    let sign = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// World direction into the frame `(tangent, bitangent, normal)`.
pub fn to_local(tangent: Vec3, bitangent: Vec3, normal: Vec3, v: Vec3) -> Vec3 {
    Vec3::new(v.dot(tangent), v.dot(bitangent), v.dot(normal))
}

/// Direction in the frame back to the world.
pub fn to_world(tangent: Vec3, bitangent: Vec3, normal: Vec3, v: Vec3) -> Vec3 {
    tangent * v.x + bitangent * v.y + normal * v.z
}

/// Moves a ray's origin off the surface it starts on by `error` ([`surface_error`]), to the side that `direction` leaves
/// to: so a ray does not meet its own surface, at any scale and distance from the origin, which fixed epsilons get
/// wrong (Waechter and Binder 2019, "A Fast and Robust Method for Avoiding Self-Intersection"; a bound on the rounding
/// error stands in place of their fixed number of ulps, as in Pharr, Jakob and Humphreys 2023, section 6.8).
pub fn offset_origin(position: Vec3, error: f32, normal: Vec3, direction: Vec3) -> Vec3 {
    if direction.dot(normal) >= 0.0 { position + normal * error } else { position - normal * error }
}

/// Weight of a sample with density `a` against another technique's `b` (power heuristic, Veach 1997, section 9.2.4).
/// Scaled by the larger one, so that huge densities do not overflow.
pub fn power_heuristic(a: f32, b: f32) -> f32 {
    if a <= 0.0 {
        return 0.0;
    }
    if b <= a {
        let r = b / a;
        1.0 / (1.0 + r * r)
    } else {
        let r = a / b;
        (r * r) / (1.0 + r * r)
    }
}

/// Cosine-distributed direction about +Z; its density is `z / PI`.
pub fn cosine_hemisphere(u: f32, v: f32) -> Vec3 {
    let r = u.sqrt();
    let phi = TWO_PI * v;
    Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - u).max(0.0).sqrt())
}

/// Uniform direction; its density is `1 / (4 PI)`.
pub fn uniform_sphere(u: f32, v: f32) -> Vec3 {
    let z = 1.0 - 2.0 * u;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let phi = TWO_PI * v;
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

/// Barycentric coordinates of vertices 1 and 2, uniform over a triangle.
pub fn uniform_triangle(u: f32, v: f32) -> (f32, f32) {
    let s = u.sqrt();
    (s * (1.0 - v), s * v)
}

/// Whether all three components are finite.
pub fn is_finite(v: Vec3) -> bool {
    v.x.abs() < f32::INFINITY && v.y.abs() < f32::INFINITY && v.z.abs() < f32::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn basis_is_orthonormal_and_right_handed() {
        for i in 0..1000u32 {
            let n = uniform_sphere((i as f32 + 0.5) / 1000.0, (i as f32 * 0.618_034).fract());
            let (t, b) = basis(n);
            assert!((t.length() - 1.0).abs() < 1e-5 && (b.length() - 1.0).abs() < 1e-5);
            assert!(t.dot(b).abs() < 1e-5 && t.dot(n).abs() < 1e-5 && b.dot(n).abs() < 1e-5);
            assert!(t.cross(b).dot(n) > 0.999);
        }
    }

    #[test]
    fn offset_clears_the_error_on_the_side_of_the_direction() {
        let n = Vec3::new(0.0, 0.6, -0.8);
        let e = 1e-3;
        let p = Vec3::new(5.0, 6.0, 7.0);
        assert!((offset_origin(p, e, n, n) - p).dot(n) >= 0.999e-3);
        assert!((offset_origin(p, e, n, -n) - p).dot(n) <= -0.999e-3);
    }

    #[test]
    fn power_heuristic_sums_to_one_and_survives_huge_densities() {
        for (a, b) in [(1.0, 3.0), (0.0, 2.0), (1e30, 1e-30), (3e38, 3e38)] {
            assert!((power_heuristic(a, b) + power_heuristic(b, a) - 1.0).abs() < 1e-6, "{a} {b}");
        }
    }

    #[test]
    fn normals_stay_perpendicular_under_uneven_scale() {
        let rows = [[2.0, 0.0, 0.0, 5.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]];
        let inverse = [[0.5, 0.0, 0.0, -2.5], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]];
        let (edge, normal) = (Vec3::new(1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 0.0));
        assert!(transform_vector(&rows, edge).dot(transform_normal(&inverse, normal)).abs() < 1e-6);
    }
}
