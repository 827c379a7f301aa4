//! The stored form of a structure: what is costly to make is stored, what is cheap is made again.
//!
//! All numbers are little-endian:
//!
//! | bytes | content |
//! |---|---|
//! | 0..8 | `LSHTBVH2` |
//! | 8..12 | [`BUILDER_VERSION`] |
//! | 12..16 | 0 |
//! | 16..48 | hash of the mesh |
//! | 48..56 | number of nodes |
//! | 56..64 | number of leaf entries |
//! | 64..96 | BLAKE3 of all other bytes |
//! | 96.. | nodes (32 bytes each), then primitive numbers (4 bytes each) |

use bytemuck::{cast_slice, cast_slice_mut};

use super::BUILDER_VERSION;
use super::bvh2::{Bvh2, Bvh2Node};
use crate::scene::{Mesh, MeshHash};

const MAGIC: &[u8; 8] = b"LSHTBVH2";
const CHECKSUM: std::ops::Range<usize> = 64..96;
const HEADER: usize = 96;

pub(super) fn encode(mesh: MeshHash, bvh2: &Bvh2) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER + bvh2.bytes());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&BUILDER_VERSION.to_le_bytes());
    bytes.extend_from_slice(&[0; 4]);
    bytes.extend_from_slice(&mesh.0);
    bytes.extend_from_slice(&(bvh2.nodes.len() as u64).to_le_bytes());
    bytes.extend_from_slice(&(bvh2.primitives.len() as u64).to_le_bytes());
    bytes.extend_from_slice(&[0; 32]);
    push_words(&mut bytes, cast_slice(&bvh2.nodes));
    push_words(&mut bytes, &bvh2.primitives);
    let checksum = checksum(&bytes);
    bytes[CHECKSUM].copy_from_slice(&checksum);
    bytes
}

pub(super) fn decode(bytes: &[u8], mesh: &Mesh) -> Result<Bvh2, String> {
    if bytes.len() < HEADER {
        return Err(format!("{} bytes, but the header alone has {HEADER}", bytes.len()));
    }
    if &bytes[..8] != MAGIC {
        return Err("it does not begin with LSHTBVH2".into());
    }
    let version = u32::from_le_bytes(array(&bytes[8..12]));
    if version != BUILDER_VERSION {
        return Err(format!("builder version {version}, this is {BUILDER_VERSION}"));
    }
    let (nodes, entries) = (u64::from_le_bytes(array(&bytes[48..56])), u64::from_le_bytes(array(&bytes[56..64])));
    let expected = u128::from(nodes) * size_of::<Bvh2Node>() as u128 + u128::from(entries) * 4 + HEADER as u128;
    if expected != bytes.len() as u128 {
        return Err(format!("{nodes} nodes and {entries} entries take {expected} bytes, not {}", bytes.len()));
    }
    if bytes[CHECKSUM] != checksum(bytes) {
        return Err("the checksum does not match".into());
    }
    let hash = MeshHash(array(&bytes[16..48]));
    if hash != mesh.hash {
        return Err(format!("it is for mesh {hash}, not {}", mesh.hash));
    }
    let (node_bytes, entry_bytes) = bytes[HEADER..].split_at(nodes as usize * size_of::<Bvh2Node>());
    let mut bvh2 =
        Bvh2 { nodes: vec![bytemuck::Zeroable::zeroed(); nodes as usize], primitives: vec![0; entries as usize] };
    read_words(node_bytes, cast_slice_mut(&mut bvh2.nodes));
    read_words(entry_bytes, &mut bvh2.primitives);
    bvh2.check_topology(mesh.primitive_count())?;
    Ok(bvh2)
}

fn checksum(bytes: &[u8]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes[..CHECKSUM.start]);
    hasher.update_rayon(&bytes[CHECKSUM.end..]);
    *hasher.finalize().as_bytes()
}

fn push_words(bytes: &mut Vec<u8>, words: &[u32]) {
    if cfg!(target_endian = "little") {
        bytes.extend_from_slice(cast_slice(words));
    } else {
        bytes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
    }
}

fn read_words(bytes: &[u8], words: &mut [u32]) {
    cast_slice_mut(words).copy_from_slice(bytes);
    if cfg!(target_endian = "big") {
        words.iter_mut().for_each(|word| *word = u32::from_le(*word));
    }
}

fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().expect("the caller takes N bytes")
}
