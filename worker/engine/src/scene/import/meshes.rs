//! glTF meshes to unique [`Mesh`]es: decoded in parallel, their primitives merged, equal ones found by hash.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::Session;
use super::accessor::Accessors;
use super::document::{self, Document};
use super::primitive::{Context, Part};
use super::topology::Topology;
use crate::scene::error::{ImportError, Result};
use crate::scene::hash;
use crate::scene::limits::Limits;
use crate::scene::model::{Aabb, Material, Mesh, MeshHash, Sphere};

/// Bytes that one vertex may come to: position, normal, tangent, two UV sets, colour.
const VERTEX_BYTES: u64 = 12 + 12 + 16 + 8 + 8 + 16;
/// Three indices and a slot.
const TRIANGLE_BYTES: u64 = 16;

/// What a glTF mesh became.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    /// Index into the unique meshes.
    pub(super) mesh: u32,
    /// glTF material of each slot; `None` is the default material.
    pub(super) materials: Vec<Option<usize>>,
    /// Where the vertices of each slot come from.
    pub(super) sources: Vec<VertexSource>,
}

/// Where the vertices of one part of a mesh come from.
#[derive(Clone, Debug)]
pub(super) struct VertexSource {
    /// Index into the glTF mesh's primitives.
    pub(super) primitive: usize,
    /// The part's vertices in the merged mesh.
    pub(super) vertices: Range<usize>,
    /// Number of each vertex in the primitive's accessors; `None` when the numbers are the same.
    pub(super) origin: Option<Vec<u32>>,
}

/// A decoded mesh before it is known whether another one equals it.
struct Decoded {
    mesh: Mesh,
    materials: Vec<Option<usize>>,
    sources: Vec<VertexSource>,
}

/// A decoded primitive with its place in its mesh.
struct Piece {
    primitive: usize,
    material: Option<usize>,
    part: Part,
}

/// Collects meshes, each hash once.
#[derive(Debug, Default)]
pub(super) struct Unique {
    pub(super) meshes: Vec<Arc<Mesh>>,
    by_hash: HashMap<MeshHash, u32>,
}

impl Unique {
    pub(super) fn add(&mut self, mesh: Mesh) -> u32 {
        *self.by_hash.entry(mesh.hash).or_insert_with(|| {
            self.meshes.push(Arc::new(mesh));
            self.meshes.len() as u32 - 1
        })
    }
}

/// Decodes the meshes for which `used` says so; `None` for the others and for meshes with nothing in them.
pub(super) fn load(
    document: &Document,
    accessors: &Accessors<'_>,
    materials: &[Material],
    used: &[bool],
    unique: &mut Unique,
    session: &mut Session<'_>,
) -> Result<Vec<Option<Placed>>> {
    check_budget(document, used, session.limits)?;
    let jobs: Vec<(usize, usize)> = (0..document.meshes.len())
        .filter(|mesh| used[*mesh])
        .flat_map(|mesh| (0..document.meshes[mesh].primitives.len()).map(move |primitive| (mesh, primitive)))
        .collect();
    let cancel = session.cancel;
    let parts: Result<Vec<Part>> = jobs
        .par_iter()
        .map(|(mesh, index)| {
            if cancel() {
                return Err(ImportError::cancelled());
            }
            let primitive = &document.meshes[*mesh].primitives[*index];
            let normal_map = primitive.material.and_then(|material| materials[material].normal_texture);
            let context = Context {
                accessors,
                at: format!("meshes/{mesh}/primitives/{index}"),
                normal_map_uv: normal_map.map(|texture| texture.uv_set),
            };
            Part::decode(primitive, &context)
        })
        .collect();

    let mut groups: Vec<(usize, Vec<Piece>)> = Vec::new();
    for ((mesh, primitive), mut part) in jobs.into_iter().zip(parts?) {
        session.warnings.append(std::mem::take(&mut part.warnings));
        let piece = Piece { primitive, material: document.meshes[mesh].primitives[primitive].material, part };
        match groups.last_mut() {
            Some((last, group)) if *last == mesh => group.push(piece),
            _ => groups.push((mesh, vec![piece])),
        }
    }
    let decoded: Result<Vec<(usize, Option<Decoded>)>> = groups
        .into_par_iter()
        .map(|(index, pieces)| {
            if cancel() {
                return Err(ImportError::cancelled());
            }
            Ok((index, merge(name(document, index), pieces)))
        })
        .collect();

    let mut placed: Vec<Option<Placed>> = vec![None; document.meshes.len()];
    for (index, decoded) in decoded? {
        placed[index] =
            decoded.map(|Decoded { mesh, materials, sources }| Placed { mesh: unique.add(mesh), materials, sources });
    }
    for (index, is_used) in used.iter().enumerate() {
        if *is_used && placed[index].is_none() {
            session.warnings.add(&format!("meshes/{index}"), "has no triangles or spheres; skipped");
        }
    }
    Ok(placed)
}

pub(super) fn name(document: &Document, index: usize) -> String {
    match document.meshes[index].name.as_str() {
        "" => format!("mesh {index}"),
        name => name.to_owned(),
    }
}

/// Adds up what the primitives will need, before any of it is allocated.
fn check_budget(document: &Document, used: &[bool], limits: &Limits) -> Result<()> {
    let (mut triangles, mut bytes) = (0_u64, 0_u64);
    for (mesh_index, mesh) in document.meshes.iter().enumerate().filter(|(index, _)| used[*index]) {
        let has_normals = mesh.primitives.iter().any(|primitive| primitive.attributes.contains_key("NORMAL"));
        let mut mesh_vertices = 0_u64;
        for (index, primitive) in mesh.primitives.iter().enumerate() {
            let vertices =
                primitive.attributes.get("POSITION").map_or(0, |accessor| document.accessors[*accessor].count);
            let indices = primitive.indices.map_or(vertices, |accessor| document.accessors[accessor].count);
            let at = format!("meshes/{mesh_index}/primitives/{index}");
            let topology = Topology::from_mode(primitive.mode);
            let primitives = if topology == Topology::Points { indices } else { topology.triangle_count(indices) };
            triangles = triangles.saturating_add(primitives);
            let vertices = vertices_after(document, primitive, has_normals, vertices, primitives);
            // Vertex numbers are 32 bits wide, with one value to spare for "none".
            mesh_vertices = mesh_vertices.saturating_add(vertices);
            Limits::check(&at, "vertices in one mesh", mesh_vertices, u64::from(u32::MAX - 1))?;
            let vertex_bytes = vertices.saturating_mul(VERTEX_BYTES);
            bytes = bytes.saturating_add(vertex_bytes).saturating_add(primitives.saturating_mul(TRIANGLE_BYTES));
            Limits::check(&at, "triangles and spheres", triangles, limits.triangles)?;
            Limits::check(&at, "bytes of geometry", bytes, limits.geometry_bytes)?;
        }
    }
    Ok(())
}

/// Vertices of a primitive at most, once flat normals and tangents are there.
fn vertices_after(
    document: &Document,
    primitive: &document::Primitive,
    mesh_has_normals: bool,
    vertices: u64,
    triangles: u64,
) -> u64 {
    let normal_map = primitive.material.is_some_and(|material| document.materials[material].normal_texture.is_some());
    let needs_tangents = normal_map && !primitive.attributes.contains_key("TANGENT");
    let needs_normals = mesh_has_normals && !primitive.attributes.contains_key("NORMAL");
    if needs_tangents || needs_normals { vertices.max(triangles.saturating_mul(3)) } else { vertices }
}

/// Joins the pieces of one mesh; `None` when they hold nothing. Pieces without triangles and spheres get no slot.
fn merge(name: String, mut pieces: Vec<Piece>) -> Option<Decoded> {
    pieces.retain(|piece| !piece.part.triangles.is_empty() || !piece.part.spheres.is_empty());
    if pieces.is_empty() {
        return None;
    }
    if pieces.iter().any(|piece| !piece.part.normals.is_empty()) {
        for Piece { part, .. } in &mut pieces {
            if part.normals.is_empty() {
                part.expand_flat_normals();
            }
        }
    }
    let mut mesh = Mesh {
        hash: MeshHash([0; 32]),
        name,
        positions: Vec::new(),
        triangles: Vec::new(),
        triangle_slots: Vec::new(),
        normals: Vec::new(),
        tangents: Vec::new(),
        uv0: Vec::new(),
        uv1: Vec::new(),
        colors: Vec::new(),
        spheres: Vec::new(),
        slots: pieces.len() as u32,
        bounds: Aabb::EMPTY,
    };
    let mut materials = Vec::new();
    let mut sources = Vec::new();
    for (slot, Piece { primitive, material, mut part }) in pieces.into_iter().enumerate() {
        let start = mesh.positions.len();
        let vertices = start..start + part.positions.len();
        sources.push(VertexSource { primitive, vertices, origin: part.origin.take() });
        materials.push(material);
        append(&mut mesh, part, slot as u32);
    }
    finish(&mut mesh);
    Some(Decoded { mesh, materials, sources })
}

/// Bounds and hash of a mesh whose arrays are complete.
pub(super) fn finish(mesh: &mut Mesh) {
    mesh.bounds = bounds(mesh);
    mesh.hash = hash::mesh_hash(mesh);
}

fn append(mesh: &mut Mesh, part: Part, slot: u32) {
    let base = mesh.positions.len() as u32;
    let before = mesh.positions.len();
    let after = before + part.positions.len();
    if base == 0 {
        // The usual mesh has one primitive: its arrays move without a copy.
        mesh.triangles = part.triangles;
        mesh.triangle_slots = vec![slot; mesh.triangles.len()];
    } else {
        mesh.triangle_slots.extend(std::iter::repeat_n(slot, part.triangles.len()));
        mesh.triangles.extend(part.triangles.iter().map(|triangle| triangle.map(|vertex| vertex + base)));
    }
    // Values that no shading reads stand in for attributes that only other parts have.
    extend(&mut mesh.normals, part.normals, before, after, glam::Vec3::Y);
    extend(&mut mesh.tangents, part.tangents, before, after, [1.0, 0.0, 0.0, 1.0]);
    extend(&mut mesh.uv0, part.uv0, before, after, [0.0; 2]);
    extend(&mut mesh.uv1, part.uv1, before, after, [0.0; 2]);
    extend(&mut mesh.colors, part.colors, before, after, [1.0; 4]);
    extend(&mut mesh.positions, part.positions, before, after, glam::Vec3::ZERO);
    mesh.spheres.extend(part.spheres.iter().map(|(center, radius)| Sphere { center: *center, radius: *radius, slot }));
}

/// Appends a part's attribute; the array stays empty as long as no part has it.
fn extend<T: Copy>(all: &mut Vec<T>, part: Vec<T>, before: usize, after: usize, missing: T) {
    if all.is_empty() && part.is_empty() {
        return;
    }
    if before == 0 {
        *all = part;
    } else {
        all.resize(before, missing);
        all.extend(part);
    }
    all.resize(after, missing);
}

fn bounds(mesh: &Mesh) -> Aabb {
    let mut bounds = Aabb::EMPTY;
    // Parts are compacted, but dropped triangles may leave vertices behind: only those in use count.
    for triangle in &mesh.triangles {
        for vertex in triangle {
            bounds.grow(mesh.positions[*vertex as usize]);
        }
    }
    for sphere in &mesh.spheres {
        bounds.grow(sphere.center - sphere.radius);
        bounds.grow(sphere.center + sphere.radius);
    }
    bounds
}
