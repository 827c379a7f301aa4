//! Where a scene's bytes come from: one .glb, a .zip, a set of uploaded files, or a .gltf on disk with its siblings.
//!
//! A [`Source`] only finds and reads files by their path relative to the scene's root. Every read is counted against
//! the budget of the import, so that neither a zip bomb nor one file named a thousand times costs more than allowed.

mod archive;
pub(super) mod uri;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use archive::{Archive, ReadSeek};

use super::error::{ImportError, ImportErrorKind, Result};
use super::limits::Limits;

/// One file of a scene that came in several parts.
#[derive(Clone, Debug)]
pub enum Content {
    Bytes(Vec<u8>),
    /// Read from disk when it is needed.
    File(PathBuf),
}

/// A scene's files. Opening one reads no more than a directory or a few bytes.
#[derive(Debug)]
pub struct Source {
    /// Path of the .glb or .gltf, relative to the root.
    main: String,
    files: Files,
}

enum Files {
    Set(BTreeMap<String, Content>),
    Zip(Archive),
    /// A .gltf on disk: other files are looked for below its folder.
    Folder(PathBuf),
}

impl std::fmt::Debug for Files {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Set(files) => f.debug_tuple("Set").field(&files.keys()).finish(),
            Self::Zip(archive) => f.debug_tuple("Zip").field(&archive.names().collect::<Vec<_>>()).finish(),
            Self::Folder(folder) => f.debug_tuple("Folder").field(folder).finish(),
        }
    }
}

impl Source {
    /// A .glb, a .zip, or a .gltf with its files beside it. What it is, its first bytes say, not its name.
    ///
    /// # Errors
    /// [`Io`](ImportErrorKind::Io) when the file cannot be opened; the errors of a bad archive.
    pub fn open(path: &Path, limits: &Limits) -> Result<Self> {
        let name = file_name(path);
        let mut file = File::open(path).map_err(|error| ImportError::io(name.as_str(), &error))?;
        let mut start = [0; 4];
        let read = read_up_to(&mut file, &mut start).map_err(|error| ImportError::io(name.as_str(), &error))?;
        match Kind::of(&start[..read]) {
            Kind::Zip => Self::zip(Box::new(file), limits),
            Kind::Glb => {
                Ok(Self { main: name.clone(), files: Files::Set([(name, Content::File(path.to_owned()))].into()) })
            }
            Kind::Json => {
                let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
                let folder = folder.unwrap_or(Path::new(".")).canonicalize();
                let folder = folder.map_err(|error| ImportError::io(name.as_str(), &error))?;
                Ok(Self { main: name, files: Files::Folder(folder) })
            }
        }
    }

    /// The same from memory; a .gltf must then hold all its data in data URIs.
    ///
    /// # Errors
    /// Those of a bad archive.
    pub fn from_bytes(name: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Self> {
        match Kind::of(&bytes) {
            Kind::Zip => Self::zip(Box::new(Cursor::new(bytes)), limits),
            Kind::Glb | Kind::Json => {
                Ok(Self { main: name.to_owned(), files: Files::Set([(name.to_owned(), Content::Bytes(bytes))].into()) })
            }
        }
    }

    /// An upload of several parts: each file under the path by which the .gltf names it. Exactly one of them must be the
    /// .gltf (or .glb).
    ///
    /// # Errors
    /// Malformed: a path that is absolute or holds `..`, two files of one path, no .gltf or more than one.
    pub fn from_files(parts: impl IntoIterator<Item = (String, Content)>, limits: &Limits) -> Result<Self> {
        let mut files = BTreeMap::new();
        for (name, content) in parts {
            let path = uri::normalise("", &name).ok_or_else(|| {
                ImportError::malformed(uri::quoted(&name), "file names must be relative paths within the scene")
            })?;
            if files.insert(path, content).is_some() {
                return Err(ImportError::malformed(uri::quoted(&name), "came twice; each file must come once"));
            }
            Limits::check("", "files", files.len() as u64, limits.files)?;
        }
        let main = find_main(files.keys().map(String::as_str))?;
        Ok(Self { main, files: Files::Set(files) })
    }

    fn zip(reader: Box<dyn ReadSeek>, limits: &Limits) -> Result<Self> {
        let archive = Archive::open(reader, limits)?;
        let main = find_main(archive.names())?;
        Ok(Self { main, files: Files::Zip(archive) })
    }

    /// Path of the .glb or .gltf, relative to the root.
    pub fn main(&self) -> &str {
        &self.main
    }

    /// Reads the file that `reference`, found at `position` in the main document, names.
    pub(super) fn read_reference(
        &self,
        reference: &str,
        position: &str,
        meter: &mut Meter<'_>,
    ) -> Result<Cow<'_, [u8]>> {
        let folder = self.main.rsplit_once('/').map_or("", |(folder, _)| folder);
        let resolved = uri::resolve(folder, reference, position)?;
        let path = match uri::normalise(folder, reference) {
            // Some exporters do not percent-encode: a file that bears the literal name is meant as well.
            Some(literal) if !self.contains(&resolved) && self.contains(&literal) => literal,
            _ => resolved,
        };
        if !self.contains(&path) {
            return Err(ImportError::new(
                ImportErrorKind::MissingFile,
                position,
                format!("the file {} did not come with the scene", uri::quoted(&path)),
            ));
        }
        self.read(&path, meter)
    }

    pub(super) fn read_main(&self, meter: &mut Meter<'_>) -> Result<Cow<'_, [u8]>> {
        self.read(&self.main, meter)
    }

    fn contains(&self, path: &str) -> bool {
        match &self.files {
            Files::Set(files) => files.contains_key(path),
            Files::Zip(archive) => archive.contains(path),
            Files::Folder(folder) => folder.join(path).is_file(),
        }
    }

    fn read(&self, path: &str, meter: &mut Meter<'_>) -> Result<Cow<'_, [u8]>> {
        let bytes = match &self.files {
            Files::Set(files) => match files.get(path) {
                Some(Content::Bytes(bytes)) => Cow::Borrowed(bytes.as_slice()),
                Some(Content::File(file)) => Cow::Owned(read_file(file, path, meter)?),
                None => return Err(ImportError::new(ImportErrorKind::MissingFile, path, "is not there")),
            },
            Files::Zip(archive) => Cow::Owned(archive.read(path, meter.left(), meter.limits)?),
            Files::Folder(folder) => {
                let file = folder.join(path).canonicalize().map_err(|error| ImportError::io(path, &error))?;
                if !file.starts_with(folder) {
                    return Err(ImportError::malformed(path, "is a link that leads outside the scene's own folder"));
                }
                Cow::Owned(read_file(&file, path, meter)?)
            }
        };
        meter.count(path, bytes.len() as u64)?;
        Ok(bytes)
    }
}

/// Counts the bytes that one import has read.
pub(super) struct Meter<'a> {
    limits: &'a Limits,
    used: u64,
}

impl<'a> Meter<'a> {
    pub(super) fn new(limits: &'a Limits) -> Self {
        Self { limits, used: 0 }
    }

    fn left(&self) -> u64 {
        self.limits.input_bytes - self.used
    }

    /// Takes note of `bytes` more.
    pub(super) fn count(&mut self, position: &str, bytes: u64) -> Result<()> {
        let used = self.used.saturating_add(bytes);
        Limits::check(position, "bytes in the scene's files", used, self.limits.input_bytes)?;
        self.used = used;
        Ok(())
    }
}

#[derive(Debug, PartialEq, Eq)]
enum Kind {
    Glb,
    Zip,
    Json,
}

impl Kind {
    /// By the first four bytes; what is neither .glb nor .zip is taken for JSON, whose parser explains what is wrong.
    fn of(start: &[u8]) -> Self {
        match start.get(..4) {
            Some(b"glTF") => Self::Glb,
            Some(b"PK\x03\x04" | b"PK\x05\x06") => Self::Zip,
            _ => Self::Json,
        }
    }
}

/// The one .gltf or .glb that lies nearest to the root.
fn find_main<'a>(names: impl Iterator<Item = &'a str>) -> Result<String> {
    let depth = |name: &str| name.matches('/').count();
    let is_main = |name: &str| {
        let extension = name.rsplit_once('.').map(|(_, extension)| extension.to_ascii_lowercase());
        matches!(extension.as_deref(), Some("gltf" | "glb"))
    };
    let mut candidates: Vec<&str> = names.filter(|name| is_main(name)).collect();
    let nearest = candidates.iter().map(|name| depth(name)).min();
    candidates.retain(|name| Some(depth(name)) == nearest);
    match candidates[..] {
        [main] => Ok(main.to_owned()),
        [] => Err(ImportError::malformed("", "there is no .gltf or .glb among the files; exactly one is needed")),
        [first, second, ..] => Err(ImportError::malformed(
            "",
            format!(
                "{} and {} could both be the scene; exactly one .gltf or .glb may lie at the top",
                uri::quoted(first),
                uri::quoted(second)
            ),
        )),
    }
}

fn read_file(file: &Path, shown: &str, meter: &Meter<'_>) -> Result<Vec<u8>> {
    let mut opened = File::open(file).map_err(|error| ImportError::io(shown, &error))?;
    let bytes = opened.metadata().map_err(|error| ImportError::io(shown, &error))?.len();
    Limits::check(shown, "bytes", bytes, meter.left())?;
    let mut contents = Vec::with_capacity(bytes as usize);
    opened
        .by_ref()
        .take(meter.left().saturating_add(1))
        .read_to_end(&mut contents)
        .map_err(|error| ImportError::io(shown, &error))?;
    Ok(contents)
}

fn read_up_to(reader: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match reader.read(&mut buffer[filled..])? {
            0 => break,
            read => filled += read,
        }
    }
    Ok(filled)
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(|| "scene".to_owned(), |name| name.to_string_lossy().into_owned())
}
