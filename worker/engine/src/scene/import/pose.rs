//! Meshes with morph targets and skins, frozen in the pose that the file holds outside of any animation.
//!
//! Morph targets come first, then the skin (glTF 2.0, 3.7.2.2 and 3.7.3). A skinned mesh follows its joints and ignores
//! its own node, so the result is in world space.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};

use super::Session;
use super::accessor::Accessors;
use super::document::Document;
use super::meshes::{self, Placed, Unique, VertexSource};
use super::nodes::Graph;
use super::tangents;
use crate::scene::error::{ImportError, Result};
use crate::scene::model::Mesh;

pub(super) struct Posed {
    /// Index into the unique meshes.
    pub(super) mesh: u32,
    /// Whether the mesh is in world space rather than in its node's.
    pub(super) in_world: bool,
}

/// The mesh of node `index` in its pose; `None` when it has none and stays as it is.
pub(super) fn posed_mesh(
    document: &Document,
    graph: &Graph,
    accessors: &Accessors<'_>,
    index: usize,
    place: &Placed,
    unique: &mut Unique,
    session: &mut Session<'_>,
) -> Result<Option<Posed>> {
    let node = &document.nodes[index];
    let Some(mesh_index) = node.mesh else { return Ok(None) };
    let weights = node.weights.as_ref().or(document.meshes[mesh_index].weights.as_ref());
    let weights: &[f32] = weights.map_or(&[], Vec::as_slice);
    let morphs = weights.iter().any(|weight| *weight != 0.0);
    let joints = match node.skin {
        Some(skin) => joint_matrices(document, graph, accessors, skin, session)?,
        None => None,
    };
    if !morphs && joints.is_none() {
        return Ok(None);
    }
    let mut mesh = Mesh::clone(&unique.meshes[place.mesh as usize]);
    for source in &place.sources {
        let pose = Pose { document, accessors, mesh_index, source };
        if morphs {
            pose.morph(&mut mesh, weights)?;
        }
        if let (Some(joints), Some(world)) = (&joints, &graph.world[index]) {
            pose.skin(&mut mesh, joints, world)?;
        }
    }
    if !mesh.positions.iter().all(|position| position.is_finite()) {
        return Err(ImportError::malformed(
            format!("nodes/{index}"),
            "its morph targets or skin move vertices beyond all bounds",
        ));
    }
    meshes::finish(&mut mesh);
    Ok(Some(Posed { mesh: unique.add(mesh), in_world: joints.is_some() }))
}

/// Joint's world transform times its inverse bind matrix; `None`, with a warning, when a joint is not in the scene.
fn joint_matrices(
    document: &Document,
    graph: &Graph,
    accessors: &Accessors<'_>,
    skin_index: usize,
    session: &mut Session<'_>,
) -> Result<Option<Vec<DAffine3>>> {
    let skin = &document.skins[skin_index];
    let at = format!("skins/{skin_index}/inverseBindMatrices");
    let inverse_bind: Vec<DAffine3> = match skin.inverse_bind_matrices {
        None => vec![DAffine3::IDENTITY; skin.joints.len()],
        Some(accessor) => accessors
            .floats::<16>(accessor, None, &at)?
            .into_iter()
            .map(|matrix| DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from))))
            .collect(),
    };
    if inverse_bind.len() < skin.joints.len() {
        let message = format!("has {} matrices for {} joints", inverse_bind.len(), skin.joints.len());
        return Err(ImportError::malformed(at, message));
    }
    let joints: Option<Vec<DAffine3>> =
        skin.joints.iter().zip(inverse_bind).map(|(joint, inverse)| Some(graph.world[*joint]? * inverse)).collect();
    if joints.is_none() {
        let message = "not all of its joints are in the scene; shown without the skin";
        session.warnings.add(&format!("skins/{skin_index}"), message);
    }
    Ok(joints)
}

/// One part of a mesh and where its vertices come from.
struct Pose<'a> {
    document: &'a Document,
    accessors: &'a Accessors<'a>,
    mesh_index: usize,
    source: &'a VertexSource,
}

impl Pose<'_> {
    fn at(&self, rest: &str) -> String {
        format!("meshes/{}/primitives/{}/{rest}", self.mesh_index, self.source.primitive)
    }

    fn read<const N: usize>(
        &self,
        attributes: &std::collections::BTreeMap<String, usize>,
        prefix: &str,
        name: &str,
    ) -> Result<Option<Vec<[f32; N]>>> {
        let Some(accessor) = attributes.get(name).copied() else { return Ok(None) };
        let at = self.at(&format!("{prefix}/{name}"));
        let primitive = &self.document.meshes[self.mesh_index].primitives[self.source.primitive];
        let vertices = primitive.attributes.get("POSITION").map_or(0, |position| self.accessors.count(*position));
        if self.accessors.count(accessor) != vertices {
            return Err(ImportError::malformed(at, format!("must have as many elements as POSITION, {vertices}")));
        }
        let values = self.accessors.floats::<N>(accessor, self.source.origin.as_deref(), &at)?;
        // A primitive of spheres has no vertices of its own in the mesh.
        Ok((values.len() == self.source.vertices.len()).then_some(values))
    }

    fn morph(&self, mesh: &mut Mesh, weights: &[f32]) -> Result<()> {
        let primitive = &self.document.meshes[self.mesh_index].primitives[self.source.primitive];
        for (index, (target, weight)) in primitive.targets.iter().zip(weights).enumerate() {
            let prefix = format!("targets/{index}");
            let vertices = self.source.vertices.clone();
            if let Some(deltas) = self.read::<3>(target, &prefix, "POSITION")? {
                for (position, delta) in mesh.positions[vertices.clone()].iter_mut().zip(deltas) {
                    *position += Vec3::from(delta) * *weight;
                }
            }
            if let (Some(deltas), false) = (self.read::<3>(target, &prefix, "NORMAL")?, mesh.normals.is_empty()) {
                for (normal, delta) in mesh.normals[vertices].iter_mut().zip(deltas) {
                    *normal = (*normal + Vec3::from(delta) * *weight).try_normalize().unwrap_or(*normal);
                }
            }
        }
        Ok(())
    }

    fn skin(&self, mesh: &mut Mesh, joints: &[DAffine3], world: &DAffine3) -> Result<()> {
        let vertices = self.source.vertices.clone();
        let mut matrices = vec![(DMat3::ZERO, DVec3::ZERO, 0.0_f64); vertices.len()];
        let primitive = &self.document.meshes[self.mesh_index].primitives[self.source.primitive];
        for set in 0..2 {
            let (joints_name, weights_name) = (format!("JOINTS_{set}"), format!("WEIGHTS_{set}"));
            let indices = self.read::<4>(&primitive.attributes, "attributes", &joints_name)?;
            let weights = self.read::<4>(&primitive.attributes, "attributes", &weights_name)?;
            let (Some(indices), Some(weights)) = (indices, weights) else { continue };
            for ((matrix, indices), weights) in matrices.iter_mut().zip(indices).zip(weights) {
                for (joint, weight) in indices.into_iter().zip(weights.map(f64::from)) {
                    if weight == 0.0 || !weight.is_finite() {
                        continue;
                    }
                    let Some(joint) = joints.get(joint as usize) else {
                        let message = format!("joint {joint} is out of range: the skin has {}", joints.len());
                        return Err(ImportError::malformed(self.at(&format!("attributes/{joints_name}")), message));
                    };
                    matrix.0 += joint.matrix3 * weight;
                    matrix.1 += joint.translation * weight;
                    matrix.2 += weight;
                }
            }
        }
        for (vertex, (matrix, translation, weight)) in vertices.zip(matrices) {
            // Weights are to sum to one; a vertex without any follows the node.
            let (matrix, translation) = if weight.abs() > 1e-6 {
                (matrix * weight.recip(), translation / weight)
            } else {
                (world.matrix3, world.translation)
            };
            mesh.positions[vertex] = (matrix * mesh.positions[vertex].as_dvec3() + translation).as_vec3();
            if let Some(normal) = mesh.normals.get_mut(vertex) {
                *normal = turned_normal(&matrix, *normal);
            }
            if let Some(tangent) = mesh.tangents.get_mut(vertex) {
                let turned = (matrix * DVec3::new(tangent[0].into(), tangent[1].into(), tangent[2].into())).as_vec3();
                let normal = mesh.normals.get(vertex).copied().unwrap_or(Vec3::Y);
                *tangent = tangents::repaired([turned.x, turned.y, turned.z, tangent[3]], normal);
            }
        }
        Ok(())
    }
}

/// By the cofactor matrix, which is the inverse transpose up to a factor and exists for singular matrices too.
fn turned_normal(matrix: &DMat3, normal: Vec3) -> Vec3 {
    let cofactor = DMat3::from_cols(
        matrix.y_axis.cross(matrix.z_axis),
        matrix.z_axis.cross(matrix.x_axis),
        matrix.x_axis.cross(matrix.y_axis),
    );
    let sign = matrix.determinant().signum();
    (cofactor * normal.as_dvec3() * sign).try_normalize().map_or(normal, |unit| unit.as_vec3())
}

/// One warning for each thing that would move.
pub(super) fn warn_about_motion(document: &Document, session: &mut Session<'_>) {
    let mut found: HashMap<&str, usize> = HashMap::new();
    *found.entry("animations").or_default() = document.animations.len();
    *found.entry("skins").or_default() = document.skins.len();
    let morphing = document.meshes.iter().filter(|mesh| mesh.primitives.iter().any(|part| !part.targets.is_empty()));
    *found.entry("meshes with morph targets").or_default() = morphing.count();
    for what in ["animations", "skins", "meshes with morph targets"] {
        if let Some(count @ 1..) = found.get(what) {
            session.warnings.add("", format!("{count} {what}: the scene is shown in its rest pose"));
        }
    }
}
