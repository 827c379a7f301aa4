//! Which meshes the scene shows, in which poses and where.
//!
//! This is planned before any mesh is decoded. Every pose in which a mesh is shown is a [`Shape`], decoded once however
//! many instances it has; so the budget for geometry can count all of them first.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{Affine3A, DAffine3};

use super::Session;
use super::accessor::Accessors;
use super::document::Document;
use super::meshes::{Placed, Unique};
use super::nodes::Graph;
use super::pose::{self, Pose, Skin};
use super::transform::{self, Single};
use crate::scene::error::Result;
use crate::scene::limits::Limits;
use crate::scene::model::Instance;

/// A mesh in a pose.
#[derive(Debug)]
pub(super) struct Shape<'a> {
    /// Index into the document's meshes.
    pub(super) mesh: usize,
    pub(super) pose: Pose<'a>,
}

/// All shapes that the scene shows, and their places.
#[derive(Debug, Default)]
pub(super) struct Plan<'a> {
    pub(super) shapes: Vec<Shape<'a>>,
    places: Vec<Place>,
}

#[derive(Debug)]
struct Place {
    node: usize,
    /// Index into the shapes.
    shape: usize,
    transform: Affine3A,
}

impl<'a> Plan<'a> {
    /// Goes through the nodes of the graph.
    ///
    /// # Errors
    /// Limit: too many instances. Malformed: skins or instancing that contradict themselves.
    pub(super) fn new(
        document: &'a Document,
        graph: &Graph,
        accessors: &Accessors<'_>,
        session: &mut Session<'_>,
    ) -> Result<Self> {
        let mut plan = Self::default();
        let mut skins = HashMap::new();
        // Shapes by their mesh and the bits of their morph weights. Skinned ones belong to a single node.
        let mut known: HashMap<(usize, Vec<u32>), usize> = HashMap::new();
        for &index in &graph.visited {
            session.check_cancelled()?;
            let node = &document.nodes[index];
            let (Some(mesh), Some(world)) = (node.mesh, graph.world[index]) else { continue };
            let weights = node.weights.as_ref().or(document.meshes[mesh].weights.as_ref());
            let weights = weights.map(Vec::as_slice).filter(|all| all.iter().any(|weight| *weight != 0.0));
            let weights = weights.unwrap_or_default();
            let joints = match node.skin {
                None => None,
                Some(skin) => match skins.get(&skin) {
                    Some(joints) => Option::clone(joints),
                    None => {
                        let joints = pose::joint_matrices(document, graph, accessors, skin, session)?;
                        skins.insert(skin, joints.clone());
                        joints
                    }
                },
            };
            let skin = joints.map(|joints| Skin { joints, node: world });
            let base = if skin.is_some() { DAffine3::IDENTITY } else { world };
            let transforms = match &node.extensions.instancing {
                None => vec![base],
                Some(extension) => transform::instancing(extension, document, accessors, index, session.limits)?
                    .into_iter()
                    .map(|local| base * local)
                    .collect(),
            };
            let instances = (plan.places.len() + transforms.len()) as u64;
            Limits::check(format_args!("nodes/{index}"), "instances", instances, session.limits.instances)?;

            let mut own_shape = None;
            let mut lost = 0;
            for transform in transforms {
                let (shape, transform) = match transform::to_single(&transform) {
                    Single::Usable(single) => {
                        let shape = *own_shape.get_or_insert_with(|| {
                            let pose = || Pose { weights, skin: skin.clone(), flattened: None };
                            if skin.is_some() {
                                return plan.add(mesh, pose());
                            }
                            let bits = weights.iter().map(|weight| weight.to_bits()).collect();
                            *known.entry((mesh, bits)).or_insert_with(|| plan.add(mesh, pose()))
                        });
                        (shape, single)
                    }
                    Single::Flat => {
                        let pose = Pose { weights, skin: skin.clone(), flattened: Some(transform) };
                        (plan.add(mesh, pose), Affine3A::IDENTITY)
                    }
                    Single::Nothing => {
                        lost += 1;
                        continue;
                    }
                };
                plan.places.push(Place { node: index, shape, transform });
            }
            warn_about_lost(index, lost, session);
        }
        Ok(plan)
    }

    fn add(&mut self, mesh: usize, pose: Pose<'a>) -> usize {
        self.shapes.push(Shape { mesh, pose });
        self.shapes.len() - 1
    }

    /// The instances of the decoded shapes.
    pub(super) fn instances(
        &self,
        document: &Document,
        placed: &[Option<Placed>],
        unique: &Unique,
        session: &mut Session<'_>,
    ) -> Vec<Instance> {
        let mut instances: Vec<Instance> = Vec::with_capacity(self.places.len());
        // Places come node by node, and one node may have a million.
        for places in self.places.chunk_by(|a, b| a.node == b.node) {
            let node = places[0].node;
            let name: Arc<str> = match document.nodes[node].name.as_str() {
                "" => format!("node {node}").into(),
                name => name.into(),
            };
            let mut lost = 0;
            for place in places {
                let Some(Placed { mesh, materials }) = &placed[place.shape] else { continue };
                let bounds = unique.meshes[*mesh as usize].bounds;
                let corners = [bounds.min, bounds.max].map(|corner| place.transform.transform_point3(corner));
                if !corners.iter().all(|corner| corner.is_finite()) {
                    lost += 1;
                    continue;
                }
                instances.push(Instance {
                    name: name.clone(),
                    mesh: *mesh,
                    transform: place.transform,
                    materials: materials.clone(),
                });
            }
            warn_about_lost(node, lost, session);
        }
        if instances.is_empty() {
            session.warnings.add("", "the scene shows no mesh");
        }
        instances
    }
}

fn warn_about_lost(node: usize, instances: usize, session: &mut Session<'_>) {
    if instances > 0 {
        let message =
            format!("{instances} instances have a scale of zero along two axes or beyond all bounds; skipped");
        session.warnings.add(&format!("nodes/{node}"), message);
    }
}
