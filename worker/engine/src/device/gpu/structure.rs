//! The spatial structure on the device: one node pool and one primitive pool for the top level and all meshes.

use std::sync::{Arc, Weak};

use glam::{Affine3A, Mat3};
use rayon::prelude::*;

use super::context::Context;
use super::flat;
use super::gates;
use super::pool::{Pool, PoolLayout};
use crate::accel::compressed::{CompressedBvh, CompressedNode};
use crate::accel::line_space::LineSpace;
use crate::accel::{Bvh2, MeshStructure, SceneAccel, Structure, WeakStructure};
use crate::device::DeviceError;
use crate::pack::{INSTANCE_ALPHA, PackedInstance, PackedMesh, PackedScene};
use crate::scene::Aabb;

/// Hits of this placement go through the alpha filter (`PLACEMENT_FILTERED` in `traverse.wgsl`).
const PLACEMENT_FILTERED: u32 = 1;
const PRIMITIVE_SPHERE: u32 = 1;

/// A mesh as the structure sees it.
#[derive(Clone, Copy)]
pub struct MeshView<'a> {
    pub structure: &'a MeshStructure,
    pub positions: &'a [[f32; 3]],
    pub triangles: &'a [[u32; 3]],
    /// Centre and radius; numbered after the triangles.
    pub spheres: &'a [[f32; 4]],
}

impl<'a> MeshView<'a> {
    fn packed(scene: &'a PackedScene, mesh: &PackedMesh, structure: &'a MeshStructure) -> Self {
        Self {
            structure,
            positions: &scene.positions[mesh.position_offset as usize..],
            triangles: &scene.triangles[mesh.triangle_offset as usize..][..mesh.triangle_count as usize],
            spheres: &scene.spheres[mesh.sphere_offset as usize..][..mesh.sphere_count as usize],
        }
    }

    fn corners(&self, triangle: usize) -> [[f32; 3]; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    fn bounds(&self, primitive: u32) -> Aabb {
        let mut bounds = Aabb::EMPTY;
        match (primitive as usize).checked_sub(self.triangles.len()) {
            None => self.corners(primitive as usize).iter().for_each(|&p| bounds.grow(p.into())),
            Some(sphere) => {
                let [x, y, z, radius] = self.spheres[sphere];
                let center = glam::Vec3::new(x, y, z);
                bounds = Aabb { min: center - radius, max: center + radius };
            }
        }
        bounds
    }

    /// The kernel's record: three corners with the number and the kind, or centre and radius.
    fn record(&self, primitive: u32) -> [[u32; 4]; 3] {
        let element = |[x, y, z]: [f32; 3], word: u32| [x.to_bits(), y.to_bits(), z.to_bits(), word];
        match (primitive as usize).checked_sub(self.triangles.len()) {
            None => {
                let [a, b, c] = self.corners(primitive as usize);
                [element(a, primitive), element(b, 0), element(c, 0)]
            }
            Some(sphere) => {
                let [x, y, z, radius] = self.spheres[sphere];
                [element([x, y, z], primitive), element([radius, 0.0, 0.0], PRIMITIVE_SPHERE), [0; 4]]
            }
        }
    }
}

/// An instance as the structure sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacementView {
    pub mesh: u32,
    /// Rows of the inverse of the 3x3 part.
    pub inverse: [[f32; 3]; 3],
    /// Comes off a ray's origin before `inverse` is applied: so nothing is lost far from the world's origin.
    pub translation: [f32; 3],
    pub filtered: bool,
}

impl PlacementView {
    pub fn new(mesh: u32, object_to_world: Affine3A, filtered: bool) -> Self {
        // In f64, as the CPU's top level does.
        let columns = Mat3::from(object_to_world.matrix3).as_dmat3();
        let rows = columns.inverse().as_mat3().transpose();
        Self { mesh, inverse: rows.to_cols_array_2d(), translation: object_to_world.translation.into(), filtered }
    }

    fn packed(instance: &PackedInstance) -> Self {
        let [x, y, z] = instance.object_to_world;
        let columns = Mat3::from_cols_array_2d(&[[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]);
        let transform = Affine3A::from_mat3_translation(columns, glam::Vec3::new(x[3], y[3], z[3]));
        Self::new(instance.mesh, transform, instance.flags & INSTANCE_ALPHA != 0)
    }

    /// As `traverse.wgsl` reads it: each row with a component of the translation.
    fn rows(&self) -> [[u32; 4]; 3] {
        let row = |i: usize| {
            let [x, y, z] = self.inverse[i];
            [x, y, z, self.translation[i]].map(f32::to_bits)
        };
        [row(0), row(1), row(2)]
    }
}

/// Which kernel walks a structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Walk {
    /// `traverse.wgsl`: a top level over meshes.
    TwoLevel,
    /// `traverse.wgsl`, with primitives that name their instance.
    Flat,
    /// `traverse_cells.wgsl`.
    Cells,
}

/// Host arrays, ready for upload.
pub struct HostStructure {
    pub(super) nodes: Vec<u32>,
    /// Four elements a placement, in the top level's leaf order, then from a multiple of three on three elements a
    /// primitive, then the records of gates.
    pub(super) prims: Vec<[u32; 4]>,
    /// Stack entries that the kernel needs.
    pub stack_size: u32,
    pub spheres: bool,
    /// Some placement's hits go through the alpha filter.
    pub filtered: bool,
    /// Some mesh has a Line Space that is asked.
    pub gated: bool,
    /// Whether occlusion rays take for true what it does not prove.
    pub approximate: bool,
    /// The top level is one instance, which needs no test of its box ahead of the mesh's root.
    pub(super) alone: bool,
    pub(super) walk: Walk,
}

impl HostStructure {
    /// What the device walks of a flat scene; none of a scene of two levels.
    pub fn flat(accel: &SceneAccel) -> Option<Self> {
        Some(flat::of_flat(&accel.structures()[0], accel.names()?))
    }

    /// The compressed wide trees that `traverse.wgsl` walks, and the Line Spaces that `accel` asks. Each mesh's tree is made
    /// once and kept with its structure.
    pub fn wide(accel: &SceneAccel, meshes: &[MeshView<'_>], placements: &[PlacementView]) -> Self {
        let top = accel.compressed_top();
        let trees: Vec<&CompressedBvh> = meshes
            .par_iter()
            .with_max_len(1)
            .map(|mesh| mesh.structure.compressed(&|primitive| mesh.bounds(primitive)))
            .collect();
        let mut host = Self::empty(meshes, placements.len());
        let (mut node_count, mut prim_count) = (top.nodes.len().max(1), host.prims.len());
        let mut starts = Vec::with_capacity(trees.len());
        for tree in &trees {
            starts.push((node_count as u32, prim_count as u32 / 3));
            node_count += tree.nodes.len();
            prim_count += 3 * tree.leaves.len();
        }
        host.nodes.resize(node_count * NODE_WORDS, 0);
        host.prims.resize(prim_count, [0; 4]);
        copy_nodes(&mut host.nodes, &top, (0, 0));
        for ((tree, mesh), &(first_node, first_leaf)) in trees.iter().zip(meshes).zip(&starts) {
            copy_nodes(&mut host.nodes[first_node as usize * NODE_WORDS..], tree, (first_node, first_leaf));
            let records = host.prims[3 * first_leaf as usize..].par_chunks_exact_mut(3);
            records.zip(&tree.leaves).with_min_len(4096).for_each(|(record, &primitive)| {
                record.copy_from_slice(&mesh.record(primitive));
            });
        }
        let gates = accel.gates().asked_on_gpu();
        let roots: Vec<[u32; 2]> = starts
            .iter()
            .zip(0..)
            .map(|(&(first_node, _), mesh)| [first_node, host.push_gate(gates.get(mesh).and_then(Option::as_deref))])
            .collect();
        host.approximate = accel.gates().approximate;
        let has_root = |instance: u32| !trees[placements[instance as usize].mesh as usize].nodes.is_empty();
        host.alone = matches!(top.leaves[..], [instance] if has_root(instance));
        host.set_placements(&top.leaves, placements, &roots);
        host.stack_size = top.depth + trees.iter().map(|tree| tree.depth).max().unwrap_or(0) + 2;
        host
    }

    /// The plain binary trees of the benchmark's base kernel. Leaves of the top level must hold one instance each.
    pub fn baseline(top: &Bvh2, meshes: &[MeshView<'_>], placements: &[PlacementView]) -> Self {
        let mut host = Self::empty(meshes, placements.len());
        host.push_binary(top, 0);
        let mut roots = Vec::with_capacity(meshes.len());
        for mesh in meshes {
            roots.push([(host.nodes.len() / 8) as u32, 0]);
            host.push_binary(mesh.structure.bvh2(), (host.prims.len() / 3) as u32);
            host.prims.extend(mesh.structure.bvh2().primitives.iter().flat_map(|&primitive| mesh.record(primitive)));
        }
        host.set_placements(&top.primitives, placements, &roots);
        host.stack_size =
            binary_depth(top) + meshes.iter().map(|m| binary_depth(m.structure.bvh2())).max().unwrap_or(0) + 1;
        host
    }

    /// Where the primitives' records begin behind those of so many placements.
    pub(super) fn first_record(placements: usize) -> usize {
        (4 * placements).next_multiple_of(3)
    }

    fn empty(meshes: &[MeshView<'_>], placements: usize) -> Self {
        Self {
            nodes: Vec::new(),
            prims: vec![[0; 4]; Self::first_record(placements)],
            stack_size: 0,
            spheres: meshes.iter().any(|m| !m.spheres.is_empty()),
            filtered: false,
            gated: false,
            approximate: false,
            alone: false,
            walk: Walk::TwoLevel,
        }
    }

    /// Where the record of a mesh's gate begins; 0 without one.
    fn push_gate(&mut self, space: Option<&LineSpace>) -> u32 {
        let Some(record) = space.and_then(gates::record) else { return 0 };
        let start = self.prims.len() as u32;
        self.prims.extend(record);
        self.gated = true;
        start
    }

    fn push_binary(&mut self, tree: &Bvh2, first_leaf: u32) {
        let first_node = (self.nodes.len() / 8) as u32;
        for node in &tree.nodes {
            let mut node = *node;
            node.right_or_first += if node.count == 0 { first_node } else { first_leaf };
            self.nodes.extend_from_slice(bytemuck::cast_slice(&[node]));
        }
    }

    /// `roots`: root node and gate of each mesh.
    fn set_placements(&mut self, order: &[u32], placements: &[PlacementView], roots: &[[u32; 2]]) {
        for (record, &instance) in self.prims.chunks_exact_mut(4).zip(order) {
            let placement = &placements[instance as usize];
            let flags = if placement.filtered { PLACEMENT_FILTERED } else { 0 };
            self.filtered |= placement.filtered;
            record[..3].copy_from_slice(&placement.rows());
            let [root, gate] = roots[placement.mesh as usize];
            record[3] = [root, instance, flags, gate];
        }
    }
}

/// Words of a node.
const NODE_WORDS: usize = size_of::<CompressedNode>() / 4;

/// Writes a tree's nodes where the pools' nodes and leaf entries before it are so many.
fn copy_nodes(into: &mut [u32], tree: &CompressedBvh, (nodes, leaves): (u32, u32)) {
    into.par_chunks_exact_mut(NODE_WORDS).zip(&tree.nodes).with_min_len(4096).for_each(|(into, node)| {
        into.copy_from_slice(bytemuck::cast_slice(&[node.moved(nodes, leaves)]));
    });
}

fn binary_depth(tree: &Bvh2) -> u32 {
    let mut depths = vec![1; tree.nodes.len()];
    for (i, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.count == 0) {
        depths[i + 1] = depths[i] + 1;
        depths[node.right_or_first as usize] = depths[i] + 1;
    }
    depths.into_iter().max().unwrap_or(1)
}

/// What a structure on the device is made from: equal origins make equal structures.
pub(super) struct Origin {
    structures: Vec<WeakStructure>,
    placements: Vec<PlacementView>,
    /// Line Spaces that are asked.
    gates: Vec<Option<Weak<LineSpace>>>,
    approximate: bool,
}

impl Origin {
    pub(super) fn of(scene: &PackedScene) -> Self {
        Self {
            structures: scene.accel.structures().iter().map(Structure::downgrade).collect(),
            placements: scene.instances.iter().map(PlacementView::packed).collect(),
            gates: scene.accel.gates().asked_on_gpu().iter().map(|space| space.as_ref().map(Arc::downgrade)).collect(),
            approximate: scene.accel.gates().approximate,
        }
    }

    /// The structure of the scene that this is the origin of.
    fn layout(&self, scene: &PackedScene) -> HostStructure {
        if let Some(flat) = HostStructure::flat(&scene.accel) {
            return flat;
        }
        let meshes: Vec<_> = scene
            .meshes
            .iter()
            .zip(scene.accel.structures())
            .filter_map(|(mesh, structure)| Some(MeshView::packed(scene, mesh, structure.bvh()?)))
            .collect();
        HostStructure::wide(&scene.accel, &meshes, &self.placements)
    }
}

impl PartialEq for Origin {
    fn eq(&self, other: &Self) -> bool {
        self.structures.len() == other.structures.len()
            && self.structures.iter().zip(&other.structures).all(|(a, b)| a.ptr_eq(b))
            && self.placements == other.placements
            && self.approximate == other.approximate
            && self.gates.len() == other.gates.len()
            && self.gates.iter().zip(&other.gates).all(|pair| match pair {
                (Some(a), Some(b)) => a.ptr_eq(b),
                (None, None) => true,
                _ => false,
            })
    }
}

/// The structure that was last on the device: the next job often has the same.
#[derive(Default)]
pub(super) struct Kept(Option<(Origin, Arc<GpuStructure>)>);

impl Kept {
    /// The structure of a scene on the device: two levels of BVHs, or one structure over everything. What was kept before goes first
    /// unless it is the same or somebody traces with it.
    pub(super) fn of_scene(
        &mut self,
        context: &Context,
        scene: &PackedScene,
    ) -> Result<Arc<GpuStructure>, DeviceError> {
        let origin = Origin::of(scene);
        if let Some((_, known)) = self.0.as_ref().filter(|(known, _)| *known == origin) {
            return Ok(Arc::clone(known));
        }
        self.0 = None;
        let made = Arc::new(GpuStructure::upload(context, &origin.layout(scene))?);
        context.check()?;
        self.0 = Some((origin, Arc::clone(&made)));
        Ok(made)
    }
}

/// Bind group 0 of the tracing stages.
pub(super) struct GpuStructure {
    pub pools: [PoolLayout; 2],
    pub layout: wgpu::BindGroupLayout,
    pub group: wgpu::BindGroup,
    /// Storage buffers in the group.
    pub bindings: usize,
    pub stack_size: u32,
    pub spheres: bool,
    /// Some placement's hits go through the alpha filter.
    pub filtered: bool,
    /// Some mesh has a Line Space that is asked.
    pub gated: bool,
    approximate: bool,
    alone: bool,
    walk: Walk,
    pub bytes: u64,
}

impl GpuStructure {
    /// Constants of `traverse.wgsl` and `gate.wgsl`.
    pub(super) fn constants(&self, any_hit: bool, counting: bool) -> Vec<(&'static str, String)> {
        // Rounded up, so that scenes share compiled pipelines.
        vec![
            ("STACK_SIZE", format!("{}u", self.stack_size.next_multiple_of(8))),
            ("ANY_HIT", any_hit.to_string()),
            ("SPHERES", self.spheres.to_string()),
            ("FILTERED", self.filtered.to_string()),
            ("COUNTING", counting.to_string()),
            ("GATED", self.gated.to_string()),
            ("APPROXIMATE", self.approximate.to_string()),
            ("ALONE", self.alone.to_string()),
            ("FLAT", (self.walk == Walk::Flat).to_string()),
        ]
    }

    /// Shared files that stand in for others where this structure is traced.
    pub(super) fn replacements(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        (self.walk == Walk::Cells).then_some(("traverse", "traverse_cells")).into_iter()
    }

    pub(super) fn upload(context: &Context, host: &HostStructure) -> Result<Self, DeviceError> {
        let nodes = Pool::upload(context, "nodes", "vec4<u32>", (0, 0), 16, &[bytemuck::cast_slice(&host.nodes)])?;
        let prims = Pool::upload(context, "prims", "vec4<u32>", (0, 4), 16, &[bytemuck::cast_slice(&host.prims)])?;
        let entries: Vec<_> = nodes.entries().chain(prims.entries()).collect();
        let (layout, group) = context.bind_storage("structure", &entries, true);
        Ok(Self {
            layout,
            group,
            bindings: entries.len(),
            stack_size: host.stack_size,
            spheres: host.spheres,
            filtered: host.filtered,
            gated: host.gated,
            approximate: host.approximate,
            alone: host.alone,
            walk: host.walk,
            bytes: nodes.bytes + prims.bytes,
            pools: [nodes.layout, prims.layout],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Structure;
    use crate::integrate::tests::{camera, matte, prepare, scene, settings, sphere, square};
    use crate::pack::{pack, placements};
    use crate::scene::Scene;
    use crate::settings::Integrator;
    use glam::Vec3;

    #[test]
    fn a_structure_stays_on_the_device_until_a_scene_has_another() {
        let context = Context::open(None).expect("tests need an adapter (mesa-vulkan-drivers has one)");
        let objects = |height: f32| {
            let lifted = Affine3A::from_translation(Vec3::Z * height);
            scene(vec![(square(), matte(0.5, 1.0), Affine3A::IDENTITY), (sphere(), matte(0.5, 1.0), lifted)])
        };
        let settings = |distance| settings(Integrator::Direct, camera(Vec3::ZERO, Vec3::Z, distance, 1.0), 1.0);
        let first = prepare(&objects(1.0), &settings(2.0));
        let structures: Vec<Structure> = first.accel.structures().to_vec();
        let next_job = |scene: &Scene, distance| {
            let accel = SceneAccel::build(structures.clone(), &placements(scene));
            pack(scene, &settings(distance), Arc::new(accel)).expect("packs")
        };
        let mut kept = Kept::default();
        let structure = kept.of_scene(&context, &first).expect("fits");
        for structure in &structures {
            let bvh = structure.bvh().expect("a BVH");
            assert!(!bvh.compressed(&|_| panic!("made a second time")).nodes.is_empty());
        }
        let with_another_camera = kept.of_scene(&context, &next_job(&objects(1.0), 3.0)).expect("fits");
        assert!(Arc::ptr_eq(&structure, &with_another_camera));
        let with_the_sphere_moved = kept.of_scene(&context, &next_job(&objects(2.0), 3.0)).expect("fits");
        assert!(!Arc::ptr_eq(&structure, &with_the_sphere_moved));
        let of_other_meshes = kept.of_scene(&context, &prepare(&objects(2.0), &settings(3.0))).expect("fits");
        assert!(!Arc::ptr_eq(&with_the_sphere_moved, &of_other_meshes));
    }
}
