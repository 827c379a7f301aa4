//! Scenes: what a glTF file means, before anything is built over it.

mod error;
mod generate;
mod hash;
mod import;
mod limits;
mod model;
mod source;
mod summary;
mod view;
mod write_glb;

pub use error::{ImportError, ImportErrorKind};
pub use generate::{GenerateError, KINDS, Kind, Params, generate};
pub use hash::mesh_hash;
pub use import::{import, import_file};
pub use limits::Limits;
pub use model::*;
pub use source::{Content, Source};
pub use summary::{CameraSummary, LightSummary, MeshSummary, SceneSummary};
pub use view::default_camera;
