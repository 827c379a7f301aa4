//! The container around the glTF JSON: a .glb and its chunks (glTF 2.0, section 4.4).

use std::ops::Range;

use crate::scene::error::{ImportError, Result};

/// The JSON of a main file and, of a .glb, where its binary chunk lies.
pub(super) struct Container {
    pub(super) json: Range<usize>,
    pub(super) binary: Option<Range<usize>>,
}

impl Container {
    /// Splits a .glb into its chunks; anything else is JSON as a whole.
    ///
    /// # Errors
    /// Unsupported: a container version other than 2. Malformed: lengths that do not fit the file, or a first chunk that
    /// is not JSON.
    pub(super) fn split(bytes: &[u8]) -> Result<Self> {
        if !bytes.starts_with(b"glTF") {
            return Ok(Self { json: 0..bytes.len(), binary: None });
        }
        let word = |at: usize| {
            let four = bytes.get(at..at.checked_add(4)?)?;
            Some(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
        };
        let truncated =
            |what: &str| ImportError::malformed("", format!("the .glb ends within {what}; it is truncated"));
        let version = word(4).ok_or_else(|| truncated("its header"))?;
        if version != 2 {
            return Err(ImportError::unsupported(
                "",
                format!("the .glb has container version {version}; only version 2 (glTF 2.0) is supported"),
            ));
        }
        let declared = word(8).ok_or_else(|| truncated("its header"))? as usize;
        if declared > bytes.len() {
            return Err(ImportError::malformed(
                "",
                format!("the .glb says that it is {declared} bytes long, but it has {}; it is truncated", bytes.len()),
            ));
        }
        let mut json = None;
        let mut binary = None;
        let mut at = 12;
        while at < declared {
            let length = word(at).ok_or_else(|| truncated("a chunk header"))? as usize;
            let kind = word(at + 4).ok_or_else(|| truncated("a chunk header"))?.to_le_bytes();
            let start = at + 8;
            let end = start.checked_add(length).filter(|end| *end <= declared).ok_or_else(|| {
                ImportError::malformed(
                    "",
                    format!("the chunk at byte {at} says that it is {length} bytes long, beyond the end of the .glb"),
                )
            })?;
            match (&kind, json.is_some()) {
                (b"JSON", false) => json = Some(start..end),
                (b"BIN\0", true) if binary.is_none() => binary = Some(start..end),
                (_, false) => {
                    return Err(ImportError::malformed("", "the first chunk of the .glb is not its JSON chunk"));
                }
                // Chunks of other kinds are to be skipped (glTF 2.0, 4.4.3.1).
                _ => {}
            }
            at = end.next_multiple_of(4);
        }
        let json = json.ok_or_else(|| ImportError::malformed("", "the .glb has no JSON chunk"))?;
        Ok(Self { json, binary })
    }
}
