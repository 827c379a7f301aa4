//! Representative candidates as rays meet them: a triangle stands for all that is in a shaft (Keul 2020, chapter 6; Keul,
//! Koß, Müller 2018, "Representative candidate" Line Space).
//!
//! The triangle counts as its whole plane, and its vertex normals go on beyond its edges, so that one covers the width of a
//! shaft. Where the extrapolated normal has turned too far from the triangle's mean normal, the shaft is taken to be covered only in
//! part, and the hit is dropped. So is a hit outside the node's box: that place belongs to another node.

use glam::Vec3;

use crate::scene::{Aabb, Mesh};
use crate::trace::Ray;

/// When the plane of a candidate counts as hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CandidateRules {
    /// Least cosine of the angle between the extrapolated normal and the triangle's mean normal; -1 accepts all.
    pub min_cosine: f32,
    /// By how much of its diagonal a node's box grows before hits outside it are dropped.
    pub range_slack: f32,
    /// Nodes in which a ray starts are tested exactly; otherwise their shafts are asked too, and light leaks at contacts.
    pub exact_origin: bool,
}

impl Default for CandidateRules {
    fn default() -> Self {
        Self { min_cosine: 0.5, range_slack: 0.0, exact_origin: true }
    }
}

/// A triangle with all that its plane needs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CandidateTriangle {
    corner: Vec3,
    edges: [Vec3; 2],
    /// Cross product of the edges.
    normal: Vec3,
    /// At the vertices.
    normals: [Vec3; 3],
    /// Unit.
    mean: Vec3,
    pub primitive: u32,
}

impl CandidateTriangle {
    pub(super) fn new(mesh: &Mesh, primitive: u32) -> Self {
        let vertices = mesh.triangles[primitive as usize];
        let [a, b, c] = vertices.map(|v| mesh.positions[v as usize]);
        let edges = [b - a, c - a];
        let normal = edges[0].cross(edges[1]);
        let flat = normal.normalize_or_zero();
        let normals = vertices.map(|v| mesh.normals.get(v as usize).copied().unwrap_or(flat));
        let mean = (normals[0] + normals[1] + normals[2]).normalize_or(flat);
        Self { corner: a, edges, normal, normals, mean, primitive }
    }

    /// Where the ray meets the plane: `t` and the coordinates of vertices 1 and 2, which may lie outside of 0 to 1. Of a node with
    /// the box `bounds`.
    #[inline]
    pub(crate) fn hit(&self, ray: &Ray, bounds: &Aabb, rules: &CandidateRules) -> Option<[f32; 3]> {
        let t = self.normal.dot(self.corner - ray.origin) / self.normal.dot(ray.direction);
        // Also where the ray runs along the plane, or the triangle has none.
        if !(t > ray.t_min && t < ray.t_max) {
            return None;
        }
        let point = ray.origin + t * ray.direction;
        let slack = Vec3::splat(rules.range_slack * bounds.extent().length() + 1e-4 * bounds.extent().max_element());
        let is_inside = point.cmpge(bounds.min - slack).all() && point.cmple(bounds.max + slack).all();
        if !is_inside {
            return None;
        }
        let offset = point - self.corner;
        let scale = 1.0 / self.normal.length_squared();
        let u = offset.cross(self.edges[1]).dot(self.normal) * scale;
        let v = self.edges[0].cross(offset).dot(self.normal) * scale;
        if rules.min_cosine > -1.0 {
            let [a, b, c] = self.normals;
            let extrapolated = (1.0 - u - v) * a + u * b + v * c;
            let is_alike = extrapolated.dot(self.mean) >= rules.min_cosine * extrapolated.length();
            if !is_alike || extrapolated.length_squared() < 1e-12 {
                return None;
            }
        }
        (u.is_finite() && v.is_finite()).then_some([t, u, v])
    }
}
