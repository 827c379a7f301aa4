//! Shapes (glTF meshes in their poses) to unique [`Mesh`]es: decoded in parallel, their primitives merged, equal ones found by hash.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use rayon::prelude::*;

use super::Session;
use super::accessor::Accessors;
use super::document::{self, Document};
use super::placement::Shape;
use super::primitive::{Context, Part};
use super::topology::Topology;
use crate::scene::error::{ImportError, Result};
use crate::scene::hash;
use crate::scene::limits::Limits;
use crate::scene::model::{Material, Mesh, MeshHash, Sphere};

/// Bytes that one vertex may come to: position, normal, tangent, two UV sets, colour.
const VERTEX_BYTES: u64 = 12 + 12 + 16 + 8 + 8 + 16;
/// Three indices and a slot.
const TRIANGLE_BYTES: u64 = 16;

/// What any decoded primitive costs, even an empty one.
const PRIMITIVE_BYTES: u64 = 512;

/// What a shape became.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    /// Index into the unique meshes.
    pub(super) mesh: u32,
    /// Material of each slot.
    pub(super) materials: Arc<[u32]>,
}

/// A decoded mesh before it is known whether another one equals it.
struct Decoded {
    mesh: Mesh,
    /// glTF material of each slot; `None` is the default material.
    materials: Vec<Option<usize>>,
}

/// A decoded primitive with its glTF material.
struct Piece {
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

/// Decodes the shapes; `None` for those with nothing in them. Adds glTF's default material where one is needed.
///
/// # Errors
/// Limit: over all shapes, more triangles or bytes than allowed. Malformed: as [`Part::decode`].
pub(super) fn load(
    document: &Document,
    accessors: &Accessors<'_>,
    materials: &mut Vec<Material>,
    shapes: &[Shape<'_>],
    unique: &mut Unique,
    session: &mut Session<'_>,
) -> Result<Vec<Option<Placed>>> {
    check_budget(document, shapes, session.limits)?;
    let primitives = |shape: &Shape<'_>| document.meshes[shape.mesh].primitives.len();
    let jobs: Vec<(usize, usize)> = shapes
        .iter()
        .enumerate()
        .flat_map(|(shape, of)| (0..primitives(of)).map(move |primitive| (shape, primitive)))
        .collect();
    let cancel = session.cancel;
    let parts: Result<Vec<Part>> = jobs
        .par_iter()
        .map(|(shape, index)| {
            if cancel() {
                return Err(ImportError::cancelled());
            }
            let Shape { mesh, pose } = &shapes[*shape];
            let primitive = &document.meshes[*mesh].primitives[*index];
            let context = Context {
                accessors,
                at: format!("meshes/{mesh}/primitives/{index}"),
                normal_map: primitive.material.and_then(|material| materials[material].normal_texture),
                pose,
            };
            Part::decode(primitive, &context)
        })
        .collect();

    let mut parts = parts?.into_iter();
    let groups: Vec<(usize, Vec<Piece>)> = shapes
        .iter()
        .map(|shape| {
            let pieces = parts.by_ref().take(primitives(shape)).zip(&document.meshes[shape.mesh].primitives);
            let pieces = pieces.map(|(mut part, primitive)| {
                session.warnings.append(std::mem::take(&mut part.warnings));
                Piece { material: primitive.material, part }
            });
            (shape.mesh, pieces.collect())
        })
        .collect();
    let decoded: Result<Vec<Option<Decoded>>> = groups
        .into_par_iter()
        .map(|(mesh, pieces)| {
            if cancel() {
                return Err(ImportError::cancelled());
            }
            Ok(merge(name(document, mesh), pieces))
        })
        .collect();

    let mut slots = Slots { default_material: None, materials, known: HashSet::new() };
    let mut placed = Vec::with_capacity(shapes.len());
    for (decoded, shape) in decoded?.into_iter().zip(shapes) {
        if decoded.is_none() {
            session.warnings.add(&format!("meshes/{}", shape.mesh), "has no triangles or spheres; skipped");
        }
        placed.push(
            decoded
                .map(|decoded| Placed { mesh: unique.add(decoded.mesh), materials: slots.share(&decoded.materials) }),
        );
    }
    Ok(placed)
}

/// Lists of materials for slots, each list once: as many instances as a scene has may share one.
struct Slots<'a> {
    materials: &'a mut Vec<Material>,
    default_material: Option<u32>,
    known: HashSet<Arc<[u32]>>,
}

impl Slots<'_> {
    fn share(&mut self, of_slots: &[Option<usize>]) -> Arc<[u32]> {
        let numbers: Vec<u32> = of_slots
            .iter()
            .map(|material| match material {
                Some(material) => *material as u32,
                None => *self.default_material.get_or_insert_with(|| {
                    self.materials.push(Material { name: "default".into(), ..Material::default() });
                    self.materials.len() as u32 - 1
                }),
            })
            .collect();
        if let Some(known) = self.known.get(numbers.as_slice()) {
            return known.clone();
        }
        let shared: Arc<[u32]> = numbers.into();
        self.known.insert(shared.clone());
        shared
    }
}

fn name(document: &Document, index: usize) -> String {
    match document.meshes[index].name.as_str() {
        "" => format!("mesh {index}"),
        name => name.to_owned(),
    }
}

/// Adds up what the primitives of all shapes will need, before any of it is allocated.
fn check_budget(document: &Document, shapes: &[Shape<'_>], limits: &Limits) -> Result<()> {
    let (mut triangles, mut bytes) = (0_u64, 0_u64);
    for shape in shapes {
        let mesh_index = shape.mesh;
        let mesh = &document.meshes[mesh_index];
        let has_normals = mesh.primitives.iter().any(|primitive| primitive.attributes.contains_key("NORMAL"));
        let mut mesh_vertices = 0_u64;
        for (index, primitive) in mesh.primitives.iter().enumerate() {
            let vertices =
                primitive.attributes.get("POSITION").map_or(0, |accessor| document.accessors[*accessor].count);
            let indices = primitive.indices.map_or(vertices, |accessor| document.accessors[accessor].count);
            let topology = Topology::from_mode(primitive.mode);
            let primitives = if topology == Topology::Points { indices } else { topology.triangle_count(indices) };
            triangles = triangles.saturating_add(primitives);
            let flattened = shape.pose.flattened.is_some();
            let vertices = vertices_after(document, primitive, has_normals, flattened, vertices, primitives);
            // Vertex numbers are 32 bits wide, with one value to spare for "none".
            mesh_vertices = mesh_vertices.saturating_add(vertices);
            let vertex_bytes = vertices.saturating_mul(VERTEX_BYTES);
            let triangle_bytes = primitives.saturating_mul(TRIANGLE_BYTES);
            bytes = bytes.saturating_add(vertex_bytes).saturating_add(triangle_bytes).saturating_add(PRIMITIVE_BYTES);
            let at = format_args!("meshes/{mesh_index}/primitives/{index}");
            Limits::check(at, "vertices in one mesh", mesh_vertices, u64::from(u32::MAX - 1))?;
            Limits::check(at, "triangles and spheres", triangles, limits.triangles)?;
            Limits::check(at, "bytes of geometry", bytes, limits.geometry_bytes)?;
        }
    }
    Ok(())
}

/// Vertices of a primitive at most, once flat normals and tangents are there.
fn vertices_after(
    document: &Document,
    primitive: &document::Primitive,
    mesh_has_normals: bool,
    flattened: bool,
    vertices: u64,
    triangles: u64,
) -> u64 {
    let normal_map = primitive.material.is_some_and(|material| document.materials[material].normal_texture.is_some());
    let has = |name: &str| primitive.attributes.contains_key(name) && !flattened;
    // Tangents count only beside normals.
    let needs_tangents = normal_map && !(has("TANGENT") && has("NORMAL"));
    let needs_normals = mesh_has_normals && !has("NORMAL");
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
    let mut mesh = Mesh::of_shapes(&name, Vec::new(), Vec::new(), Vec::new());
    mesh.slots = pieces.len() as u32;
    let mut materials = Vec::new();
    for (slot, Piece { material, part }) in pieces.into_iter().enumerate() {
        materials.push(material);
        append(&mut mesh, part, slot as u32);
    }
    mesh.bounds = mesh.shape_bounds();
    mesh.hash = hash::mesh_hash(&mesh);
    Some(Decoded { mesh, materials })
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
