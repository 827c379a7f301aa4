//! Line Spaces: shafts, payloads and what is claimed of them, against slow oracles.

mod approximate;
mod cells;
mod classes;
#[path = "../common/mod.rs"]
mod common;
mod judge;
mod meshes;
mod nodes;
mod payloads;
mod shafts;
mod surfaces;
