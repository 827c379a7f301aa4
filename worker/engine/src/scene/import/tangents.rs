//! Tangents that a file left out: MikkTSpace (Mikkelsen 2008), which glTF 2.0 (3.7.2.1) asks for, over the UV set of
//! the normal map, transformed as the map is looked up (KHR_texture_transform). Tangents are found per triangle corner; corners of one vertex with different tangents become
//! vertices of their own.

use glam::Vec3;

/// A tangent and its handedness for every corner; `None` when there is nothing to compute.
pub(super) fn corner_tangents(
    triangles: &[[u32; 3]],
    positions: &[Vec3],
    normals: &[Vec3],
    uvs: &[[f32; 2]],
) -> Option<Vec<[[f32; 4]; 3]>> {
    let mut geometry = Corners { triangles, positions, normals, uvs, tangents: vec![[[0.0; 4]; 3]; triangles.len()] };
    if triangles.is_empty() || !mikktspace::generate_tangents(&mut geometry) {
        return None;
    }
    let mut tangents = geometry.tangents;
    for (triangle, corners) in triangles.iter().zip(&mut tangents) {
        for (vertex, tangent) in triangle.iter().zip(corners) {
            *tangent = repaired(*tangent, normals[*vertex as usize]);
        }
    }
    Some(tangents)
}

/// A unit tangent with handedness of exactly 1 or -1; where there is none (degenerate UVs), any direction across the
/// normal.
pub(super) fn repaired(tangent: [f32; 4], normal: Vec3) -> [f32; 4] {
    let handedness = if tangent[3] < 0.0 { -1.0 } else { 1.0 };
    let direction = Vec3::new(tangent[0], tangent[1], tangent[2]);
    let unit = direction.try_normalize().unwrap_or_else(|| normal.any_orthonormal_vector());
    [unit.x, unit.y, unit.z, handedness]
}

struct Corners<'a> {
    triangles: &'a [[u32; 3]],
    positions: &'a [Vec3],
    normals: &'a [Vec3],
    uvs: &'a [[f32; 2]],
    tangents: Vec<[[f32; 4]; 3]>,
}

impl Corners<'_> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.triangles[face][corner] as usize
    }
}

impl mikktspace::Geometry for Corners<'_> {
    fn num_faces(&self) -> usize {
        self.triangles.len()
    }

    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }

    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        self.positions[self.vertex(face, corner)].into()
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        self.normals[self.vertex(face, corner)].into()
    }

    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        // MikkTSpace thinks of v as pointing up, glTF of v as pointing down.
        let [u, v] = self.uvs[self.vertex(face, corner)];
        [u, 1.0 - v]
    }

    fn set_tangent_encoded(&mut self, tangent: [f32; 4], face: usize, corner: usize) {
        self.tangents[face][corner] = tangent;
    }
}
