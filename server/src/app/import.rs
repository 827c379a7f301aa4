//! Importing an uploaded scene with the engine, off the async threads and a few at a time.

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use lightshaft_api::problem::FieldError;
use lightshaft_api::scene::{Bounds, CameraSummary, LightSummary, MeshSummary, SceneSummary};
use lightshaft_engine::scene::{self, Aabb, Content, ImportError, ImportErrorKind, Limits, Source};

use tokio::sync::Semaphore;

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
        let limits = self.config.limits.import.clone();
        let import = in_turn(&self.imports, move |is_cancelled| {
            let source = open(files, &limits)?;
            let scene = scene::import(&source, &limits, is_cancelled)?;
            Ok(summary(&scene.summary()))
        });
        import.await.map_err(ApiError::internal)?.map_err(import_error)
    }
}

/// Runs `work` on a thread of its own once a permit is free. The permit is the thread's: work that goes on for a while
/// after its client has gone still counts. A panic in it is an error here, and the service lives on.
async fn in_turn<T: Send + 'static>(
    permits: &Arc<Semaphore>,
    work: impl FnOnce(&(dyn Fn() -> bool + Sync)) -> T + Send + 'static,
) -> Result<T, Box<dyn Error + Send + Sync>> {
    let permit = Arc::clone(permits).acquire_owned().await?;
    let cancelled = Arc::new(AtomicBool::new(false));
    let _guard = CancelOnDrop(Arc::clone(&cancelled));
    let thread = tokio::task::spawn_blocking(move || {
        let _permit = permit;
        work(&|| cancelled.load(Ordering::Relaxed))
    });
    Ok(thread.await?)
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

/// The engine's summary as the API shows it.
pub fn summary(found: &scene::SceneSummary) -> SceneSummary {
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
    use std::sync::mpsc;
    use std::time::Duration;

    use super::*;

    #[tokio::test]
    async fn an_import_whose_client_has_gone_keeps_its_permit_until_it_stops() {
        let permits = Arc::new(Semaphore::new(1));
        let (started, has_started) = tokio::sync::oneshot::channel();
        let (go_on, may_go_on) = mpsc::channel::<()>();
        let (ended, has_ended) = tokio::sync::oneshot::channel();
        let import = in_turn(&permits, move |is_cancelled| {
            started.send(()).unwrap();
            may_go_on.recv().unwrap();
            ended.send(is_cancelled()).unwrap();
        });
        tokio::select! {
            _ = import => unreachable!("it cannot go on"),
            begun = has_started => begun.unwrap(),
        }
        assert_eq!(permits.available_permits(), 0, "the client has gone, its import has not");
        go_on.send(()).unwrap();
        assert!(has_ended.await.unwrap(), "it is told to stop");
        drop(tokio::time::timeout(Duration::from_secs(10), permits.acquire()).await.unwrap().unwrap());
    }

    #[test]
    fn formats_are_told_by_their_first_bytes() {
        assert_eq!(Format::sniff(b"glTF\x02\0\0\0"), Some(Format::Glb));
        assert_eq!(Format::sniff(b"PK\x03\x04"), Some(Format::Zip));
        assert_eq!(Format::sniff(b"\xef\xbb\xbf \n{\"asset\""), Some(Format::Gltf));
        assert_eq!(Format::sniff(b""), None);
        assert_eq!(Format::sniff(b"\x89PNG"), None);
    }
}
