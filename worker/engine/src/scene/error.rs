//! The one error of scene import: where in the file, what is wrong, and what would be right.

/// Which kind of answer an [`ImportError`] asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImportErrorKind {
    /// The file breaks its format.
    Malformed,
    /// The file is well formed but needs something that is not supported: a glTF version, a required extension, an
    /// encrypted archive.
    Unsupported,
    /// The file names another one that did not come with it.
    MissingFile,
    /// The scene is over a limit of [`Limits`](super::Limits).
    Limit,
    /// The disk failed, not the file.
    Io,
    Cancelled,
}

/// Why a scene could not be imported.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{}{message}", position, if position.is_empty() { "" } else { ": " })]
pub struct ImportError {
    pub kind: ImportErrorKind,
    /// Where: a path through the glTF document such as `meshes/0/primitives/1/attributes/POSITION`, or a file's name.
    /// Empty when the whole file is meant.
    pub position: String,
    /// What is wrong and what would be right, in plain words.
    pub message: String,
}

impl ImportError {
    pub(super) fn new(kind: ImportErrorKind, position: impl Into<String>, message: impl Into<String>) -> Self {
        Self { kind, position: position.into(), message: message.into() }
    }

    pub(super) fn malformed(position: impl Into<String>, message: impl Into<String>) -> Self {
        Self::new(ImportErrorKind::Malformed, position, message)
    }

    pub(super) fn unsupported(position: impl Into<String>, message: impl Into<String>) -> Self {
        Self::new(ImportErrorKind::Unsupported, position, message)
    }

    pub(super) fn io(position: impl Into<String>, error: &std::io::Error) -> Self {
        Self::new(ImportErrorKind::Io, position, format!("cannot be read: {error}"))
    }

    pub(super) fn cancelled() -> Self {
        Self::new(ImportErrorKind::Cancelled, "", "the import was cancelled")
    }
}

pub(super) type Result<T, E = ImportError> = std::result::Result<T, E>;
