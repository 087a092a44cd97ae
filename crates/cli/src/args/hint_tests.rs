//! Tests that commands, options and files that messages name exist.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use clap::CommandFactory;

use super::Arguments;
use super::documented_tests::{fault, files, joined};
use crate::options::as_flags;

/// The quoted code of the messages in a source file: text between grave accents outside comments
/// and tests, with placeholders as `X`.
fn quoted(source: &str) -> Vec<String> {
    let source = source
        .split("#[cfg(test)]\nmod ")
        .next()
        .unwrap_or_default();
    let lines = joined(source).into_iter();
    let lines = lines.filter(|line| !line.starts_with("//"));
    lines.flat_map(|line| codes(&line)).collect()
}

fn codes(line: &str) -> Vec<String> {
    let code = line.split('`').skip(1).step_by(2);
    let code = code.map(|code| {
        let parts = code.split('{').map(|part| match part.split_once('}') {
            Some((_, rest)) => format!("X{rest}"),
            None => part.to_owned(),
        });
        parts.collect::<String>().replace("\\\"", "\"")
    });
    code.collect()
}

/// The names of all options of all commands, without dashes.
fn options(command: &clap::Command) -> BTreeSet<String> {
    let own = command
        .get_arguments()
        .filter_map(|option| option.get_long());
    let own = own.map(str::to_owned);
    let below = command.get_subcommands().flat_map(options);
    own.chain(below)
        .chain(["help", "version"].map(str::to_owned))
        .collect()
}

#[test]
fn commands_and_options_in_messages_exist() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut paths = Vec::new();
    files(&crates, "rs", &mut paths);
    paths.retain(|path| {
        let name = path.to_string_lossy();
        !name.ends_with("tests.rs") && !name.contains("/tests/")
    });
    let mut known = options(&Arguments::command());
    // Options of Cargo and of a launcher.
    known.extend(["features", "mpi"].map(str::to_owned));
    let (mut read, mut faults) = (0, Vec::new());
    for path in paths {
        let source = fs::read_to_string(&path).expect("a source file");
        for code in quoted(&as_flags(&source)) {
            let option = code.strip_prefix("--").map(|option| {
                let end = option.find(|c: char| c != '-' && !c.is_ascii_lowercase());
                option[..end.unwrap_or(option.len())].to_owned()
            });
            let wrong = match option {
                // A placeholder.
                Some(option) if option.is_empty() => continue,
                Some(option) => {
                    (!known.contains(&option)).then(|| format!("option --{option} does not exist"))
                }
                None if code.starts_with("kinegrad ") => fault(&code, false),
                None => continue,
            };
            read += 1;
            faults.extend(wrong.map(|wrong| format!("{}: {wrong}", path.display())));
        }
    }
    assert!(read > 100, "only {read} commands and options were found");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn pages_and_scripts_in_messages_exist() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut paths = Vec::new();
    files(&workspace.join("crates"), "rs", &mut paths);
    let mut absent = BTreeSet::new();
    for path in paths {
        let source = fs::read_to_string(&path).expect("a source file");
        let words = source.split(|c: char| !c.is_ascii_alphanumeric() && !"/._-".contains(c));
        let words = words.map(|word| word.trim_matches('.'));
        let words = words.filter(|word| {
            word.starts_with("docs/") && word.ends_with(".md") || word.starts_with("scripts/")
        });
        absent.extend(
            words
                .filter(|word| !workspace.join(word).exists())
                .map(str::to_owned),
        );
    }
    assert!(absent.is_empty(), "{absent:?}");
}

#[test]
fn a_message_that_is_wrong_is_found() {
    let source = "    let hint = \"`kinegrad data \\\n        list {name}` and `--nowhere`\";\n";
    let found = quoted(source);
    assert_eq!(found, ["kinegrad data list X", "--nowhere"]);
    assert!(fault(&found[0], false).is_some());
}
