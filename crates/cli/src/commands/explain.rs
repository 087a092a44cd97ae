//! `kinegrad config explain`

use std::fmt::Write as _;
use std::process::ExitCode;

use kinegrad_capture::Plan;
use kinegrad_motion::goal::Goal;
use kinegrad_train::system::{ConfigKey, toml_text};
use kinegrad_train::{Error, Systems};

use super::nearest;
use crate::args::ExplainArguments;

/// A kind of file and its keys.
struct ConfigFile {
    title: &'static str,
    about: &'static str,
    keys: Vec<ConfigKey>,
}

const PAGE: &str = "\
# Config keys

Every key of a training config, of a plan for `kinegrad data prepare` and of a goal for
`kinegrad sample --goal`, with its meaning, allowed values and default. Defaults of
single recipes come before that of the others. `kinegrad config explain --markdown` generates this page from the types that
read the files; `kinegrad config explain KEY` prints one key or one table.

Units are in the names of keys (`_seconds`, `_frames`, `_metres`, `_steps`) or in their meanings.
";

/// Prints descriptions of keys.
pub fn run(systems: Systems<'_>, arguments: ExplainArguments) -> Result<ExitCode, Error> {
    let mut files = files(systems);
    if arguments.markdown {
        files
            .iter_mut()
            .for_each(|file| systems.find_ranges(&mut file.keys));
        show!("{}", markdown(&files).trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let Some(requested) = &arguments.key else {
        for ConfigFile { title, keys, .. } in &files {
            say!("# {title}");
            let plain = keys.iter().filter(|key| !key.key.values.is_table());
            let mut lines: Vec<String> = plain
                .map(|key| format!("{}: {}", key.key.name, key.key.meaning))
                .collect();
            lines.dedup();
            show!("{}\n", lines.join("\n"));
        }
        return Ok(ExitCode::SUCCESS);
    };
    let requested = requested.replace("[]", "");
    for file in &mut files {
        file.keys = chosen(&file.keys, &requested);
        systems.find_ranges(&mut file.keys);
    }
    files.retain(|file| !file.keys.is_empty());
    if files.is_empty() {
        return Err(unknown(systems, &requested));
    }
    // An exact name takes precedence over the last part of another.
    let has_it = |file: &ConfigFile| file.keys.iter().any(|key| bare(&key.key.name) == requested);
    if files.iter().any(has_it) {
        files.retain(has_it);
    }
    let every = systems.recipes().count();
    let texts = files.iter().flat_map(|file| {
        let keys = file.keys.iter();
        keys.map(|key| explained(key, file.title, every))
    });
    show!("{}", texts.collect::<Vec<_>>().join("\n").trim_end());
    Ok(ExitCode::SUCCESS)
}

fn files(systems: Systems<'_>) -> Vec<ConfigFile> {
    let of_type = |keys: Vec<kinegrad_settings::Key>| {
        let described = keys.into_iter().map(|key| ConfigKey {
            defaults: match (&key.default, key.required || key.values.is_table()) {
                (_, true) => Vec::new(),
                (Some(default), false) => vec![(Vec::new(), toml_text(default))],
                (None, false) => vec![(Vec::new(), "not set".to_owned())],
            },
            recipes: Vec::new(),
            range: None,
            key,
        });
        described.collect()
    };
    vec![
        ConfigFile {
            title: "training config",
            about: "Read by `kinegrad train`; `--set table.key=value` overrides a key.",
            keys: systems.keys(),
        },
        ConfigFile {
            title: "plan of `kinegrad data prepare`",
            about: "[dataset.md](dataset.md) describes how a dataset is prepared. Paths are relative \
                    to the plan.",
            keys: of_type(kinegrad_settings::keys_of::<Plan>()),
        },
        ConfigFile {
            title: "goal of `kinegrad sample --goal`",
            about: "[goals.md](goals.md) describes goals.",
            keys: of_type(kinegrad_settings::keys_of::<Goal>()),
        },
    ]
}

/// The name of a key without the `[]` of lists.
fn bare(name: &str) -> String {
    name.replace("[]", "")
}

/// The key or the keys of the table `requested`; otherwise all keys with this last part.
fn chosen(keys: &[ConfigKey], requested: &str) -> Vec<ConfigKey> {
    let with = |is_match: &dyn Fn(&str) -> bool| -> Vec<ConfigKey> {
        let keys = keys.iter().filter(|key| is_match(&bare(&key.key.name)));
        keys.cloned().collect()
    };
    let below = format!("{requested}.");
    let found = with(&|name| name == requested || name.starts_with(&below));
    match found.is_empty() {
        false => found,
        true => with(&|name| name.rsplit('.').next() == Some(requested)),
    }
}

fn unknown(systems: Systems<'_>, requested: &str) -> Error {
    let files = files(systems);
    let names: Vec<String> = files
        .iter()
        .flat_map(|file| file.keys.iter().map(|key| bare(&key.key.name)))
        .collect();
    let last = |name: &str| name.rsplit('.').next().unwrap_or_default().to_owned();
    let near_name = nearest(requested, names.iter().map(String::as_str));
    let near = near_name.map(str::to_owned).or_else(|| {
        let lasts: Vec<String> = names.iter().map(|name| last(name)).collect();
        let near = nearest(&last(requested), lasts.iter().map(String::as_str))?;
        names.iter().find(|name| last(name) == near).cloned()
    });
    let hint = match near {
        Some(near) => format!("did you mean `{near}`?"),
        None => "`kinegrad config explain` lists every key".into(),
    };
    Error::usage(format!("there is no key or table `{requested}`"), hint)
}

/// Type and range of a key.
fn allowed(key: &ConfigKey) -> String {
    let values = &key.key.values;
    match &key.range {
        Some(range) => {
            let words = values.to_string();
            let words = words.strip_suffix(", 0 or more").unwrap_or(&words);
            format!("{words}, {range}")
        }
        None => values.to_string(),
    }
}

/// The default between two `quote`s. Several defaults have their recipes; the default of most
/// recipes is last.
fn default(key: &ConfigKey, quote: &str) -> String {
    let quoted = |value: &str| match value {
        "not set" => value.to_owned(),
        value => format!("{quote}{value}{quote}"),
    };
    match key.defaults.as_slice() {
        [] if key.key.required => "none: must be given".into(),
        [] => String::new(),
        [(_, one)] => quoted(one),
        several => {
            let mut several: Vec<_> = several.iter().collect();
            several.sort_by_key(|(recipes, _)| recipes.len());
            let last = several.len() - 1;
            let one = |(place, (recipes, value)): (usize, &&(Vec<&str>, String))| match place {
                place if place == last && recipes.len() > 2 => format!("else {}", quoted(value)),
                _ => format!("{} ({})", quoted(value), recipes.join(", ")),
            };
            several
                .iter()
                .enumerate()
                .map(one)
                .collect::<Vec<_>>()
                .join("; ")
        }
    }
}

/// A key for the terminal; `every` is the number of recipes.
fn explained(key: &ConfigKey, file: &str, every: usize) -> String {
    let mut text = format!("{}\n", key.key.name);
    let mut add = |line: &str, indent: &str| {
        text.push_str(&wrapped(line, indent));
        text.push('\n');
    };
    add(&key.key.meaning, "  ");
    if key.key.values.is_table() {
        return text;
    }
    let names = key.key.values.names();
    if names.iter().any(|name| !name.meaning.is_empty()) {
        add("allowed:", "  ");
        for name in names {
            add(&format!("\"{}\": {}", name.name, name.meaning), "    ");
        }
    } else {
        add(&format!("allowed: {}", allowed(key)), "  ");
    }
    add(&format!("default: {}", default(key, "")), "  ");
    let place = match &key.recipes[..] {
        recipes if recipes.is_empty() || recipes.len() == every => file.to_owned(),
        recipes => format!("{file}, recipe {}", recipes.join(", ")),
    };
    let place = match &key.key.only_with {
        Some(with) => format!("{place}, with {with}"),
        None => place,
    };
    add(&format!("in: {place}"), "  ");
    text
}

/// `text` in lines of at most 100 columns, each indented.
fn wrapped(text: &str, indent: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.len() + 1 + word.len() <= 100 => *line = format!("{line} {word}"),
            _ => lines.push(format!("{indent}{word}")),
        }
    }
    lines.join("\n")
}

/// All keys as a page.
fn markdown(files: &[ConfigFile]) -> String {
    let mut page = PAGE.to_owned();
    for ConfigFile { title, about, keys } in files {
        let _ = write!(page, "\n## The {title}\n\n{about}\n");
        for (table, group) in groups(keys) {
            section(&mut page, keys, group[0], table);
            let mut above = String::new();
            for key in group {
                let choices = choices(key);
                let shown = match choices == above && choices.contains("<br>") {
                    true => "as above",
                    false => &choices,
                };
                let _ = writeln!(
                    page,
                    "| `{}` | {} | {} | {} |",
                    key.key.name,
                    cell(&key.key.meaning),
                    cell(shown),
                    cell(&default(key, "`")),
                );
                above = choices;
            }
        }
    }
    page
}

/// Keys by table and condition; keys without a table are first.
fn groups(keys: &[ConfigKey]) -> Vec<(&str, Vec<&ConfigKey>)> {
    let mut groups: Vec<(&str, Vec<&ConfigKey>)> = Vec::new();
    for key in keys.iter().filter(|key| !key.key.values.is_table()) {
        let table = key.key.name.rsplit_once('.').map_or("", |(table, _)| table);
        let same = |first: &ConfigKey| {
            first.key.only_with == key.key.only_with && first.recipes == key.recipes
        };
        let mut known = groups.iter_mut();
        match known.find(|(name, group)| *name == table && same(group[0])) {
            Some((_, group)) => group.push(key),
            None => groups.push((table, vec![key])),
        }
    }
    // Keys without a condition come first in a table.
    let order: Vec<&str> = groups.iter().map(|(table, _)| *table).collect();
    groups.sort_by_key(|(table, group)| {
        let place = order.iter().position(|known| known == table);
        (!table.is_empty(), place, group[0].key.only_with.is_some())
    });
    groups
}

/// The heading and description of a table of keys.
fn section(page: &mut String, keys: &[ConfigKey], key: &ConfigKey, table: &str) {
    let of = match (&key.key.only_with, &key.recipes[..]) {
        (Some(with), _) => format!(", with `{with}`"),
        (None, recipes) if recipes.len() < longest(keys) => format!(" in {}", recipes.join(", ")),
        _ => String::new(),
    };
    let named = match table {
        "" => "At the top".to_owned(),
        table => format!("`{table}`"),
    };
    let _ = write!(page, "\n### {named}{of}\n\n");
    let about = keys.iter().find(|other| {
        other.key.name.trim_end_matches("[]") == table.trim_end_matches("[]")
            && (other.recipes == key.recipes || other.recipes.len() == longest(keys))
    });
    if let Some(about) = about.filter(|about| !about.key.meaning.is_empty()) {
        let _ = write!(page, "{}\n\n", about.key.meaning);
    }
    page.push_str("| key | meaning | allowed | default |\n|---|---|---|---|\n");
}

/// The number of recipes.
fn longest(keys: &[ConfigKey]) -> usize {
    let counts = keys.iter().map(|key| key.recipes.len());
    counts.max().unwrap_or_default()
}

/// Short names for kinds of values on the page.
const SHORT: [(&str, &str); 7] = [
    ("a whole number, 0 or more", "integer ≥ 0"),
    ("a whole number", "integer"),
    ("a number", "number"),
    ("text in quotes", "text"),
    ("true or false", "boolean"),
    ("a table of `name = value` entries; each: ", "table of "),
    ("a list; each: ", "list of "),
];

/// The allowed values; names with their meanings.
fn choices(key: &ConfigKey) -> String {
    let names = key.key.values.names();
    if names.iter().all(|name| name.meaning.is_empty()) {
        let mut allowed = allowed(key);
        for (words, short) in SHORT {
            allowed = allowed.replace(words, short);
        }
        return allowed;
    }
    let named = names.iter().map(|name| match name.meaning.as_str() {
        "" => format!("`\"{}\"`", name.name),
        meaning => format!("`\"{}\"`: {meaning}", name.name),
    });
    named.collect::<Vec<_>>().join("<br>")
}

/// Text for a cell of a Markdown table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}
