//! Payloads that are bits in 32-bit words, as a device stores them.

use super::Patch;
use super::shaft::{directed_index, symmetric_index};

/// A bit for each shaft.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BitSet {
    len: u64,
    words: Vec<u32>,
}

impl BitSet {
    pub fn new(len: u64) -> Self {
        Self { len, words: vec![0; Self::words_needed(len)] }
    }

    fn words_needed(len: u64) -> usize {
        len.div_ceil(32) as usize
    }

    pub(crate) fn from_words(len: u64, words: Vec<u32>) -> Result<Self, String> {
        if words.len() != Self::words_needed(len) {
            return Err(format!("{} words for {len} bits", words.len()));
        }
        let used = len % 32;
        let rest = if used == 0 { 0 } else { words.last().map_or(0, |last| last >> used) };
        if rest != 0 {
            return Err(format!("bits are set behind the last of {len}"));
        }
        Ok(Self { len, words })
    }

    pub fn get(&self, index: u32) -> bool {
        self.words[index as usize / 32] >> (index % 32) & 1 == 1
    }

    pub fn set(&mut self, index: u32) {
        self.words[index as usize / 32] |= 1 << (index % 32);
    }

    pub fn union(&mut self, other: &[u32]) {
        self.words.iter_mut().zip(other).for_each(|(word, other)| *word |= other);
    }

    pub fn count(&self) -> u64 {
        self.words.iter().map(|word| u64::from(word.count_ones())).sum()
    }

    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Number of bits.
    pub fn len(&self) -> u64 {
        self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}

/// The binary payload (Keul 2020, chapter 4): a set bit where a symmetric shaft may not be empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BinaryShafts {
    pub(super) n: u32,
    pub(super) bits: BitSet,
}

impl BinaryShafts {
    /// From a bit for each shaft, in words.
    pub(super) fn from_words(n: u32, words: Vec<u32>) -> Result<Self, String> {
        Ok(Self { n, bits: BitSet::from_words(super::shaft::symmetric_count(n), words)? })
    }

    /// From a bit for each symmetric shaft.
    pub(crate) fn new(n: u32, bits: BitSet) -> Self {
        Self { n, bits }
    }

    /// Bytes for `n`: 15 N^4 bits in words.
    pub fn bytes_needed(n: u32) -> u64 {
        super::shaft::symmetric_count(n).div_ceil(32) * 4
    }

    /// Whether the shaft between two patches on different faces is marked.
    #[inline]
    pub fn is_marked(&self, a: Patch, b: Patch) -> bool {
        self.bits.get(symmetric_index(self.n, a, b))
    }

    pub fn bits(&self) -> &BitSet {
        &self.bits
    }
}

/// Representative candidates (Keul 2020, chapter 6): a primitive for each directed shaft, or none.
///
/// Sparse: a bit says whether a shaft has one, an offset for each word of bits where its candidates begin (section 6.3).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SparseCandidates {
    n: u32,
    filled: BitSet,
    /// Set bits in front of each word.
    offsets: Vec<u32>,
    primitives: Vec<u32>,
}

/// In the dense layout: no candidate.
pub(crate) const NO_CANDIDATE: u32 = u32::MAX;

impl SparseCandidates {
    /// Bytes for `n` when all shafts have a candidate: a bit, a 32nd of an offset, a number each.
    pub fn bytes_needed_at_most(n: u32) -> u64 {
        let shafts = super::shaft::directed_count(n);
        shafts.div_ceil(32) * 8 + shafts * 4
    }

    /// From the dense layout: one number, or [`NO_CANDIDATE`], for each directed shaft.
    pub(crate) fn from_dense(n: u32, dense: &[u32]) -> Self {
        let mut filled = BitSet::new(dense.len() as u64);
        let primitives =
            (0..).zip(dense).filter(|(_, primitive)| **primitive != NO_CANDIDATE).map(|(index, primitive)| {
                filled.set(index);
                *primitive
            });
        let primitives = primitives.collect();
        Self { n, offsets: offsets(&filled), filled, primitives }
    }

    pub(super) fn from_parts(
        n: u32,
        filled: BitSet,
        primitives: Vec<u32>,
        primitive_count: usize,
    ) -> Result<Self, String> {
        if filled.count() != primitives.len() as u64 {
            return Err(format!("{} candidates for {} shafts that have one", primitives.len(), filled.count()));
        }
        match primitives.iter().find(|&&primitive| primitive as usize >= primitive_count) {
            Some(primitive) => Err(format!("candidate {primitive} of {primitive_count} primitives")),
            None => Ok(Self { n, offsets: offsets(&filled), filled, primitives }),
        }
    }

    /// Gives each candidate another number.
    pub(super) fn renumber(&mut self, number: impl Fn(u32) -> u32) {
        self.primitives.iter_mut().for_each(|primitive| *primitive = number(*primitive));
    }

    /// The candidate of the shaft from `start` to `end`, which are on different faces.
    #[inline]
    pub fn candidate(&self, start: Patch, end: Patch) -> Option<u32> {
        let index = directed_index(self.n, start, end);
        let (word, bit) = (self.filled.words[index as usize / 32], index % 32);
        if word >> bit & 1 == 0 {
            return None;
        }
        let rank = (word & ((1 << bit) - 1)).count_ones();
        Some(self.primitives[(self.offsets[index as usize / 32] + rank) as usize])
    }

    pub fn filled(&self) -> &BitSet {
        &self.filled
    }

    /// Candidates of the filled shafts, in the order of their numbers.
    pub fn primitives(&self) -> &[u32] {
        &self.primitives
    }

    pub fn bytes(&self) -> usize {
        4 * (self.filled.words.len() + self.offsets.len() + self.primitives.len())
    }
}

fn offsets(filled: &BitSet) -> Vec<u32> {
    let mut before = 0;
    let offset = |word: &u32| {
        let offset = before;
        before += word.count_ones();
        offset
    };
    filled.words.iter().map(offset).collect()
}

/// Coverage (beyond Keul): the part of sampled lines of each symmetric shaft that is blocked, quantised.
///
/// Accepted with that probability, a hit darkens on average as much as the geometry does; one bit darkens too much.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Coverage {
    n: u32,
    /// 2 to 8; a value never spans two words.
    bits: u32,
    words: Vec<u32>,
}

impl Coverage {
    pub fn bytes_needed(n: u32, bits: u32) -> u64 {
        super::shaft::symmetric_count(n).div_ceil(u64::from(32 / bits)) * 4
    }

    /// From the blocked part of each shaft, 0 to 1. Only what is wholly free becomes 0, only what is wholly blocked 1.
    pub(super) fn from_parts(n: u32, bits: u32, parts: &[f32]) -> Self {
        let per_word = 32 / bits as usize;
        let most = (1_u32 << bits) - 1;
        let quantise = |part: f32| {
            let level = (part * most as f32).round() as u32;
            if part <= 0.0 || part >= 1.0 { level } else { level.clamp(1, most - 1) }
        };
        let word =
            |parts: &[f32]| (0..).zip(parts).fold(0, |word, (slot, &part)| word | quantise(part) << (bits * slot));
        Self { n, bits, words: parts.chunks(per_word).map(word).collect() }
    }

    pub(super) fn from_words(n: u32, bits: u32, words: Vec<u32>) -> Result<Self, String> {
        let coverage = Self { n, bits, words };
        if coverage.bytes() as u64 != Self::bytes_needed(n, bits) {
            return Err(format!("{} bytes of coverage, not {}", coverage.bytes(), Self::bytes_needed(n, bits)));
        }
        Ok(coverage)
    }

    pub(crate) fn words(&self) -> &[u32] {
        &self.words
    }

    /// The blocked part, 0 to 1, of the shaft between two patches on different faces.
    #[inline]
    pub fn blocked(&self, a: Patch, b: Patch) -> f32 {
        let per_word = 32 / self.bits;
        let index = symmetric_index(self.n, a, b);
        let most = (1_u32 << self.bits) - 1;
        let level = self.words[(index / per_word) as usize] >> (self.bits * (index % per_word)) & most;
        level as f32 / most as f32
    }

    pub fn bits(&self) -> u32 {
        self.bits
    }

    pub fn bytes(&self) -> usize {
        size_of_val(self.words.as_slice())
    }
}
