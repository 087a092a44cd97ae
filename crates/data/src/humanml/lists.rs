//! The clip lists of a dataset, `train.txt` and `val.txt`, with one id per line.

use kinegrad_settings::counted;
use std::collections::{BTreeMap, HashMap};

use crate::files::Files;
use crate::layout::check_id;
use crate::listing::{Expected, Listed};
use crate::split::Side;
use crate::{Error, FileError};

use super::Humanml3dConfig;
use super::clip::{FEATURES, features_path};
use super::texts::{TEXTS, texts_path};

/// Largest list.
pub(super) const MAX_BYTES: u64 = 1 << 28;

/// The clips of both lists, sorted by id. Fails with [`Error::File`] for a missing or empty list,
/// an invalid id, and a clip on both lists; [`Error::Store`].
pub(super) fn read_lists(
    files: &Files,
    config: &Humanml3dConfig,
    warnings: &mut Vec<String>,
) -> Result<Vec<Listed>, Error> {
    let mut sides: BTreeMap<String, Side> = BTreeMap::new();
    // An evaluation may hold out the test list.
    let held_out = match config.validation_list == config.test_list {
        true => "test_list",
        false => "validation_list",
    };
    for (key, list, side) in [
        ("train_list", &config.train_list, Side::Train),
        (held_out, &config.validation_list, Side::Validation),
    ] {
        if list.is_empty() {
            continue;
        }
        let name = files.store.name_of(list);
        let mut twice = Vec::new();
        let Some((bytes, _)) = files.find(list, MAX_BYTES)? else {
            let hint = format!(
                "a HumanML3D dataset contains new_joint_vecs/, texts/ and its lists; data.source \
                 names the folder and data.humanml3d.{key} the list in it"
            );
            let expected = "a list of clips, one id a line";
            return Err(FileError::unexpected(name, "no such file", expected, hint).into());
        };
        let ids = parse_list(&bytes, &name)?;
        if ids.is_empty() && side == Side::Train {
            let hint = "clips on no list are not used";
            return Err(FileError::unexpected(name, "no id", "one id a line", hint).into());
        }
        for (line, id) in ids {
            match sides.insert(id.clone(), side) {
                Some(before) if before != side => {
                    let found = format!("clip `{id}`, which {} lists too", config.train_list);
                    return Err(FileError::unexpected(
                        format!("{name}, line {line}"),
                        found,
                        "held-out clips that are not trained on",
                        "remove it from one of the lists",
                    )
                    .into());
                }
                Some(_) => twice.push(id),
                None => {}
            }
        }
        if let Some(first) = twice.first() {
            let clips = counted(twice.len(), "clip");
            warnings.push(format!(
                "{name} lists {clips} twice, counted once; the first: {first}"
            ));
        }
    }
    let (features, texts) = (
        files.store.versions(FEATURES)?,
        files.store.versions(TEXTS)?,
    );
    let listed = sides.into_iter().map(|(id, side)| {
        let version = |versions: &HashMap<String, String>, path: String| {
            Expected::Version(versions.get(&path).cloned().unwrap_or_default())
        };
        Listed {
            files: vec![
                version(&features, features_path(&id)),
                version(&texts, texts_path(&id)),
            ],
            id,
            side: Some(side),
        }
    });
    Ok(listed.collect())
}

/// The ids of a list and their line numbers. Empty lines and comments (`#`) are skipped.
pub(super) fn parse_list(bytes: &[u8], file: &str) -> Result<Vec<(usize, String)>, FileError> {
    let hint = "a list names clips as their files are called, without the ending";
    let text = str::from_utf8(bytes)
        .map_err(|_| FileError::unexpected(file, "bytes that are not UTF-8", "UTF-8 text", hint))?;
    let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim);
    let lines = (1..).zip(lines);
    let ids = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    ids.map(|(number, id)| match check_id(id) {
        Ok(()) => Ok((number, id.to_owned())),
        Err(reason) => Err(FileError::unexpected(
            format!("{file}, line {number}"),
            reason.to_string(),
            "the id of a clip",
            hint,
        )),
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_stand_one_a_line() {
        let ids = parse_list(b"\xef\xbb\xbf000021\r\n\n# mirrored\nM000021  \n", "t").unwrap();
        assert_eq!(ids, [(1, "000021".to_owned()), (4, "M000021".to_owned())]);
        let message = parse_list(b"a\n../b\n", "list.txt").unwrap_err();
        let expected = "list.txt, line 2: found path `../b`";
        assert!(message.to_string().starts_with(expected), "{message}");
    }
}
