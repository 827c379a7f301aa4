//! One glTF primitive, decoded: a [`Part`] of a mesh.

use glam::{DVec3, Vec3};

use super::accessor::Accessors;
use super::document::Primitive;
use super::pose::{Pose, Vertices};
use super::tangents;
use super::topology::{self, Topology};
use super::warnings::Warnings;
use crate::scene::error::{ImportError, Result};
use crate::scene::model::TextureRef;

/// Vertices and what they span. Attributes are empty where the file has none.
#[derive(Debug, Default)]
pub(super) struct Part {
    pub(super) positions: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    pub(super) tangents: Vec<[f32; 4]>,
    pub(super) uv0: Vec<[f32; 2]>,
    pub(super) uv1: Vec<[f32; 2]>,
    pub(super) colors: Vec<[f32; 4]>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Centres and radii.
    pub(super) spheres: Vec<(Vec3, f32)>,
    pub(super) warnings: Warnings,
}

/// What the document says around a primitive.
pub(super) struct Context<'a> {
    pub(super) accessors: &'a Accessors<'a>,
    /// Such as `meshes/0/primitives/1`.
    pub(super) at: String,
    /// The material's normal map: tangents are needed.
    pub(super) normal_map: Option<TextureRef>,
    pub(super) pose: &'a Pose<'a>,
}

impl Part {
    /// # Errors
    /// Malformed: an index out of range, a position that is not finite, attributes of unequal counts or wrong types.
    pub(super) fn decode(primitive: &Primitive, context: &Context<'_>) -> Result<Self> {
        let mut part = Self::default();
        let topology = Topology::from_mode(primitive.mode);
        let spheres = primitive.extensions.spheres.as_ref();
        if topology == Topology::Lines || (topology == Topology::Points && spheres.is_none()) {
            part.warnings.add(&context.at, "points and lines are not rendered; skipped");
            return Ok(part);
        }
        let Some(position) = primitive.attributes.get("POSITION").copied() else {
            part.warnings.add(&context.at, "has no POSITION; skipped");
            return Ok(part);
        };
        let vertices = context.accessors.count(position);
        for (name, accessor) in &primitive.attributes {
            let count = context.accessors.count(*accessor);
            if count != vertices {
                return Err(ImportError::malformed(
                    format!("{}/attributes/{name}", context.at),
                    format!("has {count} elements, but POSITION has {vertices}; they must be equal"),
                ));
            }
        }
        let mut indices = match primitive.indices {
            Some(accessor) => {
                let at = format!("{}/indices", context.at);
                let indices = context.accessors.indices(accessor, &at)?;
                topology::check_range(&indices, vertices, &at)?;
                indices
            }
            None => (0..vertices as u32).collect(),
        };
        if topology == Topology::Points {
            let radius = spheres.and_then(|spheres| spheres.radius);
            part.decode_spheres(primitive, context, position, &indices, radius)?;
            return Ok(part);
        }
        if topology == Topology::Triangles && indices.len() % 3 != 0 {
            let left = indices.len() % 3;
            part.warnings.add(&context.at, format!("the last {left} indices make no triangle; ignored"));
            indices.truncate(indices.len() - left);
        }
        let used = topology::compact(&mut indices, vertices);
        part.triangles = topology.triangles(&indices);
        drop(indices);
        part.read_attributes(primitive, context, position, used.as_deref())?;
        part.drop_degenerate(topology, &context.at);
        part.complete_tangents(context);
        Ok(part)
    }

    fn decode_spheres(
        &mut self,
        primitive: &Primitive,
        context: &Context<'_>,
        position: usize,
        indices: &[u32],
        radius: Option<f32>,
    ) -> Result<()> {
        let centers_at = format!("{}/attributes/POSITION", context.at);
        let centers = context.accessors.floats::<3>(position, Some(indices), &centers_at)?;
        check_finite(&centers, None, &centers_at)?;
        let radii: Vec<f32> = match (primitive.attributes.get("_RADIUS"), radius) {
            (Some(accessor), _) => {
                let at = format!("{}/attributes/_RADIUS", context.at);
                context
                    .accessors
                    .floats::<1>(*accessor, Some(indices), &at)?
                    .into_iter()
                    .map(|[radius]| radius)
                    .collect()
            }
            (None, Some(radius)) => vec![radius; centers.len()],
            (None, None) => {
                return Err(ImportError::malformed(
                    format!("{}/extensions/LIGHTSHAFT_spheres", context.at),
                    "needs a radius, either here or as the attribute _RADIUS",
                ));
            }
        };
        if let Some(place) = radii.iter().position(|radius| !radius.is_finite() || *radius < 0.0) {
            return Err(ImportError::malformed(
                format!("{}/attributes/_RADIUS", context.at),
                format!("radius {} of sphere {place} is not a positive finite number", radii[place]),
            ));
        }
        if context.pose.flattened.is_some() {
            self.warnings.add(&context.at, "a scale of zero flattens its spheres; skipped");
            return Ok(());
        }
        let mut centers: Vec<Vec3> = centers.into_iter().map(Vec3::from).collect();
        let mut vertices = Vertices { positions: &mut centers, normals: &mut Vec::new(), tangents: &mut Vec::new() };
        context.pose.apply(primitive, context, Some(indices), &mut vertices)?;
        self.spheres = centers.into_iter().zip(radii).collect();
        let before = self.spheres.len();
        self.spheres.retain(|(_, radius)| *radius > 0.0);
        if self.spheres.len() < before {
            let dropped = before - self.spheres.len();
            self.warnings.add(&context.at, format!("{dropped} spheres of radius 0 dropped"));
        }
        Ok(())
    }

    /// Reads the vertices that `subset` lists (`None`: all) and poses them.
    fn read_attributes(
        &mut self,
        primitive: &Primitive,
        context: &Context<'_>,
        position: usize,
        subset: Option<&[u32]>,
    ) -> Result<()> {
        let attribute = |name: &str| {
            let accessor = primitive.attributes.get(name).copied()?;
            Some((accessor, format!("{}/attributes/{name}", context.at)))
        };

        let at = format!("{}/attributes/POSITION", context.at);
        let positions = context.accessors.floats::<3>(position, subset, &at)?;
        check_finite(&positions, subset, &at)?;
        self.positions = positions.into_iter().map(Vec3::from).collect();

        for (name, target) in [("TEXCOORD_0", &mut self.uv0), ("TEXCOORD_1", &mut self.uv1)] {
            let Some((accessor, at)) = attribute(name) else { continue };
            *target = context.accessors.floats::<2>(accessor, subset, &at)?;
            if replace_non_finite(target, [0.0; 2]) {
                self.warnings.add(&at, "some values are not finite; 0 takes their place");
            }
        }
        if let Some((accessor, at)) = attribute("COLOR_0") {
            self.colors = if context.accessors.components(accessor) == 3 {
                let rgb = context.accessors.floats::<3>(accessor, subset, &at)?;
                rgb.into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect()
            } else {
                context.accessors.floats::<4>(accessor, subset, &at)?
            };
            if replace_non_finite(&mut self.colors, [1.0; 4]) {
                self.warnings.add(&at, "some values are not finite; 1 takes their place");
            }
        }
        if let Some((accessor, at)) = attribute("NORMAL") {
            let normals = context.accessors.floats::<3>(accessor, subset, &at)?;
            self.normals = normals.into_iter().map(Vec3::from).collect();
            // Tangents without normals are to be ignored (glTF 2.0, 3.7.2.1).
            if let Some((accessor, at)) = attribute("TANGENT") {
                self.tangents = context.accessors.floats::<4>(accessor, subset, &at)?;
            }
        }
        let mut vertices =
            Vertices { positions: &mut self.positions, normals: &mut self.normals, tangents: &mut self.tangents };
        context.pose.apply(primitive, context, subset, &mut vertices)?;
        self.repair_normals(&context.at);
        for (tangent, normal) in self.tangents.iter_mut().zip(&self.normals) {
            *tangent = tangents::repaired(*tangent, *normal);
        }
        Ok(())
    }

    /// Makes all normals unit vectors; one without a direction becomes the mean of its triangles'.
    fn repair_normals(&mut self, at: &str) {
        let mut missing = false;
        for normal in &mut self.normals {
            *normal = normal.try_normalize().unwrap_or(Vec3::ZERO);
            missing |= *normal == Vec3::ZERO;
        }
        if !missing {
            return;
        }
        let at = format!("{at}/attributes/NORMAL");
        self.warnings.add(&at, "some normals have no direction; the mean of their triangles' takes their place");
        let mut sums = vec![Vec3::ZERO; self.positions.len()];
        for triangle in &self.triangles {
            let face = face_normal(&self.positions, *triangle).unwrap_or(Vec3::ZERO);
            for vertex in triangle {
                sums[*vertex as usize] += face;
            }
        }
        for (normal, sum) in self.normals.iter_mut().zip(sums) {
            if *normal == Vec3::ZERO {
                *normal = sum.try_normalize().unwrap_or(Vec3::Y);
            }
        }
    }

    /// Drops triangles without area: no ray can hit them, and they only disturb structures.
    fn drop_degenerate(&mut self, topology: Topology, at: &str) {
        let before = self.triangles.len();
        // Strips are stitched together with triangles that name a vertex twice: nobody needs to hear of these.
        let repeats = |triangle: &[u32; 3]| {
            triangle[0] == triangle[1] || triangle[1] == triangle[2] || triangle[2] == triangle[0]
        };
        self.triangles.retain(|triangle| !repeats(triangle));
        let expected = if topology == Topology::TriangleStrip { self.triangles.len() } else { before };
        let positions = &self.positions;
        self.triangles.retain(|triangle| face_normal(positions, *triangle).is_some());
        let dropped = expected - self.triangles.len();
        if dropped > 0 {
            self.warnings.add(at, format!("{dropped} triangles without area dropped"));
        }
    }

    /// With a normal map but without tangents, computes them; flat normals first where there are none.
    fn complete_tangents(&mut self, context: &Context<'_>) {
        let Some(TextureRef { uv_set, transform, .. }) = context.normal_map else { return };
        if !self.tangents.is_empty() || self.triangles.is_empty() {
            return;
        }
        if self.normals.is_empty() {
            self.expand_flat_normals();
        }
        let uvs = if uv_set == 0 { &self.uv0 } else { &self.uv1 };
        if uvs.is_empty() {
            let message = format!("its normal map needs TEXCOORD_{uv_set}, which is not there");
            self.warnings.add(&context.at, message);
            return;
        }
        // The map is looked up with its transformed coordinates: they are what its red and green axes follow.
        let uvs: Vec<[f32; 2]> = uvs
            .iter()
            .map(|[u, v]| transform.map(|[along_u, along_v, offset]| along_u * u + along_v * v + offset))
            .collect();
        match tangents::corner_tangents(&self.triangles, &self.positions, &self.normals, &uvs) {
            Some(corners) => self.split_by_tangent(&corners),
            None => self.warnings.add(&context.at, "no tangents could be computed for its normal map"),
        }
    }

    /// Gives every triangle vertices of its own, with its geometric normal.
    pub(super) fn expand_flat_normals(&mut self) {
        let corners: Vec<u32> = self.triangles.iter().flatten().copied().collect();
        let faces: Vec<Vec3> =
            self.triangles.iter().map(|triangle| face_normal(&self.positions, *triangle).unwrap_or(Vec3::Y)).collect();
        self.gather(&corners);
        self.normals = faces.iter().flat_map(|normal| [*normal; 3]).collect();
        self.triangles = (0..faces.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    }

    /// Vertex `i` becomes a copy of the old vertex `sources[i]`.
    fn gather(&mut self, sources: &[u32]) {
        fn pick<T: Copy>(values: &mut Vec<T>, sources: &[u32]) {
            if !values.is_empty() {
                *values = sources.iter().map(|source| values[*source as usize]).collect();
            }
        }
        pick(&mut self.positions, sources);
        pick(&mut self.normals, sources);
        pick(&mut self.tangents, sources);
        pick(&mut self.uv0, sources);
        pick(&mut self.uv1, sources);
        pick(&mut self.colors, sources);
    }

    /// One vertex for every old vertex and each different tangent of its corners.
    fn split_by_tangent(&mut self, corners: &[[[f32; 4]; 3]]) {
        const NONE: u32 = u32::MAX;
        // A list per old vertex: its first new vertex, and each new vertex's successor.
        let mut first = vec![NONE; self.positions.len()];
        let mut next: Vec<u32> = Vec::with_capacity(self.positions.len());
        let mut sources: Vec<u32> = Vec::with_capacity(self.positions.len());
        let mut tangents: Vec<[f32; 4]> = Vec::with_capacity(self.positions.len());
        for (triangle, corner_tangents) in self.triangles.iter_mut().zip(corners) {
            for (vertex, tangent) in triangle.iter_mut().zip(corner_tangents) {
                let mut candidate = first[*vertex as usize];
                while candidate != NONE && tangents[candidate as usize] != *tangent {
                    candidate = next[candidate as usize];
                }
                if candidate == NONE {
                    candidate = sources.len() as u32;
                    sources.push(*vertex);
                    tangents.push(*tangent);
                    next.push(first[*vertex as usize]);
                    first[*vertex as usize] = candidate;
                }
                *vertex = candidate;
            }
        }
        self.gather(&sources);
        self.tangents = tangents;
    }
}

/// The unit normal by the winding; `None` for a triangle without area. In double precision, so that no tiny or long
/// thin triangle is mistaken for an empty one.
pub(in crate::scene) fn face_normal(positions: &[Vec3], triangle: [u32; 3]) -> Option<Vec3> {
    let [a, b, c] = triangle.map(|vertex| positions[vertex as usize].as_dvec3());
    let cross: DVec3 = (b - a).cross(c - a);
    let length = cross.length();
    (length > 0.0).then(|| (cross / length).as_vec3())
}

fn check_finite(vectors: &[[f32; 3]], numbers: Option<&[u32]>, at: &str) -> Result<()> {
    let Some(place) = vectors.iter().position(|vector| !vector.iter().all(|entry| entry.is_finite())) else {
        return Ok(());
    };
    let vertex = numbers.map_or(place as u32, |numbers| numbers[place]);
    Err(ImportError::malformed(at, format!("vertex {vertex} is {:?}; positions must be finite", vectors[place])))
}

fn replace_non_finite<const N: usize>(values: &mut [[f32; N]], replacement: [f32; N]) -> bool {
    let mut replaced = false;
    for value in values {
        if !value.iter().all(|entry| entry.is_finite()) {
            *value = replacement;
            replaced = true;
        }
    }
    replaced
}
