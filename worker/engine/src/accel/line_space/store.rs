//! The stored form of Line Spaces and surface shafts.
//!
//! All numbers are little-endian:
//!
//! | bytes | content |
//! |---|---|
//! | 0..8 | `LSHTLSPC` |
//! | 8..12 | [`LINE_SPACE_VERSION`] |
//! | 12..16 | length of the parameters' text |
//! | 16..48 | hash of the mesh |
//! | 48..80 | BLAKE3 of all other bytes |
//! | 80.. | the parameters' canonical text, zeros up to a multiple of 4, then arrays: length (u32) and words (u32) |
//!
//! Without arrays nothing can be said of the mesh. The grid is not stored: it follows from the mesh's box.

use super::bits::{BinaryShafts, BitSet, Coverage, SparseCandidates};
use super::classes::{ClassTable, ClassTree};
use super::shaft::directed_count;
use super::{ClassLayout, LINE_SPACE_VERSION, LineSpace, LineSpaceParams, Payload, ShaftGrid, Shafts};
use crate::accel::MeshStructure;
use crate::scene::{Mesh, MeshHash};

const MAGIC: &[u8; 8] = b"LSHTLSPC";
const CHECKSUM: std::ops::Range<usize> = 48..80;
const HEADER: usize = 80;

pub(super) fn encode(space: &LineSpace) -> Vec<u8> {
    let levels;
    let arrays: Vec<&[u32]> = match space.shafts() {
        None => vec![],
        Some(Shafts::Binary(binary)) => vec![binary.bits().words()],
        Some(Shafts::Candidates(candidates)) => vec![candidates.filled().words(), candidates.primitives()],
        Some(Shafts::Table(table)) => vec![table.words()],
        Some(Shafts::Tree(tree)) => {
            levels = tree.levels();
            levels.iter().map(Vec::as_slice).collect()
        }
        Some(Shafts::Coverage(coverage)) => vec![coverage.words()],
    };
    seal(space.mesh, &space.params.canonical(), &arrays)
}

pub(super) fn decode(
    bytes: &[u8],
    mesh: &Mesh,
    structure: &MeshStructure,
    params: &LineSpaceParams,
) -> Result<LineSpace, String> {
    params.check()?;
    let arrays = open(bytes, mesh, structure, &params.canonical())?;
    let content = match ShaftGrid::new(&structure.bvh2().bounds(), params.n) {
        None if arrays.is_empty() => None,
        None => return Err("shafts for a box that has none".into()),
        Some(grid) => Some((grid, shafts(params, arrays, mesh.primitive_count())?)),
    };
    Ok(LineSpace { mesh: mesh.hash, params: *params, content })
}

pub(super) fn shafts(
    params: &LineSpaceParams,
    arrays: Vec<Vec<u32>>,
    primitive_count: usize,
) -> Result<Shafts, String> {
    let n = params.n;
    Ok(match params.payload {
        Payload::Binary { .. } => {
            let [words] = exactly(arrays)?;
            Shafts::Binary(BinaryShafts::from_words(n, words)?)
        }
        Payload::Candidates { .. } => {
            let [filled, primitives] = exactly(arrays)?;
            let filled = BitSet::from_words(directed_count(n), filled)?;
            Shafts::Candidates(SparseCandidates::from_parts(n, filled, primitives, primitive_count)?)
        }
        Payload::Classes { layout: ClassLayout::Table, .. } => {
            let [words] = exactly(arrays)?;
            Shafts::Table(ClassTable::from_words(n, words)?)
        }
        Payload::Classes { layout: ClassLayout::Tree, .. } => {
            let levels = params.class_levels() as usize + 1;
            if arrays.len() != levels {
                return Err(format!("{} arrays, not {levels}", arrays.len()));
            }
            Shafts::Tree(ClassTree::from_levels(n >> (levels - 1), arrays)?)
        }
        Payload::Coverage { bits, .. } => {
            let [words] = exactly(arrays)?;
            Shafts::Coverage(Coverage::from_words(n, bits, words)?)
        }
    })
}

/// As many arrays as are wanted.
pub(super) fn exactly<const N: usize>(arrays: Vec<Vec<u32>>) -> Result<[Vec<u32>; N], String> {
    <[Vec<u32>; N]>::try_from(arrays).map_err(|arrays| format!("{} arrays, not {N}", arrays.len()))
}

/// Header, parameters and arrays, under a checksum.
pub(super) fn seal(mesh: MeshHash, parameters: &str, arrays: &[&[u32]]) -> Vec<u8> {
    let words: usize = arrays.iter().map(|array| array.len() + 1).sum();
    let mut bytes = Vec::with_capacity(HEADER + parameters.len() + 4 + 4 * words);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&LINE_SPACE_VERSION.to_le_bytes());
    bytes.extend_from_slice(&(parameters.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&mesh.0);
    bytes.extend_from_slice(&[0; 32]);
    bytes.extend_from_slice(parameters.as_bytes());
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    for array in arrays {
        bytes.extend_from_slice(&(array.len() as u32).to_le_bytes());
        bytes.extend(array.iter().flat_map(|word| word.to_le_bytes()));
    }
    let checksum = checksum(&bytes);
    bytes[CHECKSUM].copy_from_slice(&checksum);
    bytes
}

/// The arrays that [`seal`] wrote for this mesh and these parameters.
pub(super) fn open(
    bytes: &[u8],
    mesh: &Mesh,
    structure: &MeshStructure,
    parameters: &str,
) -> Result<Vec<Vec<u32>>, String> {
    if bytes.len() < HEADER {
        return Err(format!("{} bytes, but the header alone has {HEADER}", bytes.len()));
    }
    if &bytes[..8] != MAGIC {
        return Err("it does not begin with LSHTLSPC".into());
    }
    let version = word(&bytes[8..12]);
    if version != LINE_SPACE_VERSION {
        return Err(format!("builder version {version}, this is {LINE_SPACE_VERSION}"));
    }
    if bytes[CHECKSUM] != checksum(bytes) {
        return Err("the checksum does not match".into());
    }
    let hash = MeshHash(bytes[16..48].try_into().expect("32 bytes"));
    if hash != mesh.hash || hash != structure.mesh() {
        return Err(format!("it is for mesh {hash}, not {}", mesh.hash));
    }
    let text = bytes[HEADER..].get(..word(&bytes[12..16]) as usize).ok_or("the parameters' text is cut off")?;
    if text != parameters.as_bytes() {
        return Err(format!("it was built with {}, not {parameters}", String::from_utf8_lossy(text)));
    }
    let mut rest = bytes.get((HEADER + text.len()).next_multiple_of(4)..).ok_or("the file ends early")?;
    let mut arrays = Vec::new();
    while !rest.is_empty() {
        let (length, behind) = rest.split_at_checked(4).ok_or("an array's length is cut off")?;
        let size = word(length) as usize * 4;
        let (words, behind) =
            behind.split_at_checked(size).ok_or_else(|| format!("an array of {size} bytes is cut off"))?;
        arrays.push(words.chunks_exact(4).map(word).collect());
        rest = behind;
    }
    Ok(arrays)
}

fn word(bytes: &[u8]) -> u32 {
    u32::from_le_bytes(bytes.try_into().expect("four bytes"))
}

fn checksum(bytes: &[u8]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes[..CHECKSUM.start]);
    hasher.update_rayon(&bytes[CHECKSUM.end..]);
    *hasher.finalize().as_bytes()
}
