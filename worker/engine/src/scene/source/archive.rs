//! Scenes in a .zip: names that could escape are refused on opening, sizes are held to the budget while reading.

use std::collections::BTreeMap;
use std::io::{Read, Seek};
use std::sync::Mutex;

use zip::ZipArchive;
use zip::result::ZipError;

use super::uri;
use crate::scene::error::{ImportError, ImportErrorKind, Result};
use crate::scene::limits::Limits;

/// Entries up to this size may have any ratio: a small file of zeros is no bomb.
const RATIO_FREE_BYTES: u64 = 1 << 20;

pub(super) trait ReadSeek: Read + Seek + Send {}
impl<T: Read + Seek + Send> ReadSeek for T {}

/// An opened archive whose directory has been checked.
pub(super) struct Archive {
    reader: Mutex<ZipArchive<Box<dyn ReadSeek>>>,
    /// Entry number by normalised path.
    entries: BTreeMap<String, usize>,
}

impl Archive {
    pub(super) fn open(reader: Box<dyn ReadSeek>, limits: &Limits) -> Result<Self> {
        let mut archive = ZipArchive::new(reader).map_err(|error| zip_error("", &error))?;
        if archive.has_duplicate_names() {
            return Err(ImportError::malformed("", "the zip holds two files of the same name"));
        }
        Limits::check("", "files in the zip", archive.len() as u64, limits.files)?;

        let mut entries = BTreeMap::new();
        for index in 0..archive.len() {
            let entry = archive.by_index_raw(index).map_err(|error| zip_error(&format!("entry {index}"), &error))?;
            let raw_name = entry.name().map_err(|error| zip_error(&format!("entry {index}"), &error))?.into_owned();
            let shown = uri::quoted(&raw_name);
            if entry.is_symlink() {
                return Err(ImportError::unsupported(shown, "is a symbolic link; put the file itself into the zip"));
            }
            if entry.encrypted() {
                return Err(ImportError::unsupported(shown, "is encrypted; upload the zip without a password"));
            }
            let leaves_root = raw_name.split(['/', '\\']).any(|part| part == "..");
            let path = uri::normalise("", &raw_name).filter(|_| !leaves_root).ok_or_else(|| {
                ImportError::malformed(shown.as_str(), "names in a zip must be relative paths without \"..\"")
            })?;
            if entry.is_dir() || is_clutter(&path) {
                continue;
            }
            Limits::check(&shown, "bytes (decompressed)", entry.size(), limits.input_bytes)?;
            if entries.insert(path, index).is_some() {
                return Err(ImportError::malformed(shown, "the zip holds two files of the same name"));
            }
        }
        Ok(Self { reader: Mutex::new(archive), entries })
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    pub(super) fn contains(&self, path: &str) -> bool {
        self.entries.contains_key(path)
    }

    /// Decompresses one file, never beyond `budget` bytes whatever its header claims.
    pub(super) fn read(&self, path: &str, budget: u64, limits: &Limits) -> Result<Vec<u8>> {
        let Some(&index) = self.entries.get(path) else {
            return Err(ImportError::new(ImportErrorKind::MissingFile, path, "is not in the zip"));
        };
        // A panic while the lock is held would leave only a seek position behind, which every read sets anew.
        let mut archive = self.reader.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let entry = archive.by_index(index).map_err(|error| zip_error(path, &error))?;
        let ratio_bytes = entry.compressed_size().saturating_mul(limits.zip_ratio).max(RATIO_FREE_BYTES);
        let most = budget.min(ratio_bytes);
        // The header's size is a hint only: reserve what it says up to a bound, and let the data prove the rest.
        let mut bytes = Vec::with_capacity(entry.size().min(most).min(64 << 20) as usize);
        entry
            .take(most.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(|error| ImportError::malformed(path, format!("cannot be decompressed: {error}")))?;
        if bytes.len() as u64 > most {
            let message = if ratio_bytes < budget {
                format!("decompresses to more than {} times its size", limits.zip_ratio)
            } else {
                format!("the scene's files decompress to more than the limit of {} bytes", limits.input_bytes)
            };
            return Err(ImportError::new(ImportErrorKind::Limit, path, message));
        }
        Ok(bytes)
    }
}

/// Files that archivers add by themselves.
fn is_clutter(path: &str) -> bool {
    path.starts_with("__MACOSX/") || path.rsplit('/').next().is_some_and(|name| name == ".DS_Store")
}

fn zip_error(position: &str, error: &ZipError) -> ImportError {
    match error {
        ZipError::UnsupportedArchive(_) | ZipError::CompressionMethodNotSupported(_) => {
            ImportError::unsupported(position, format!("{error}; use a plain zip (stored or deflate)"))
        }
        error => ImportError::malformed(position, format!("the zip is damaged: {error}")),
    }
}
