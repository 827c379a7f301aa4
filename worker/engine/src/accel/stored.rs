//! What all stored structures have in common: a header that says what it is, and a checksum.
//!
//! All numbers are little-endian:
//!
//! | bytes | content |
//! |---|---|
//! | 0..8 | which structure |
//! | 8..12 | [`BUILDER_VERSION`] |
//! | 12..16 | 0 |
//! | 16..48 | hash of the mesh |
//! | 48..80 | BLAKE3 of all other bytes |
//! | 80.. | words of 32 bits; before each array its length in elements, 64 bits |

use std::ops::Range;

use bytemuck::{Pod, cast_slice, cast_slice_mut};

use super::BUILDER_VERSION;
use super::memory::fresh;
use crate::scene::{Mesh, MeshHash};

const CHECKSUM: Range<usize> = 48..80;
const HEADER: usize = 80;

pub(super) struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    /// `capacity`: bytes behind the header, roughly.
    pub(super) fn new(magic: &[u8; 8], mesh: MeshHash, capacity: usize) -> Self {
        let mut bytes = Vec::with_capacity(HEADER + capacity);
        bytes.extend_from_slice(magic);
        bytes.extend_from_slice(&BUILDER_VERSION.to_le_bytes());
        bytes.extend_from_slice(&[0; 4]);
        bytes.extend_from_slice(&mesh.0);
        bytes.extend_from_slice(&[0; CHECKSUM.end - CHECKSUM.start]);
        Self { bytes }
    }

    pub(super) fn words(&mut self, words: &[u32]) {
        if cfg!(target_endian = "little") {
            self.bytes.extend_from_slice(cast_slice(words));
        } else {
            self.bytes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        }
    }

    /// Elements made of words of 32 bits.
    pub(super) fn array<T: Pod>(&mut self, elements: &[T]) {
        self.bytes.extend_from_slice(&(elements.len() as u64).to_le_bytes());
        self.words(cast_slice(elements));
    }

    pub(super) fn finish(mut self) -> Vec<u8> {
        let checksum = checksum(&self.bytes);
        self.bytes[CHECKSUM].copy_from_slice(&checksum);
        self.bytes
    }
}

pub(super) struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Checks everything that can be checked without knowing what is stored.
    pub(super) fn open(bytes: &'a [u8], magic: &[u8; 8], mesh: &Mesh) -> Result<Self, String> {
        if bytes.len() < HEADER {
            return Err(format!("{} bytes, but the header alone has {HEADER}", bytes.len()));
        }
        if &bytes[..8] != magic {
            return Err(format!("it does not begin with {}", String::from_utf8_lossy(magic)));
        }
        let version = u32::from_le_bytes(number(&bytes[8..12]));
        if version != BUILDER_VERSION {
            return Err(format!("builder version {version}, this is {BUILDER_VERSION}"));
        }
        if bytes[CHECKSUM] != checksum(bytes) {
            return Err("the checksum does not match".into());
        }
        let hash = MeshHash(number(&bytes[16..48]));
        if hash != mesh.hash {
            return Err(format!("it is for mesh {hash}, not {}", mesh.hash));
        }
        Ok(Self { rest: &bytes[HEADER..] })
    }

    pub(super) fn words<const N: usize>(&mut self) -> Result<[u32; N], String> {
        let mut words = [0; N];
        self.read(&mut words)?;
        Ok(words)
    }

    pub(super) fn array<T: Pod>(&mut self) -> Result<Vec<T>, String> {
        let [low, high] = self.words()?;
        let len = u64::from(low) | u64::from(high) << 32;
        if u128::from(len) * size_of::<T>() as u128 > self.rest.len() as u128 {
            return Err(format!("an array of {len} elements sticks out of the end"));
        }
        let mut elements: Vec<T> = fresh(len as usize);
        self.read(cast_slice_mut(&mut elements))?;
        Ok(elements)
    }

    /// Nothing may be left.
    pub(super) fn finish(self) -> Result<(), String> {
        if self.rest.is_empty() { Ok(()) } else { Err(format!("{} bytes too many", self.rest.len())) }
    }

    fn read(&mut self, words: &mut [u32]) -> Result<(), String> {
        let bytes: &mut [u8] = cast_slice_mut(words);
        let (read, rest) = self.rest.split_at_checked(bytes.len()).ok_or("it ends early")?;
        bytes.copy_from_slice(read);
        self.rest = rest;
        if cfg!(target_endian = "big") {
            words.iter_mut().for_each(|word| *word = u32::from_le(*word));
        }
        Ok(())
    }
}

fn checksum(bytes: &[u8]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes[..CHECKSUM.start]);
    hasher.update_rayon(&bytes[CHECKSUM.end..]);
    *hasher.finalize().as_bytes()
}

fn number<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().expect("the caller takes N bytes")
}
