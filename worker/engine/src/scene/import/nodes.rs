//! Nodes to instances, cameras and lights in world space.

use glam::{DAffine3, DVec3, Vec3};

use super::Session;
use super::accessor::Accessors;
use super::document::{self, Document};
use super::meshes::{Placed, Unique};
use super::pose;
use super::transform;
use crate::scene::error::Result;
use crate::scene::limits::Limits;
use crate::scene::model::{Camera, Instance, Material, Projection, PunctualKind, PunctualLight};

/// The nodes of the shown scene with their world transforms, parents first.
pub(super) struct Graph {
    pub(super) visited: Vec<usize>,
    /// By node; `None` for nodes outside the shown scene.
    pub(super) world: Vec<Option<DAffine3>>,
}

impl Graph {
    /// Walks the default scene: `scene`, else the first one, else all root nodes.
    pub(super) fn walk(document: &Document, session: &mut Session<'_>) -> Result<Self> {
        let roots: Vec<usize> = match document.scenes.get(document.scene.unwrap_or(0)) {
            Some(scene) => scene.nodes.clone(),
            None => {
                session.warnings.add("scenes", "there is none; all root nodes are shown");
                roots(document)
            }
        };
        if document.scenes.len() > 1 {
            let shown = document.scene.unwrap_or(0);
            session.warnings.add("scenes", format!("there are {}; scene {shown} is shown", document.scenes.len()));
        }
        let mut graph = Self { visited: Vec::new(), world: vec![None; document.nodes.len()] };
        let mut stack: Vec<(usize, DAffine3)> = roots.iter().rev().map(|node| (*node, DAffine3::IDENTITY)).collect();
        while let Some((index, parent)) = stack.pop() {
            let node = &document.nodes[index];
            let world = parent * transform::local(node, index)?;
            graph.visited.push(index);
            graph.world[index] = Some(world);
            stack.extend(node.children.iter().rev().map(|child| (*child, world)));
        }
        Ok(graph)
    }

    pub(super) fn used_meshes(&self, document: &Document) -> Vec<bool> {
        let mut used = vec![false; document.meshes.len()];
        for mesh in self.visited.iter().filter_map(|node| document.nodes[*node].mesh) {
            used[mesh] = true;
        }
        used
    }
}

fn roots(document: &Document) -> Vec<usize> {
    let mut is_child = vec![false; document.nodes.len()];
    for child in document.nodes.iter().flat_map(|node| &node.children) {
        is_child[*child] = true;
    }
    (0..document.nodes.len()).filter(|node| !is_child[*node]).collect()
}

/// Places every mesh of the graph.
pub(super) fn instances(
    document: &Document,
    graph: &Graph,
    accessors: &Accessors<'_>,
    placed: &[Option<Placed>],
    unique: &mut Unique,
    materials: &mut Vec<Material>,
    session: &mut Session<'_>,
) -> Result<Vec<Instance>> {
    let mut instances = Vec::new();
    let mut default_material = None;
    for &index in &graph.visited {
        session.check_cancelled()?;
        let node = &document.nodes[index];
        let (Some(mesh_index), Some(world)) = (node.mesh, graph.world[index]) else { continue };
        let Some(place) = &placed[mesh_index] else { continue };
        let at = format!("nodes/{index}");
        let posed = pose::posed_mesh(document, graph, accessors, index, place, unique, session)?;
        let (mesh, base) = match posed {
            None => (place.mesh, world),
            Some(pose::Posed { mesh, in_world: true }) => (mesh, DAffine3::IDENTITY),
            Some(pose::Posed { mesh, in_world: false }) => (mesh, world),
        };
        let transforms = match &node.extensions.instancing {
            None => vec![base],
            Some(extension) => transform::instancing(extension, document, accessors, index, session.limits)?
                .into_iter()
                .map(|local| base * local)
                .collect(),
        };
        Limits::check(&at, "instances", (instances.len() + transforms.len()) as u64, session.limits.instances)?;
        let slots: Vec<u32> = place
            .materials
            .iter()
            .map(|material| match material {
                Some(material) => *material as u32,
                None => *default_material.get_or_insert_with(|| {
                    materials.push(Material { name: "default".into(), ..Material::default() });
                    materials.len() as u32 - 1
                }),
            })
            .collect();
        let name = if node.name.is_empty() { format!("node {index}") } else { node.name.clone() };
        let bounds = unique.meshes[mesh as usize].bounds;
        let mut flattened = 0;
        for transform in transforms {
            let Some(transform) = transform::to_single(&transform) else {
                flattened += 1;
                continue;
            };
            let corners = [bounds.min, bounds.max].map(|corner| transform.transform_point3(corner));
            if !corners.iter().all(|corner| corner.is_finite()) {
                flattened += 1;
                continue;
            }
            instances.push(Instance { name: name.clone(), mesh, transform, materials: slots.clone() });
        }
        if flattened > 0 {
            let message = format!("{flattened} instances have a scale of zero or beyond all bounds; skipped");
            session.warnings.add(&at, message);
        }
    }
    if instances.is_empty() {
        session.warnings.add("", "the scene shows no mesh");
    }
    Ok(instances)
}

/// The cameras of the graph. One that makes no picture is skipped with a warning.
pub(super) fn cameras(document: &Document, graph: &Graph, session: &mut Session<'_>) -> Vec<Camera> {
    let mut cameras: Vec<Camera> = Vec::new();
    for &index in &graph.visited {
        let node = &document.nodes[index];
        let (Some(camera_index), Some(world)) = (node.camera, graph.world[index]) else { continue };
        let source = &document.cameras[camera_index];
        let projection = match projection(source) {
            Ok(projection) => projection,
            Err((field, message)) => {
                let at = format!("cameras/{camera_index}{field}");
                session.warnings.add(&at, format!("{message}; the camera is skipped"));
                continue;
            }
        };
        let Some((forward, up)) = orientation(&world) else {
            session.warnings.add(&format!("nodes/{index}"), "has a scale of zero; its camera is skipped");
            continue;
        };
        let base = [&source.name, &node.name].into_iter().find(|name| !name.is_empty()).cloned();
        let base = base.unwrap_or_else(|| format!("camera {}", cameras.len()));
        let same = cameras.iter().filter(|camera| camera.name == base).count();
        let name = if same == 0 { base } else { format!("{base} ({})", cameras.len()) };
        cameras.push(Camera { name, position: world.translation.as_vec3(), forward, up, projection });
    }
    cameras
}

fn projection(source: &document::Camera) -> Result<Projection, (&'static str, String)> {
    match (source.kind.as_str(), &source.perspective, &source.orthographic) {
        ("perspective", Some(perspective), _) => {
            let fov = perspective.yfov;
            if fov.is_finite() && fov > 0.0 && fov < std::f32::consts::PI {
                Ok(Projection::Perspective { fov_y_rad: fov })
            } else {
                Err(("/perspective/yfov", format!("{fov} is not between 0 and pi")))
            }
        }
        ("orthographic", _, Some(orthographic)) => {
            // A negative magnification mirrors; like other viewers, we only take its size.
            let half_height = orthographic.ymag.abs();
            if half_height.is_finite() && half_height > 0.0 {
                Ok(Projection::Orthographic { half_height })
            } else {
                Err(("/orthographic/ymag", format!("{} is not a size", orthographic.ymag)))
            }
        }
        (kind, ..) => {
            Err(("/type", format!("{kind:?} needs the object of the same name (perspective or orthographic)")))
        }
    }
}

/// Forward (-Z) and up (+Y) of a node, orthonormal.
fn orientation(world: &DAffine3) -> Option<(Vec3, Vec3)> {
    let forward = (world.matrix3 * DVec3::NEG_Z).try_normalize()?;
    let up = world.matrix3 * DVec3::Y;
    let up = (up - forward * forward.dot(up)).try_normalize()?;
    let finite = world.translation.as_vec3().is_finite();
    finite.then(|| (forward.as_vec3(), up.as_vec3()))
}

/// The lights of the graph. One that cannot shine is skipped with a warning.
pub(super) fn lights(document: &Document, graph: &Graph, session: &mut Session<'_>) -> Vec<PunctualLight> {
    let mut lights = Vec::new();
    for &index in &graph.visited {
        let node = &document.nodes[index];
        let (Some(reference), Some(world)) = (&node.extensions.light, graph.world[index]) else { continue };
        let source = &document.extensions.lights.lights[reference.light];
        let at = format!("extensions/KHR_lights_punctual/lights/{}", reference.light);
        let kind = match source.kind.as_str() {
            "point" => PunctualKind::Point,
            "directional" => PunctualKind::Directional,
            "spot" => {
                let (inner, outer) = (source.spot.inner_cone_angle, source.spot.outer_cone_angle);
                let outer = outer.clamp(0.0, std::f32::consts::FRAC_PI_2);
                PunctualKind::Spot { inner_cone_rad: inner.clamp(0.0, outer), outer_cone_rad: outer }
            }
            other => {
                let message = format!("{other:?} is not point, spot or directional; the light is skipped");
                session.warnings.add(&format!("{at}/type"), message);
                continue;
            }
        };
        let intensity = Vec3::from(source.color).max(Vec3::ZERO) * source.intensity.max(0.0);
        let position = world.translation.as_vec3();
        let direction = transform::direction(&world.matrix3, DVec3::NEG_Z);
        let (Some(direction), true, true) = (direction, intensity.is_finite(), position.is_finite()) else {
            session.warnings.add(&at, "its intensity or place is beyond all bounds; the light is skipped");
            continue;
        };
        let range = source.range.filter(|range| *range > 0.0).unwrap_or(f32::INFINITY);
        let name = [&source.name, &node.name].into_iter().find(|name| !name.is_empty()).cloned();
        let name = name.unwrap_or_else(|| format!("light {}", lights.len()));
        lights.push(PunctualLight { name, position, direction, intensity, range, kind });
    }
    lights
}
