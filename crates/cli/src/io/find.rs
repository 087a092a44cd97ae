//! Finds motion files.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use kinegrad_data::file::is_inside;
use kinegrad_train::Error;

/// Endings of companion files: other forms of a sample.
pub const COMPANIONS: [&str; 3] = [".raw.npy", ".features.npy", ".path.npy"];

/// A file's name without its folder and extension.
pub fn file_stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

/// True for a file with this extension, in upper or lower case.
pub fn has_extension(path: &Path, extension: &str) -> bool {
    let found = path.extension();
    found.is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// True for the name of a sample's companion file.
pub fn is_companion(path: &Path) -> bool {
    let name = path.to_string_lossy();
    COMPANIONS.iter().any(|ending| name.ends_with(ending))
}

/// The files at `paths`. A folder gives its files with these endings, each once, without companion
/// files of samples; links to folders and to files outside of it are not followed. Fails if a path
/// has no motion.
pub fn motion_files(paths: &[PathBuf], endings: &[&str]) -> Result<Vec<PathBuf>, Error> {
    let mut files = Vec::new();
    for path in paths {
        let before = files.len();
        match path.is_file() {
            true => files.push(path.clone()),
            false => files.extend(walk(path, endings)),
        }
        if files.len() == before {
            let message = format!("there is no motion file at {}", path.display());
            let is_bvh = endings.contains(&"bvh");
            let bvh = if is_bvh { ", a .bvh file," } else { "" };
            let hint = format!(
                "give a .npy file such as `kinegrad sample` writes{bvh} or a folder of them; links \
                 that lead out of a folder are not followed"
            );
            return Err(Error::usage(message, hint));
        }
    }
    Ok(files)
}

/// The motion files below `root`, by path.
fn walk(root: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let (mut files, mut links) = (Vec::new(), Vec::new());
    collect(root, endings, &mut files, &mut links);
    let root = root.canonicalize().unwrap_or_default();
    let real = files.iter().filter_map(|file| file.canonicalize().ok());
    let mut real: HashSet<PathBuf> = real.collect();
    links.sort();
    links.retain(|link| {
        let target = link.canonicalize().ok();
        let target = target.filter(|target| target.is_file() && target.starts_with(&root));
        target.is_some_and(|target| real.insert(target))
    });
    files.extend(links);
    files.sort();
    files
}

/// Collects the motion files below `folder`, and the links that are named as motion files.
fn collect(folder: &Path, endings: &[&str], files: &mut Vec<PathBuf>, links: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, kind) = (entry.path(), entry.file_type());
        let is_motion = || {
            let ending = path.extension().and_then(|ending| ending.to_str());
            ending.is_some_and(|ending| endings.contains(&ending)) && !has_sample(&path)
        };
        match kind {
            Ok(kind) if kind.is_dir() => collect(&path, endings, files, links),
            Ok(kind) if kind.is_file() && is_motion() => files.push(path),
            Ok(kind) if kind.is_symlink() && is_motion() => links.push(path),
            _ => {}
        }
    }
}

/// True for the companion file of an existing sample.
fn has_sample(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut endings = COMPANIONS.iter().chain([&".bvh"]);
    let stem = endings.find_map(|ending| name.strip_suffix(*ending));
    stem.is_some_and(|stem| path.with_file_name(format!("{stem}.npy")).exists())
}

/// The files, each followed by its raw model output if that file exists in the same folder and is not
/// listed.
pub fn with_raw(files: Vec<PathBuf>) -> Vec<PathBuf> {
    let listed: HashSet<PathBuf> = files.iter().cloned().collect();
    let each = files.into_iter().flat_map(|file| {
        let raw = Some(file.with_extension("raw.npy"));
        let is_beside = |raw: &Path| {
            let folder = file.parent().filter(|folder| *folder != Path::new(""));
            is_inside(folder.unwrap_or(Path::new(".")), raw).unwrap_or(false)
        };
        let raw = raw.filter(|raw| raw.is_file() && is_beside(raw) && !listed.contains(raw));
        [Some(file), raw]
    });
    each.flatten().collect()
}

/// The files of a folder with one of these endings, by name; empty without the folder.
pub fn files_in(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.retain(|path| {
        let ending = path.extension().unwrap_or_default();
        path.is_file() && endings.iter().any(|known| ending == *known)
    });
    paths.sort();
    paths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_output_is_added_once() {
        let folder = tempfile::tempdir().unwrap();
        let [motion, raw] = ["a.npy", "a.raw.npy"].map(|name| folder.path().join(name));
        fs::write(&motion, "").unwrap();
        fs::write(&raw, "").unwrap();
        let both = vec![motion.clone(), raw];
        assert_eq!(with_raw(vec![motion]), both);
        assert_eq!(with_raw(both.clone()), both);
    }

    #[test]
    fn a_folder_gives_each_motion_once() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "a.npy",
            "a.raw.npy",
            "a.bvh",
            "a.features.npy",
            "a.path.npy",
            "b.bvh",
            "c.txt",
            "d.raw.npy",
        ] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let found = |raw| -> Vec<String> {
            let files = motion_files(&[folder.path().to_path_buf()], &["npy", "bvh"]).unwrap();
            let files = if raw { with_raw(files) } else { files };
            let names = files.iter().map(|file| file.file_name().unwrap());
            names
                .map(|name| name.to_string_lossy().into_owned())
                .collect()
        };
        assert_eq!(found(false), ["a.npy", "b.bvh", "d.raw.npy"]);
        assert_eq!(found(true), ["a.npy", "a.raw.npy", "b.bvh", "d.raw.npy"]);
        assert!(motion_files(&[folder.path().join("none")], &["npy"]).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn links_add_no_files_and_no_loops() {
        use std::os::unix::fs::symlink;
        let [folder, outside] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let at = |name: &str| folder.path().join(name);
        for file in [
            at("deep/b.npy"),
            at("c.npy"),
            outside.path().join("secret.npy"),
        ] {
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, "").unwrap();
        }
        fs::write(at("deep/object"), "").unwrap();
        for (target, link) in [
            (folder.path().to_path_buf(), "deep/loop"),
            (outside.path().to_path_buf(), "out"),
            (outside.path().join("secret.npy"), "secret.npy"),
            (at("c.npy"), "a.npy"),
            (at("none"), "none.npy"),
            // The store of a versioned dataset.
            (at("deep/object"), "d.npy"),
        ] {
            symlink(target, at(link)).unwrap();
        }
        let found = motion_files(&[folder.path().to_path_buf()], &["npy"]).unwrap();
        assert_eq!(found, ["c.npy", "d.npy", "deep/b.npy"].map(at));
        // A link that is named itself is followed.
        for (link, files) in [
            ("out", vec![at("out/secret.npy")]),
            ("a.npy", vec![at("a.npy")]),
        ] {
            assert_eq!(motion_files(&[at(link)], &["npy"]).unwrap(), files);
        }
        fs::remove_file(at("c.npy")).unwrap();
        fs::remove_dir_all(at("deep")).unwrap();
        let error = motion_files(&[folder.path().to_path_buf()], &["npy"]).unwrap_err();
        let hint = miette::Diagnostic::help(&error).unwrap().to_string();
        assert!(hint.contains("links that lead out of a folder"), "{hint}");
    }
}
