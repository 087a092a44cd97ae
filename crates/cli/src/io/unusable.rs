//! Motion that is far out of bounds: the names of its files, and the end of its command.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_settings::counted;

/// Ending of the names of files of motion that is not usable.
pub const UNUSABLE: &str = ".unusable";

/// The prefix of the files of motion that is not usable.
pub fn unusable_stem(stem: &OsStr) -> OsString {
    let mut stem = stem.to_owned();
    stem.push(UNUSABLE);
    stem
}

/// The file of motion that is not usable, instead of `path`: its ending stays the last one.
pub fn unusable_path(path: &Path) -> PathBuf {
    let mut name = unusable_stem(path.file_stem().unwrap_or_default());
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// The exit code of a command with so many motions that are not usable, whose kind is `noun`. Prints
/// their number and what to do, `advice`.
pub fn exit_code(unusable: usize, noun: &str, advice: &str) -> ExitCode {
    if unusable == 0 {
        return ExitCode::SUCCESS;
    }
    let (are, gives) = match unusable {
        1 => ("is", "it its usual name"),
        _ => ("are", "them their usual names"),
    };
    let found = counted(unusable, noun);
    tell!(
        "{found} {are} not usable, named `{UNUSABLE}`: {advice}; `--allow-unusable` gives {gives}"
    );
    ExitCode::FAILURE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unusable_motion_has_its_own_names() {
        for (path, expected) in [
            ("new.bvh", "new.unusable.bvh"),
            ("a.b/new.1.npy", "a.b/new.1.unusable.npy"),
            ("new", "new.unusable"),
        ] {
            assert_eq!(unusable_path(Path::new(path)), Path::new(expected));
        }
    }
}
