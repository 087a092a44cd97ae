//! Where a dataset lies: what `data.source` may say.

use std::path::PathBuf;

use crate::Error;

/// The local folder that `source` (a path or a `file://` URI) names. Nothing is opened.
///
/// # Errors
/// [`Error::Scheme`] for any other scheme (`gs://`, `s3://`, `http://`), for a `file://` URI with
/// a host, and for percent escapes that are not UTF-8.
pub fn local_folder(source: &str) -> Result<PathBuf, Error> {
    let Some((scheme, rest)) = source.split_once("://") else {
        return Ok(PathBuf::from(source));
    };
    let refused = |scheme: &str| Error::Scheme {
        found: source.to_owned(),
        scheme: scheme.to_owned(),
    };
    if !scheme.eq_ignore_ascii_case("file") {
        return Err(refused(scheme));
    }
    let path = rest.strip_prefix("localhost").unwrap_or(rest);
    if !path.starts_with('/') {
        let host = path.split('/').next().unwrap_or_default();
        return Err(refused(&format!("file://{host}")));
    }
    percent_decoded(path)
        .map(PathBuf::from)
        .ok_or_else(|| refused("file"))
}

/// `text` with `%20` and its like replaced; `None` where that is malformed or not UTF-8.
fn percent_decoded(text: &str) -> Option<String> {
    let mut bytes = text.bytes();
    let mut decoded = Vec::with_capacity(text.len());
    while let Some(byte) = bytes.next() {
        if byte != b'%' {
            decoded.push(byte);
            continue;
        }
        let high = char::from(bytes.next()?).to_digit(16)?;
        let low = char::from(bytes.next()?).to_digit(16)?;
        decoded.push((high * 16 + low) as u8);
    }
    String::from_utf8(decoded).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_and_file_uris_name_folders() {
        for (source, folder) in [
            ("../shared/real", "../shared/real"),
            ("file:///data/set%20one", "/data/set one"),
            ("file://localhost/data", "/data"),
            ("FILE:///data", "/data"),
        ] {
            assert_eq!(
                local_folder(source).unwrap(),
                PathBuf::from(folder),
                "{source}"
            );
        }
    }

    #[test]
    fn other_schemes_are_refused_by_name() {
        for (source, expected) in [
            ("gs://bucket/set", "gs"),
            ("https://host/set", "https"),
            ("file://host/set", "file://host"),
            ("file:///bad%zz", "file"),
            ("file:///bad%ff", "file"),
        ] {
            match local_folder(source) {
                Err(Error::Scheme { scheme, .. }) => assert_eq!(scheme, expected),
                other => panic!("{source}: {other:?}"),
            }
        }
    }
}
