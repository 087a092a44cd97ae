//! Tests that every command in the README, in `docs` and in comments of `configs` parses.

use std::fs;
use std::path::{Path, PathBuf};

use clap::error::ErrorKind;

use super::Arguments;

/// A page and its commands: complete commands in code blocks, possibly incomplete commands in text.
struct Page {
    path: PathBuf,
    blocks: Vec<String>,
    inline: Vec<String>,
}

pub fn files(folder: &Path, extension: &str, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files(&path, extension, found);
        } else if path.extension().is_some_and(|its| its == extension) {
            found.push(path);
        }
    }
}

/// Lines; a line that ends in `\` is joined to the next line.
pub fn joined(text: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    let mut goes_on = false;
    for line in text.lines() {
        let (line, more) = match line.trim_end().strip_suffix('\\') {
            Some(line) => (line.trim_end(), true),
            None => (line, false),
        };
        match lines.last_mut() {
            Some(last) if goes_on => *last = format!("{last} {}", line.trim()),
            _ => lines.push(line.trim().to_owned()),
        }
        goes_on = more;
    }
    lines
}

/// The commands in lines, without prompts; each part of a chain is a separate command.
fn commands(text: &str) -> Vec<String> {
    let parts = joined(text).into_iter().flat_map(|line| {
        let parts = line.split(" && ").map(str::to_owned);
        parts.collect::<Vec<_>>()
    });
    let parts = parts.map(|part| part.trim_start_matches("$ ").to_owned());
    parts.filter(|part| part.starts_with("kinegrad ")).collect()
}

fn page(path: PathBuf) -> Page {
    let text = fs::read_to_string(&path).expect("a page");
    if path.extension().is_some_and(|its| its == "toml") {
        let comments: String = text
            .lines()
            .filter_map(|line| line.strip_prefix('#'))
            .map(|line| format!("{line}\n"))
            .collect();
        return Page {
            path,
            blocks: commands(&comments),
            inline: Vec::new(),
        };
    }
    let (mut blocks, mut inline) = (Vec::new(), Vec::new());
    for (i, part) in text.split("```").enumerate() {
        if i % 2 == 1 {
            blocks.extend(commands(part));
        } else {
            let code = part.split('`').skip(1).step_by(2);
            inline.extend(code.flat_map(|code| commands(&code.replace('\n', " "))));
        }
    }
    Page {
        path,
        blocks,
        inline,
    }
}

/// The error of a command.
pub fn fault(command: &str, whole: bool) -> Option<String> {
    // Operators of the shell end a command; `[...]` and `...` are placeholders.
    let Some(words) = shlex::split(command) else {
        return whole.then(|| format!("`{command}`: a quote without its end"));
    };
    let words: Vec<String> = words
        .into_iter()
        .take_while(|word| !matches!(word.as_str(), "|" | ">" | ";"))
        .collect();
    if words
        .iter()
        .any(|word| word.contains("...") || word.starts_with('['))
    {
        return None;
    }
    let error = Arguments::read(&words).err()?;
    let kind = error.kind();
    let is_fault = if whole {
        !matches!(kind, ErrorKind::DisplayHelp | ErrorKind::DisplayVersion)
    } else {
        matches!(
            kind,
            ErrorKind::UnknownArgument | ErrorKind::InvalidSubcommand
        )
    };
    is_fault.then(|| format!("`{command}`: {error}"))
}

#[test]
fn documented_commands_are_read() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut paths = vec![
        workspace.join("README.md"),
        workspace.join("CONTRIBUTING.md"),
    ];
    files(&workspace.join("docs"), "md", &mut paths);
    files(&workspace.join("configs"), "toml", &mut paths);
    let (mut read, mut faults) = (0, Vec::new());
    for page in paths.into_iter().map(page) {
        for (commands, whole) in [(&page.blocks, true), (&page.inline, false)] {
            read += commands.len();
            let wrong = commands.iter().filter_map(|command| fault(command, whole));
            faults.extend(wrong.map(|fault| format!("{}: {fault}", page.path.display())));
        }
    }
    assert!(read > 100, "only {read} commands were found");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn a_command_that_is_not_there_is_found() {
    assert!(fault("kinegrad view --bvh walk.bvh --out walk.html", true).is_some());
    assert!(fault("kinegrad view", false).is_none());
    assert!(fault("kinegrad view a.npy --no-such", false).is_some());
    let text = "$ kinegrad init && kinegrad train a.toml \\\n    --resume   # goes on\n";
    assert_eq!(
        commands(text),
        [
            "kinegrad init",
            "kinegrad train a.toml --resume   # goes on"
        ]
    );
}
