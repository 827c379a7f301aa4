//! Proves every index and extent in a document before anything follows it.
//!
//! After [`check`] has passed, all index fields are in range, all accessors lie within their views and all views within
//! their buffers' declared lengths, and the nodes form a forest. The rest of the importer relies on that.

use std::fmt::Display;

use super::accessor::{ComponentType, Shape};
use super::document::{Accessor, Document, Node, TextureInfo};
use super::specular_glossiness;
use crate::scene::error::{ImportError, Result};
use crate::scene::limits::Limits;

/// # Errors
/// Malformed, at the field that is wrong; Limit for too many nodes, materials, textures, cameras or lights.
pub(super) fn check(document: &Document, limits: &Limits) -> Result<()> {
    check_counts(document, limits)?;
    check_buffers(document)?;
    for (index, accessor) in document.accessors.iter().enumerate() {
        check_accessor(document, accessor, &format!("accessors/{index}"))?;
    }
    check_materials(document)?;
    check_meshes(document)?;
    check_nodes(document)?;
    check_forest(document)
}

fn check_counts(document: &Document, limits: &Limits) -> Result<()> {
    let nodes_with = |has: fn(&Node) -> bool| document.nodes.iter().filter(|node| has(node)).count();
    Limits::check("nodes", "nodes", document.nodes.len() as u64, limits.nodes)?;
    Limits::check("materials", "materials", document.materials.len() as u64, limits.materials)?;
    Limits::check("textures", "textures", document.textures.len() as u64, limits.textures)?;
    let cameras = nodes_with(|node| node.camera.is_some());
    Limits::check("nodes", "nodes with a camera", cameras as u64, limits.cameras)?;
    let lights = nodes_with(|node| node.extensions.light.is_some());
    Limits::check("nodes", "nodes with a light", lights as u64, limits.lights)
}

/// An error unless `index` is one of `count` things called `target`.
fn in_range(position: impl Display, index: usize, target: &str, count: usize) -> Result<()> {
    if index < count {
        return Ok(());
    }
    let there_are = match count {
        0 => format!("the document has no {target}"),
        1 => format!("the only valid index into {target} is 0"),
        count => format!("indices into {target} go from 0 to {}", count - 1),
    };
    Err(ImportError::malformed(position.to_string(), format!("{index} is out of range: {there_are}")))
}

fn optional_in_range(position: impl Display, index: Option<usize>, target: &str, count: usize) -> Result<()> {
    index.map_or(Ok(()), |index| in_range(position, index, target, count))
}

fn check_buffers(document: &Document) -> Result<()> {
    for (index, view) in document.buffer_views.iter().enumerate() {
        in_range(format_args!("bufferViews/{index}/buffer"), view.buffer, "buffers", document.buffers.len())?;
        let buffer_bytes = document.buffers[view.buffer].byte_length;
        let end = view.byte_offset.checked_add(view.byte_length);
        if end.is_none_or(|end| end > buffer_bytes) {
            return Err(ImportError::malformed(
                format!("bufferViews/{index}"),
                format!(
                    "{} bytes from offset {} do not fit buffer {}, which has {buffer_bytes}",
                    view.byte_length, view.byte_offset, view.buffer
                ),
            ));
        }
    }
    for (index, image) in document.images.iter().enumerate() {
        let views = document.buffer_views.len();
        optional_in_range(format_args!("images/{index}/bufferView"), image.buffer_view, "bufferViews", views)?;
    }
    Ok(())
}

fn check_accessor(document: &Document, accessor: &Accessor, at: &str) -> Result<()> {
    let component = ComponentType::from_gl(accessor.component_type).ok_or_else(|| {
        ImportError::malformed(
            format!("{at}/componentType"),
            format!("{} is not a component type: use 5120, 5121, 5122, 5123, 5125 or 5126", accessor.component_type),
        )
    })?;
    let shape = Shape::from_name(&accessor.shape).ok_or_else(|| {
        ImportError::malformed(
            format!("{at}/type"),
            format!("{:?} is not SCALAR, VEC2, VEC3, VEC4, MAT2, MAT3 or MAT4", accessor.shape),
        )
    })?;
    let element_bytes = shape.bytes(component) as u64;
    // Without a view it is all zeros, but for what sparse values say (glTF 2.0, 3.6.2.1); `check_unbacked` bounds how many.
    if let Some(view) = accessor.buffer_view {
        in_range(format_args!("{at}/bufferView"), view, "bufferViews", document.buffer_views.len())?;
        let stride = document.buffer_views[view].byte_stride.unwrap_or(element_bytes);
        if stride < element_bytes {
            return Err(ImportError::malformed(
                format!("bufferViews/{view}/byteStride"),
                format!("{stride} is less than the {element_bytes} bytes of an element of {at}"),
            ));
        }
        check_extent(document, view, accessor.byte_offset, accessor.count, stride, element_bytes, at)?;
    }
    let Some(sparse) = &accessor.sparse else { return Ok(()) };
    if sparse.count > accessor.count {
        return Err(ImportError::malformed(
            format!("{at}/sparse/count"),
            format!("{} values cannot replace those of an accessor of {}", sparse.count, accessor.count),
        ));
    }
    let indices_at = format!("{at}/sparse/indices");
    let index_type = ComponentType::from_gl(sparse.indices.component_type).filter(|kind| kind.is_index());
    let index_type = index_type.ok_or_else(|| {
        ImportError::malformed(format!("{indices_at}/componentType"), "indices must be 5121, 5123 or 5125 (unsigned)")
    })?;
    let views = document.buffer_views.len();
    in_range(format_args!("{indices_at}/bufferView"), sparse.indices.buffer_view, "bufferViews", views)?;
    let index_bytes = index_type.bytes() as u64;
    let indices = &sparse.indices;
    check_extent(
        document,
        indices.buffer_view,
        indices.byte_offset,
        sparse.count,
        index_bytes,
        index_bytes,
        &indices_at,
    )?;
    let values_at = format!("{at}/sparse/values");
    let values = &sparse.values;
    in_range(format_args!("{values_at}/bufferView"), values.buffer_view, "bufferViews", views)?;
    check_extent(
        document,
        values.buffer_view,
        values.byte_offset,
        sparse.count,
        element_bytes,
        element_bytes,
        &values_at,
    )
}

/// An error unless `count` elements fit the view.
fn check_extent(
    document: &Document,
    view: usize,
    offset: u64,
    count: u64,
    stride: u64,
    element_bytes: u64,
    at: &str,
) -> Result<()> {
    let view_bytes = document.buffer_views[view].byte_length;
    let needed = match count {
        0 => Some(0),
        count => (count - 1)
            .checked_mul(stride)
            .and_then(|last| last.checked_add(element_bytes))
            .and_then(|span| span.checked_add(offset)),
    };
    if needed.is_some_and(|needed| needed <= view_bytes) {
        return Ok(());
    }
    Err(ImportError::malformed(
        at,
        format!(
            "{count} elements of {element_bytes} bytes, {stride} apart from offset {offset}, do not fit buffer view \
             {view}, which has {view_bytes} bytes"
        ),
    ))
}

fn check_materials(document: &Document) -> Result<()> {
    for (index, texture) in document.textures.iter().enumerate() {
        let at = format!("textures/{index}");
        optional_in_range(format_args!("{at}/source"), texture.source, "images", document.images.len())?;
        optional_in_range(format_args!("{at}/sampler"), texture.sampler, "samplers", document.samplers.len())?;
    }
    for (index, material) in document.materials.iter().enumerate() {
        let at = format!("materials/{index}");
        let pbr = &material.pbr_metallic_roughness;
        let (base_color, roughness) = if pbr.specular_factor.is_some() {
            let [diffuse, specular_glossiness] = specular_glossiness::TEXTURES;
            (diffuse, specular_glossiness)
        } else {
            ("pbrMetallicRoughness/baseColorTexture", "pbrMetallicRoughness/metallicRoughnessTexture")
        };
        let uses: [(&str, &Option<TextureInfo>); 5] = [
            (base_color, &pbr.base_color_texture),
            (roughness, &pbr.metallic_roughness_texture),
            ("normalTexture", &material.normal_texture),
            ("occlusionTexture", &material.occlusion_texture),
            ("emissiveTexture", &material.emissive_texture),
        ];
        for (field, info) in uses {
            let texture = info.as_ref().map(|info| info.index);
            optional_in_range(format_args!("{at}/{field}/index"), texture, "textures", document.textures.len())?;
        }
    }
    Ok(())
}

fn check_meshes(document: &Document) -> Result<()> {
    let accessors = document.accessors.len();
    for (mesh_index, mesh) in document.meshes.iter().enumerate() {
        for (index, primitive) in mesh.primitives.iter().enumerate() {
            let at = format!("meshes/{mesh_index}/primitives/{index}");
            if primitive.mode > 6 {
                return Err(ImportError::malformed(
                    format!("{at}/mode"),
                    format!("{} is not a topology: use 0 to 6 (4 is triangles)", primitive.mode),
                ));
            }
            for (name, accessor) in &primitive.attributes {
                in_range(format_args!("{at}/attributes/{name}"), *accessor, "accessors", accessors)?;
            }
            for (target_index, target) in primitive.targets.iter().enumerate() {
                for (name, accessor) in target {
                    in_range(format_args!("{at}/targets/{target_index}/{name}"), *accessor, "accessors", accessors)?;
                }
            }
            optional_in_range(format_args!("{at}/indices"), primitive.indices, "accessors", accessors)?;
            let materials = document.materials.len();
            optional_in_range(format_args!("{at}/material"), primitive.material, "materials", materials)?;
        }
    }
    for (index, skin) in document.skins.iter().enumerate() {
        let at = format!("skins/{index}");
        optional_in_range(
            format_args!("{at}/inverseBindMatrices"),
            skin.inverse_bind_matrices,
            "accessors",
            accessors,
        )?;
        for (joint_index, joint) in skin.joints.iter().enumerate() {
            in_range(format_args!("{at}/joints/{joint_index}"), *joint, "nodes", document.nodes.len())?;
        }
    }
    Ok(())
}

fn check_nodes(document: &Document) -> Result<()> {
    optional_in_range("scene", document.scene, "scenes", document.scenes.len())?;
    let nodes = document.nodes.len();
    for (scene_index, scene) in document.scenes.iter().enumerate() {
        for (index, node) in scene.nodes.iter().enumerate() {
            in_range(format_args!("scenes/{scene_index}/nodes/{index}"), *node, "nodes", nodes)?;
        }
    }
    let lights = document.extensions.lights.lights.len();
    for (index, node) in document.nodes.iter().enumerate() {
        let at = format!("nodes/{index}");
        for (child_index, child) in node.children.iter().enumerate() {
            in_range(format_args!("{at}/children/{child_index}"), *child, "nodes", nodes)?;
        }
        optional_in_range(format_args!("{at}/mesh"), node.mesh, "meshes", document.meshes.len())?;
        optional_in_range(format_args!("{at}/camera"), node.camera, "cameras", document.cameras.len())?;
        optional_in_range(format_args!("{at}/skin"), node.skin, "skins", document.skins.len())?;
        let light = node.extensions.light.as_ref().map(|light| light.light);
        let light_at = format_args!("{at}/extensions/KHR_lights_punctual/light").to_string();
        optional_in_range(light_at, light, "lights", lights)?;
        for (name, accessor) in node.extensions.instancing.iter().flat_map(|instancing| &instancing.attributes) {
            let at = format!("{at}/extensions/EXT_mesh_gpu_instancing/attributes/{name}");
            in_range(at, *accessor, "accessors", document.accessors.len())?;
        }
    }
    Ok(())
}

/// Every node has at most one parent, none is its own ancestor, and scenes list only roots (glTF 2.0, 3.5.3).
fn check_forest(document: &Document) -> Result<()> {
    let mut parents: Vec<Option<usize>> = vec![None; document.nodes.len()];
    for (index, node) in document.nodes.iter().enumerate() {
        for (child_index, child) in node.children.iter().enumerate() {
            if let Some(other) = parents[*child] {
                return Err(ImportError::malformed(
                    format!("nodes/{index}/children/{child_index}"),
                    format!("node {child} is already a child of node {other}; a node may have one parent only"),
                ));
            }
            parents[*child] = Some(index);
        }
    }
    // Walking up from each node, until a root or a node seen in an earlier walk, touches every node at most twice.
    let mut seen_in_walk: Vec<usize> = vec![0; document.nodes.len()];
    for start in 0..document.nodes.len() {
        let walk = start + 1;
        let mut at = Some(start);
        while let Some(node) = at.filter(|node| seen_in_walk[*node] == 0 || seen_in_walk[*node] == walk) {
            if seen_in_walk[node] == walk {
                return Err(ImportError::malformed(
                    format!("nodes/{node}"),
                    "is its own ancestor; nodes must form trees without cycles",
                ));
            }
            seen_in_walk[node] = walk;
            at = parents[node];
        }
    }
    for (scene_index, scene) in document.scenes.iter().enumerate() {
        let mut listed = std::collections::HashSet::new();
        for (index, node) in scene.nodes.iter().enumerate() {
            let at = || format!("scenes/{scene_index}/nodes/{index}");
            if let Some(parent) = parents[*node] {
                let message = format!("node {node} is a child of node {parent}; a scene lists root nodes only");
                return Err(ImportError::malformed(at(), message));
            }
            if !listed.insert(*node) {
                return Err(ImportError::malformed(at(), format!("node {node} is listed twice")));
            }
        }
    }
    Ok(())
}
