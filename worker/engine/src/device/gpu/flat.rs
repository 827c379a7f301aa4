//! A flat scene's one structure on the device: a BVH, or a tree of cells.
//!
//! Kernels test records of world-space primitives, which say whose they are: the instance, the primitive in its mesh, and
//! whether its hits go through the alpha filter.

use glam::Affine3A;

use super::structure::{HostStructure, MeshView, PlacementView, Walk};
use crate::accel::cells::{CellTree, MAX_LEVELS};
use crate::accel::wide::{LANES, NO_PRIMITIVE, Packet};
use crate::accel::{MeshStructure, Names, Placement, SceneAccel, Structure};
use crate::pack::NONE;

/// In a record's second element (`candidates.wgsl`).
const PRIMITIVE_SPHERE: u32 = 1;
const PRIMITIVE_FILTERED: u32 = 2;
/// Words of [`cells`]' header (`HEADER` in `traverse_cells.wgsl`, in elements of four).
const HEADER_WORDS: usize = 4 * (4 + 2 * MAX_LEVELS);
const _: () = assert!(MAX_LEVELS == 16, "the shader's header has room for as many");

/// The arrays that the kernels walk of a flat scene.
pub(super) fn of_flat(structure: &Structure, names: &Names) -> HostStructure {
    match structure {
        Structure::Bvh(_) => bvh(structure, names),
        Structure::Cells(tree) => cells(tree, names),
    }
}

/// One primitive in the first words of its record.
type Record = [[u32; 4]; 3];

fn name(record: &mut Record, flat: u32, names: &Names) {
    let (instance, primitive, filtered) = names.of_primitive(flat);
    record[0][3] = primitive;
    record[1][3] |= if filtered { PRIMITIVE_FILTERED } else { 0 };
    record[2][3] = instance;
}

/// The world-space primitives of a flat BVH, from its leaves: the flat mesh itself is not kept.
struct Primitives {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    spheres: Vec<[f32; 4]>,
}

impl Primitives {
    fn of(structure: &MeshStructure) -> Self {
        let (packets, triangle_count) = structure.packets();
        let ids = || packets.iter().flat_map(|packet| packet.ids).filter(|&id| id != NO_PRIMITIVE);
        let count = ids().max().map_or(0, |last| last as usize + 1);
        let triangles = (triangle_count as usize).min(count);
        let mut all = Self {
            positions: vec![[0.0; 3]; 3 * triangles],
            triangles: (0..triangles as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            spheres: vec![[0.0; 4]; count - triangles],
        };
        for packet in packets {
            for (lane, &id) in packet.ids.iter().enumerate().filter(|&(_, &id)| id != NO_PRIMITIVE) {
                let id = id as usize;
                match id.checked_sub(triangle_count as usize) {
                    None => all.positions[3 * id..3 * id + 3].copy_from_slice(&corners(packet, lane)),
                    Some(sphere) => all.spheres[sphere] = std::array::from_fn(|row| packet.rows[row][lane]),
                }
            }
        }
        all
    }
}

fn corners(packet: &Packet, lane: usize) -> [[f32; 3]; 3] {
    std::array::from_fn(|vertex| std::array::from_fn(|axis| packet.rows[3 * vertex + axis][lane]))
}

/// As a scene of one instance that stands where it is, with records that name others.
fn bvh(structure: &Structure, names: &Names) -> HostStructure {
    let placement = Placement { mesh: 0, transform: Affine3A::IDENTITY, filtered: false };
    let single = SceneAccel::build(vec![structure.clone()], &[placement]);
    let views: Vec<_> = structure.bvh().map(|bvh| (bvh, Primitives::of(bvh))).into_iter().collect();
    let views: Vec<_> = views
        .iter()
        .map(|(structure, all)| MeshView {
            structure,
            positions: &all.positions,
            triangles: &all.triangles,
            spheres: &all.spheres,
        })
        .collect();
    let mut host = HostStructure::wide(&single, &views, &[PlacementView::new(0, Affine3A::IDENTITY, false)]);
    for record in host.prims[HostStructure::first_record(1)..].as_chunks_mut::<3>().0 {
        let flat = record[0][3];
        name(record, flat, names);
    }
    host.walk = Walk::Flat;
    host.filtered = names.any_filtered();
    host
}

/// A header, then the words, children and lists of the tree; and its packets.
fn cells(tree: &CellTree, names: &Names) -> HostStructure {
    let arrays = tree.arrays();
    let mut nodes = vec![0_u32; HEADER_WORDS];
    nodes.extend(arrays.words.as_flattened());
    let children = nodes.len();
    nodes.extend_from_slice(arrays.children);
    let lists = nodes.len();
    nodes.extend_from_slice(arrays.lists);
    nodes.resize(nodes.len().next_multiple_of(4), 0);
    let [nx, ny, nz] = tree.dims();
    let element = |[x, y, z]: [f32; 3], w: f32| [x, y, z, w].map(f32::to_bits);
    let mut header = vec![
        [children as u32, lists as u32, tree.first_word(1) as u32, (tree.first_word(2) - tree.first_word(1)) as u32],
        [nx, ny, nz, tree.n()],
        element(tree.origin().to_array(), tree.growth()),
        [0; 4],
    ];
    header.extend(tree.level_cells().map(|edges| element(edges, 0.0)));
    header.extend((0..MAX_LEVELS).map(|level| element([0, 1, 2].map(|axis| tree.inverse_cell(level, axis)), 0.0)));
    nodes[..HEADER_WORDS].copy_from_slice(header.as_flattened());

    let mut prims = vec![[0, 0, 0, NONE]; 3 * LANES * arrays.packets.len()];
    let mut spheres = false;
    for (packet, records) in arrays.packets.iter().zip(prims.as_chunks_mut::<{ 3 * LANES }>().0) {
        let is_triangles = tree.is_triangles(packet);
        spheres |= !is_triangles;
        for (lane, record) in records.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let id = packet.ids[lane];
            if id == NO_PRIMITIVE {
                continue;
            }
            *record = if is_triangles {
                corners(packet, lane).map(|corner| element(corner, 0.0))
            } else {
                let [x, y, z, radius] = std::array::from_fn(|row| packet.rows[row][lane]);
                let mut record = [element([x, y, z], 0.0), element([radius, 0.0, 0.0], 0.0), [0; 4]];
                record[1][3] = PRIMITIVE_SPHERE;
                record
            };
            name(record, id, names);
        }
    }
    HostStructure {
        nodes,
        prims,
        stack_size: tree.levels(),
        spheres,
        filtered: names.any_filtered(),
        gated: false,
        approximate: false,
        alone: false,
        walk: Walk::Cells,
    }
}
