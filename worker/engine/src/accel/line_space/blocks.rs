//! Blocks of sixteen classes, packed: what the finest level of a [`ClassTree`](super::ClassTree) consists of.
//!
//! Silhouettes cross blocks in few ways, so a block takes a byte when it is one of those that occur most. Of the others most know only
//! two classes, MIXED and one more: a bit for each shaft. What is left takes two bits for each.

use std::collections::HashMap;

use super::classes::{CODES, Class};

/// Blocks of which one number knows what is in front of them: with it 32 bytes, half a cache line.
const GROUP: usize = 28;

/// Codes of blocks that stand in [`PackedBlocks::rest`]; lower ones are places in the table.
const EMPTY_OR_MIXED: u8 = 253;
const OPAQUE_OR_MIXED: u8 = 254;
const ANY: u8 = 255;

/// Low bit of each class in a block.
const LOW: u32 = 0x5555_5555;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PackedBlocks {
    count: usize,
    groups: Vec<Group>,
    /// The blocks that save most by standing here.
    table: Vec<u32>,
    /// One entry of a block of two classes, two of any other, the low half first.
    rest: Vec<u16>,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Group {
    /// Entries of the rest that belong to blocks in front of the group.
    before: u32,
    codes: [u8; GROUP],
}

impl PackedBlocks {
    pub(super) fn new(blocks: &[u32]) -> Self {
        let mut counts: HashMap<u32, usize> = HashMap::new();
        for &block in blocks {
            *counts.entry(block).or_default() += 1;
        }
        let spared = |&(block, count): &(u32, usize)| (count * 2 * entries(code_of(block))).saturating_sub(4);
        let mut by_gain: Vec<(u32, usize)> = counts.into_iter().filter(|known| spared(known) > 0).collect();
        by_gain.sort_unstable_by(|a, b| spared(b).cmp(&spared(a)).then(a.0.cmp(&b.0)));
        by_gain.truncate(usize::from(EMPTY_OR_MIXED));
        let table: Vec<u32> = by_gain.into_iter().map(|(block, _)| block).collect();
        let places: HashMap<u32, u8> = table.iter().copied().zip(0..).collect();
        let mut rest = Vec::new();
        let groups = blocks.chunks(GROUP).map(|chunk| {
            let mut group = Group { before: rest.len() as u32, codes: [0; GROUP] };
            for (code, &block) in group.codes.iter_mut().zip(chunk) {
                *code = places.get(&block).copied().unwrap_or_else(|| code_of(block));
                match *code {
                    EMPTY_OR_MIXED | OPAQUE_OR_MIXED => rest.push(is_mixed(block)),
                    ANY => rest.extend([block as u16, (block >> 16) as u16]),
                    _ => {}
                }
            }
            group
        });
        let groups = groups.collect();
        Self { count: blocks.len(), groups, table, rest }
    }

    /// The class of number `slot` in block `at`.
    #[inline]
    pub(super) fn class(&self, at: usize, slot: usize) -> Class {
        let group = &self.groups[at / GROUP];
        let code = group.codes[at % GROUP];
        if let Some(&block) = self.table.get(usize::from(code)) {
            return Class::from_code(block >> (2 * slot) & 3);
        }
        let entry = self.entry_of(group, at % GROUP);
        let other = match code {
            EMPTY_OR_MIXED => Class::Empty,
            OPAQUE_OR_MIXED => Class::Opaque,
            _ => return Class::from_code(u32::from(self.rest[entry + slot / 8]) >> (2 * (slot % 8)) & 3),
        };
        if self.rest[entry] >> slot & 1 == 1 { Class::Mixed } else { other }
    }

    /// The blocks as they were.
    pub(super) fn unpacked(&self) -> Vec<u32> {
        let block = |at: usize| (0..CODES).fold(0, |block, slot| block | (self.class(at, slot) as u32) << (2 * slot));
        (0..self.count).map(block).collect()
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.groups.as_slice()) + size_of_val(self.table.as_slice()) + size_of_val(self.rest.as_slice())
    }

    /// Where a block's entries in the rest begin.
    fn entry_of(&self, group: &Group, within: usize) -> usize {
        group.before as usize + group.codes[..within].iter().map(|&code| entries(code)).sum::<usize>()
    }
}

/// How a block is stored that is not in the table.
fn code_of(block: u32) -> u8 {
    let (has_opaque, has_empty) = (block & LOW != 0, (block | block >> 1) & LOW != LOW);
    match (has_empty, has_opaque) {
        (_, false) => EMPTY_OR_MIXED,
        (false, true) => OPAQUE_OR_MIXED,
        (true, true) => ANY,
    }
}

/// Entries of the rest that a block with this code has.
fn entries(code: u8) -> usize {
    match code {
        EMPTY_OR_MIXED | OPAQUE_OR_MIXED => 1,
        ANY => 2,
        _ => 0,
    }
}

/// A bit for each shaft of a block: whether it is MIXED.
fn is_mixed(block: u32) -> u16 {
    (0..CODES).fold(0, |bits, slot| bits | ((block >> (2 * slot + 1) & 1) as u16) << slot)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of random classes among the first `classes` of an order.
    fn random(count: usize, order: [u32; 3], classes: u64, seed: u64) -> Vec<u32> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            state >> 33
        };
        (0..count).map(|_| (0..CODES).fold(0, |b, slot| b | order[(next() % classes) as usize] << (2 * slot))).collect()
    }

    #[test]
    fn blocks_of_every_kind_come_back_and_common_ones_take_a_byte() {
        let (empty, opaque, mixed) = (Class::Empty as u32, Class::Opaque as u32, Class::Mixed as u32);
        let few = random(7, [empty, opaque, mixed], 3, 1);
        let common: Vec<u32> = (0..10_000).map(|i| few[i * i % 7]).collect();
        let two = random(1000, [empty, mixed, opaque], 2, 2);
        let other_two = random(1000, [opaque, mixed, empty], 2, 3);
        let any = random(1000, [empty, mixed, opaque], 3, 4);
        let all = [common.clone(), two.clone(), other_two.clone(), any.clone()].concat();
        for blocks in [vec![], vec![0], vec![LOW], vec![LOW << 1], common.clone(), two.clone(), other_two, any, all] {
            let packed = PackedBlocks::new(&blocks);
            assert_eq!(packed.unpacked(), blocks);
        }
        let each = |blocks: &[u32]| PackedBlocks::new(blocks).bytes() as f64 / blocks.len() as f64;
        assert!(each(&common) < 1.2 && each(&two) < 3.3, "{} {}", each(&common), each(&two));
    }
}
