//! What a worker keeps so that nothing is downloaded, decoded or built twice.
//!
//! - [`DiskStore`]: files under a byte budget, written atomically, safe for several processes on one folder;
//! - [`BlobCache`]: the service's blobs by hash, on a [`DiskStore`];
//! - [`StructureCache`]: built structures and Line Spaces in memory, on a [`DiskStore`], and in the service's blob store;
//! - [`Lru`]: values in memory under a byte budget.

mod blobs;
mod disk;
mod lru;
mod recipe;
mod structures;

pub use blobs::BlobCache;
pub use disk::{DiskStore, PendingFile, Pin};
pub use lru::Lru;
pub use recipe::{Built, Cached, Kept, LineSpaceRecipe, NodeSpacesRecipe, Recipe};
pub use structures::{Obtained, StructureCache, StructureStore};
