//! Blobs: immutable bytes named by their BLAKE3 hash, 64 lower-case hex digits.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Answer to storing a blob.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StoredBlob {
    pub hash: String,
    pub bytes: u64,
}

/// Body of `POST /v1/blobs:missing`: at most 10,000 hashes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BlobQuery {
    pub hashes: Vec<String>,
}

/// Those of the asked hashes that the service does not hold, in the order asked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct MissingBlobs {
    pub missing: Vec<String>,
}

/// Whether a text is a hash as this API writes them.
pub fn is_hash(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}
