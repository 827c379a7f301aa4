//! Line Spaces on the device: records that `shaders/shared/gate.wgsl` reads, and the counters of what they told.
//!
//! Records stand behind the primitives in their pool, so that a tracing stage binds no more buffers than without.

use crate::accel::line_space::{GateCounters, LineSpace, Shafts};

/// Kinds of payloads, as in `gate.wgsl`.
const CLASS_TREE: u32 = 0;
const CLASS_TABLE: u32 = 1;
const SYMMETRIC_BITS: u32 = 2;
const DIRECTED_BITS: u32 = 3;
const COVERAGE: u32 = 4;

/// Elements in front of the payload: the grid, what it is, where its parts begin.
const HEADER: usize = 4;

/// Counters that a tracing stage leaves behind a queue, and copies of them (`queue.wgsl`).
pub(super) const COUNTERS: usize = 10;
pub(super) const COPIES: usize = 32;

/// The record of a Line Space; none where nothing is known of any ray.
pub(super) fn record(space: &LineSpace) -> Option<Vec<[u32; 4]>> {
    let (grid, shafts) = (space.grid()?, space.shafts()?);
    let mut record = vec![[0; 4]; HEADER];
    let words = grid.to_words().map(f32::to_bits);
    record[0].copy_from_slice(&words[..4]);
    record[1].copy_from_slice(&words[4..]);
    let mut parts = Vec::new();
    let mut number = 0;
    let kind = match shafts {
        Shafts::Tree(tree) => {
            let (inner, last) = tree.quads();
            number = inner.len() as u32;
            for level in &inner {
                parts.push(record.len() as u32);
                record.extend_from_slice(level);
            }
            append(&mut record, &mut parts, &last);
            CLASS_TREE
        }
        Shafts::Table(table) => {
            append(&mut record, &mut parts, table.words());
            CLASS_TABLE
        }
        Shafts::Binary(binary) => {
            append(&mut record, &mut parts, binary.bits().words());
            SYMMETRIC_BITS
        }
        Shafts::Candidates(candidates) => {
            append(&mut record, &mut parts, candidates.filled().words());
            DIRECTED_BITS
        }
        Shafts::Coverage(coverage) => {
            number = coverage.bits();
            append(&mut record, &mut parts, coverage.words());
            COVERAGE
        }
    };
    record[2] = [kind, u32::from(space.params().is_conservative()), number, 0];
    record[3][..parts.len()].copy_from_slice(&parts);
    Some(record)
}

/// Appends an array of words as a part, four to an element.
fn append(record: &mut Vec<[u32; 4]>, parts: &mut Vec<u32>, words: &[u32]) {
    parts.push(record.len() as u32);
    record.extend(words.chunks(4).map(|chunk| {
        let mut element = [0; 4];
        element[..chunk.len()].copy_from_slice(chunk);
        element
    }));
}

/// From the counters in the order of `gate_tell.wgsl`. Surface shafts and nodes are asked by the CPU alone.
pub(super) fn counters(words: [u64; COUNTERS]) -> GateCounters {
    let [empty, opaque, mixed, empty_inside, opaque_inside, mixed_inside, starts_inside, approximated, beside, too_far] =
        words;
    GateCounters {
        full_chord: [empty, opaque, mixed],
        ends_inside: [empty_inside, opaque_inside, mixed_inside],
        starts_inside,
        approximated,
        beside,
        too_far,
        ..GateCounters::default()
    }
}
