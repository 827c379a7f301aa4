//! Importing an uploaded scene with the engine, off the async threads and a few at a time.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use lightshaft_api::problem::FieldError;
use lightshaft_api::scene::{Bounds, CameraSummary, LightSummary, MeshSummary, SceneSummary};
use lightshaft_engine::scene::{self, Aabb, Content, ImportError, ImportErrorKind, Limits, Source};

use super::App;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;

/// What an upload is, by its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Glb,
    Zip,
    Gltf,
}

impl Format {
    /// By the first bytes; `None` when it is none of them.
    pub fn sniff(start: &[u8]) -> Option<Self> {
        if start.starts_with(b"glTF") {
            return Some(Self::Glb);
        }
        if start.starts_with(b"PK") {
            return Some(Self::Zip);
        }
        let text = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start);
        (text.trim_ascii_start().first() == Some(&b'{')).then_some(Self::Gltf)
    }

    /// The name under which a single file is kept.
    pub fn file_name(self) -> &'static str {
        match self {
            Self::Glb => "scene.glb",
            Self::Zip => "scene.zip",
            Self::Gltf => "scene.gltf",
        }
    }

    pub fn media_type(self) -> &'static str {
        match self {
            Self::Glb => "model/gltf-binary",
            Self::Zip => "application/zip",
            Self::Gltf => "model/gltf+json",
        }
    }
}

/// Files on disk that make up a scene.
#[derive(Clone, Debug)]
pub enum Files {
    Zip(PathBuf),
    /// Each under the path by which the glTF names it.
    Set(Vec<(String, PathBuf)>),
}

/// Tells the import to stop when the client has gone.
struct CancelOnDrop(Arc<AtomicBool>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl App {
    /// Reads the whole scene; nothing of it is kept but the summary.
    pub(super) async fn import(&self, files: Files) -> ApiResult<SceneSummary> {
        let _turn = self.imports.acquire().await.map_err(ApiError::internal)?;
        let cancelled = Arc::new(AtomicBool::new(false));
        let _guard = CancelOnDrop(Arc::clone(&cancelled));
        let limits = self.config.limits.import.clone();
        let imported = tokio::task::spawn_blocking(move || {
            let source = open(files, &limits)?;
            let scene = scene::import(&source, &limits, &|| cancelled.load(Ordering::Relaxed))?;
            Ok(summary(&scene.summary()))
        });
        // A panic in the importer ends up here as a join error: an answer of 500, and the service lives on.
        imported.await.map_err(ApiError::internal)?.map_err(import_error)
    }
}

fn open(files: Files, limits: &Limits) -> Result<Source, ImportError> {
    match files {
        Files::Zip(path) => Source::open(&path, limits),
        Files::Set(files) => {
            Source::from_files(files.into_iter().map(|(path, file)| (path, Content::File(file))), limits)
        }
    }
}

fn import_error(error: ImportError) -> ApiError {
    match error.kind {
        ImportErrorKind::Io | ImportErrorKind::Cancelled => ApiError::internal(error),
        ImportErrorKind::Malformed
        | ImportErrorKind::Unsupported
        | ImportErrorKind::MissingFile
        | ImportErrorKind::Limit => {
            let pointer =
                if error.position.is_empty() { "file".to_owned() } else { format!("file/{}", error.position) };
            ApiError::with_errors(Code::InvalidScene, vec![FieldError::new(pointer, error.message)])
        }
    }
}

fn summary(found: &scene::SceneSummary) -> SceneSummary {
    let meshes = found.meshes.iter().map(|mesh| MeshSummary {
        hash: mesh.hash.to_string(),
        name: mesh.name.clone(),
        triangles: mesh.triangles,
        spheres: mesh.spheres,
        instances: mesh.instances,
        bounds: bounds(mesh.bounds),
    });
    let cameras =
        found.cameras.iter().map(|camera| CameraSummary { name: camera.name.clone(), kind: camera.kind.to_owned() });
    let lights =
        found.lights.iter().map(|light| LightSummary { name: light.name.clone(), kind: light.kind.to_owned() });
    SceneSummary {
        meshes: meshes.collect(),
        instances: found.instances,
        triangles_total: found.triangles_total,
        triangles_instanced: found.triangles_instanced,
        spheres_total: found.spheres_total,
        materials: found.materials.clone(),
        textures: found.textures,
        texture_pixels: found.texture_pixels,
        cameras: cameras.collect(),
        lights: lights.collect(),
        emitters: found.emitters,
        bounds: bounds(found.bounds),
        estimated_bytes: found.estimated_bytes,
        warnings: found.warnings.clone(),
    }
}

fn bounds(found: Aabb) -> Option<Bounds> {
    (!found.is_empty()).then(|| Bounds { min: found.min.to_array(), max: found.max.to_array() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_told_by_their_first_bytes() {
        assert_eq!(Format::sniff(b"glTF\x02\0\0\0"), Some(Format::Glb));
        assert_eq!(Format::sniff(b"PK\x03\x04"), Some(Format::Zip));
        assert_eq!(Format::sniff(b"\xef\xbb\xbf \n{\"asset\""), Some(Format::Gltf));
        assert_eq!(Format::sniff(b""), None);
        assert_eq!(Format::sniff(b"\x89PNG"), None);
    }
}
