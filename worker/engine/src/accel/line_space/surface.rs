//! Surface shafts: what rays meet that start on the mesh itself (beyond Keul).
//!
//! Shadow, ambient-occlusion and indirect rays start on surfaces, so half of the work of an instanced scene is a mesh
//! tested against its own rays, of which a shaft between two patches of its box says nothing. Here the start is a cluster
//! of triangles (a subtree of the BVH) and the end a patch of the root box. A row, all patches of one cluster, is
//! contiguous: the rays of a pixel read the same few cache lines.
//!
//! For rays that leave a triangle of the cluster on its front side and the box through the patch:
//! EMPTY says that none meets the mesh again, OPAQUE that all do.
//!
//! - **Sampled** rows say what some random rays did. They approximate, and [`SurfaceShafts::wrong_share`] measures how well.
//! - **Proven** rows hold for every ray. A ray that starts on A meets no B that lies below A's plane, for it rises
//!   from it; nor a B that A lies above the plane of, when the exit patch is higher above that plane than A is, for then
//!   it rises from that one too. Of two neighbours at an edge one is always so: the first where the surface is convex, the
//!   second where it is concave. And no ray at all leads from A to a patch below A's plane. EMPTY is every pair of a cluster
//!   and a patch between which each triangle passes one of the tests. (OPAQUE is not proven: those pairs are MIXED. So are most where triangles lie in one plane but for
//!   rounding, which may lift one above the other.)

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::store;
use super::surface_rows::{RowBuilder, Scatter};
use super::{Class, LINE_SPACE_VERSION, Location, Patch, ShaftGrid, Verdict};
use crate::accel::build::check;
use crate::accel::{BuildError, CorruptStructure, MeshStructure, StructureKey};
use crate::scene::{Mesh, MeshHash};
use crate::trace::{Kernels, Ray};

/// Codes in a word of a row.
const CODES: usize = 16;
/// Finest N: 24 words a row at 8, 96 at 16.
const MAX_SURFACE_N: u32 = 16;
/// Clusters are numbered in 16 bits; this number means none.
const NO_CLUSTER: u16 = u16::MAX;

/// Parameters of surface shafts. [`Self::canonical`] is their part of the cache key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SurfaceShaftParams {
    /// Patches along the edge of a face, 1 to 16.
    pub n: u32,
    /// Most triangles of a cluster, 1 to 4096; twice as many, and so on, where a mesh has too many clusters to number.
    pub cluster: u32,
    pub evidence: Evidence,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Evidence {
    /// Holds for every ray.
    Proven,
    /// Holds for so many random rays of each pair, 1 to 1024: an approximation.
    Sampled { rays: u32 },
}

impl SurfaceShaftParams {
    /// E.g. `n=8,cluster=128,evidence=sampled,rays=24`.
    pub fn canonical(&self) -> String {
        let evidence = match self.evidence {
            Evidence::Proven => "proven".to_owned(),
            Evidence::Sampled { rays } => format!("sampled,rays={rays}"),
        };
        format!("n={},cluster={},evidence={evidence}", self.n, self.cluster)
    }

    /// The key of a mesh's surface shafts in every cache.
    pub fn key(&self, mesh: MeshHash) -> StructureKey {
        StructureKey { mesh, kind: "surface_shafts", parameters: self.canonical(), builder_version: LINE_SPACE_VERSION }
    }

    /// Says which parameter is out of range, and what would be right.
    pub fn check(&self) -> Result<(), String> {
        let range = |name: &str, value: u32, most: u32| {
            let is_right = (1..=most).contains(&value);
            if is_right {
                Ok(())
            } else {
                Err(format!("surface_shafts.{name} is {value}; it must be from 1 to {most}"))
            }
        };
        range("n", self.n, MAX_SURFACE_N)?;
        range("cluster", self.cluster, 4096)?;
        match self.evidence {
            Evidence::Proven => Ok(()),
            Evidence::Sampled { rays } => range("rays", rays, 1024),
        }
    }

    fn words_per_row(&self) -> usize {
        (6 * self.n * self.n).div_ceil(CODES as u32) as usize
    }

    /// Bytes for a mesh with so many primitives, at most: a row for every leaf of the tree when clusters are that small.
    pub fn bytes_at_most(&self, primitives: usize) -> u64 {
        primitives as u64 * 2 + primitives as u64 * 4 * self.words_per_row() as u64
    }
}

/// The surface shafts of one mesh. Immutable; share them in an [`std::sync::Arc`].
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceShafts {
    mesh: MeshHash,
    params: SurfaceShaftParams,
    /// None for a mesh whose box single precision cannot divide.
    content: Option<Content>,
}

#[derive(Clone, Debug, PartialEq)]
struct Content {
    grid: ShaftGrid,
    /// Of each primitive; spheres have none.
    clusters: Vec<u16>,
    rows: Vec<u32>,
}

impl SurfaceShafts {
    /// Builds with rayon's current pool; looks at `cancel` once for each cluster.
    ///
    /// # Errors
    /// [`BuildError::Unsupported`] for parameters out of range, and with the figure when more than `budget_bytes` would
    /// be taken.
    pub fn build(
        mesh: &Mesh,
        structure: &MeshStructure,
        params: &SurfaceShaftParams,
        budget_bytes: u64,
        cancel: &AtomicBool,
    ) -> Result<Self, BuildError> {
        params.check().map_err(BuildError::Unsupported)?;
        let Some(grid) = ShaftGrid::new(&structure.bvh2().bounds(), params.n) else {
            return Ok(Self { mesh: mesh.hash, params: *params, content: None });
        };
        let ranges = cluster_ranges(structure, params.cluster);
        let words_per_row = params.words_per_row();
        let needed = (mesh.primitive_count() * 2 + ranges.len() * words_per_row * 4) as u64;
        if needed > budget_bytes {
            return Err(BuildError::Unsupported(format!(
                "the surface shafts of a mesh ({}) take {needed} bytes; the budget is {budget_bytes}",
                params.canonical()
            )));
        }
        let triangles = mesh.triangles.len();
        let mut clusters = vec![NO_CLUSTER; mesh.primitive_count()];
        for (number, &(first, count)) in (0..).zip(&ranges) {
            for &primitive in &structure.bvh2().primitives[first as usize..(first + count) as usize] {
                // With spatial splits a triangle may stand in several: in the last one it is as good as in any.
                if (primitive as usize) < triangles {
                    clusters[primitive as usize] = number;
                }
            }
        }
        let mut members = vec![Vec::new(); ranges.len()];
        for (triangle, &cluster) in (0..).zip(&clusters).filter(|(_, cluster)| **cluster != NO_CLUSTER) {
            members[cluster as usize].push(triangle);
        }
        let builder = RowBuilder { mesh, structure, grid: &grid, kernels: Kernels::detect() };
        let mut rows = vec![0; ranges.len() * words_per_row];
        rows.par_chunks_mut(words_per_row).zip(&members).enumerate().try_for_each(|(number, (row, members))| {
            check(cancel)?;
            let class: Box<dyn FnMut(Patch) -> Class> = match params.evidence {
                Evidence::Proven => builder.proven(members),
                Evidence::Sampled { rays } => builder.sampled(number as u32, members, rays),
            };
            fill(row, params.n, class);
            Ok(())
        })?;
        Ok(Self { mesh: mesh.hash, params: *params, content: Some(Content { grid, clusters, rows }) })
    }

    /// The mesh that they were built for.
    pub fn mesh(&self) -> MeshHash {
        self.mesh
    }

    pub fn params(&self) -> &SurfaceShaftParams {
        &self.params
    }

    /// Whether what they say holds for every ray.
    pub fn is_exact(&self) -> bool {
        self.params.evidence == Evidence::Proven
    }

    /// Memory that they take, in bytes.
    pub fn bytes(&self) -> usize {
        self.content
            .as_ref()
            .map_or(0, |content| size_of_val(content.clusters.as_slice()) + size_of_val(content.rows.as_slice()))
    }

    /// Pairs of a cluster and a patch that are EMPTY, OPAQUE and MIXED.
    pub fn census(&self) -> [u64; 3] {
        let mut found = [0; 3];
        let Some(content) = &self.content else { return found };
        for row in content.rows.chunks(self.params.words_per_row()) {
            for patch in 0..(6 * self.params.n * self.params.n) as usize {
                found[(row[patch / CODES] >> (2 * (patch % CODES)) & 3) as usize] += 1;
            }
        }
        found
    }

    /// What is known of a ray, in the mesh's space, that leaves the front side of a triangle.
    #[inline]
    pub(crate) fn verdict(&self, ray: &Ray, triangle: u32, counters: &mut [u64; 3]) -> Verdict {
        let Some(content) = &self.content else { return Verdict::Unknown };
        let cluster = content.clusters.get(triangle as usize).copied().unwrap_or(NO_CLUSTER);
        let is_valid = ray.origin.is_finite() && ray.direction.is_finite() && ray.t_min.max(0.0) < ray.t_max;
        if cluster == NO_CLUSTER || !is_valid {
            return Verdict::Unknown;
        }
        let Location::Through(chord) = content.grid.locate(ray) else { return Verdict::Unknown };
        let patch = chord.exit.index(self.params.n) as usize;
        let word = content.rows[cluster as usize * self.params.words_per_row() + patch / CODES];
        let code = word >> (2 * (patch % CODES)) & 3;
        counters[code as usize] += 1;
        if code == Class::Empty as u32 {
            Verdict::Miss
        } else if code == Class::Opaque as u32 && chord.reaches_exit {
            Verdict::Hit
        } else {
            Verdict::Unknown
        }
    }

    /// The share of random decided rays for which the rows are wrong: 0 for proven ones.
    ///
    /// Rays start at random points of random triangles and end at random points of the box's surface.
    pub fn wrong_share(&self, mesh: &Mesh, structure: &MeshStructure, rays: u32, seed: u32) -> f64 {
        let Some(content) = &self.content else { return 0.0 };
        let builder = RowBuilder { mesh, structure, grid: &content.grid, kernels: Kernels::detect() };
        let triangles = mesh.triangles.len() as u32;
        let n = self.params.n;
        let (decided, wrong) = (0..rays)
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| {
                let mut random = Scatter(u64::from(seed) << 32 | u64::from(i));
                let triangle = random.below(triangles.max(1));
                let patch = Patch::from_index(n, random.below(6 * n * n));
                let Some(ray) = builder.ray(triangle, patch, &mut random) else { return (0, 0) };
                let expected = match self.verdict(&ray, triangle, &mut [0; 3]) {
                    Verdict::Miss => false,
                    Verdict::Hit => true,
                    Verdict::Unknown => return (0, 0),
                };
                (1, u64::from(builder.is_blocked(&ray) != expected))
            })
            .reduce(|| (0_u64, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        if decided == 0 { 0.0 } else { wrong as f64 / decided as f64 }
    }

    /// The stored form, as of a Line Space.
    pub fn encode(&self) -> Vec<u8> {
        let Some(content) = &self.content else { return store::seal(self.mesh, &self.params.canonical(), &[]) };
        let pair = |pair: &[u16]| u32::from(pair[0]) | u32::from(pair.get(1).copied().unwrap_or(0)) << 16;
        let clusters: Vec<u32> = content.clusters.chunks(2).map(pair).collect();
        store::seal(self.mesh, &self.params.canonical(), &[&clusters, &content.rows])
    }

    /// Reads what [`Self::encode`] wrote for `mesh` with `params`, and checks every number of it.
    pub fn decode(
        bytes: &[u8],
        mesh: &Mesh,
        structure: &MeshStructure,
        params: &SurfaceShaftParams,
    ) -> Result<Self, CorruptStructure> {
        Self::decoded(bytes, mesh, structure, params).map_err(CorruptStructure)
    }

    fn decoded(
        bytes: &[u8],
        mesh: &Mesh,
        structure: &MeshStructure,
        params: &SurfaceShaftParams,
    ) -> Result<Self, String> {
        params.check()?;
        let arrays = store::open(bytes, mesh, structure, &params.canonical())?;
        let space = |content| Self { mesh: mesh.hash, params: *params, content };
        let Some(grid) = ShaftGrid::new(&structure.bvh2().bounds(), params.n) else {
            return if arrays.is_empty() { Ok(space(None)) } else { Err("shafts for a box that has none".into()) };
        };
        let [pairs, rows] = store::exactly(arrays)?;
        let count = mesh.primitive_count();
        if pairs.len() != count.div_ceil(2) {
            return Err(format!("clusters of {} pairs of primitives, not {}", pairs.len(), count.div_ceil(2)));
        }
        let mut clusters: Vec<u16> = pairs.iter().flat_map(|&pair| [pair as u16, (pair >> 16) as u16]).collect();
        clusters.truncate(count);
        let words = params.words_per_row();
        let row_count = rows.len() / words;
        if !rows.len().is_multiple_of(words) {
            return Err(format!("{} words are no rows of {words}", rows.len()));
        }
        if let Some(cluster) = clusters.iter().find(|&&c| c != NO_CLUSTER && usize::from(c) >= row_count) {
            return Err(format!("cluster {cluster} of {row_count}"));
        }
        if let Some(word) = rows.iter().position(|&word| word & (word >> 1) & 0x5555_5555 != 0) {
            return Err(format!("word {word} of the rows has a code that is not a class"));
        }
        Ok(space(Some(Content { grid, clusters, rows })))
    }
}

/// Ranges (first, count) of the primitives of subtrees with at most `most` of them, or more where those are too many.
fn cluster_ranges(structure: &MeshStructure, most: u32) -> Vec<(u32, u32)> {
    let nodes = &structure.bvh2().nodes;
    let mut spans = vec![(0, 0); nodes.len()];
    for index in (0..nodes.len()).rev() {
        let node = &nodes[index];
        spans[index] = if node.is_leaf() {
            (node.right_or_first, node.count)
        } else {
            let (left, right) = (spans[index + 1], spans[node.right_or_first as usize]);
            (left.0, left.1 + right.1)
        };
    }
    let mut most = most;
    loop {
        let mut ranges = Vec::new();
        let mut pending = if nodes.is_empty() { vec![] } else { vec![0] };
        while let Some(index) = pending.pop() {
            if spans[index].1 <= most || nodes[index].is_leaf() {
                ranges.push(spans[index]);
            } else {
                pending.extend([nodes[index].right_or_first as usize, index + 1]);
            }
        }
        if ranges.len() < usize::from(NO_CLUSTER) {
            return ranges;
        }
        most *= 2;
    }
}

/// Writes a row of codes.
fn fill(row: &mut [u32], n: u32, mut class: impl FnMut(Patch) -> Class) {
    for patch in 0..6 * n * n {
        let code = class(Patch::from_index(n, patch)) as u32;
        row[patch as usize / CODES] |= code << (2 * (patch as usize % CODES));
    }
}
