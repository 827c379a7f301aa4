//! The pose in which a mesh is shown: morph targets and a skin as the file holds them outside of any animation, and, for
//! instances that a scale of zero flattens, the place in the world.
//!
//! Morph targets come first, then the skin (glTF 2.0, 3.7.2.2 and 3.7.3). A skinned mesh follows its joints and ignores
//! its own node, so the result is in world space. Vertices are posed as soon as they are read: what follows from them
//! (triangles without area, flat normals, tangents) is found in the pose that is shown.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};

use super::Session;
use super::accessor::Accessors;
use super::document::{Document, Primitive};
use super::nodes::Graph;
use super::primitive::Context;
use crate::scene::error::{ImportError, Result};

/// How the vertices of a mesh are moved. The default leaves them where they are.
#[derive(Debug, Default)]
pub(super) struct Pose<'a> {
    /// Of the morph targets; empty when none is in effect.
    pub(super) weights: &'a [f32],
    pub(super) skin: Option<Skin>,
    /// Takes vertices into world space by a transform that flattens them: no instance can, since rays would have to be
    /// transformed by its inverse.
    pub(super) flattened: Option<DAffine3>,
}

#[derive(Clone, Debug)]
pub(super) struct Skin {
    /// World transform times inverse bind matrix of each joint.
    pub(super) joints: Arc<[DAffine3]>,
    /// World transform of the mesh's node, which vertices without weights follow.
    pub(super) node: DAffine3,
}

/// Vertices of a primitive as read from the file. Normals and tangents are empty where it has none.
pub(super) struct Vertices<'a> {
    pub(super) positions: &'a mut Vec<Vec3>,
    pub(super) normals: &'a mut Vec<Vec3>,
    pub(super) tangents: &'a mut Vec<[f32; 4]>,
}

impl Pose<'_> {
    fn is_rest(&self) -> bool {
        self.weights.is_empty() && self.skin.is_none() && self.flattened.is_none()
    }

    /// Moves the vertices whose numbers in the primitive's accessors `subset` lists (`None`: all).
    ///
    /// # Errors
    /// Malformed: attributes of wrong counts or types, joints out of range, positions that leave all bounds.
    pub(super) fn apply(
        &self,
        primitive: &Primitive,
        context: &Context<'_>,
        subset: Option<&[u32]>,
        vertices: &mut Vertices<'_>,
    ) -> Result<()> {
        if self.is_rest() {
            return Ok(());
        }
        self.morph(primitive, context, subset, vertices)?;
        if let Some(skin) = &self.skin {
            skin.apply(primitive, context, subset, vertices)?;
        }
        if let Some(transform) = &self.flattened {
            for position in vertices.positions.iter_mut() {
                *position = transform.transform_point3(position.as_dvec3()).as_vec3();
            }
            // All that is left lies in one plane: every triangle's own normal is the right one.
            vertices.normals.clear();
            vertices.tangents.clear();
        }
        if vertices.positions.iter().all(|position| position.is_finite()) {
            Ok(())
        } else {
            let message = "its morph targets, skin or node move vertices beyond all bounds";
            Err(ImportError::malformed(context.at.clone(), message))
        }
    }

    fn morph(
        &self,
        primitive: &Primitive,
        context: &Context<'_>,
        subset: Option<&[u32]>,
        vertices: &mut Vertices<'_>,
    ) -> Result<()> {
        for (index, (target, weight)) in primitive.targets.iter().zip(self.weights).enumerate() {
            if *weight == 0.0 {
                continue;
            }
            let read = |name: &str| read::<3>(primitive, context, subset, target, &format!("targets/{index}"), name);
            let add = |vectors: &mut [Vec3], deltas: Vec<[f32; 3]>| {
                for (vector, delta) in vectors.iter_mut().zip(deltas) {
                    *vector += Vec3::from(delta) * *weight;
                }
            };
            if let Some(deltas) = read("POSITION")? {
                add(vertices.positions, deltas);
            }
            if !vertices.normals.is_empty()
                && let Some(deltas) = read("NORMAL")?
            {
                add(vertices.normals, deltas);
            }
            if !vertices.tangents.is_empty()
                && let Some(deltas) = read("TANGENT")?
            {
                for (tangent, delta) in vertices.tangents.iter_mut().zip(deltas) {
                    (0..3).for_each(|axis| tangent[axis] += delta[axis] * weight);
                }
            }
        }
        Ok(())
    }
}

impl Skin {
    fn apply(
        &self,
        primitive: &Primitive,
        context: &Context<'_>,
        subset: Option<&[u32]>,
        vertices: &mut Vertices<'_>,
    ) -> Result<()> {
        let mut matrices = vec![(DMat3::ZERO, DVec3::ZERO, 0.0_f64); vertices.positions.len()];
        for set in 0..2 {
            let (joints_name, weights_name) = (format!("JOINTS_{set}"), format!("WEIGHTS_{set}"));
            let read = |name: &str| read::<4>(primitive, context, subset, &primitive.attributes, "attributes", name);
            let (Some(indices), Some(weights)) = (read(&joints_name)?, read(&weights_name)?) else { continue };
            for ((matrix, indices), weights) in matrices.iter_mut().zip(indices).zip(weights) {
                for (joint, weight) in indices.into_iter().zip(weights.map(f64::from)) {
                    if weight == 0.0 || !weight.is_finite() {
                        continue;
                    }
                    let Some(joint) = self.joints.get(joint as usize) else {
                        let message = format!("joint {joint} is out of range: the skin has {}", self.joints.len());
                        return Err(ImportError::malformed(
                            format!("{}/attributes/{joints_name}", context.at),
                            message,
                        ));
                    };
                    matrix.0 += joint.matrix3 * weight;
                    matrix.1 += joint.translation * weight;
                    matrix.2 += weight;
                }
            }
        }
        for (vertex, (matrix, translation, weight)) in matrices.into_iter().enumerate() {
            // Weights are to sum to one.
            let (matrix, translation) = if weight.abs() > 1e-6 {
                (matrix * weight.recip(), translation / weight)
            } else {
                (self.node.matrix3, self.node.translation)
            };
            let position = &mut vertices.positions[vertex];
            *position = (matrix * position.as_dvec3() + translation).as_vec3();
            if let Some(normal) = vertices.normals.get_mut(vertex) {
                *normal = turned_normal(&matrix, *normal);
            }
            if let Some([x, y, z, _]) = vertices.tangents.get_mut(vertex) {
                let turned = matrix * Vec3::new(*x, *y, *z).as_dvec3();
                [*x, *y, *z] = turned.as_vec3().to_array();
            }
        }
        Ok(())
    }
}

/// Reads one attribute of the vertices in `subset`; `None` when it is not there.
fn read<const N: usize>(
    primitive: &Primitive,
    context: &Context<'_>,
    subset: Option<&[u32]>,
    attributes: &BTreeMap<String, usize>,
    prefix: &str,
    name: &str,
) -> Result<Option<Vec<[f32; N]>>> {
    let Some(accessor) = attributes.get(name).copied() else { return Ok(None) };
    let at = format!("{}/{prefix}/{name}", context.at);
    let vertices = primitive.attributes.get("POSITION").map_or(0, |position| context.accessors.count(*position));
    if context.accessors.count(accessor) != vertices {
        return Err(ImportError::malformed(at, format!("must have as many elements as POSITION, {vertices}")));
    }
    context.accessors.floats::<N>(accessor, subset, &at).map(Some)
}

/// By the cofactor matrix, which is the inverse transpose up to a factor and exists for singular matrices too.
fn turned_normal(matrix: &DMat3, normal: Vec3) -> Vec3 {
    let sign = matrix.determinant().signum();
    (cofactor(matrix) * normal.as_dvec3() * sign).try_normalize().map_or(normal, |unit| unit.as_vec3())
}

/// Zero where the matrix leaves no area: where it has less than two directions.
pub(super) fn cofactor(matrix: &DMat3) -> DMat3 {
    DMat3::from_cols(
        matrix.y_axis.cross(matrix.z_axis),
        matrix.z_axis.cross(matrix.x_axis),
        matrix.x_axis.cross(matrix.y_axis),
    )
}

/// World transform times inverse bind matrix of each joint; `None`, with a warning, when a joint is not in the scene.
///
/// # Errors
/// Malformed: fewer inverse bind matrices than joints, or of another type.
pub(super) fn joint_matrices(
    document: &Document,
    graph: &Graph,
    accessors: &Accessors<'_>,
    skin_index: usize,
    session: &mut Session<'_>,
) -> Result<Option<Arc<[DAffine3]>>> {
    let skin = &document.skins[skin_index];
    let mut joints = Vec::with_capacity(skin.joints.len());
    for joint in &skin.joints {
        let Some(world) = graph.world[*joint] else {
            let message = "not all of its joints are in the scene; shown without the skin";
            session.warnings.add(&format!("skins/{skin_index}"), message);
            return Ok(None);
        };
        joints.push(world);
    }
    if let Some(accessor) = skin.inverse_bind_matrices {
        let at = format!("skins/{skin_index}/inverseBindMatrices");
        let count = accessors.count(accessor);
        if count < joints.len() {
            let message = format!("has {count} matrices for {} joints", joints.len());
            return Err(ImportError::malformed(at, message));
        }
        // The accessor may hold more, and a sparse one costs nothing to make long.
        let needed: Vec<u32> = (0..joints.len() as u32).collect();
        for (joint, matrix) in joints.iter_mut().zip(accessors.floats::<16>(accessor, Some(&needed), &at)?) {
            *joint *= DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)));
        }
    }
    Ok(Some(joints.into()))
}

/// One warning for each thing that would move.
pub(super) fn warn_about_motion(document: &Document, session: &mut Session<'_>) {
    let morphing = document.meshes.iter().filter(|mesh| mesh.primitives.iter().any(|part| !part.targets.is_empty()));
    let found = [
        (document.animations.len(), "animations"),
        (document.skins.len(), "skins"),
        (morphing.count(), "meshes with morph targets"),
    ];
    for (count, what) in found.into_iter().filter(|(count, _)| *count > 0) {
        session.warnings.add("", format!("{count} {what}: the scene is shown in its rest pose"));
    }
}
