//! The stored form of a mesh's BVH: the binary tree, and what its nodes are to become in the wide ones. That takes little
//! to read; a wide tree itself would be twice as much.
//!
//! Behind the [common header](super::stored): nodes (32 bytes each), primitive numbers (4 bytes each), roles (1 byte for
//! each node, four in a word, the first in the lowest byte; bits 0 and 1 for the CPU's tree, 2 and 3 for the GPU's).

use rayon::prelude::*;

use super::Roles;
use super::bvh2::{Bvh2, Bvh2Node};
use super::stored::{Reader, Writer};
use super::wide::Role;
use crate::scene::{Mesh, MeshHash};

const MAGIC: &[u8; 8] = b"LSHTBVH2";

pub(super) fn encode(mesh: MeshHash, bvh2: &Bvh2, roles: &Roles) -> Vec<u8> {
    let mut writer = Writer::new(MAGIC, mesh, bvh2.bytes() + roles.cpu.len() + 32);
    writer.array(&bvh2.nodes);
    writer.array(&bvh2.primitives);
    let bytes: Vec<u8> = roles.cpu.iter().zip(&roles.gpu).map(|(&cpu, &gpu)| cpu as u8 | (gpu as u8) << 2).collect();
    let packed: Vec<u32> =
        bytes.chunks(4).map(|four| four.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte))).collect();
    writer.array(&packed);
    writer.finish()
}

/// A tree in which every index is in range and every box finite and inside its parent's; and its nodes' roles, which
/// may still contradict each other.
pub(super) fn decode(bytes: &[u8], mesh: &Mesh) -> Result<(Bvh2, Roles), String> {
    let mut reader = Reader::open(bytes, MAGIC, mesh)?;
    let nodes: Vec<Bvh2Node> = reader.array()?;
    let primitives: Vec<u32> = reader.array()?;
    let packed: Vec<u32> = reader.array()?;
    reader.finish()?;
    if packed.len() != nodes.len().div_ceil(4) {
        return Err(format!("{} words of roles for {} nodes", packed.len(), nodes.len()));
    }
    let bvh2 = Bvh2 { nodes, primitives };
    let (topology, boxes) = rayon::join(|| bvh2.check_topology(mesh.primitive_count()), || bvh2.check_boxes());
    topology.and(boxes)?;
    let roles: Option<(Vec<Role>, Vec<Role>)> = (0..bvh2.nodes.len())
        .into_par_iter()
        .with_min_len(4096)
        .map(|node| {
            let byte = packed[node / 4].to_le_bytes()[node % 4];
            Role::from_bits(byte & 3).zip(Role::from_bits(byte >> 2))
        })
        .collect();
    let (cpu, gpu) = roles.ok_or("a node has an unknown role")?;
    Ok((bvh2, Roles { cpu, gpu }))
}
