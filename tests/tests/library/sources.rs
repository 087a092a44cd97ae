//! Rules that the source files keep.

use std::fs;
use std::path::{Path, PathBuf};

use kinegrad_tests::golden::workspace;

/// Crates whose texts users of the command line alone read.
const ENTRY_POINTS: [&str; 2] = ["cli", "python"];

/// All Rust files in a folder.
fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder");
    let paths = entries.map(|entry| entry.expect("an entry").path());
    let of_path = |path: PathBuf| match path.is_dir() {
        true => rust_files(&path),
        false => vec![path],
    };
    let files = paths.flat_map(of_path);
    files
        .filter(|path| path.extension().is_some_and(|ending| ending == "rs"))
        .collect()
}

/// The lines of a file that are neither comments nor tests, with their numbers.
fn code(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let end = text
        .find("\n#[cfg(test)]\nmod tests {")
        .unwrap_or(text.len());
    let lines = text[..end].lines().enumerate();
    lines
        .filter(|(_, line)| !line.trim_start().starts_with("//"))
        .map(|(number, line)| (number + 1, line))
}

/// Whether a line names an option as it is typed, such as `--frames`.
fn names_a_flag(line: &str) -> bool {
    line.match_indices("--").any(|(at, _)| {
        let before = line[..at].chars().next_back();
        let after = line[at + 2..].chars().next();
        after.is_some_and(|c| c.is_ascii_lowercase())
            && before.is_none_or(|c| c.is_whitespace() || "`\"'(=".contains(c))
    })
}

#[test]
fn libraries_name_options_and_no_flags() {
    for line in [
        "\"give `--frames`\"",
        "    --frames 3\",",
        "format!(\"--set {x}\")",
    ] {
        assert!(names_a_flag(line), "{line}");
    }
    assert!(!names_a_flag("a---b, x -- y, a--b"));
    let mut found = Vec::new();
    let crates = ["crates", "crates/systems"].map(|folder| workspace().join(folder));
    let folders = crates.map(|folder| fs::read_dir(folder).expect("crates"));
    for crate_folder in folders.into_iter().flatten() {
        let folder = crate_folder.expect("a crate").path();
        let name = folder.file_name().expect("a name").to_string_lossy();
        if ENTRY_POINTS.contains(&&*name) || !folder.join("src").exists() {
            continue;
        }
        for path in rust_files(&folder.join("src")) {
            if path.ends_with("tests.rs") || path.to_string_lossy().contains("/tests/") {
                continue;
            }
            let text = fs::read_to_string(&path).expect("text");
            let flags = code(&text).filter(|(_, line)| names_a_flag(line));
            found.extend(
                flags.map(|(number, line)| format!("{}:{number}: {}", path.display(), line.trim())),
            );
        }
    }
    assert!(
        found.is_empty(),
        "flags in libraries:\n{}",
        found.join("\n")
    );
}
