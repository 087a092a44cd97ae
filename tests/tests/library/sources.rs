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

/// The source files of all crates that are not tests, with the names of their crates.
fn sources() -> Vec<(String, PathBuf)> {
    let crates = ["crates", "crates/systems"].map(|folder| workspace().join(folder));
    let folders = crates.map(|folder| fs::read_dir(folder).expect("crates"));
    let mut found = Vec::new();
    for crate_folder in folders.into_iter().flatten() {
        let folder = crate_folder.expect("a crate").path();
        let name = folder.file_name().expect("a name").to_string_lossy();
        if !folder.join("src").exists() {
            continue;
        }
        let is_test = |path: &Path| {
            let file = path.file_stem().unwrap_or_default().to_string_lossy();
            file == "tests" || file.ends_with("_tests") || path.iter().any(|part| part == "tests")
        };
        let files = rust_files(&folder.join("src")).into_iter();
        let files = files.filter(|path| !is_test(path.strip_prefix(&folder).expect("inside")));
        found.extend(files.map(|path| (name.clone().into_owned(), path)));
    }
    assert!(found.len() > 400, "{} files", found.len());
    found
}

/// The lines of a file that are neither comments nor tests, with their numbers.
fn code(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let end = text.find("\nmod tests {").unwrap_or(text.len());
    let lines = text[..end].lines().enumerate();
    lines
        .filter(|(_, line)| !line.trim_start().starts_with("//"))
        .map(|(number, line)| (number + 1, line))
}

/// Fails with the lines outside of `allowed` files that contain one of the `calls`. Every allowed
/// file must contain one.
fn only_in(allowed: &[&str], calls: &[&str]) {
    let (mut found, mut used) = (Vec::new(), Vec::new());
    for (_, path) in sources() {
        let text = fs::read_to_string(&path).expect("text");
        let name = path.strip_prefix(workspace()).expect("inside");
        let name = name.to_string_lossy().replace('\\', "/");
        for (number, line) in code(&text) {
            if !calls.iter().any(|call| line.contains(call)) {
                continue;
            }
            match allowed.contains(&name.as_str()) {
                true => used.push(name.clone()),
                false => found.push(format!("{name}:{number}: {}", line.trim())),
            }
        }
    }
    assert!(found.is_empty(), "{calls:?} in:\n{}", found.join("\n"));
    for file in allowed {
        assert!(
            used.iter().any(|used| used == file),
            "{file} has no {calls:?}"
        );
    }
}

#[test]
fn one_module_writes_files() {
    let opens = [
        "fs::write(",
        "fs::copy(",
        "fs::hard_link(",
        "File::create",
        "File::options",
        "OpenOptions",
        "tempfile::",
        "set_permissions(",
        "from_path(",
        "Backend::new(",
        "save_file(",
    ];
    only_in(
        &["crates/output/src/file.rs", "crates/output/src/folder.rs"],
        &opens,
    );
    // Libraries that write to a path get a temporary one.
    let libraries = ["serialize_to_file(", "generate_to("];
    let temporary = [
        "crates/train/src/checkpoint/tensors.rs",
        "crates/cli/src/commands/shell.rs",
    ];
    only_in(&temporary, &libraries);
    // Folders of a run are moved whole.
    let folders = [
        "crates/output/src/folder.rs",
        "crates/train/src/checkpoint/folder.rs",
        "crates/cli/src/commands/train.rs",
    ];
    only_in(&folders, &["fs::rename("]);
}

#[test]
fn one_module_prints() {
    let prints = [
        "print!(",
        "println!(",
        "dbg!(",
        "io::stdout()",
        "io::stderr()",
    ];
    only_in(&["crates/cli/src/output.rs"], &prints);
    // The command line's own errors are plain text, and log lines are escaped as messages.
    only_in(&["crates/cli/src/lib.rs"], &[".exit();"]);
    only_in(&["crates/cli/src/log.rs"], &["env_logger::"]);
}

/// Whether a line names an option as it is typed, such as `--frames`.
fn names_a_flag(line: &str) -> bool {
    line.match_indices("--").any(|(at, _)| {
        let (before, rest) = (line[..at].chars().next_back(), &line[at + 2..]);
        rest.starts_with(|c: char| c.is_ascii_lowercase())
            // Variables of the viewer's style.
            && !rest.starts_with("kg-")
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
    for (name, path) in sources() {
        if ENTRY_POINTS.contains(&&*name) {
            continue;
        }
        let text = fs::read_to_string(&path).expect("text");
        let flags = code(&text).filter(|(_, line)| names_a_flag(line));
        found.extend(
            flags.map(|(number, line)| format!("{}:{number}: {}", path.display(), line.trim())),
        );
    }
    assert!(
        found.is_empty(),
        "flags in libraries:\n{}",
        found.join("\n")
    );
}
