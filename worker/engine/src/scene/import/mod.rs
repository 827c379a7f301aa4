//! Import of glTF 2.0: from a [`Source`] to a [`Scene`].
//!
//! The order is what makes it safe: the document is parsed, every index and extent in it is proved
//! ([`check`]), buffers are read and held to their declared lengths, the budget for geometry and images is added up from
//! headers, and only then is anything decoded. What a picture can do without (a missing image, an unknown extension, a
//! degenerate triangle) becomes a warning; what would make it a wrong picture is an error with its position.

mod accessor;
mod check;
mod container;
mod document;
mod images;
mod materials;
mod meshes;
mod nodes;
mod placement;
mod pose;
mod primitive;
mod specular_glossiness;
mod tangents;
mod topology;
mod transform;
mod warnings;

#[cfg(test)]
mod tests;

#[cfg(test)]
pub(super) use primitive::face_normal;

use std::borrow::Cow;
use std::path::Path;

use accessor::Accessors;
use container::Container;
use document::{Document, SUPPORTED_EXTENSIONS};
use meshes::Unique;
use nodes::Graph;
use placement::Plan;
use warnings::Warnings;

use super::error::{ImportError, ImportErrorKind, Result};
use super::limits::Limits;
use super::model::Scene;
use super::source::{Meter, Source, uri};

/// What every step of one import shares.
struct Session<'a> {
    source: &'a Source,
    limits: &'a Limits,
    meter: Meter<'a>,
    warnings: Warnings,
    cancel: &'a (dyn Fn() -> bool + Sync),
}

impl Session<'_> {
    fn check_cancelled(&self) -> Result<()> {
        if (self.cancel)() { Err(ImportError::cancelled()) } else { Ok(()) }
    }
}

/// Imports a scene. `cancel` is asked between meshes and images.
///
/// # Errors
/// See [`ImportErrorKind`]; every error says where in the file it was found.
pub fn import(source: &Source, limits: &Limits, cancel: &(dyn Fn() -> bool + Sync)) -> Result<Scene> {
    let mut session = Session { source, limits, meter: Meter::new(limits), warnings: Warnings::default(), cancel };
    let main = source.read_main(&mut session.meter)?;
    let container = Container::split(&main)?;
    let document = Document::parse(&main[container.json])?;
    check::check(&document, limits)?;
    accessor::check_unbacked(&document, limits)?;
    warn_about_extensions(&document, &mut session);
    pose::warn_about_motion(&document, &mut session);

    let buffers = read_buffers(&document, container.binary.map(|range| &main[range]), &mut session)?;
    let accessors = Accessors::new(&document, buffers)?;
    let images = images::load(&document, &accessors, &mut session)?;
    let (mut materials, textures) = materials::convert(&document, &images, &mut session.warnings)?;

    let graph = Graph::walk(&document, &mut session)?;
    let plan = Plan::new(&document, &graph, &accessors, &mut session)?;
    let mut unique = Unique::default();
    let placed = meshes::load(&document, &accessors, &mut materials, &plan.shapes, &mut unique, &mut session)?;
    let instances = plan.instances(&document, &placed, &unique, &mut session);
    let cameras = nodes::cameras(&document, &graph, &mut session);
    let lights = nodes::lights(&document, &graph, &mut session);
    let mut scene = Scene {
        name: scene_name(&document, source),
        meshes: unique.meshes,
        instances,
        materials,
        textures,
        images: images.images,
        lights,
        cameras,
        warnings: session.warnings.into_messages(),
    };
    drop_unplaced_meshes(&mut scene);
    Ok(scene)
}

/// Imports a .glb, .zip or .gltf from disk.
///
/// # Errors
/// As [`import`] and [`Source::open`].
pub fn import_file(path: &Path, limits: &Limits) -> Result<Scene> {
    import(&Source::open(path, limits)?, limits, &|| false)
}

fn warn_about_extensions(document: &Document, session: &mut Session<'_>) {
    for name in &document.extensions_used {
        if !SUPPORTED_EXTENSIONS.contains(&name.as_str()) {
            session.warnings.add("extensionsUsed", format!("{} is not supported and has no effect", uri::quoted(name)));
        }
    }
}

fn read_buffers<'a>(
    document: &Document,
    binary: Option<&'a [u8]>,
    session: &mut Session<'a>,
) -> Result<Vec<Cow<'a, [u8]>>> {
    let mut buffers = Vec::with_capacity(document.buffers.len());
    for (index, buffer) in document.buffers.iter().enumerate() {
        session.check_cancelled()?;
        let at = format!("buffers/{index}");
        let bytes = match (&buffer.uri, binary) {
            (None, Some(binary)) if index == 0 => Cow::Borrowed(binary),
            (None, _) => {
                return Err(ImportError::new(
                    ImportErrorKind::MissingFile,
                    at,
                    "has no uri; only the first buffer of a .glb with a binary chunk may do without",
                ));
            }
            (Some(reference), _) => {
                let at = format!("{at}/uri");
                match uri::data_uri(reference, &at)? {
                    Some(bytes) => Cow::Owned(bytes),
                    None => session.source.read_reference(reference, &at, &mut session.meter)?,
                }
            }
        };
        buffers.push(bytes);
    }
    Ok(buffers)
}

fn scene_name(document: &Document, source: &Source) -> String {
    let named = document.scenes.get(document.scene.unwrap_or(0)).map(|scene| scene.name.trim());
    match named {
        // Names that exporters give every scene say less than the file's.
        None | Some("" | "Scene" | "scene" | "Sketchfab_Scene" | "AuxScene" | "Root Scene") => {
            let file = source.main().rsplit('/').next().unwrap_or_default();
            file.rsplit_once('.').map_or(file, |(stem, _)| stem).to_owned()
        }
        Some(name) => name.to_owned(),
    }
}

/// All instances of a mesh may have been skipped.
fn drop_unplaced_meshes(scene: &mut Scene) {
    let mut used = vec![false; scene.meshes.len()];
    for instance in &scene.instances {
        used[instance.mesh as usize] = true;
    }
    let mut kept = 0;
    let renumbered: Vec<u32> = used
        .iter()
        .map(|used| {
            let number = kept;
            kept += u32::from(*used);
            number
        })
        .collect();
    for instance in &mut scene.instances {
        instance.mesh = renumbered[instance.mesh as usize];
    }
    let mut flags = used.into_iter();
    scene.meshes.retain(|_| flags.next().unwrap_or(false));
}
