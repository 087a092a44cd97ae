//! The location of a dataset: `data.source`.

use std::path::PathBuf;

use crate::Error;

/// A parsed source. Nothing is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Location {
    /// A local folder.
    Folder(PathBuf),
    /// A remote location.
    Remote {
        /// The service.
        service: Service,
        /// The address without a trailing slash.
        uri: String,
    },
}

/// Remote services.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Service {
    /// `gs://BUCKET/PREFIX`
    Gcs,
    /// `s3://BUCKET/PREFIX`
    S3,
    /// `http://` and `https://`, which are read-only.
    Http,
}

impl Location {
    /// Parses `source`: a path or a `file://`, `gs://`, `s3://`, `http://` or `https://` URI.
    ///
    /// Fails with [`Error::Scheme`] for another scheme, a `file://` URI with a host, invalid
    /// percent escapes, and an address without bucket or host; [`Error::Address`] for credentials
    /// or a query.
    pub fn parse(source: &str) -> Result<Self, Error> {
        let Some((scheme, rest)) = source.split_once("://") else {
            return Ok(Self::Folder(PathBuf::from(source)));
        };
        let refused = |scheme: &str| Error::Scheme {
            found: source.to_owned(),
            scheme: scheme.to_owned(),
        };
        let service = match scheme.to_ascii_lowercase().as_str() {
            "file" => {
                let path = rest.strip_prefix("localhost").unwrap_or(rest);
                if !path.starts_with('/') {
                    let host = path.split('/').next().unwrap_or_default();
                    return Err(refused(&format!("file://{host}")));
                }
                let folder = percent_decoded(path).ok_or_else(|| refused("file"))?;
                return Ok(Self::Folder(PathBuf::from(folder)));
            }
            "gs" => Service::Gcs,
            "s3" => Service::S3,
            "http" | "https" => Service::Http,
            _ => return Err(refused(scheme)),
        };
        if rest.is_empty() || rest.starts_with('/') {
            return Err(refused(&format!("{scheme}://(nothing)")));
        }
        let scheme = scheme.to_ascii_lowercase();
        let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
        let (user, host) = authority.rsplit_once('@').unwrap_or(("", authority));
        let problem = match service {
            _ if !user.is_empty() => Some("contains a user name or password"),
            Service::Http if path.contains(['?', '#']) => {
                Some("continues after its path (`?` or `#`)")
            }
            _ => None,
        };
        if let Some(problem) = problem {
            return Err(Error::Address {
                place: format!("{scheme}://{}", host.split('?').next().unwrap_or_default()),
                problem,
            });
        }
        Ok(Self::Remote {
            service,
            uri: format!("{scheme}://{}", rest.trim_end_matches('/')),
        })
    }
}

/// `text` with percent escapes decoded; `None` if they are invalid.
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
                Location::parse(source).unwrap(),
                Location::Folder(PathBuf::from(folder)),
                "{source}"
            );
        }
    }

    #[test]
    fn addresses_name_their_service() {
        for (source, service, uri) in [
            ("gs://bucket/set/", Service::Gcs, "gs://bucket/set"),
            ("S3://bucket", Service::S3, "s3://bucket"),
            ("https://host/a//", Service::Http, "https://host/a"),
        ] {
            let uri = uri.to_owned();
            assert_eq!(
                Location::parse(source).unwrap(),
                Location::Remote { service, uri }
            );
        }
    }

    #[test]
    fn secrets_in_addresses_are_refused_and_not_repeated() {
        for source in [
            "http://me:secret@host/set",
            "https://host/set?signature=secret",
            "https://host/set#secret",
            "gs://secret@bucket/set",
        ] {
            let error = Location::parse(source).unwrap_err();
            assert!(matches!(error, Error::Address { .. }), "{source}");
            assert!(!error.to_string().contains("secret"), "{error}");
        }
        assert!(Location::parse("gs://bucket/what?/is#this@").is_ok());
    }

    #[test]
    fn other_schemes_are_refused_by_name() {
        for (source, expected) in [
            ("ftp://host/set", "ftp"),
            ("gs://", "gs://(nothing)"),
            ("s3:///set", "s3://(nothing)"),
            ("file://host/set", "file://host"),
            ("file:///bad%zz", "file"),
            ("file:///bad%ff", "file"),
        ] {
            match Location::parse(source) {
                Err(Error::Scheme { scheme, .. }) => assert_eq!(scheme, expected),
                other => panic!("{source}: {other:?}"),
            }
        }
    }
}
