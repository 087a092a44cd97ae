//! Names of a dataset's files (CC-MotionGen, section 1.3) and valid ids.

use crate::StoreError;

/// Folder of all motion, and the file name in each phrase's folder.
pub const MOTION_FILE: (&str, &str) = ("motion", "trajectory.npy");

/// Folder of all audio features, and the file name in each phrase's folder.
pub const AUDIO_FILE: (&str, &str) = ("audio_features", "features.npz");

/// The table of all phrases.
pub const MANIFEST: &str = "manifest.parquet";

/// The preparation report, written with the dataset.
pub const PREPARATION: &str = "prepare/report.json";

/// Maximum length of an id, bytes; file systems allow 255 bytes for a name.
const MAX_ID_BYTES: usize = 200;

/// Path of the motion of phrase `id` in its dataset.
pub fn motion_path(id: &str) -> String {
    format!("{}/{id}/{}", MOTION_FILE.0, MOTION_FILE.1)
}

/// Path of the audio features of phrase `id` in its dataset.
pub fn features_path(id: &str) -> String {
    format!("{}/{id}/{}", AUDIO_FILE.0, AUDIO_FILE.1)
}

/// Rejects ids that are not plain file names. Fails with [`StoreError::Path`].
pub fn check_id(id: &str) -> Result<(), StoreError> {
    let reason = match id {
        _ if id.contains(['/', '\\']) => "an id has no slash in it",
        _ if id.len() > MAX_ID_BYTES => "an id has at most 200 bytes",
        _ if id.trim() != id => "an id begins and ends with no blank: lists of ids would lose it",
        _ => return check_path(id),
    };
    Err(StoreError::Path {
        path: id.to_owned(),
        reason,
    })
}

/// Rejects paths that are absolute, ambiguous or lead upwards.
pub(crate) fn check_path(path: &str) -> Result<(), StoreError> {
    let is_odd = |c: char| c == '\\' || c.is_control();
    let reason = match path {
        _ if path.starts_with('/') => "it is absolute",
        _ if path.contains(is_odd) => "it contains a backslash or a control character",
        _ if path.split('/').any(|part| matches!(part, "" | "." | "..")) => {
            "it has an empty part, `.` or `..`"
        }
        _ => return Ok(()),
    };
    Err(StoreError::Path {
        path: path.to_owned(),
        reason,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::path::{Component, Path};

    #[test]
    fn tricks_are_refused_and_names_are_not() {
        for id in [
            "",
            ".",
            "..",
            "../a",
            "a/b",
            "/etc",
            "a\\b",
            "a\0b",
            "a\nb",
            " a",
            "a ",
            &"a".repeat(201),
        ] {
            assert!(check_id(id).is_err(), "{id:?}");
        }
        for id in ["C_5_00188", "a b", "a..b", "..a", "Größe", &"a".repeat(200)] {
            assert!(check_id(id).is_ok(), "{id:?}");
        }
    }

    proptest! {
        #[test]
        fn an_allowed_path_never_leaves_its_folder(path in "[a./\\\\ ]{0,12}") {
            if check_path(&path).is_ok() {
                let parts: Vec<_> = Path::new(&path).components().collect();
                prop_assert!(!parts.is_empty());
                prop_assert!(parts.iter().all(|part| matches!(part, Component::Normal(_))), "{path}");
            }
        }
    }
}
