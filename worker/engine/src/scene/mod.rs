//! Scenes: what a glTF file means, before anything is built over it.

mod model;

pub use model::*;
