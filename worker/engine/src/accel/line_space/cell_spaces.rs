//! Line Spaces of the nodes of an N-tree for the approximate policies (Keul 2020, chapters 5 and 6): a ray that crosses a node of
//! one level takes for true what its shaft says, and the cells below are not looked at.
//!
//! What lies above that level in leaves is tested exactly, and so is what a ray from very far away meets.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

use super::bits::BinaryShafts;
use super::candidates::CandidateTriangle;
use super::nodes::gather_triangles;
use super::shaft::symmetric_count;
use super::{AtlasParams, BinaryBuilder, LineSpaceParams, MaskAtlas, Payload, ShaftGrid, Shafts, cast};
use crate::accel::BuildError;
use crate::accel::build::check;
use crate::accel::cells::{CellTree, GROWTH, marked};
use crate::scene::{Aabb, Mesh, MeshHash};
use crate::trace::{Counters, Kernels, ObjectRay, Ray, Sink};

/// Masks are of cells of the node, the patches of a grid that is [`GROWTH`] larger on each side.
const MASK_GROWTH: f64 = 2.0 * GROWTH;

/// Which nodes of an N-tree have Line Spaces, and of what kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellSpaceParams {
    /// With masks, patches are whole cells wide: there are at most `n` of them along an edge.
    pub each: LineSpaceParams,
    /// Levels below the root, 1 and more. In a tree of fewer levels, its deepest nodes.
    pub level: u32,
}

impl CellSpaceParams {
    /// Says which parameter is out of range, and what would be right.
    pub fn check(&self) -> Result<(), String> {
        self.each.check()?;
        if self.level == 0 {
            return Err(
                "line_space.depth is 0; the nodes of an N-tree that are asked are at least 1 below its root".into()
            );
        }
        match self.each.payload {
            Payload::Classes { .. } => {
                Err("line_space.payload is classes; nodes have binary, candidates or coverage".into())
            }
            Payload::Binary { builder: BinaryBuilder::Clipping } => {
                Err("line_space.builder is clipping; nodes of an N-tree have masking or casting".into())
            }
            _ => Ok(()),
        }
    }

    /// The level whose nodes have them; none in a tree of the root alone.
    fn level_in(&self, tree: &CellTree) -> Option<u32> {
        let deepest = tree.levels().checked_sub(1)?;
        Some(self.level.min(deepest)).filter(|&level| level > 0)
    }

    /// The same with half as many patches along an edge, if that can be.
    pub fn coarser(&self) -> Option<Self> {
        Some(Self { each: self.each.coarser()?, ..*self })
    }
}

/// The Line Spaces of the nodes of one level of an N-tree. Immutable; share it in an [`std::sync::Arc`].
#[derive(Debug)]
pub struct CellSpaces {
    mesh: MeshHash,
    level: u32,
    first_node: u32,
    spaces: Vec<CellSpace>,
    triangles: Vec<CandidateTriangle>,
}

/// A node.
#[derive(Debug)]
pub(crate) struct CellSpace {
    pub bounds: Aabb,
    /// None for a node that is to be tested exactly.
    pub content: Option<(ShaftGrid, Shafts)>,
}

impl CellSpaces {
    /// Builds with rayon's current pool; looks at `cancel` often enough to stop within 100 ms.
    ///
    /// # Errors
    /// [`BuildError::Unsupported`] for parameters out of range, for a tree whose root is not divided as its other nodes are, and as soon
    /// as more than `budget_bytes` are taken.
    pub fn build(
        mesh: &Mesh,
        tree: &CellTree,
        params: &CellSpaceParams,
        budget_bytes: u64,
        cancel: &AtomicBool,
    ) -> Result<Self, BuildError> {
        params.check().map_err(BuildError::Unsupported)?;
        if tree.dims() != [tree.n(); 3] {
            return Err(BuildError::Unsupported(format!(
                "line spaces of nodes need an N-tree; this has {:?} cells in its root, {} in others",
                tree.dims(),
                tree.n()
            )));
        }
        let Some(level) = params.level_in(tree) else {
            return Ok(Self { mesh: mesh.hash, level: 0, first_node: 0, spaces: Vec::new(), triangles: Vec::new() });
        };
        let maker = Maker::new(tree, params, level, cancel)?;
        let mut boxes = Vec::new();
        tree.for_each_node(|node| {
            if node.level == level {
                boxes.push((node.number, node.bounds()));
            }
        });
        // A sphere has no plane that could stand for it.
        let has_planes = mesh.spheres.is_empty() || !matches!(params.each.payload, Payload::Candidates { .. });
        let taken = AtomicU64::new(0);
        let made = boxes.par_iter().map(|&(node, bounds)| {
            check(cancel)?;
            let content = if has_planes { maker.shafts(node, &bounds)? } else { None };
            let bytes = content.as_ref().map_or(0, |(_, shafts)| shafts.bytes() as u64);
            if taken.fetch_add(bytes, Ordering::Relaxed) + bytes > budget_bytes {
                return Err(BuildError::Unsupported(format!(
                    "the line spaces of an N-tree's {} nodes of level {level} ({}) take more than {budget_bytes} bytes",
                    boxes.len(),
                    params.each.canonical()
                )));
            }
            Ok(CellSpace { bounds, content })
        });
        let mut spaces = made.collect::<Result<Vec<_>, BuildError>>()?;
        let shafts = spaces.iter_mut().filter_map(|space| space.content.as_mut());
        let triangles = gather_triangles(mesh, shafts.map(|(_, shafts)| shafts).collect());
        Ok(Self { mesh: mesh.hash, level, first_node: tree.nodes_at(level).start, spaces, triangles })
    }

    /// The mesh whose tree it was built for.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    /// Whether these are of the nodes of `tree`.
    pub(crate) fn fit(&self, tree: &CellTree) -> bool {
        let is_whole = self.level > 0
            && tree.nodes_at(self.level) == (self.first_node..self.first_node + self.spaces.len() as u32);
        self.mesh == tree.mesh() && (is_whole || self.spaces.is_empty())
    }

    /// The level of the nodes that have them, counted from the root.
    pub(crate) fn level(&self) -> usize {
        self.level as usize
    }

    /// Nodes that have one.
    pub fn count(&self) -> usize {
        self.spaces.iter().filter(|space| space.content.is_some()).count()
    }

    /// Memory, in bytes.
    pub fn bytes(&self) -> usize {
        let shafts = self.spaces.iter().filter_map(|space| space.content.as_ref());
        shafts.map(|(_, shafts)| shafts.bytes()).sum::<usize>()
            + size_of_val(self.spaces.as_slice())
            + size_of_val(self.triangles.as_slice())
    }

    /// The Line Space of a node of that level.
    #[inline(always)]
    pub(crate) fn of_node(&self, node: u32) -> Option<&CellSpace> {
        self.spaces.get(node.wrapping_sub(self.first_node) as usize)
    }

    pub(crate) fn triangles(&self) -> &[CandidateTriangle] {
        &self.triangles
    }
}

/// Makes the shafts of nodes.
struct Maker<'a> {
    tree: &'a CellTree,
    level: u32,
    each: LineSpaceParams,
    /// Of masks.
    atlas: Option<(AtlasParams, Arc<MaskAtlas>)>,
    cancel: &'a AtomicBool,
}

impl<'a> Maker<'a> {
    fn new(
        tree: &'a CellTree,
        params: &CellSpaceParams,
        level: u32,
        cancel: &'a AtomicBool,
    ) -> Result<Self, BuildError> {
        let atlas = if let Payload::Binary { builder: BinaryBuilder::Masking } = params.each.payload {
            let width = tree.n().div_ceil(params.each.n.min(tree.n()));
            let atlas = AtlasParams { cells: tree.n(), width, growth: MASK_GROWTH };
            Some((atlas, MaskAtlas::get(&atlas, cancel)?))
        } else {
            None
        };
        Ok(Self { tree, level, each: params.each, atlas, cancel })
    }

    fn shafts(&self, node: u32, bounds: &Aabb) -> Result<Option<(ShaftGrid, Shafts)>, BuildError> {
        let n = self.atlas.as_ref().map_or(self.each.n, |(atlas, _)| atlas.patches());
        let Some(grid) = ShaftGrid::new(bounds, n).map(ShaftGrid::without_limit) else { return Ok(None) };
        let shafts = match (self.each.payload, &self.atlas) {
            (Payload::Candidates { pattern }, _) => {
                Shafts::Candidates(cast::candidates(self.tree, &grid, pattern, self.cancel)?)
            }
            (Payload::Coverage { bits, rays }, _) => {
                Shafts::Coverage(cast::coverage(self.tree, &grid, bits, rays, self.cancel)?)
            }
            (Payload::Binary { builder: BinaryBuilder::Casting(pattern) }, _) => {
                Shafts::Binary(cast::marks(self.tree, &grid, pattern, self.cancel)?)
            }
            (_, Some((_, atlas))) => {
                let words = symmetric_count(n).div_ceil(32) as usize;
                let words = marked(self.tree, atlas, node, self.level, words);
                Shafts::Binary(BinaryShafts::from_words(n, words).map_err(BuildError::Unsupported)?)
            }
            // Refused by CellSpaceParams::check.
            (Payload::Binary { .. } | Payload::Classes { .. }, None) => return Ok(None),
        };
        Ok(Some((grid, shafts)))
    }
}

impl cast::Target for CellTree {
    fn trace(&self, ray: &Ray, sink: &mut impl Sink) {
        let Some(ray) = ObjectRay::new(ray, &self.bounds()) else { return };
        Kernels::detect().walk_cells(self, None, &ray, 0, sink, &mut Counters::default());
    }
}
