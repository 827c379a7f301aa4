//! What a Line Space is to hold, and how it is to be built.

use super::bits::{BinaryShafts, Coverage, SparseCandidates};
use super::classes::ClassTable;
use super::layered::MAX_RESOLUTION;
use super::mask::{MAX_MASK_N, MaskAtlas};
use super::shaft::MAX_N;
use super::voxels::Voxels;

/// Finest N of the payloads whose size grows with every shaft: candidates take 126 MB there when all are filled.
const MAX_CANDIDATE_N: u32 = 32;
/// Coarsest level of a tree of classes: its 3,840 shafts take 960 bytes.
const TREE_ROOT_N: u32 = 4;

/// Parameters of a Line Space. [`Self::canonical`] is their part of the cache key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LineSpaceParams {
    /// Patches along the edge of a face, 1 to [`MAX_N`]; of a tree of classes, in its finest level.
    pub n: u32,
    pub payload: Payload,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Payload {
    Binary {
        builder: BinaryBuilder,
    },
    Candidates {
        pattern: CastPattern,
    },
    /// By the layered build, over `resolution` voxels along each axis: a power of two from 16 to 256.
    Classes {
        layout: ClassLayout,
        resolution: u32,
    },
    /// `bits` (2 to 8) for each shaft, from `rays` (1 to 1024) lines.
    Coverage {
        bits: u32,
        rays: u32,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BinaryBuilder {
    /// Conservative. N up to [`MAX_MASK_N`], for its atlas grows with N^7.
    Masking,
    /// Conservative, and exact but for the growth of shafts. Slow.
    Clipping,
    /// Not conservative.
    Casting(CastPattern),
}

/// Which lines of a shaft are cast.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CastPattern {
    /// From centre to centre.
    Centre,
    /// That one, and where it misses its eight neighbours in a 3 x 3 pattern.
    Nine,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ClassLayout {
    /// Two bits for each shaft: one load.
    Table,
    /// N = 4, 8, 16, 32, and only what is undecided is refined: up to four dependent loads, and a fraction of the bytes.
    Tree,
}

impl LineSpaceParams {
    /// The hierarchical classes that [`SceneAccel`](crate::accel::SceneAccel) is meant to be gated with.
    pub const DEFAULT_CLASSES: Self =
        Self { n: 16, payload: Payload::Classes { layout: ClassLayout::Tree, resolution: 128 } };

    /// E.g. `n=16,payload=classes,builder=layered,layout=tree,resolution=128`.
    pub fn canonical(&self) -> String {
        let pattern = |pattern| match pattern {
            CastPattern::Centre => "centre",
            CastPattern::Nine => "nine",
        };
        let payload = match self.payload {
            Payload::Binary { builder } => match builder {
                BinaryBuilder::Masking => "binary,builder=masking".to_owned(),
                BinaryBuilder::Clipping => "binary,builder=clipping".to_owned(),
                BinaryBuilder::Casting(cast) => format!("binary,builder=casting,rays={}", pattern(cast)),
            },
            Payload::Candidates { pattern: cast } => format!("candidates,builder=casting,rays={}", pattern(cast)),
            Payload::Classes { layout, resolution } => {
                let layout = match layout {
                    ClassLayout::Table => "table",
                    ClassLayout::Tree => "tree",
                };
                format!("classes,builder=layered,layout={layout},resolution={resolution}")
            }
            Payload::Coverage { bits, rays } => format!("coverage,builder=casting,bits={bits},rays={rays}"),
        };
        format!("n={},payload={payload}", self.n)
    }

    /// The same with half as many patches along an edge, if that can be.
    pub fn coarser(&self) -> Option<Self> {
        let coarser = Self { n: self.n / 2, ..*self };
        coarser.check().is_ok().then_some(coarser)
    }

    /// Says which parameter is out of range, and what would be right.
    pub fn check(&self) -> Result<(), String> {
        let range = |name: &str, value: u32, least: u32, most: u32| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(format!("line_space.{name} is {value}; it must be from {least} to {most}"))
            }
        };
        range("n", self.n, 1, MAX_N)?;
        match self.payload {
            Payload::Binary { builder: BinaryBuilder::Masking } => range("n (with masking)", self.n, 1, MAX_MASK_N),
            Payload::Binary { .. } => Ok(()),
            Payload::Candidates { .. } => range("n (with candidates)", self.n, 1, MAX_CANDIDATE_N),
            Payload::Classes { layout, resolution } => {
                range("resolution", resolution, 16, MAX_RESOLUTION)?;
                if !resolution.is_power_of_two() {
                    return Err(format!("line_space.resolution is {resolution}; it must be a power of two"));
                }
                if layout == ClassLayout::Tree && !(self.n.is_power_of_two() && self.n >= TREE_ROOT_N) {
                    return Err(format!("line_space.n is {}; a tree of classes has 4, 8, 16 or 32", self.n));
                }
                Ok(())
            }
            Payload::Coverage { bits, rays } => {
                range("bits", bits, 2, 8)?;
                range("rays", rays, 1, 1024)
            }
        }
    }

    /// Whether what it says of a shaft holds for all lines of it.
    pub fn is_conservative(&self) -> bool {
        match self.payload {
            Payload::Classes { .. } => true,
            Payload::Binary { builder: BinaryBuilder::Masking | BinaryBuilder::Clipping } => true,
            Payload::Binary { builder: BinaryBuilder::Casting(_) }
            | Payload::Candidates { .. }
            | Payload::Coverage { .. } => false,
        }
    }

    /// Levels of classes below the coarsest one. A table is made from a tree too, so that both give the same answers.
    pub(crate) fn class_levels(&self) -> u32 {
        if self.n.is_multiple_of(TREE_ROOT_N) { (self.n / TREE_ROOT_N).trailing_zeros() } else { 0 }
    }

    /// Bytes of the Line Space when it is largest; exact for a table, and for all binary payloads.
    pub fn bytes_at_most(&self) -> u64 {
        match self.payload {
            Payload::Binary { .. } => BinaryShafts::bytes_needed(self.n),
            Payload::Candidates { .. } => SparseCandidates::bytes_needed_at_most(self.n),
            Payload::Classes { layout: ClassLayout::Table, .. } => ClassTable::bytes_needed(self.n),
            Payload::Classes { layout: ClassLayout::Tree, .. } => {
                let levels = 0..=self.class_levels();
                levels.map(|level| ClassTable::bytes_needed(self.n >> level) * 4 / 3 + 16).sum()
            }
            Payload::Coverage { bits, .. } => Coverage::bytes_needed(self.n, bits),
        }
    }

    /// Memory, in bytes, that is needed while the Line Space of a mesh with so many triangles is built, beside its own.
    pub fn build_bytes(&self, triangles: usize) -> u64 {
        match self.payload {
            Payload::Binary { builder: BinaryBuilder::Masking } => 2 * MaskAtlas::bytes_needed(self.n),
            Payload::Binary { .. } | Payload::Coverage { .. } => 8 * BinaryShafts::bytes_needed(self.n),
            Payload::Candidates { .. } => 4 * super::shaft::directed_count(self.n),
            Payload::Classes { resolution, .. } => Voxels::bytes_needed(resolution, triangles) + self.bytes_at_most(),
        }
    }
}
