//! The node graph, and its cameras and lights in world space.

use std::collections::{HashMap, HashSet};

use glam::{DAffine3, DVec3, Vec3};

use super::Session;
use super::document::{self, Document};
use super::transform;
use crate::scene::error::Result;
use crate::scene::model::{Camera, Projection, PunctualKind, PunctualLight};
use crate::scene::source::uri::quoted;

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
}

fn roots(document: &Document) -> Vec<usize> {
    let mut is_child = vec![false; document.nodes.len()];
    for child in document.nodes.iter().flat_map(|node| &node.children) {
        is_child[*child] = true;
    }
    (0..document.nodes.len()).filter(|node| !is_child[*node]).collect()
}

/// The cameras of the graph. One that makes no picture is skipped with a warning.
pub(super) fn cameras(document: &Document, graph: &Graph, session: &mut Session<'_>) -> Vec<Camera> {
    let mut cameras: Vec<Camera> = Vec::new();
    let mut names = UniqueNames::default();
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
        let name = names.make(base.unwrap_or_else(|| format!("camera {}", cameras.len())));
        let (position, frame_aspect) = (world.translation.as_vec3(), frame_aspect(source));
        cameras.push(Camera { name, position, forward, up, projection, frame_aspect });
    }
    cameras
}

/// Names that are all different, since cameras are chosen by name.
#[derive(Default)]
struct UniqueNames {
    taken: HashSet<String>,
    /// The number to try next for each name that came more than once.
    next: HashMap<String, usize>,
}

impl UniqueNames {
    /// `base`, or `base (n)` where that is taken.
    fn make(&mut self, base: String) -> String {
        let mut name = base.clone();
        while self.taken.contains(&name) {
            let number = self.next.entry(base.clone()).or_insert(0);
            *number += 1;
            name = format!("{base} ({number})");
        }
        self.taken.insert(name.clone());
        name
    }
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
            let kind = quoted(kind);
            Err(("/type", format!("{kind} needs the object of the same name (perspective or orthographic)")))
        }
    }
}

/// Width over height of the camera's frame; `None` where the file gives none that makes sense.
fn frame_aspect(source: &document::Camera) -> Option<f32> {
    let aspect = match source.kind.as_str() {
        "perspective" => source.perspective.as_ref()?.aspect_ratio?,
        _ => {
            let orthographic = source.orthographic.as_ref()?;
            (orthographic.xmag? / orthographic.ymag).abs()
        }
    };
    (aspect.is_finite() && aspect > 0.0).then_some(aspect)
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
                let message = format!("{} is not point, spot or directional; the light is skipped", quoted(other));
                session.warnings.add(&format!("{at}/type"), message);
                continue;
            }
        };
        let intensity = Vec3::from(source.color).max(Vec3::ZERO) * source.intensity.max(0.0);
        let position = world.translation.as_vec3();
        // A point light needs no direction, and a node with a scale of zero has none to give.
        let direction = transform::direction(&world.matrix3, DVec3::NEG_Z);
        let direction = direction.or((kind == PunctualKind::Point).then_some(Vec3::NEG_Z));
        let (Some(direction), true, true) = (direction, intensity.is_finite(), position.is_finite()) else {
            session
                .warnings
                .add(&at, "its intensity, direction or place is none or beyond all bounds; the light is skipped");
            continue;
        };
        let range = source.range.filter(|range| *range > 0.0).unwrap_or(f32::INFINITY);
        let name = [&source.name, &node.name].into_iter().find(|name| !name.is_empty()).cloned();
        let name = name.unwrap_or_else(|| format!("light {}", lights.len()));
        lights.push(PunctualLight { name, position, direction, intensity, range, kind });
    }
    lights
}
