//! Hashes of meshes: BLAKE3 over canonical content, so that equal geometry is one mesh wherever it comes from.
//!
//! Structures are cached under this hash, across scenes and machines. It covers everything of a mesh that a structure or
//! a shader can see, and nothing else: not its name, and not its materials, which instances bring.

use super::model::{Mesh, MeshHash};

/// Domain and version: raise the number whenever the content below changes, and every cache starts anew.
const DOMAIN: &str = "lightshaft mesh v1";

/// The hash of `mesh`; its fields `hash`, `name` and `bounds` do not count.
///
/// Canonical content: each array as its length (u64) and its entries, all little-endian, floats with -0 written as +0.
pub fn mesh_hash(mesh: &Mesh) -> MeshHash {
    let mut writer =
        Writer { hasher: blake3::Hasher::new_derive_key(DOMAIN), buffer: Vec::with_capacity(BUFFER_BYTES) };
    writer.length(mesh.slots as usize);
    writer.floats(mesh.positions.len(), mesh.positions.iter().map(|position| position.to_array()));
    writer.words(mesh.triangles.len(), mesh.triangles.iter().copied());
    writer.words(mesh.triangle_slots.len(), mesh.triangle_slots.iter().map(|slot| [*slot]));
    writer.floats(mesh.normals.len(), mesh.normals.iter().map(|normal| normal.to_array()));
    writer.floats(mesh.tangents.len(), mesh.tangents.iter().copied());
    writer.floats(mesh.uv0.len(), mesh.uv0.iter().copied());
    writer.floats(mesh.uv1.len(), mesh.uv1.iter().copied());
    writer.floats(mesh.colors.len(), mesh.colors.iter().copied());
    writer.floats(
        mesh.spheres.len(),
        mesh.spheres.iter().map(|sphere| [sphere.center.x, sphere.center.y, sphere.center.z, sphere.radius]),
    );
    writer.words(mesh.spheres.len(), mesh.spheres.iter().map(|sphere| [sphere.slot]));
    writer.finish()
}

/// Large enough for BLAKE3 to use its widest SIMD, small enough for the second-level cache.
const BUFFER_BYTES: usize = 128 << 10;

struct Writer {
    hasher: blake3::Hasher,
    buffer: Vec<u8>,
}

impl Writer {
    fn length(&mut self, length: usize) {
        self.bytes(&(length as u64).to_le_bytes());
    }

    fn floats<const N: usize>(&mut self, length: usize, entries: impl Iterator<Item = [f32; N]>) {
        // Adding +0 turns -0 into +0 and leaves all else.
        self.words(length, entries.map(|entry| entry.map(|value| (value + 0.0).to_bits())));
    }

    fn words<const N: usize>(&mut self, length: usize, entries: impl Iterator<Item = [u32; N]>) {
        self.length(length);
        for entry in entries {
            self.bytes(bytemuck::cast_slice(&entry.map(u32::to_le)));
        }
    }

    #[inline]
    fn bytes(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
        if self.buffer.len() >= BUFFER_BYTES - 64 {
            self.hasher.update(&self.buffer);
            self.buffer.clear();
        }
    }

    fn finish(mut self) -> MeshHash {
        self.hasher.update(&self.buffer);
        MeshHash(*self.hasher.finalize().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::scene::model::Sphere;

    fn triangle() -> Mesh {
        Mesh::of_shapes("a", vec![Vec3::ZERO, Vec3::X, Vec3::Y], vec![[0, 1, 2]], Vec::new())
    }

    #[test]
    fn names_and_the_sign_of_zero_do_not_count() {
        let plain = triangle();
        let mut other = triangle();
        other.name = "b".into();
        other.positions[0] = Vec3::new(-0.0, 0.0, -0.0);
        assert_eq!(mesh_hash(&plain), mesh_hash(&other));
    }

    #[test]
    fn every_part_of_the_content_counts() {
        let changes: [fn(&mut Mesh); 10] = [
            |mesh| mesh.positions[0].x = 1e-30,
            |mesh| mesh.triangles[0] = [1, 2, 0],
            |mesh| mesh.triangle_slots[0] = 1,
            |mesh| mesh.normals = vec![Vec3::Z; 3],
            |mesh| mesh.tangents = vec![[1.0, 0.0, 0.0, 1.0]; 3],
            |mesh| mesh.uv0 = vec![[0.0; 2]; 3],
            |mesh| mesh.uv1 = vec![[0.0; 2]; 3],
            |mesh| mesh.colors = vec![[1.0; 4]; 3],
            |mesh| mesh.spheres = vec![Sphere { center: Vec3::ZERO, radius: 1.0, slot: 0 }],
            |mesh| mesh.slots = 2,
        ];
        let mut hashes = vec![mesh_hash(&triangle())];
        for change in changes {
            let mut mesh = triangle();
            change(&mut mesh);
            hashes.push(mesh_hash(&mesh));
        }
        let count = hashes.len();
        hashes.sort_unstable();
        hashes.dedup();
        assert_eq!(hashes.len(), count);
    }

    /// Caches on disk and in the service outlive a release: the hash of given content must not change unnoticed.
    #[test]
    fn the_hash_is_stable() {
        assert_eq!(
            mesh_hash(&triangle()).to_string(),
            "288b746909409c8594b8a10b4f070173278c073b232bfee02d24fa253ae1a96f"
        );
    }
}
