//! Whether a tree of cells is what a walk relies on, and holds what it should.

use super::{CellTree, LAST, LEAF, Layout, MAX_DIM, MAX_LEVELS};
use crate::accel::build::primitive_bounds;
use crate::accel::wide::{LANES, NO_PRIMITIVE};
use crate::scene::Mesh;

/// Numbers that a tree can have.
pub(super) fn layout(layout: &Layout) -> Result<(), String> {
    let sound = layout.origin.is_finite()
        && layout.cell.is_finite()
        && layout.cell.min_element() > 0.0
        && layout.growth > 0.0
        && layout.growth.is_finite()
        && layout.dims.iter().all(|&dim| (1..=MAX_DIM).contains(&dim))
        && (1..=16).contains(&layout.n)
        && (1..=MAX_LEVELS as u32).contains(&layout.levels);
    let cells: u64 = layout.dims.iter().map(|&dim| u64::from(dim)).product();
    if !sound || cells >= 1 << 31 {
        return Err(format!("unsound layout {layout:?}"));
    }
    let finest = u64::from(layout.n).saturating_pow(layout.levels - 1);
    if layout.dims.iter().any(|&dim| u64::from(dim).saturating_mul(finest) > 1 << 24) {
        return Err(format!("cells of {layout:?} cannot be counted in a float"));
    }
    Ok(())
}

/// All indices in range, nodes in their order, lists that end. The layout must be sound; packets are not looked at.
pub(super) fn structure(tree: &CellTree) -> Result<(), String> {
    let layout = &tree.layout;
    if tree.levels() > layout.levels || tree.level_starts.get(..2) != Some(&[0, 1]) {
        return Err(format!("the levels of at most {} begin with the nodes {:?}", layout.levels, tree.level_starts));
    }
    let words = layout.node_words(0) + (tree.node_count() - 1) * layout.node_words(1);
    if words != tree.words.len() {
        return Err(format!("{} words of cells for {} nodes", tree.words.len(), tree.node_count()));
    }
    let mut next_node = 1;
    let mut next_place = 0_u64;
    for level in 0..tree.levels() {
        let nodes = tree.level_starts[level as usize]..next_node;
        if nodes.is_empty() || tree.level_starts[level as usize + 1] != nodes.end {
            return Err(format!("level {level} does not have the nodes {nodes:?}"));
        }
        let cells: u64 = layout.node_dims(level).iter().map(|&dim| u64::from(dim)).product();
        for node in nodes {
            let first = layout.first_word(node);
            for (number, &[bits, place]) in tree.words[first..first + layout.node_words(level)].iter().enumerate() {
                let unused = cells - 32 * number as u64;
                if u64::from(place) != next_place || (unused < 32 && bits >> unused != 0) {
                    return Err(format!("node {node} has a wrong word of cells {number}"));
                }
                next_place += u64::from(bits.count_ones());
                let Some(children) = tree.children.get(place as usize..next_place as usize) else {
                    return Err(format!("node {node} has more children than there are"));
                };
                for &child in children {
                    if child & LEAF != 0 {
                        if (child & !LEAF) as usize >= tree.lists.len() {
                            return Err(format!("node {node} has a leaf behind the last list"));
                        }
                    } else if child != next_node || level + 1 == tree.levels() {
                        return Err(format!("node {node} has the child {child}, not {next_node}"));
                    } else {
                        next_node += 1;
                    }
                }
            }
        }
    }
    if next_place != tree.children.len() as u64 || next_node as usize != tree.node_count() {
        return Err("the tree ends early".into());
    }
    if tree.lists.last().is_some_and(|last| last & LAST == 0) {
        return Err("the last list does not end".into());
    }
    match tree.lists.iter().find(|&&entry| (entry & !LAST) as usize >= tree.packets.len()) {
        Some(entry) => Err(format!("packet {} of {}", entry & !LAST, tree.packets.len())),
        None => Ok(()),
    }
}

/// Each primitive that a ray can hit stands in a packet, and that is listed in each cell that the primitive meets.
pub(super) fn coverage(tree: &CellTree, mesh: &Mesh) -> Result<(), String> {
    if tree.mesh != mesh.hash {
        return Err(format!("the structure is for mesh {}, not {}", tree.mesh, mesh.hash));
    }
    let mut packet_of = vec![NO_PRIMITIVE; mesh.primitive_count()];
    for (number, packet) in (0_u32..).zip(&tree.packets) {
        for &id in packet.ids.iter().filter(|&&id| id != NO_PRIMITIVE) {
            *packet_of.get_mut(id as usize).ok_or_else(|| format!("packet {number} holds primitive {id}"))? = number;
        }
    }
    for (primitive, &packet) in packet_of.iter().enumerate() {
        let bounds = primitive_bounds(mesh, primitive);
        if !(bounds.min.is_finite() && bounds.max.is_finite()) {
            continue;
        }
        if packet == NO_PRIMITIVE {
            return Err(format!("primitive {primitive} is in no packet"));
        }
        if !is_listed(tree, mesh, primitive, packet, 0, 0, [0; 3]) {
            return Err(format!("primitive {primitive} meets a cell that does not list it"));
        }
    }
    Ok(())
}

/// Whether the packet is listed in all leaves below `node` that the primitive meets; and it meets one at least.
fn is_listed(
    tree: &CellTree,
    mesh: &Mesh,
    primitive: usize,
    packet: u32,
    level: u32,
    node: u32,
    first_cell: [u32; 3],
) -> bool {
    let layout = &tree.layout;
    let [nx, ny, _] = layout.node_dims(level);
    let mut met = 0;
    let mut listed = 0;
    layout.lattice(level).primitive_cells(mesh, primitive, layout.node_cells(level, first_cell), |cell| {
        met += 1;
        let [x, y, z] = std::array::from_fn(|k| cell[k] - first_cell[k]);
        let Some(child) = tree.child(layout.first_word(node), ((z * ny + y) * nx + x) as usize) else { return };
        let is_inside = if child & LEAF == 0 {
            // A primitive that just comes near the cell may meet none of its cells.
            let below = cell.map(|at| at * layout.n);
            is_listed(tree, mesh, primitive, packet, level + 1, child, below)
        } else {
            tree.list((child & !LEAF) as usize).any(|entry| entry == packet)
        };
        listed += usize::from(is_inside);
    });
    met == listed && (met > 0 || level > 0)
}

/// Whether a packet is one that the builder could have made: its used lanes first, all of one kind.
pub(super) fn is_packet(ids: [u32; LANES], mesh: &Mesh) -> bool {
    let used = ids.iter().take_while(|&&id| id != NO_PRIMITIVE).count();
    let is_sphere = |id: u32| id as usize >= mesh.triangles.len();
    used > 0
        && ids[used..].iter().all(|&id| id == NO_PRIMITIVE)
        && ids[..used].iter().all(|&id| (id as usize) < mesh.primitive_count() && is_sphere(id) == is_sphere(ids[0]))
}
