//! The spatial structure on the device: one node pool and one primitive pool for the top level and all meshes.

use glam::{Affine3A, Mat3};

use super::context::Context;
use super::pool::{Pool, PoolLayout};
use super::wide::WideTree;
use crate::accel::Bvh2;
use crate::device::DeviceError;
use crate::pack::{INSTANCE_ALPHA, PackedInstance, PackedMesh, PackedScene};
use crate::scene::Aabb;

/// Hits of this placement go through the alpha filter (`PLACEMENT_FILTERED` in `traverse.wgsl`).
const PLACEMENT_FILTERED: u32 = 1;
const PRIMITIVE_SPHERE: u32 = 1;

/// A mesh as the structure sees it.
#[derive(Clone, Copy)]
pub struct MeshView<'a> {
    pub bvh: &'a Bvh2,
    pub positions: &'a [[f32; 3]],
    pub triangles: &'a [[u32; 3]],
    /// Centre and radius; numbered after the triangles.
    pub spheres: &'a [[f32; 4]],
}

impl<'a> MeshView<'a> {
    fn packed(scene: &'a PackedScene, mesh: &PackedMesh, bvh: &'a Bvh2) -> Self {
        Self {
            bvh,
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
#[derive(Clone, Copy, Debug)]
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

/// Host arrays, ready for upload.
pub struct HostStructure {
    nodes: Vec<u32>,
    /// Four elements a placement, in the top level's leaf order, then from a multiple of three on three elements a
    /// primitive.
    prims: Vec<[u32; 4]>,
    /// Stack entries that the kernel needs.
    pub stack_size: u32,
    pub spheres: bool,
    /// Some placement's hits go through the alpha filter.
    pub filtered: bool,
}

impl HostStructure {
    /// The compressed wide trees that `traverse.wgsl` walks.
    pub fn wide(top: &Bvh2, meshes: &[MeshView<'_>], placements: &[PlacementView]) -> Self {
        let mut host = Self::empty(meshes, placements.len());
        let top_bounds = leaf_bounds(top, placements.len());
        let top_tree = WideTree::from_bvh2(top, &|instance| top_bounds[instance as usize]);
        host.push_tree(&top_tree, 0);
        if top_tree.nodes.is_empty() {
            host.nodes.resize(20, 0);
        }
        let mut roots = Vec::with_capacity(meshes.len());
        let mut deepest = 0;
        for mesh in meshes {
            let tree = WideTree::from_bvh2(mesh.bvh, &|primitive| mesh.bounds(primitive));
            deepest = deepest.max(tree.depth);
            roots.push((host.nodes.len() / 20) as u32);
            host.push_tree(&tree, (host.prims.len() / 3) as u32);
            host.prims.extend(tree.leaves.iter().flat_map(|&primitive| mesh.record(primitive)));
        }
        host.set_placements(&top_tree.leaves, placements, &roots);
        host.stack_size = top_tree.depth + deepest + 2;
        host
    }

    /// The structure of a packed scene, which must be of two levels of BVHs.
    pub fn of_scene(scene: &PackedScene) -> Self {
        let meshes: Vec<_> = scene
            .meshes
            .iter()
            .zip(scene.accel.structures())
            .filter_map(|(m, s)| Some(MeshView::packed(scene, m, s.bvh2()?)))
            .collect();
        let placements: Vec<_> = scene.instances.iter().map(PlacementView::packed).collect();
        Self::wide(scene.accel.top(), &meshes, &placements)
    }

    /// The plain binary trees of the benchmark's base kernel. Leaves of the top level must hold one instance each.
    pub fn baseline(top: &Bvh2, meshes: &[MeshView<'_>], placements: &[PlacementView]) -> Self {
        let mut host = Self::empty(meshes, placements.len());
        host.push_binary(top, 0);
        let mut roots = Vec::with_capacity(meshes.len());
        for mesh in meshes {
            roots.push((host.nodes.len() / 8) as u32);
            host.push_binary(mesh.bvh, (host.prims.len() / 3) as u32);
            host.prims.extend(mesh.bvh.primitives.iter().flat_map(|&primitive| mesh.record(primitive)));
        }
        host.set_placements(&top.primitives, placements, &roots);
        host.stack_size = binary_depth(top) + meshes.iter().map(|m| binary_depth(m.bvh)).max().unwrap_or(0) + 1;
        host
    }

    fn empty(meshes: &[MeshView<'_>], placements: usize) -> Self {
        Self {
            nodes: Vec::new(),
            prims: vec![[0; 4]; (4 * placements).next_multiple_of(3)],
            stack_size: 0,
            spheres: meshes.iter().any(|m| !m.spheres.is_empty()),
            filtered: false,
        }
    }

    fn push_tree(&mut self, tree: &WideTree, first_leaf: u32) {
        let first_node = (self.nodes.len() / 20) as u32;
        for node in &tree.nodes {
            let mut node = *node;
            node.child_base += first_node;
            node.leaf_base += first_leaf;
            self.nodes.extend_from_slice(bytemuck::cast_slice(&[node]));
        }
    }

    fn push_binary(&mut self, tree: &Bvh2, first_leaf: u32) {
        let first_node = (self.nodes.len() / 8) as u32;
        for node in &tree.nodes {
            let mut node = *node;
            node.right_or_first += if node.count == 0 { first_node } else { first_leaf };
            self.nodes.extend_from_slice(bytemuck::cast_slice(&[node]));
        }
    }

    fn set_placements(&mut self, order: &[u32], placements: &[PlacementView], roots: &[u32]) {
        for (record, &instance) in self.prims.chunks_exact_mut(4).zip(order) {
            let placement = &placements[instance as usize];
            let flags = if placement.filtered { PLACEMENT_FILTERED } else { 0 };
            self.filtered |= placement.filtered;
            record[..3].copy_from_slice(&placement.rows());
            record[3] = [roots[placement.mesh as usize], instance, flags, 0];
        }
    }
}

/// For every instance the box of the top level's leaf in which it stands.
fn leaf_bounds(top: &Bvh2, instances: usize) -> Vec<Aabb> {
    let mut bounds = vec![Aabb::EMPTY; instances];
    for node in top.nodes.iter().filter(|node| node.count > 0) {
        let first = node.right_or_first as usize;
        for &instance in &top.primitives[first..first + node.count as usize] {
            bounds[instance as usize] = Aabb { min: node.min.into(), max: node.max.into() };
        }
    }
    bounds
}

fn binary_depth(tree: &Bvh2) -> u32 {
    let mut depths = vec![1; tree.nodes.len()];
    for (i, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.count == 0) {
        depths[i + 1] = depths[i] + 1;
        depths[node.right_or_first as usize] = depths[i] + 1;
    }
    depths.into_iter().max().unwrap_or(1)
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
    pub bytes: u64,
}

impl GpuStructure {
    /// Constants of `traverse.wgsl`.
    pub(super) fn constants(&self, any_hit: bool, counting: bool) -> Vec<(&'static str, String)> {
        // Rounded up, so that scenes share compiled pipelines.
        vec![
            ("STACK_SIZE", format!("{}u", self.stack_size.next_multiple_of(8))),
            ("ANY_HIT", any_hit.to_string()),
            ("SPHERES", self.spheres.to_string()),
            ("FILTERED", self.filtered.to_string()),
            ("COUNTING", counting.to_string()),
        ]
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
            bytes: nodes.bytes + prims.bytes,
            pools: [nodes.layout, prims.layout],
        })
    }
}
