//! URIs inside a glTF file (glTF 2.0, 2.8): data URIs, and relative paths that must stay within the scene's folder.

use base64::Engine as _;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use percent_encoding::percent_decode_str;

use crate::scene::error::{ImportError, Result};

/// Base64 with or without its padding, since exporters write both.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// The bytes of a `data:` URI; `None` when `uri` is not one.
///
/// # Errors
/// Malformed, at `position`: no comma, or a body that is not base64.
pub(crate) fn data_uri(uri: &str, position: &str) -> Result<Option<Vec<u8>>> {
    let Some((scheme, rest)) = uri.split_at_checked(5) else { return Ok(None) };
    if !scheme.eq_ignore_ascii_case("data:") {
        return Ok(None);
    }
    let Some((head, body)) = rest.split_once(',') else {
        return Err(ImportError::malformed(position, "a data URI needs a comma between its media type and its data"));
    };
    if !head.to_ascii_lowercase().ends_with(";base64") {
        return Ok(Some(percent_decode_str(body).collect()));
    }
    BASE64
        .decode(body)
        .map(Some)
        .map_err(|error| ImportError::malformed(position, format!("the data URI is not valid base64: {error}")))
}

/// The path, relative to the scene's root, that `uri` means when it stands in a document in `folder` (also relative to
/// the root, empty for the root itself).
///
/// # Errors
/// Malformed, at `position`: a scheme or host, an absolute path, or a path that leaves the root.
pub(crate) fn resolve(folder: &str, uri: &str, position: &str) -> Result<String> {
    let has_scheme = uri.split(['/', '\\']).next().is_some_and(|first| first.contains(':'));
    if has_scheme {
        return Err(ImportError::malformed(
            position,
            format!("{} is not a relative path: files must come with the scene, nothing is downloaded", quoted(uri)),
        ));
    }
    let Ok(decoded) = percent_decode_str(uri).decode_utf8() else {
        return Err(ImportError::malformed(position, format!("{} does not decode to UTF-8", quoted(uri))));
    };
    normalise(folder, &decoded).ok_or_else(|| {
        ImportError::malformed(position, format!("{} leads outside the scene's own folder", quoted(uri)))
    })
}

/// `path`, relative to `folder`, without `.` and `..`; `None` when it is absolute, empty, leaves the root, or holds a
/// control character. Backslashes count as slashes.
pub(crate) fn normalise(folder: &str, path: &str) -> Option<String> {
    let path = path.replace('\\', "/");
    let absolute = path.starts_with('/') || path.as_bytes().get(1) == Some(&b':');
    if absolute || path.chars().any(char::is_control) {
        return None;
    }
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop()?;
            }
            part => parts.push(part),
        }
    }
    (!parts.is_empty()).then(|| parts.join("/"))
}

/// A URI as an error message shows it: quoted, and short whatever it holds.
pub(crate) fn quoted(uri: &str) -> String {
    const SHOWN: usize = 80;
    if uri.chars().count() <= SHOWN {
        return format!("{uri:?}");
    }
    let head: String = uri.chars().take(SHOWN).collect();
    format!("{head:?}…")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_uris_decode_with_and_without_padding_and_base64() {
        assert_eq!(data_uri("data:;base64,AAEC", "b").unwrap().unwrap(), [0, 1, 2]);
        assert_eq!(data_uri("data:application/octet-stream;base64,AAE=", "b").unwrap().unwrap(), [0, 1]);
        assert_eq!(data_uri("DATA:;BASE64,AAE", "b").unwrap().unwrap(), [0, 1]);
        assert_eq!(data_uri("data:text/plain,a%20b", "b").unwrap().unwrap(), b"a b");
        assert_eq!(data_uri("a.bin", "b").unwrap(), None);
        assert_eq!(data_uri("bin", "b").unwrap(), None);
    }

    #[test]
    fn broken_data_uris_are_refused_at_their_position() {
        let error = data_uri("data:;base64", "buffers/0/uri").unwrap_err();
        assert_eq!(error.position, "buffers/0/uri");
        assert!(data_uri("data:;base64,!!!!", "b").is_err());
    }

    #[test]
    fn relative_paths_resolve_against_the_documents_folder() {
        assert_eq!(resolve("", "a%20b/c.png", "p").unwrap(), "a b/c.png");
        assert_eq!(resolve("models/x", "../t/c.png", "p").unwrap(), "models/t/c.png");
        assert_eq!(resolve("", "./textures\\c.png", "p").unwrap(), "textures/c.png");
        assert_eq!(resolve("", "ü.png", "p").unwrap(), "ü.png");
    }

    #[test]
    fn schemes_hosts_and_escapes_are_refused() {
        for uri in [
            "http://example.com/a.bin",
            "file:///etc/passwd",
            "C:\\a.bin",
            "//host/a.bin",
            "/etc/passwd",
            "../a.bin",
            "x/../../a.bin",
            "%2e%2e/a.bin",
            "%2Fetc/passwd",
            "%ff.bin",
            "a%00.bin",
            "",
            ".",
        ] {
            let error = resolve("", uri, "buffers/0/uri").expect_err(uri);
            assert_eq!(error.position, "buffers/0/uri", "{uri}");
        }
    }
}
