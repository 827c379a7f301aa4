//! Blocks of sixteen classes, packed: what the finest level of a [`ClassTree`](super::ClassTree) consists of.
//!
//! Silhouettes cross blocks in few ways, so a block takes a byte when it is one of those that occur most. What is decided around it says
//! which these are ([`Around`]): a table for each kind of surroundings, and blocks mirrored so that the decided side is the same for all.
//! Of the others most know only two classes, MIXED and one more: a bit for each shaft. What is left takes two bits for each.

use std::collections::HashMap;

use super::classes::{CODES, Class};

/// Blocks of which one number knows what is in front of them: with it 64 bytes, a cache line.
const GROUP: usize = 60;

/// Codes of blocks that stand in [`PackedBlocks::rest`]; lower ones are places in a table.
const EMPTY_OR_MIXED: u8 = 253;
const OPAQUE_OR_MIXED: u8 = 254;
const ANY: u8 = 255;

/// Low bit of each class in a block.
const LOW: u32 = 0x5555_5555;
/// Those of the slots of which bit 0, 1, 2, 3 is set.
const UPPER: [u32; 4] = [0x4444_4444, 0x5050_5050, 0x5500_5500, 0x5555_0000];

/// What the other shafts of a block's parent, one level up, say of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Around {
    /// Whether as many are EMPTY as OPAQUE, more, or fewer.
    table: usize,
    /// Which bits of a slot turn over so that the decided ones are on the lower side.
    mirror: usize,
}

impl Around {
    const TABLES: usize = 3;

    /// Of the blocks below the split codes of `parent`.
    #[inline]
    pub(super) fn of(parent: u32) -> Self {
        let high = parent >> 1;
        let (empty, opaque) = (!(parent | high) & LOW, parent & !high & LOW);
        let (empty_count, opaque_count) = (empty.count_ones(), opaque.count_ones());
        let (table, decided, count) = match empty_count.cmp(&opaque_count) {
            std::cmp::Ordering::Equal => (0, empty, empty_count),
            std::cmp::Ordering::Greater => (1, empty, empty_count),
            std::cmp::Ordering::Less => (2, opaque, opaque_count),
        };
        let mirror =
            (0..4).fold(0, |mirror, bit| mirror | usize::from(2 * (decided & UPPER[bit]).count_ones() > count) << bit);
        Self { table, mirror }
    }

    /// The block with its slots turned over; twice gives it back.
    fn mirrored(self, block: u32) -> u32 {
        (0..CODES).fold(0, |turned, slot| turned | (block >> (2 * slot) & 3) << (2 * (slot ^ self.mirror)))
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PackedBlocks {
    groups: Vec<Group>,
    /// The blocks that save most by standing here.
    tables: [Vec<u32>; Around::TABLES],
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
    /// `around` says of each block what is around it.
    pub(super) fn new(blocks: &[u32], around: &[Around]) -> Self {
        let mut counts: [HashMap<u32, usize>; Around::TABLES] = Default::default();
        let turned: Vec<(u32, usize)> =
            blocks.iter().zip(around).map(|(&block, around)| (around.mirrored(block), around.table)).collect();
        for &(block, table) in &turned {
            *counts[table].entry(block).or_default() += 1;
        }
        let tables = counts.map(most_sparing);
        let places = tables.each_ref().map(|table| table.iter().copied().zip(0..).collect::<HashMap<u32, u8>>());
        let mut rest = Vec::new();
        let groups = turned.chunks(GROUP).map(|chunk| {
            let mut group = Group { before: rest.len() as u32, codes: [0; GROUP] };
            for (code, &(block, table)) in group.codes.iter_mut().zip(chunk) {
                *code = places[table].get(&block).copied().unwrap_or_else(|| code_of(block));
                match *code {
                    EMPTY_OR_MIXED | OPAQUE_OR_MIXED => rest.push(is_mixed(block)),
                    ANY => rest.extend([block as u16, (block >> 16) as u16]),
                    _ => {}
                }
            }
            group
        });
        let groups = groups.collect();
        Self { groups, tables, rest }
    }

    /// The class of number `slot` in block `at`.
    #[inline]
    pub(super) fn class(&self, at: usize, slot: usize, around: Around) -> Class {
        let slot = slot ^ around.mirror;
        let group = &self.groups[at / GROUP];
        let code = group.codes[at % GROUP];
        if let Some(&block) = self.tables[around.table].get(usize::from(code)) {
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
    pub(super) fn unpacked(&self, around: &[Around]) -> Vec<u32> {
        let block = |(at, &around): (usize, &Around)| {
            (0..CODES).fold(0, |block, slot| block | (self.class(at, slot, around) as u32) << (2 * slot))
        };
        around.iter().enumerate().map(block).collect()
    }

    pub(super) fn bytes(&self) -> usize {
        let tables: usize = self.tables.iter().map(|table| size_of_val(table.as_slice())).sum();
        size_of_val(self.groups.as_slice()) + tables + size_of_val(self.rest.as_slice())
    }

    /// Where a block's entries in the rest begin.
    fn entry_of(&self, group: &Group, within: usize) -> usize {
        group.before as usize + group.codes[..within].iter().map(|&code| entries(code)).sum::<usize>()
    }
}

/// The blocks that save most by standing in a table, of those that occur so often.
fn most_sparing(counts: HashMap<u32, usize>) -> Vec<u32> {
    let spared = |&(block, count): &(u32, usize)| (count * 2 * entries(code_of(block))).saturating_sub(4);
    let mut by_gain: Vec<(u32, usize)> = counts.into_iter().filter(|known| spared(known) > 0).collect();
    by_gain.sort_unstable_by(|a, b| spared(b).cmp(&spared(a)).then(a.0.cmp(&b.0)));
    by_gain.truncate(usize::from(EMPTY_OR_MIXED));
    by_gain.into_iter().map(|(block, _)| block).collect()
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

    #[test]
    fn blocks_are_mirrored_so_that_what_is_decided_is_low() {
        // EMPTY in the slots with bits 0 and 3, the others split.
        let parent = (0..CODES).fold(0, |word, slot| word | if slot & 9 == 9 { 0 } else { 3 << (2 * slot) });
        assert_eq!(Around::of(parent), Around { table: 1, mirror: 9 });
        let opaque =
            (0..CODES).fold(0, |word, slot| word | if slot & 4 == 0 { 1 << (2 * slot) } else { 3 << (2 * slot) });
        assert_eq!(Around::of(opaque), Around { table: 2, mirror: 0 });
        let block = 0x1234_5678;
        let around = Around { table: 0, mirror: 6 };
        assert!(around.mirrored(block) != block && around.mirrored(around.mirrored(block)) == block);
        assert_eq!(around.mirrored(2), 2 << 12);
    }

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
            let around: Vec<Around> = random(blocks.len(), [0, 1, 3], 3, 5).into_iter().map(Around::of).collect();
            assert_eq!(PackedBlocks::new(&blocks, &around).unpacked(&around), blocks);
        }
        let each = |blocks: &[u32]| {
            let around = vec![Around::default(); blocks.len()];
            PackedBlocks::new(blocks, &around).bytes() as f64 / blocks.len() as f64
        };
        assert!(each(&common) < 1.2 && each(&two) < 3.3, "{} {}", each(&common), each(&two));
    }
}
