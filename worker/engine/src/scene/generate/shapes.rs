//! Shapes that generated scenes are made of, with normals and texture coordinates.

use std::f32::consts::{PI, TAU};

use glam::{Affine3A, Vec3};

use crate::scene::write_glb::Geometry;

impl Geometry {
    /// Adds another shape; attributes that only one of the two has are dropped.
    pub(super) fn append(&mut self, other: &Self) {
        let base = self.positions.len() as u32;
        let was_empty = base == 0;
        fn join<T: Clone>(own: &mut Vec<T>, other: &[T], was_empty: bool) {
            if was_empty || (!own.is_empty() && !other.is_empty()) {
                own.extend_from_slice(other);
            } else {
                own.clear();
            }
        }
        join(&mut self.normals, &other.normals, was_empty);
        join(&mut self.uvs, &other.uvs, was_empty);
        join(&mut self.colors, &other.colors, was_empty);
        self.positions.extend_from_slice(&other.positions);
        self.triangles.extend(other.triangles.iter().map(|triangle| triangle.map(|vertex| vertex + base)));
    }

    /// Moves the shape; scales should be positive, so that the winding stays.
    pub(super) fn transformed(mut self, transform: Affine3A) -> Self {
        let for_normals = transform.matrix3.inverse().transpose();
        for position in &mut self.positions {
            *position = transform.transform_point3(*position);
        }
        for normal in &mut self.normals {
            *normal = (for_normals * *normal).normalize();
        }
        self
    }
}

/// A parallelogram from `corner` along `u` and `v`, facing `u` x `v`.
pub(super) fn quad(corner: Vec3, u: Vec3, v: Vec3) -> Geometry {
    let normal = u.cross(v).normalize();
    Geometry {
        positions: vec![corner, corner + u, corner + u + v, corner + v],
        normals: vec![normal; 4],
        uvs: vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Geometry::default()
    }
}

/// A horizontal square of side `2 * half`, facing up; the texture repeats `repeats` times along each side.
pub(super) fn floor(height: f32, half: f32, repeats: f32) -> Geometry {
    let mut floor = quad(Vec3::new(-half, height, half), Vec3::X * 2.0 * half, Vec3::NEG_Z * 2.0 * half);
    for uv in &mut floor.uvs {
        *uv = uv.map(|value| value * repeats);
    }
    floor
}

/// A box from `min` to `max` with flat faces.
pub(super) fn cuboid(min: Vec3, max: Vec3) -> Geometry {
    let size = max - min;
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let faces = [(min, y, x), (min + z, x, y), (min, z, y), (min + x, y, z), (min, x, z), (min + y, z, x)];
    let mut all = Geometry::default();
    for (corner, u, v) in faces {
        all.append(&quad(corner, u, v));
    }
    all
}

/// A grid of `columns` x `rows` cells over a surface: `surface(u, v)` gives position and unit normal for u and v in 0..=1.
/// The surface must turn counter-clockwise: its normal is that of d/du x d/dv.
pub(super) fn surface(columns: u32, rows: u32, mut surface: impl FnMut(f32, f32) -> (Vec3, Vec3)) -> Geometry {
    let mut geometry = Geometry::default();
    for row in 0..=rows {
        for column in 0..=columns {
            let (u, v) = (column as f32 / columns as f32, row as f32 / rows as f32);
            let (position, normal) = surface(u, v);
            geometry.positions.push(position);
            geometry.normals.push(normal);
            geometry.uvs.push([u, 1.0 - v]);
        }
    }
    let width = columns + 1;
    for row in 0..rows {
        for column in 0..columns {
            let a = row * width + column;
            let (b, c, d) = (a + 1, a + 1 + width, a + width);
            geometry.triangles.push([a, b, c]);
            geometry.triangles.push([a, c, d]);
        }
    }
    geometry
}

/// A sphere of `2 * rows` x `rows` cells. Its poles are rows of triangles, without the empty half of each cell.
pub(super) fn sphere(center: Vec3, radius: f32, rows: u32) -> Geometry {
    let mut geometry = surface(2 * rows, rows, |u, v| {
        let (longitude, latitude) = (u * TAU, (v - 0.5) * PI);
        // Exact at the seam and the poles, so that the surface is closed.
        let longitude = if u == 1.0 { 0.0 } else { longitude };
        let flat = if v == 0.0 || v == 1.0 { 0.0 } else { latitude.cos() };
        let normal = Vec3::new(flat * longitude.sin(), latitude.sin(), flat * longitude.cos()).normalize();
        (center + normal * radius, normal)
    });
    let width = 2 * rows + 1;
    let is_pole = |vertex: u32| vertex / width == 0 || vertex / width == rows;
    geometry.triangles.retain(|triangle| triangle.iter().filter(|vertex| is_pole(**vertex)).count() < 2);
    geometry
}

/// A surface of revolution about Y through `profile` (radius and height, from the bottom up), with smooth normals.
pub(super) fn lathe(profile: &[(f32, f32)], columns: u32) -> Geometry {
    let last = profile.len() - 1;
    let mut geometry = surface(columns, last as u32, |u, v| {
        let at = (v * last as f32).round() as usize;
        let (radius, height) = profile[at];
        let (before, after) = (profile[at.saturating_sub(1)], profile[(at + 1).min(last)]);
        let slope = (after.0 - before.0, after.1 - before.1);
        let angle = if u == 1.0 { 0.0 } else { u * TAU };
        let outward = Vec3::new(angle.sin(), 0.0, angle.cos());
        let normal = (outward * slope.1 - Vec3::Y * slope.0).try_normalize().unwrap_or(outward);
        (outward * radius + Vec3::Y * height, normal)
    });
    let positions = &geometry.positions;
    geometry.triangles.retain(|[a, b, c]| {
        let [a, b, c] = [a, b, c].map(|vertex| positions[*vertex as usize]);
        a != b && b != c && c != a
    });
    geometry
}

/// A tube of `radius` around a closed curve: `curve(t)` for t in 0..1.
pub(super) fn closed_tube(segments: u32, sides: u32, radius: f32, curve: impl Fn(f32) -> Vec3) -> Geometry {
    surface(segments, sides, |u, v| {
        let t = if u == 1.0 { 0.0 } else { u };
        let step = 0.25 / segments as f32;
        let center = curve(t);
        let tangent = (curve(t + step) - curve(t - step)).normalize();
        // A frame that depends on the place alone closes by itself.
        let side = tangent.cross(center.try_normalize().unwrap_or(Vec3::Y)).try_normalize();
        let side = side.unwrap_or_else(|| tangent.any_orthonormal_vector());
        let angle = if v == 1.0 { 0.0 } else { -v * TAU };
        let normal = side * angle.cos() + tangent.cross(side) * angle.sin();
        (center + normal * radius, normal)
    })
}

/// The (p, q) torus knot, about one unit in size.
pub(super) fn torus_knot(p: f32, q: f32, t: f32) -> Vec3 {
    let angle = t * TAU;
    let radius = 0.65 + 0.28 * (q * angle).cos();
    Vec3::new(radius * (p * angle).cos(), 0.28 * (q * angle).sin(), radius * (p * angle).sin())
}

/// A ring of radius 1 around Y with a tube of `tube`.
pub(super) fn torus(tube: f32, segments: u32, sides: u32) -> Geometry {
    surface(segments, sides, |u, v| {
        let around = if u == 1.0 { 0.0 } else { u * TAU };
        let about = if v == 1.0 { 0.0 } else { v * TAU };
        let outward = Vec3::new(around.sin(), 0.0, around.cos());
        let normal = outward * about.cos() + Vec3::Y * about.sin();
        (outward + normal * tube, normal)
    })
}

/// An open cone or cylinder from `bottom` to `top` with radii there, and `sides` sides.
pub(super) fn frustum(bottom: Vec3, top: Vec3, bottom_radius: f32, top_radius: f32, sides: u32) -> Geometry {
    let axis = (top - bottom).normalize();
    let side = axis.any_orthonormal_vector();
    let other = axis.cross(side);
    let length = (top - bottom).length();
    let mut geometry = surface(sides, 1, |u, v| {
        let angle = if u == 1.0 { 0.0 } else { u * TAU };
        let outward = side * angle.cos() + other * angle.sin();
        let normal = (outward * length + axis * (bottom_radius - top_radius)).normalize();
        let (center, radius) = if v == 0.0 { (bottom, bottom_radius) } else { (top, top_radius) };
        (center + outward * radius, normal)
    });
    if top_radius == 0.0 {
        let width = sides + 1;
        geometry.triangles.retain(|triangle| triangle.iter().filter(|vertex| **vertex >= width).count() < 2);
    }
    geometry
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::face_normal;

    /// No empty triangle, unit normals, and faces that turn the way their normals point.
    fn check(geometry: &Geometry) {
        for triangle in &geometry.triangles {
            let face = face_normal(&geometry.positions, *triangle).expect("a triangle with an area");
            for vertex in triangle {
                let normal = geometry.normals[*vertex as usize];
                assert!((normal.length() - 1.0).abs() < 1e-4);
                assert!(normal.dot(face) > 0.0, "{triangle:?} faces {face}, its normal is {normal}");
            }
        }
    }

    #[test]
    fn all_shapes_face_outward() {
        check(&quad(Vec3::ZERO, Vec3::X, Vec3::Y));
        check(&floor(0.0, 1.0, 1.0));
        check(&cuboid(Vec3::splat(-1.0), Vec3::ONE));
        check(&sphere(Vec3::splat(3.0), 2.0, 12));
        check(&torus(0.3, 24, 12));
        check(&frustum(Vec3::ZERO, Vec3::Y, 1.0, 0.0, 8));
        check(&frustum(Vec3::ZERO, Vec3::new(1.0, 2.0, 0.5), 0.5, 0.3, 8));
        check(&lathe(&[(0.5, 0.0), (0.7, 0.5), (0.2, 1.0)], 16));
        check(&closed_tube(400, 12, 0.1, |t| torus_knot(2.0, 3.0, t)));
        let outward = cuboid(Vec3::splat(-1.0), Vec3::ONE);
        for triangle in &outward.triangles {
            let center = triangle.iter().map(|vertex| outward.positions[*vertex as usize]).sum::<Vec3>();
            assert!(face_normal(&outward.positions, *triangle).unwrap().dot(center) > 0.0);
        }
    }
}
