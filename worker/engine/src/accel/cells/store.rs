//! The stored form of a tree of cells. Packets are made again from the mesh; only who stands in them is stored.
//!
//! Behind the [common header](crate::accel::stored) stand the layout (origin, cell, dims, N, levels, growth) and the
//! arrays: words of cells, children, list entries, packets (four primitive numbers each), first nodes of the levels.

use bytemuck::Zeroable;
use glam::Vec3;
use rayon::prelude::*;

use super::{CellTree, Layout, check};
use crate::accel::stored::{Reader, Writer};
use crate::accel::wide::{LANES, NO_PRIMITIVE, Packet, set_lanes};
use crate::scene::Mesh;

const MAGIC: &[u8; 8] = b"LSHTCELL";

pub(super) fn encode(tree: &CellTree) -> Vec<u8> {
    let layout = &tree.layout;
    let ids: Vec<[u32; LANES]> = tree.packets.iter().map(|packet| packet.ids).collect();
    let mut writer = Writer::new(MAGIC, tree.mesh, tree.bytes());
    writer.words(&layout.origin.to_array().map(f32::to_bits));
    writer.words(&layout.cell.to_array().map(f32::to_bits));
    writer.words(&layout.dims);
    writer.words(&[layout.n, layout.levels, layout.growth.to_bits()]);
    writer.array(&tree.words);
    writer.array(&tree.children);
    writer.array(&tree.lists);
    writer.array(&ids);
    writer.array(&tree.level_starts);
    writer.finish()
}

pub(super) fn decode(bytes: &[u8], mesh: &Mesh) -> Result<CellTree, String> {
    let mut reader = Reader::open(bytes, MAGIC, mesh)?;
    let header: [u32; 12] = reader.words()?;
    let vector = |at: usize| Vec3::from_array(std::array::from_fn(|k| f32::from_bits(header[at + k])));
    let layout = Layout {
        origin: vector(0),
        cell: vector(3),
        dims: std::array::from_fn(|k| header[6 + k]),
        n: header[9],
        levels: header[10],
        growth: f32::from_bits(header[11]),
    };
    let words = reader.array()?;
    let (children, lists) = (reader.array()?, reader.array()?);
    let ids: Vec<[u32; LANES]> = reader.array()?;
    let level_starts = reader.array()?;
    reader.finish()?;
    if let Some(ids) = ids.iter().find(|&&ids| !check::is_packet(ids, mesh)) {
        return Err(format!("no packet holds the primitives {ids:?}"));
    }
    let fill = |ids: &[u32; LANES]| {
        let mut packet = Packet::zeroed();
        let used = ids.iter().take_while(|&&id| id != NO_PRIMITIVE);
        used.enumerate().for_each(|(lane, &primitive)| set_lanes(&mut packet, lane, primitive, mesh));
        packet
    };
    check::layout(&layout)?;
    let mut tree = CellTree::empty(mesh, layout, ids.par_iter().with_min_len(1024).map(fill).collect());
    (tree.words, tree.children, tree.lists, tree.level_starts) = (words, children, lists, level_starts);
    check::structure(&tree)?;
    Ok(tree)
}
