//! The tri-state payload: what is proven of all lines of a shaft (beyond Keul, whose payload says empty or not; the
//! three classes are those of Billen and Dutré 2016, "Line space gathering", KU Leuven CW 695).
//!
//! [`ClassTable`] stores two bits for each shaft. [`ClassTree`] stores the same answers hierarchically: shafts of a
//! coarse subdivision, and only where those are undecided their sixteen children (each patch is cut in four), and so
//! on. It grows with the silhouettes of a mesh instead of N^4.

use super::Patch;
use super::blocks::{Around, PackedBlocks};
use super::shaft::symmetric_index;

/// What holds for every line of a shaft. All that concerns lines holds for both directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Class {
    /// No line of the shaft meets the mesh.
    Empty = 0,
    /// Every line of the shaft meets the mesh between the two patches.
    Opaque = 1,
    /// Not decided.
    Mixed = 2,
}

impl Class {
    const ALL: [Self; 3] = [Self::Empty, Self::Opaque, Self::Mixed];

    /// None for a number that stands for no class.
    pub(crate) fn of_code(code: u32) -> Option<Self> {
        Self::ALL.get(code as usize).copied()
    }

    pub(super) fn from_code(code: u32) -> Self {
        Self::ALL[code as usize]
    }
}

/// Codes in a word.
pub(super) const CODES: usize = 16;
/// In a [`ClassTree`]: undecided, and the next level knows more.
pub(super) const SPLIT: u32 = 3;
/// A block in which nothing is decided: its parent says as much.
pub(super) const ALL_MIXED: u32 = 0xaaaa_aaaa;

/// Class of every symmetric shaft, two bits each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClassTable {
    n: u32,
    words: Vec<u32>,
}

impl ClassTable {
    /// Bytes of a table for `n`.
    pub fn bytes_needed(n: u32) -> u64 {
        super::shaft::symmetric_count(n).div_ceil(CODES as u64) * 4
    }

    pub(super) fn from_fn(n: u32, class: impl Fn(u32) -> Class) -> Self {
        let count = super::shaft::symmetric_count(n) as u32;
        let mut words = vec![0; (count as usize).div_ceil(CODES)];
        for index in 0..count {
            words[index as usize / CODES] |= (class(index) as u32) << (2 * (index as usize % CODES));
        }
        Self { n, words }
    }

    pub(super) fn from_words(n: u32, words: Vec<u32>) -> Result<Self, String> {
        let table = Self { n, words };
        if table.bytes() as u64 != Self::bytes_needed(n) {
            return Err(format!("{} bytes of classes, not {}", table.bytes(), Self::bytes_needed(n)));
        }
        match table.words.iter().position(|&word| splits(word) != 0) {
            Some(word) => Err(format!("word {word} has a code that is not a class")),
            None => Ok(table),
        }
    }

    pub(crate) fn words(&self) -> &[u32] {
        &self.words
    }

    /// The class of the shaft between two patches on different faces.
    #[inline]
    pub fn class(&self, a: Patch, b: Patch) -> Class {
        let index = symmetric_index(self.n, a, b) as usize;
        Class::from_code(self.words[index / CODES] >> (2 * (index % CODES)) & 3)
    }

    pub fn bytes(&self) -> usize {
        size_of_val(self.words.as_slice())
    }
}

/// Words of a level of which one prefix knows the rank, in front of them: 64 bytes, a cache line.
const GROUP: usize = 15;
/// Of these the prefix knows the splits apart, in its low byte: what is counted on a look-up is never more than half of a group.
const HALF_GROUP: usize = 8;
/// The same for shaders, which load 16 bytes at once.
const QUAD: usize = 3;

/// Classes of shafts in levels of doubling N.
///
/// A level consists of blocks, one word each, of sixteen codes. In level 0 they follow the shafts' numbers; in the next
/// ones, block `i` belongs to the `i`-th split code of the level above, and code `8 av + 4 au + 2 bv + bu` in it to the
/// child with these lowest bits of the patches' coordinates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClassTree {
    root_n: u32,
    /// Split codes in front of the group (24 bits, for there are at most 15 * 16^4 of them) and in its first half (8 bits), then
    /// [`GROUP`] blocks.
    inner: Vec<Vec<[u32; 1 + GROUP]>>,
    /// The finest level has no splits, and most of the blocks.
    last: PackedBlocks,
}

impl ClassTree {
    /// From the blocks of each level, the coarsest first; there is at least one.
    ///
    /// # Errors
    /// When the levels do not fit each other.
    pub(super) fn from_levels(root_n: u32, mut levels: Vec<Vec<u32>>) -> Result<Self, String> {
        let Some(last) = levels.pop() else { return Err("a tree of classes without a level".into()) };
        let mut expected = (super::shaft::symmetric_count(root_n) as usize).div_ceil(CODES);
        for (level, blocks) in levels.iter().chain([&last]).enumerate() {
            if blocks.len() != expected {
                return Err(format!("level {level} of the classes has {} blocks, not {expected}", blocks.len()));
            }
            expected = blocks.iter().map(|&block| splits(block).count_ones() as usize).sum();
        }
        if expected != 0 {
            return Err("the finest level of the classes is split".into());
        }
        let around = levels.last().map_or(vec![Around::default(); last.len()], |parents| around_each(parents));
        let inner = levels.iter().map(|blocks| grouped(blocks)).collect();
        Ok(Self { root_n, inner, last: PackedBlocks::new(&last, &around) })
    }

    /// From the classes of all shafts of the coarsest level by their number, then level by level of the sixteen children of each
    /// shaft that is MIXED in the level above, in the order of those and of [`Self::children`].
    ///
    /// # Errors
    /// When the levels do not fit each other.
    pub(crate) fn from_classes(root_n: u32, levels: &[Vec<Class>]) -> Result<Self, String> {
        let mut words: Vec<Vec<u32>> = Vec::with_capacity(levels.len());
        // For each block of the level below, whether it says more than its parent.
        let mut says_more: Vec<bool> = Vec::new();
        for classes in levels.iter().rev() {
            let mut below = says_more.into_iter();
            let mut code = |class: &Class| match class {
                Class::Mixed if below.next().unwrap_or(false) => SPLIT,
                class => *class as u32,
            };
            let block =
                |block: &[Class]| (0..).zip(block).fold(0, |word, (slot, class)| word | code(class) << (2 * slot));
            let blocks: Vec<u32> = classes.chunks(CODES).map(block).collect();
            says_more = blocks.iter().map(|&word| word != ALL_MIXED).collect();
            words.push(blocks);
        }
        words.reverse();
        words[1..].iter_mut().for_each(|blocks| blocks.retain(|&word| word != ALL_MIXED));
        Self::from_levels(root_n, words)
    }

    /// The shafts that halving both patches of one makes, in the order in which a block has them.
    pub(crate) fn children(a: Patch, b: Patch) -> [(Patch, Patch); CODES] {
        let quarter = |patch: Patch, bits: usize| Patch {
            u: 2 * patch.u + (bits & 1) as u32,
            v: 2 * patch.v + (bits >> 1 & 1) as u32,
            ..patch
        };
        std::array::from_fn(|child| (quarter(a, child >> 2), quarter(b, child)))
    }

    /// The blocks of each level, the coarsest first.
    pub(super) fn levels(&self) -> Vec<Vec<u32>> {
        let mut counts = vec![(super::shaft::symmetric_count(self.root_n) as usize).div_ceil(CODES)];
        let mut levels = Vec::with_capacity(self.inner.len() + 1);
        for groups in &self.inner {
            let count = counts[levels.len()];
            let blocks: Vec<u32> = groups.iter().flat_map(|group| group[1..].iter().copied()).take(count).collect();
            counts.push(blocks.iter().map(|&block| splits(block).count_ones() as usize).sum());
            levels.push(blocks);
        }
        let last = match levels.last() {
            Some(parents) => self.last.unpacked(&around_each(parents)),
            None => self.last.unpacked(&vec![Around::default(); counts[0]]),
        };
        levels.push(last);
        levels
    }

    /// For shaders, the coarsest level first: of the levels that have splits the split codes in front of [`QUAD`] blocks, then these;
    /// and the blocks of the finest level.
    pub(crate) fn quads(&self) -> (Vec<Vec<[u32; 1 + QUAD]>>, Vec<u32>) {
        let mut levels = self.levels();
        let last = levels.pop().unwrap_or_default();
        let quads = |blocks: &Vec<u32>| {
            let mut before = 0;
            let quad = |chunk: &[u32]| {
                let mut quad = [0; 1 + QUAD];
                quad[0] = before;
                quad[1..=chunk.len()].copy_from_slice(chunk);
                before += split_count(chunk);
                quad
            };
            blocks.chunks(QUAD).map(quad).collect()
        };
        (levels.iter().map(quads).collect(), last)
    }

    /// N of the finest level.
    pub fn n(&self) -> u32 {
        self.root_n << self.inner.len()
    }

    /// N of the coarsest level.
    pub fn root_n(&self) -> u32 {
        self.root_n
    }

    /// The class of the shaft between two patches of the finest N, on different faces. One dependent load a level.
    #[inline]
    pub fn class(&self, a: Patch, b: Patch) -> Class {
        let (a, b) = if a.face < b.face { (a, b) } else { (b, a) };
        let mut shift = self.inner.len() as u32;
        let index = symmetric_index(self.root_n, a.coarser(shift), b.coarser(shift)) as usize;
        let (mut block, mut slot) = (index / CODES, index % CODES);
        let mut parent = None;
        for level in &self.inner {
            let (group, at) = (&level[block / GROUP], block % GROUP);
            let word = group[1 + at];
            let code = word >> (2 * slot) & 3;
            if code != SPLIT {
                return Class::from_code(code);
            }
            let (known, from) = if at < HALF_GROUP { (0, 0) } else { (group[0] & 0xff, HALF_GROUP) };
            let before = (group[0] >> 8) + known + split_count(&group[1 + from..=at]);
            let within = (splits(word) & ((1 << (2 * slot)) - 1)).count_ones();
            block = (before + within) as usize;
            parent = Some(word);
            shift -= 1;
            let bit = |value: u32| (value >> shift & 1) as usize;
            slot = bit(a.v) << 3 | bit(a.u) << 2 | bit(b.v) << 1 | bit(b.u);
        }
        self.last.class(block, slot, parent.map_or(Around::default(), Around::of))
    }

    pub fn bytes(&self) -> usize {
        self.inner.iter().map(|groups| size_of_val(groups.as_slice())).sum::<usize>() + self.last.bytes()
    }
}

/// The low bit of each code that is [`SPLIT`].
#[inline]
fn splits(word: u32) -> u32 {
    word & (word >> 1) & 0x5555_5555
}

fn split_count(blocks: &[u32]) -> u32 {
    blocks.iter().map(|&block| splits(block).count_ones()).sum()
}

fn grouped(blocks: &[u32]) -> Vec<[u32; 1 + GROUP]> {
    let mut before = 0;
    let group = |chunk: &[u32]| {
        let mut group = [0; 1 + GROUP];
        group[0] = before << 8 | split_count(&chunk[..chunk.len().min(HALF_GROUP)]);
        group[1..=chunk.len()].copy_from_slice(chunk);
        before += split_count(chunk);
        group
    };
    blocks.chunks(GROUP).map(group).collect()
}

/// What is around each block of the level below.
fn around_each(parents: &[u32]) -> Vec<Around> {
    let of = |&word: &u32| std::iter::repeat_n(Around::of(word), split_count(&[word]) as usize);
    parents.iter().flat_map(of).collect()
}
