//! Transforms of nodes (glTF 2.0, 3.5.2), accumulated in double precision so that deep hierarchies and large offsets do
//! not wear the result down.

use glam::{Affine3A, DAffine3, DMat3, DMat4, DQuat, DVec3, Mat3A};

use super::accessor::Accessors;
use super::document::{Document, Instancing, Node};
use super::pose::cofactor;
use crate::scene::error::{ImportError, Result};
use crate::scene::limits::Limits;

/// A node's transform relative to its parent.
///
/// # Errors
/// Malformed: a matrix that is not affine, a rotation of zero length, numbers that are not finite.
pub(super) fn local(node: &Node, index: usize) -> Result<DAffine3> {
    if let Some(matrix) = &node.matrix {
        let at = || format!("nodes/{index}/matrix");
        if !matrix.iter().all(|entry| entry.is_finite()) {
            return Err(ImportError::malformed(at(), "all 16 numbers must be finite"));
        }
        let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
        let bottom = matrix.row(3);
        if (bottom - glam::DVec4::W).abs().max_element() > 1e-4 {
            return Err(ImportError::malformed(
                at(),
                format!("must be affine: its last row is {bottom}, not 0, 0, 0, 1"),
            ));
        }
        return Ok(DAffine3::from_mat4(matrix));
    }
    from_trs(
        node.translation.unwrap_or([0.0; 3]),
        node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]),
        node.scale.unwrap_or([1.0; 3]),
        &format!("nodes/{index}"),
    )
}

fn from_trs(translation: [f32; 3], rotation: [f32; 4], scale: [f32; 3], at: &str) -> Result<DAffine3> {
    let finite = translation.iter().chain(&rotation).chain(&scale).all(|entry| entry.is_finite());
    if !finite {
        return Err(ImportError::malformed(at, "translation, rotation and scale must be finite"));
    }
    let rotation = DQuat::from_array(rotation.map(f64::from));
    if rotation.length_squared() < 1e-12 {
        return Err(ImportError::malformed(format!("{at}/rotation"), "must be a unit quaternion, not zero"));
    }
    Ok(DAffine3::from_scale_rotation_translation(
        DVec3::from_array(scale.map(f64::from)),
        rotation.normalize(),
        DVec3::from_array(translation.map(f64::from)),
    ))
}

/// The transforms of EXT_mesh_gpu_instancing, relative to the node.
///
/// # Errors
/// Malformed: attributes of unequal counts or wrong types. Limit: more than `most` instances.
pub(super) fn instancing(
    instancing: &Instancing,
    document: &Document,
    accessors: &Accessors<'_>,
    node: usize,
    limits: &Limits,
) -> Result<Vec<DAffine3>> {
    let at = format!("nodes/{node}/extensions/EXT_mesh_gpu_instancing");
    let counts: Vec<u64> = instancing.attributes.values().map(|accessor| document.accessors[*accessor].count).collect();
    let count = counts.first().copied().unwrap_or(0);
    if counts.iter().any(|other| *other != count) {
        return Err(ImportError::malformed(format!("{at}/attributes"), "all attributes must have the same count"));
    }
    Limits::check(&at, "instances", count, limits.instances)?;
    fn read<const N: usize>(
        instancing: &Instancing,
        accessors: &Accessors<'_>,
        at: &str,
        name: &str,
        default: [f32; N],
        count: u64,
    ) -> Result<Vec<[f32; N]>> {
        match instancing.attributes.get(name) {
            None => Ok(vec![default; count as usize]),
            Some(accessor) => accessors.floats::<N>(*accessor, None, &format!("{at}/attributes/{name}")),
        }
    }
    let translations = read(instancing, accessors, &at, "TRANSLATION", [0.0; 3], count)?;
    let rotations = read(instancing, accessors, &at, "ROTATION", [0.0, 0.0, 0.0, 1.0], count)?;
    let scales = read(instancing, accessors, &at, "SCALE", [1.0; 3], count)?;
    translations
        .into_iter()
        .zip(rotations)
        .zip(scales)
        .map(|((translation, rotation), scale)| from_trs(translation, rotation, scale, &at))
        .collect()
}

/// What a transform is to an instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Single {
    /// In single precision, with a finite inverse.
    Usable(Affine3A),
    /// Leaves areas in one plane only, as a scale of zero along one axis does: rays cannot be taken back by it.
    Flat,
    /// Leaves no area at all, or is beyond all bounds.
    Nothing,
}

pub(super) fn to_single(transform: &DAffine3) -> Single {
    let single = Affine3A::from_cols(
        transform.matrix3.x_axis.as_vec3().into(),
        transform.matrix3.y_axis.as_vec3().into(),
        transform.matrix3.z_axis.as_vec3().into(),
        transform.translation.as_vec3().into(),
    );
    if !single.is_finite() {
        return Single::Nothing;
    }
    let inverse = single.inverse();
    if inverse.is_finite() && inverse.matrix3 != Mat3A::ZERO {
        return Single::Usable(single);
    }
    if cofactor(&transform.matrix3) == DMat3::ZERO { Single::Nothing } else { Single::Flat }
}

/// Unit axes of a transform that carries a camera or a light, whose scale does not count.
pub(super) fn direction(matrix: &DMat3, axis: DVec3) -> Option<glam::Vec3> {
    (*matrix * axis).try_normalize().map(|unit| unit.as_vec3())
}
