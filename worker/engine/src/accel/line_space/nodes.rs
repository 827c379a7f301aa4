//! Line Spaces on the inner nodes of a mesh's BVH: the shafts of the boxes at a depth below its root (Keul 2020, chapters
//! 6 to 8), for the approximate policies of [`Approximation`](crate::accel::Approximation).
//!
//! The *cut* of a depth is the nodes at that depth, and above it the leaves and the nodes of few primitives, which are cheap to
//! test exactly and have no shafts. [`NodeSpaces`] keeps the cuts of all depths from 0 on, since the usage heuristic
//! chooses among them by ray (section 8.3.2); of candidates, which one depth is used of, that one alone. Each cut has a small wide
//! tree over its boxes, and each box the places in the mesh's wide tree where a walk through its subtree begins.

use std::ops::RangeInclusive;
use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::bits::SparseCandidates;
use super::candidates::CandidateTriangle;
use super::{BinaryBuilder, LINE_SPACE_VERSION, LineSpaceParams, Payload, ShaftGrid, Shafts, cast, mask, store};
use crate::accel::build::{build_over_boxes, check};
use crate::accel::wide::{ChildRef, WideTop, over_instances};
use crate::accel::{BuildError, BuildParams, Bvh2, CorruptStructure, MeshStructure, StructureKey};
use crate::scene::{Aabb, Mesh, MeshHash};
use crate::trace::{Counters, Kernels, ObjectRay, Ray, Sink};

/// Deepest cut that can be asked for.
pub const MAX_NODE_DEPTH: u32 = 12;
/// Nodes with fewer primitives are tested exactly: the papers' T.
pub const MIN_NODE_PRIMITIVES: u32 = 8;

/// Which nodes have Line Spaces, and of what kind. [`Self::canonical`] is its part of the cache key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct NodeSpaceParams {
    pub each: LineSpaceParams,
    /// 0 (the mesh's own box) to [`MAX_NODE_DEPTH`].
    pub depth: u32,
}

impl NodeSpaceParams {
    /// E.g. `n=6,payload=binary,builder=masking,depth=4`.
    pub fn canonical(&self) -> String {
        format!("{},depth={}", self.each.canonical(), self.depth)
    }

    /// The key in every cache: the nodes are those of the tree that was built with `over`.
    pub fn key(&self, mesh: MeshHash, over: &BuildParams) -> StructureKey {
        let parameters = format!("{},over,{}", self.canonical(), over.canonical());
        StructureKey { mesh, kind: "line_space", parameters, builder_version: LINE_SPACE_VERSION }
    }

    /// Says which parameter is out of range, and what would be right.
    pub fn check(&self) -> Result<(), String> {
        self.each.check()?;
        if self.depth > MAX_NODE_DEPTH {
            return Err(format!("line_space.depth is {}; it must be from 0 to {MAX_NODE_DEPTH}", self.depth));
        }
        if matches!(self.each.payload, Payload::Classes { .. }) {
            return Err("line_space.payload is classes; nodes have binary, candidates or coverage".into());
        }
        Ok(())
    }

    /// Depths whose cuts are kept.
    pub fn depths(&self) -> RangeInclusive<u32> {
        match self.each.payload {
            Payload::Candidates { .. } => self.depth..=self.depth,
            _ => 0..=self.depth,
        }
    }

    /// Bytes that those of a mesh with so many primitives take at most.
    pub fn bytes_at_most(&self, primitives: usize) -> u64 {
        let most = (primitives as u64 / u64::from(MIN_NODE_PRIMITIVES)).max(1);
        let nodes: u64 = self.depths().map(|depth| (1 << depth).min(most)).sum();
        nodes * self.each.bytes_at_most()
    }

    /// The same with half as many patches along an edge, if that can be.
    pub fn coarser(&self) -> Option<Self> {
        Some(Self { each: self.each.coarser()?, ..*self })
    }
}

/// The Line Spaces of the nodes of one mesh's BVH. Immutable; share it in an [`std::sync::Arc`].
#[derive(Debug)]
pub struct NodeSpaces {
    mesh: MeshHash,
    params: NodeSpaceParams,
    bounds: Aabb,
    inverse_size_squared: f32,
    /// In the order of the nodes.
    spaces: Vec<NodeSpace>,
    cuts: Vec<Cut>,
    roots: Vec<ChildRef>,
    triangles: Vec<CandidateTriangle>,
}

/// A node of a cut.
#[derive(Debug)]
pub(crate) struct NodeSpace {
    /// In the binary tree.
    pub node: u32,
    pub bounds: Aabb,
    /// None for a node that is to be tested exactly.
    pub content: Option<(ShaftGrid, Shafts)>,
    first_root: u32,
    root_count: u32,
}

/// The tree over the boxes of a cut.
#[derive(Debug)]
pub(in crate::accel) struct Cut {
    depth: u32,
    pub top: WideTop,
}

/// A node that a cut names, and the primitives below it.
#[derive(Clone, Copy)]
struct Place {
    node: u32,
    first: u32,
    count: u32,
}

impl NodeSpaces {
    /// Builds with rayon's current pool; looks at `cancel` often enough to stop within 100 ms.
    ///
    /// # Errors
    /// [`BuildError::Unsupported`] for parameters out of range, and with the figure when it may take more than
    /// `budget_bytes`.
    pub fn build(
        mesh: &Mesh,
        structure: &MeshStructure,
        params: &NodeSpaceParams,
        budget_bytes: u64,
        cancel: &AtomicBool,
    ) -> Result<Self, BuildError> {
        params.check().map_err(BuildError::Unsupported)?;
        let needed = params.bytes_at_most(mesh.primitive_count());
        if needed > budget_bytes {
            return Err(BuildError::Unsupported(format!(
                "the line spaces of a mesh's nodes ({}) may take {needed} bytes; the budget is {budget_bytes}",
                params.canonical()
            )));
        }
        let (mut all, places) = Self::without_shafts(mesh, structure, params)?;
        let roots = &all.roots;
        let built = all.spaces.par_iter().zip(&places).map(|(space, place)| {
            check(cancel)?;
            let Some(grid) = params.grid(mesh, space, place) else { return Ok(None) };
            let below = Below {
                structure,
                node: place.node as usize,
                primitives: &structure.bvh2().primitives[place.first as usize..(place.first + place.count) as usize],
                roots: space.roots(roots),
            };
            Ok(Some((grid, shafts(mesh, &below, &grid, &params.each, cancel)?)))
        });
        let built = built.collect::<Result<Vec<_>, BuildError>>()?;
        all.spaces.iter_mut().zip(built).for_each(|(space, content)| space.content = content);
        all.gather_triangles(mesh);
        Ok(all)
    }

    /// Cuts and the trees over them.
    fn without_shafts(
        mesh: &Mesh,
        structure: &MeshStructure,
        params: &NodeSpaceParams,
    ) -> Result<(Self, Vec<Place>), BuildError> {
        let bvh2 = structure.bvh2();
        let cuts: Vec<Vec<Place>> = params.depths().map(|depth| cut(bvh2, depth)).collect();
        let mut places: Vec<Place> = cuts.iter().flatten().copied().collect();
        places.sort_by_key(|place| place.node);
        places.dedup_by_key(|place| place.node);
        let (roots, ranges) =
            structure.subtree_roots(mesh, &places.iter().map(|place| place.node).collect::<Vec<_>>())?;
        let spaces = places.iter().zip(ranges).map(|(place, range)| NodeSpace {
            node: place.node,
            bounds: bvh2.nodes[place.node as usize].bounds(),
            content: None,
            first_root: range.start,
            root_count: range.end - range.start,
        });
        let spaces: Vec<NodeSpace> = spaces.collect();
        let trees = params.depths().zip(&cuts).map(|(depth, cut)| {
            let boxes: Vec<Aabb> = cut.iter().map(|place| bvh2.nodes[place.node as usize].bounds()).collect();
            let mut top = over_instances(&build_over_boxes(&boxes, 1))?;
            for entry in &mut top.entries {
                let node = cut[*entry as usize].node;
                *entry = places.partition_point(|place| place.node < node) as u32;
            }
            Ok(Cut { depth, top })
        });
        let cuts = trees.collect::<Result<_, BuildError>>()?;
        let (bounds, triangles) = (bvh2.bounds(), Vec::new());
        let inverse_size_squared = 1.0 / bounds.extent().length_squared();
        Ok((
            Self { mesh: mesh.hash, params: *params, bounds, inverse_size_squared, spaces, cuts, roots, triangles },
            places,
        ))
    }

    /// Puts what a candidate's plane needs side by side, and renumbers candidates to it.
    fn gather_triangles(&mut self, mesh: &Mesh) {
        let shafts = self.spaces.iter_mut().filter_map(|space| space.content.as_mut());
        self.triangles = gather_triangles(mesh, shafts.map(|(_, shafts)| shafts).collect());
    }

    fn candidates(&self) -> impl Iterator<Item = &SparseCandidates> {
        self.spaces.iter().filter_map(|space| match &space.content {
            Some((_, Shafts::Candidates(candidates))) => Some(candidates),
            _ => None,
        })
    }

    /// The mesh that they were built for.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    pub fn params(&self) -> &NodeSpaceParams {
        &self.params
    }

    /// Nodes that have one.
    pub fn count(&self) -> usize {
        self.spaces.iter().filter(|space| space.content.is_some()).count()
    }

    /// The part of all shafts that holds something; of candidates the ones that have one.
    pub fn filled_share(&self) -> f64 {
        let share = |shafts: &Shafts| match shafts {
            Shafts::Binary(binary) => binary.bits().count() as f64 / binary.bits().len() as f64,
            Shafts::Candidates(candidates) => candidates.filled().count() as f64 / candidates.filled().len() as f64,
            Shafts::Table(_) | Shafts::Tree(_) | Shafts::Coverage(_) => 1.0,
        };
        let shares = self.spaces.iter().filter_map(|space| space.content.as_ref()).map(|(_, shafts)| share(shafts));
        shares.sum::<f64>() / self.count().max(1) as f64
    }

    /// Memory, in bytes.
    pub fn bytes(&self) -> usize {
        let shafts = self.spaces.iter().filter_map(|space| space.content.as_ref());
        shafts.map(|(_, shafts)| shafts.bytes()).sum::<usize>()
            + size_of_val(self.spaces.as_slice())
            + size_of_val(self.triangles.as_slice())
            + self.cuts.iter().map(|cut| cut.top.bytes()).sum::<usize>()
    }

    /// The mesh's own box.
    pub(crate) fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// One by the squared diagonal of that box.
    #[inline(always)]
    pub(crate) fn inverse_size_squared(&self) -> f32 {
        self.inverse_size_squared
    }

    /// The cut of a depth, or the nearest that is kept.
    pub(in crate::accel) fn cut(&self, depth: u32) -> &Cut {
        let place = depth.saturating_sub(self.cuts[0].depth) as usize;
        &self.cuts[place.min(self.cuts.len() - 1)]
    }

    pub(crate) fn space(&self, number: u32) -> &NodeSpace {
        &self.spaces[number as usize]
    }

    pub(crate) fn roots(&self, space: &NodeSpace) -> &[ChildRef] {
        space.roots(&self.roots)
    }

    /// What candidates are numbers of.
    pub(crate) fn triangles(&self) -> &[CandidateTriangle] {
        &self.triangles
    }

    /// The stored form: as that of a Line Space, first the nodes' numbers, then the arrays of each.
    pub fn encode(&self) -> Vec<u8> {
        let nodes: Vec<u32> = self.spaces.iter().map(|space| space.node).collect();
        let renumbered: Vec<Vec<u32>> = self
            .candidates()
            .map(|c| c.primitives().iter().map(|&at| self.triangles[at as usize].primitive).collect())
            .collect();
        let mut primitives = renumbered.iter();
        let mut arrays: Vec<&[u32]> = vec![&nodes];
        for (_, shafts) in self.spaces.iter().filter_map(|space| space.content.as_ref()) {
            match shafts {
                Shafts::Candidates(candidates) => {
                    arrays.push(candidates.filled().words());
                    arrays.extend(primitives.next().map(Vec::as_slice));
                }
                Shafts::Binary(binary) => arrays.push(binary.bits().words()),
                Shafts::Coverage(coverage) => arrays.push(coverage.words()),
                // Refused by NodeSpaceParams::check.
                Shafts::Table(_) | Shafts::Tree(_) => {}
            }
        }
        store::seal(self.mesh, &self.params.canonical(), &arrays)
    }

    /// Reads what [`Self::encode`] wrote for `mesh`, `structure` and `params`. Checks header, version, checksum, mesh, parameters,
    /// nodes, and every number of the payloads before anything is made of it.
    pub fn decode(
        bytes: &[u8],
        mesh: &Mesh,
        structure: &MeshStructure,
        params: &NodeSpaceParams,
    ) -> Result<Self, CorruptStructure> {
        Self::read(bytes, mesh, structure, params).map_err(CorruptStructure)
    }

    fn read(bytes: &[u8], mesh: &Mesh, structure: &MeshStructure, params: &NodeSpaceParams) -> Result<Self, String> {
        params.check()?;
        let mut arrays = store::open(bytes, mesh, structure, &params.canonical())?.into_iter();
        let (mut all, places) = Self::without_shafts(mesh, structure, params).map_err(|error| error.to_string())?;
        let nodes = arrays.next().ok_or("the nodes are missing")?;
        if !nodes.iter().eq(all.spaces.iter().map(|space| &space.node)) {
            return Err("it is for other nodes than the structure's".into());
        }
        let of_each = if matches!(params.each.payload, Payload::Candidates { .. }) { 2 } else { 1 };
        for (space, place) in all.spaces.iter_mut().zip(&places) {
            let Some(grid) = params.grid(mesh, space, place) else { continue };
            let own = arrays.by_ref().take(of_each).collect();
            space.content = Some((grid, store::shafts(&params.each, own, mesh.primitive_count())?));
        }
        if arrays.next().is_some() {
            return Err("there are more arrays than nodes".into());
        }
        if all.candidates().any(|c| c.primitives().iter().any(|&p| p as usize >= mesh.triangles.len())) {
            return Err("a candidate is no triangle".into());
        }
        all.gather_triangles(mesh);
        Ok(all)
    }
}

impl NodeSpaceParams {
    /// The grid of a node that is to have shafts.
    fn grid(&self, mesh: &Mesh, space: &NodeSpace, place: &Place) -> Option<ShaftGrid> {
        // A sphere has no plane that could stand for it.
        let has_planes = mesh.spheres.is_empty() || !matches!(self.each.payload, Payload::Candidates { .. });
        let is_large = place.count >= MIN_NODE_PRIMITIVES;
        if is_large && has_planes { Some(ShaftGrid::new(&space.bounds, self.each.n)?.without_limit()) } else { None }
    }
}

impl NodeSpace {
    fn roots<'a>(&self, all: &'a [ChildRef]) -> &'a [ChildRef] {
        &all[self.first_root as usize..(self.first_root + self.root_count) as usize]
    }
}

/// What lies below one node.
pub(crate) struct Below<'a> {
    pub structure: &'a MeshStructure,
    pub node: usize,
    pub primitives: &'a [u32],
    /// Where walks begin.
    pub roots: &'a [ChildRef],
}

impl<'a> Below<'a> {
    /// The whole mesh.
    pub(crate) fn root(structure: &'a MeshStructure) -> Self {
        Self { structure, node: 0, primitives: &structure.bvh2().primitives, roots: &[ChildRef::ROOT] }
    }

    pub(super) fn bounds(&self) -> Aabb {
        self.structure.bvh2().nodes.get(self.node).map_or(Aabb::EMPTY, |node| node.bounds())
    }
}

impl cast::Target for Below<'_> {
    fn trace(&self, ray: &Ray, sink: &mut impl Sink) {
        let Some(ray) = ObjectRay::new(ray, &self.structure.bvh2().bounds()) else { return };
        let counters = &mut Counters::default();
        Kernels::detect().walk_mesh_from(self.structure.wide(), self.roots, &ray, 0, sink, counters);
    }
}

/// The triangles of all candidates, side by side; the candidates become numbers of these.
pub(super) fn gather_triangles(mesh: &Mesh, mut all: Vec<&mut Shafts>) -> Vec<CandidateTriangle> {
    let mut used: Vec<u32> = Vec::new();
    for shafts in &all {
        if let Shafts::Candidates(candidates) = shafts {
            used.extend_from_slice(candidates.primitives());
        }
    }
    used.sort_unstable();
    used.dedup();
    for shafts in &mut all {
        if let Shafts::Candidates(candidates) = shafts {
            candidates.renumber(|primitive| used.partition_point(|&other| other < primitive) as u32);
        }
    }
    used.iter().map(|&primitive| CandidateTriangle::new(mesh, primitive)).collect()
}

/// The shafts of a node, but for classes.
pub(super) fn shafts(
    mesh: &Mesh,
    below: &Below<'_>,
    grid: &ShaftGrid,
    params: &LineSpaceParams,
    cancel: &AtomicBool,
) -> Result<Shafts, BuildError> {
    Ok(match params.payload {
        Payload::Binary { builder } => Shafts::Binary(match builder {
            BinaryBuilder::Masking => mask::by_masking(mesh, below, grid, cancel)?,
            BinaryBuilder::Clipping => mask::by_clipping(mesh, below, grid, cancel)?,
            BinaryBuilder::Casting(pattern) => cast::marks(below, grid, pattern, cancel)?,
        }),
        Payload::Candidates { pattern } => Shafts::Candidates(cast::candidates(below, grid, pattern, cancel)?),
        Payload::Coverage { bits, rays } => Shafts::Coverage(cast::coverage(below, grid, bits, rays, cancel)?),
        Payload::Classes { .. } => {
            return Err(BuildError::Unsupported("classes are built for whole meshes alone".into()));
        }
    })
}

/// The nodes at a depth, and above it the leaves and those with few primitives.
fn cut(bvh2: &Bvh2, depth: u32) -> Vec<Place> {
    let mut places = Vec::new();
    // Ends of the ranges of primitives: of the subtree that is left of what is still to come.
    let mut pending =
        if bvh2.nodes.is_empty() { vec![] } else { vec![(0_u32, 0_u32, bvh2.primitives.len() as u32, 0)] };
    while let Some((node, first, end, at)) = pending.pop() {
        let count = end - first;
        let entry = &bvh2.nodes[node as usize];
        if at == depth || entry.is_leaf() || count < MIN_NODE_PRIMITIVES {
            places.push(Place { node, first, count });
            continue;
        }
        // The first primitive of the right child's leftmost leaf.
        let mut leftmost = entry.right_or_first as usize;
        while !bvh2.nodes[leftmost].is_leaf() {
            leftmost += 1;
        }
        let middle = bvh2.nodes[leftmost].right_or_first;
        pending.push((entry.right_or_first, middle, end, at + 1));
        pending.push((node + 1, first, middle, at + 1));
    }
    places
}
