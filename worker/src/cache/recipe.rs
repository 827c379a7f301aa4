//! What the cache of structures can hold, and how each is named, built and read back.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Weak};

use lightshaft_api::job::BuiltOn;
use lightshaft_engine::accel::line_space::{LineSpace, LineSpaceParams, NodeSpaceParams, NodeSpaces};
use lightshaft_engine::accel::{
    BuildError, BuildParams, CorruptStructure, MeshStructure, Structure, StructureKey, StructureParams, WeakStructure,
};
use lightshaft_engine::device::gpu::LineSpaceBuilder;
use lightshaft_engine::scene::Mesh;

/// How something over a mesh is made.
pub trait Recipe {
    type Product: Cached;

    fn key(&self, mesh: &Mesh) -> StructureKey;

    fn build(&self, mesh: &Mesh, cancel: &AtomicBool) -> Result<Built<Self::Product>, BuildError>;

    /// Reads what [`Cached::encode`] wrote, and checks it.
    fn decode(&self, bytes: &[u8], mesh: &Mesh) -> Result<Self::Product, CorruptStructure>;
}

/// What a recipe made.
#[derive(Debug)]
pub struct Built<T> {
    pub product: T,
    pub on: BuiltOn,
    /// What else there is to tell.
    pub warning: Option<String>,
}

impl<T> Built<T> {
    fn on_cpu(product: T) -> Self {
        Self { product, on: BuiltOn::Cpu, warning: None }
    }
}

/// Something over a mesh that is shared, stored and counted.
pub trait Cached: Clone + Into<Kept> {
    /// `None` when it is something else.
    fn from_kept(kept: Kept) -> Option<Self>;

    fn encode(&self) -> Vec<u8>;

    /// Memory that it takes, in bytes.
    fn bytes(&self) -> u64;
}

/// Anything that the cache holds.
#[derive(Clone, Debug)]
pub enum Kept {
    Structure(Structure),
    LineSpace(Arc<LineSpace>),
    NodeSpaces(Arc<NodeSpaces>),
}

/// The same, kept only as long as somebody else uses it.
#[derive(Clone, Debug)]
pub(super) enum WeakKept {
    Structure(WeakStructure),
    LineSpace(Weak<LineSpace>),
    NodeSpaces(Weak<NodeSpaces>),
}

impl Kept {
    pub(super) fn bytes(&self) -> u64 {
        match self {
            Self::Structure(structure) => Cached::bytes(structure),
            Self::LineSpace(space) => Cached::bytes(space),
            Self::NodeSpaces(spaces) => Cached::bytes(spaces),
        }
    }

    pub(super) fn downgrade(&self) -> WeakKept {
        match self {
            Self::Structure(structure) => WeakKept::Structure(structure.downgrade()),
            Self::LineSpace(space) => WeakKept::LineSpace(Arc::downgrade(space)),
            Self::NodeSpaces(spaces) => WeakKept::NodeSpaces(Arc::downgrade(spaces)),
        }
    }
}

impl WeakKept {
    pub(super) fn upgrade(&self) -> Option<Kept> {
        match self {
            Self::Structure(structure) => structure.upgrade().map(Kept::Structure),
            Self::LineSpace(space) => space.upgrade().map(Kept::LineSpace),
            Self::NodeSpaces(spaces) => spaces.upgrade().map(Kept::NodeSpaces),
        }
    }

    pub(super) fn is_alive(&self) -> bool {
        match self {
            Self::Structure(structure) => structure.is_alive(),
            Self::LineSpace(space) => space.strong_count() > 0,
            Self::NodeSpaces(spaces) => spaces.strong_count() > 0,
        }
    }
}

impl Recipe for StructureParams {
    type Product = Structure;

    fn key(&self, mesh: &Mesh) -> StructureKey {
        StructureParams::key(self, mesh.hash)
    }

    fn build(&self, mesh: &Mesh, cancel: &AtomicBool) -> Result<Built<Structure>, BuildError> {
        Structure::build(mesh, self, cancel).map(Built::on_cpu)
    }

    fn decode(&self, bytes: &[u8], mesh: &Mesh) -> Result<Structure, CorruptStructure> {
        StructureParams::decode(self, bytes, mesh)
    }
}

impl Cached for Structure {
    fn from_kept(kept: Kept) -> Option<Self> {
        match kept {
            Kept::Structure(structure) => Some(structure),
            Kept::LineSpace(_) | Kept::NodeSpaces(_) => None,
        }
    }

    fn encode(&self) -> Vec<u8> {
        Structure::encode(self)
    }

    fn bytes(&self) -> u64 {
        Structure::bytes(self) as u64
    }
}

impl From<Structure> for Kept {
    fn from(structure: Structure) -> Self {
        Self::Structure(structure)
    }
}

/// How the Line Space of a mesh is made.
#[derive(Clone, Copy, Debug)]
pub struct LineSpaceRecipe<'a> {
    pub params: LineSpaceParams,
    /// Any structure over the mesh: it serves the building, and decides nothing.
    pub structure: &'a Arc<MeshStructure>,
    pub budget_bytes: u64,
    /// What builds it, else the CPU does. The outcome is the same, so it is no part of the key.
    pub on_gpu: Option<&'a LineSpaceBuilder>,
}

impl Recipe for LineSpaceRecipe<'_> {
    type Product = Arc<LineSpace>;

    fn key(&self, mesh: &Mesh) -> StructureKey {
        self.params.key(mesh.hash)
    }

    fn build(&self, mesh: &Mesh, cancel: &AtomicBool) -> Result<Built<Arc<LineSpace>>, BuildError> {
        let Some(builder) = self.on_gpu else {
            let space = LineSpace::build(mesh, self.structure, &self.params, self.budget_bytes, cancel)?;
            return Ok(Built::on_cpu(Arc::new(space)));
        };
        let built = builder.build(mesh, self.structure, &self.params, self.budget_bytes, cancel)?;
        let on = if built.on_gpu { BuiltOn::Gpu } else { BuiltOn::Cpu };
        Ok(Built { product: Arc::new(built.space), on, warning: built.warning })
    }

    fn decode(&self, bytes: &[u8], mesh: &Mesh) -> Result<Arc<LineSpace>, CorruptStructure> {
        LineSpace::decode(bytes, mesh, self.structure, &self.params).map(Arc::new)
    }
}

impl Cached for Arc<LineSpace> {
    fn from_kept(kept: Kept) -> Option<Self> {
        match kept {
            Kept::LineSpace(space) => Some(space),
            Kept::Structure(_) | Kept::NodeSpaces(_) => None,
        }
    }

    fn encode(&self) -> Vec<u8> {
        LineSpace::encode(self)
    }

    fn bytes(&self) -> u64 {
        LineSpace::bytes(self) as u64
    }
}

impl From<Arc<LineSpace>> for Kept {
    fn from(space: Arc<LineSpace>) -> Self {
        Self::LineSpace(space)
    }
}

/// How the Line Spaces of the nodes of a mesh's BVH are made.
#[derive(Clone, Copy, Debug)]
pub struct NodeSpacesRecipe<'a> {
    pub params: NodeSpaceParams,
    /// Whose nodes they are, and how it was built.
    pub structure: &'a MeshStructure,
    pub over: BuildParams,
    pub budget_bytes: u64,
}

impl Recipe for NodeSpacesRecipe<'_> {
    type Product = Arc<NodeSpaces>;

    fn key(&self, mesh: &Mesh) -> StructureKey {
        self.params.key(mesh.hash, &self.over)
    }

    fn build(&self, mesh: &Mesh, cancel: &AtomicBool) -> Result<Built<Arc<NodeSpaces>>, BuildError> {
        let spaces = NodeSpaces::build(mesh, self.structure, &self.params, self.budget_bytes, cancel)?;
        Ok(Built::on_cpu(Arc::new(spaces)))
    }

    fn decode(&self, bytes: &[u8], mesh: &Mesh) -> Result<Arc<NodeSpaces>, CorruptStructure> {
        NodeSpaces::decode(bytes, mesh, self.structure, &self.params).map(Arc::new)
    }
}

impl Cached for Arc<NodeSpaces> {
    fn from_kept(kept: Kept) -> Option<Self> {
        match kept {
            Kept::NodeSpaces(spaces) => Some(spaces),
            Kept::Structure(_) | Kept::LineSpace(_) => None,
        }
    }

    fn encode(&self) -> Vec<u8> {
        NodeSpaces::encode(self)
    }

    fn bytes(&self) -> u64 {
        NodeSpaces::bytes(self) as u64
    }
}

impl From<Arc<NodeSpaces>> for Kept {
    fn from(spaces: Arc<NodeSpaces>) -> Self {
        Self::NodeSpaces(spaces)
    }
}
