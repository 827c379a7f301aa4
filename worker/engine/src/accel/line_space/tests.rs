//! Meshes for the unit tests of this module.

use glam::Vec3;

use crate::scene::Mesh;

fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Mesh {
    Mesh::of_shapes("test", positions, triangles, vec![])
}

/// The unit square at z = 0, in two triangles.
pub(super) fn quad() -> Mesh {
    mesh(vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y], vec![[0, 1, 2], [0, 2, 3]])
}

/// The unit cube, closed, with four vertices of its own on each face.
pub(super) fn cube() -> Mesh {
    let (mut positions, mut triangles) = (vec![], vec![]);
    for axis in 0..3 {
        for side in [0.0, 1.0] {
            let base = positions.len() as u32;
            for [u, v] in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
                let mut corner = Vec3::ZERO;
                (corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (side, u, v);
                positions.push(corner);
            }
            triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        }
    }
    mesh(positions, triangles)
}
