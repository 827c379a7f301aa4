//! Every kind of structure behind one face: how it is asked for, built, stored, and told about.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Weak};

use super::cells::CellTree;
use super::grid::GridParams;
use super::ntree::NTreeParams;
use super::octree::OctreeParams;
use super::{BUILDER_VERSION, BuildError, BuildParams, Bvh2, CorruptStructure, MeshStructure, StructureKey};
use crate::scene::{Aabb, Mesh, MeshHash};
use crate::trace::{Counters, Kernels, ObjectRay, Sink};

/// Which structure over one mesh, and how it is to be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StructureParams {
    Bvh(BuildParams),
    Grid(GridParams),
    Octree(OctreeParams),
    NTree(NTreeParams),
}

/// A structure over one mesh. Cheap to copy: it shares what it refers to.
#[derive(Clone, Debug)]
pub enum Structure {
    Bvh(Arc<MeshStructure>),
    /// A grid, an octree or an N-tree.
    Cells(Arc<CellTree>),
}

/// A structure that is kept only as long as somebody else uses it.
#[derive(Clone, Debug)]
pub enum WeakStructure {
    Bvh(Weak<MeshStructure>),
    Cells(Weak<CellTree>),
}

impl StructureParams {
    /// The name in keys and reports.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Bvh(_) => "bvh",
            Self::Grid(_) => "grid",
            Self::Octree(_) => "octree",
            Self::NTree(_) => "ntree",
        }
    }

    /// Canonical text of what decides how the structure comes out.
    pub fn canonical(&self) -> String {
        match self {
            Self::Bvh(params) => params.canonical(),
            Self::Grid(params) => params.canonical(),
            Self::Octree(params) => params.canonical(),
            Self::NTree(params) => params.canonical(),
        }
    }

    pub fn key(&self, mesh: MeshHash) -> StructureKey {
        StructureKey { mesh, kind: self.kind(), parameters: self.canonical(), builder_version: BUILDER_VERSION }
    }

    /// Reads what [`Structure::encode`] wrote for `mesh` with these parameters. Checks header, version, checksum, mesh
    /// and every index before anything is made of it.
    pub fn decode(&self, bytes: &[u8], mesh: &Mesh) -> Result<Structure, CorruptStructure> {
        Ok(match self {
            Self::Bvh(_) => Structure::Bvh(Arc::new(MeshStructure::decode(bytes, mesh)?)),
            Self::Grid(_) | Self::Octree(_) | Self::NTree(_) => {
                Structure::Cells(Arc::new(CellTree::decode(bytes, mesh)?))
            }
        })
    }
}

impl From<BuildParams> for StructureParams {
    fn from(params: BuildParams) -> Self {
        Self::Bvh(params)
    }
}

impl Structure {
    /// Builds with rayon's current pool; looks at `cancel` often enough to stop within 100 ms.
    ///
    /// The mesh's indices must be in range. Primitives with a NaN or an infinity are left out.
    pub fn build(mesh: &Mesh, params: &StructureParams, cancel: &AtomicBool) -> Result<Self, BuildError> {
        let cells = |tree: Result<CellTree, BuildError>| tree.map(|tree| Self::Cells(Arc::new(tree)));
        match params {
            StructureParams::Bvh(params) => MeshStructure::build(mesh, params, cancel).map(|bvh| Arc::new(bvh).into()),
            StructureParams::Grid(params) => cells(params.build(mesh, cancel)),
            StructureParams::Octree(params) => cells(params.build(mesh, cancel)),
            StructureParams::NTree(params) => cells(params.build(mesh, cancel)),
        }
    }

    /// Memory that the structure takes, in bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Bvh(bvh) => bvh.bytes(),
            Self::Cells(tree) => tree.bytes(),
        }
    }

    /// Nodes of the tree that is built: of a BVH those of the binary one.
    pub fn node_count(&self) -> usize {
        match self {
            Self::Bvh(bvh) => bvh.bvh2().nodes.len(),
            Self::Cells(tree) => tree.node_count(),
        }
    }

    /// The mesh that it was built over.
    pub fn mesh(&self) -> MeshHash {
        match self {
            Self::Bvh(bvh) => bvh.mesh(),
            Self::Cells(tree) => tree.mesh(),
        }
    }

    pub fn bounds(&self) -> Aabb {
        match self {
            Self::Bvh(bvh) => bvh.bvh2().bounds(),
            Self::Cells(tree) => tree.bounds(),
        }
    }

    /// The BVH, if it is one.
    pub fn bvh(&self) -> Option<&Arc<MeshStructure>> {
        match self {
            Self::Bvh(bvh) => Some(bvh),
            Self::Cells(_) => None,
        }
    }

    /// The binary tree, if it is one.
    pub fn bvh2(&self) -> Option<&Bvh2> {
        self.bvh().map(|bvh| bvh.bvh2())
    }

    /// The tree of cells, if it is one.
    pub fn cells(&self) -> Option<&CellTree> {
        match self {
            Self::Bvh(_) => None,
            Self::Cells(tree) => Some(tree),
        }
    }

    /// The stored form.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::Bvh(bvh) => bvh.encode(),
            Self::Cells(tree) => tree.encode(),
        }
    }

    /// Checks that every primitive is found wherever a ray can meet it, and that all indices are in range.
    pub fn validate(&self, mesh: &Mesh) -> Result<(), String> {
        match self {
            Self::Bvh(bvh) => bvh.validate(mesh),
            Self::Cells(tree) => tree.validate(mesh),
        }
    }

    pub fn downgrade(&self) -> WeakStructure {
        match self {
            Self::Bvh(bvh) => WeakStructure::Bvh(Arc::downgrade(bvh)),
            Self::Cells(tree) => WeakStructure::Cells(Arc::downgrade(tree)),
        }
    }

    /// Offers the sink what `ray` (in the mesh's space) hits.
    #[inline(always)]
    pub(super) fn walk<S: Sink>(
        &self,
        kernels: Kernels,
        ray: &ObjectRay,
        instance: u32,
        sink: &mut S,
        counters: &mut Counters,
    ) -> bool {
        match self {
            Self::Bvh(bvh) => kernels.walk_mesh(bvh.wide(), ray, instance, sink, counters),
            Self::Cells(tree) => kernels.walk_cells(tree, None, ray, instance, sink, counters),
        }
    }
}

impl From<Arc<MeshStructure>> for Structure {
    fn from(bvh: Arc<MeshStructure>) -> Self {
        Self::Bvh(bvh)
    }
}

impl WeakStructure {
    pub fn upgrade(&self) -> Option<Structure> {
        match self {
            Self::Bvh(bvh) => bvh.upgrade().map(Structure::Bvh),
            Self::Cells(tree) => tree.upgrade().map(Structure::Cells),
        }
    }

    /// Whether both are the same structure, not just equal ones.
    pub fn ptr_eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Bvh(a), Self::Bvh(b)) => a.ptr_eq(b),
            (Self::Cells(a), Self::Cells(b)) => a.ptr_eq(b),
            _ => false,
        }
    }

    pub fn is_alive(&self) -> bool {
        match self {
            Self::Bvh(bvh) => bvh.strong_count() > 0,
            Self::Cells(tree) => tree.strong_count() > 0,
        }
    }
}
