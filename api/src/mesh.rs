//! Meshes and the structures that exist for them.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Mesh {
    pub hash: String,
    pub triangles: u64,
    pub spheres: u64,
    pub structures: Vec<Structure>,
}

/// A built structure. Identified by mesh, kind, parameters and builder version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Structure {
    pub kind: String,
    pub parameters: String,
    pub builder_version: u32,
    pub bytes: u64,
    pub build_s: f64,
    /// When a worker told of it.
    pub built_at: Timestamp,
    /// BLAKE3 of the encoded structure in the blob store.
    pub blob: String,
    /// Ids of workers that hold it warm.
    #[serde(default)]
    pub workers: Vec<String>,
}

/// Body of `POST /v1/meshes:structures`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FindStructures {
    /// Hashes, at most 4096.
    pub meshes: Vec<String>,
    pub kind: String,
    pub parameters: String,
    pub builder_version: u32,
}

/// Answer to `POST /v1/meshes:structures`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FoundStructures {
    /// Blob of the encoded structure by mesh hash; meshes without one are not named.
    pub blobs: BTreeMap<String, String>,
}

/// Body of `POST /v1/meshes/{hash}/structures`, after the blob itself was put.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewStructure {
    pub kind: String,
    pub parameters: String,
    pub builder_version: u32,
    pub bytes: u64,
    pub build_s: f64,
    pub blob: String,
    /// Blob of the structure that is there and turned out to be unreadable; this one takes its place.
    #[serde(default)]
    pub replaces: Option<String>,
}
