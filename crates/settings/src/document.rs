//! Reading of TOML documents, with errors that name file, line and key.

use miette::Diagnostic;
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

use crate::InvalidSetting;
use crate::words::in_words;

/// Largest document, bytes: a hostile one takes up to 600 times as much memory.
const MOST_BYTES: usize = 2 << 20;

/// The location of a dotted key, such as `FILE:LINE`.
pub type Place<'a> = &'a dyn Fn(&str) -> String;

/// An invalid document.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum DocumentError {
    /// Text that is not TOML.
    #[error("{place}: {message}")]
    #[diagnostic(help("{hint}"))]
    Syntax {
        /// File and line.
        place: String,
        /// The parser's message.
        message: String,
        /// The remedy.
        hint: &'static str,
    },
    /// A key that does not exist.
    #[error("{place}: unknown key `{key}`, allowed: {allowed}")]
    #[diagnostic(help("{hint}"))]
    UnknownKey {
        /// File and line, or the override.
        place: String,
        /// The dotted key.
        key: String,
        /// The allowed keys of the table.
        allowed: String,
        /// The nearest valid key, if one is near.
        hint: String,
    },
    /// A value that has the wrong type or is not allowed.
    #[error("{place}: `{key}`: {message}")]
    #[diagnostic(help("{hint}"))]
    Value {
        /// File and line, or the override.
        place: String,
        /// The dotted key.
        key: String,
        /// The found value and the allowed values.
        message: String,
        /// The remedy.
        hint: String,
    },
    /// A value of the right type that is invalid.
    #[error("{place}: {setting}")]
    #[diagnostic(help("{}", setting.hint))]
    Setting {
        /// File and line.
        place: String,
        /// The key, the found value and the allowed values.
        setting: InvalidSetting,
    },
}

/// A TOML document and the lines of its keys.
pub struct Document<'a> {
    text: &'a str,
    /// The file name in errors.
    origin: &'a str,
    spans: Spanned<DeTable<'a>>,
    /// Its values.
    pub table: Table,
}

impl<'a> Document<'a> {
    /// Parses the document in `text`, of at most 2 MiB; errors name `origin`, its file. Fails with
    /// [`DocumentError::Syntax`], which names the line, and with [`DocumentError::Value`] for paths
    /// whose backslashes were read as escapes, such as `"C:\temp"`.
    pub fn parse(text: &'a str, origin: &'a str) -> Result<Self, DocumentError> {
        let no_toml = |error: toml::de::Error| DocumentError::Syntax {
            place: error.span().map_or(origin.to_owned(), |span| {
                format!("{origin}:{}", line_of(text, span.start))
            }),
            message: match error.message() {
                // The parser reports numbers that are too large as a type error.
                message if message.starts_with("invalid type") => in_words(message),
                message => message.to_owned(),
            },
            hint: match error
                .span()
                .is_some_and(|span| has_backslash(text, span.start))
            {
                true => BACKSLASHES,
                false => "the file is TOML: tables in [brackets], `key = value` lines",
            },
        };
        if text.len() > MOST_BYTES {
            return Err(DocumentError::Syntax {
                place: origin.to_owned(),
                message: format!("{} bytes found, at most {MOST_BYTES} allowed", text.len()),
                hint: "settings are small; long lists of points belong in a .csv file",
            });
        }
        let document = Self {
            spans: DeTable::parse(text).map_err(no_toml)?,
            table: text.parse().map_err(no_toml)?,
            text,
            origin,
        };
        let broken = document.table.iter();
        let mut broken = broken.filter_map(|(key, value)| broken_path(key.clone(), value));
        match broken.next() {
            None => Ok(document),
            Some((key, path)) => Err(DocumentError::Value {
                place: document.place(&key),
                key,
                message: format!("the path {path:?} has control characters where `\\` stood"),
                hint: BACKSLASHES.to_owned(),
            }),
        }
    }

    /// File and line of a dotted key, or of the nearest key above it.
    pub fn place(&self, key: &str) -> String {
        match start_of(self.spans.get_ref(), key) {
            Some(start) => format!("{}:{}", self.origin, line_of(self.text, start)),
            None => self.origin.to_owned(),
        }
    }

    /// The document's values as a `T`. `help` is the hint of errors without a similar valid name.
    /// The error names the first key that is unknown or has an invalid value: one that is not
    /// finite, has another type, or is a list instead of a table.
    pub fn read<T: DeserializeOwned + Serialize>(&self, help: &str) -> Result<T, DocumentError> {
        let place: Place<'_> = &|key| self.place(key);
        must_be_finite(&self.table, place)?;
        let read = from_table(&self.table, place, help, &[])?;
        must_be_tables(&self.table, &read, place)?;
        Ok(read)
    }

    /// The error of an invalid setting, with the setting's line.
    pub fn refuse(&self, setting: InvalidSetting) -> DocumentError {
        DocumentError::Setting {
            place: self.place(&setting.key),
            setting,
        }
    }
}

/// Key and value of the first text in `value` (at `key`) that begins with a drive and an escape.
fn broken_path(key: String, value: &Value) -> Option<(String, &str)> {
    match value {
        Value::String(text) => {
            let is_broken = matches!(text.as_bytes(), [drive, b':', 0..0x20, ..] if drive.is_ascii_alphabetic());
            is_broken.then_some((key, text.as_str()))
        }
        Value::Array(values) => {
            let mut values = values.iter().enumerate();
            values.find_map(|(index, value)| broken_path(format!("{key}[{index}]"), value))
        }
        Value::Table(table) => {
            let mut entries = table.iter();
            entries.find_map(|(name, value)| broken_path(format!("{key}.{name}"), value))
        }
        _ => None,
    }
}

/// The hint about paths of Windows.
const BACKSLASHES: &str = "a path with backslashes stands in single quotes: 'C:\\Users\\me'";

/// True if the line of byte `place` has a backslash after double quotes.
fn has_backslash(text: &str, place: usize) -> bool {
    let line = text.lines().nth(line_of(text, place) - 1);
    let quoted = line.and_then(|line| line.split_once('"'));
    quoted.is_some_and(|(_, text)| text.contains('\\'))
}

/// [`Document::parse`], then [`Document::read`]. Fails as both.
pub fn read_toml<T: DeserializeOwned + Serialize>(
    text: &str,
    origin: &str,
    help: &str,
) -> Result<T, DocumentError> {
    Document::parse(text, origin)?.read(help)
}

/// Deserializes `table`. `beside` lists, by table, the keys that another type reads. The error
/// names the first key that is unknown or has a value of another type; `help` is the hint unless a
/// similar valid name exists.
pub fn from_table<T: DeserializeOwned>(
    table: &Table,
    place: Place<'_>,
    help: &str,
    beside: &[(&str, &[&str])],
) -> Result<T, DocumentError> {
    serde_path_to_error::deserialize(Value::Table(table.clone())).map_err(|error| {
        let path = error.path().to_string();
        explain(place, &path, error.inner().message(), help, beside)
    })
}

/// The error for serde's `message` about the value at `path`.
fn explain(
    place: Place<'_>,
    path: &str,
    message: &str,
    help: &str,
    beside: &[(&str, &[&str])],
) -> DocumentError {
    let message = message.trim().lines().next().unwrap_or_default();
    let path = if path == "." { "" } else { path };
    let mut quoted = message.split('`').skip(1).step_by(2);
    let join = |parent: &str, key: &str| match parent {
        "" => key.to_owned(),
        parent => format!("{parent}.{key}"),
    };
    if message.starts_with("unknown field") {
        let found = quoted.next().unwrap_or_default();
        let parent = path.strip_suffix(found).unwrap_or(path);
        let parent = parent.trim_end_matches('.');
        let others = beside.iter().filter(|(table, _)| *table == parent);
        let others = others.flat_map(|(_, keys)| keys.iter().copied());
        let allowed: Vec<&str> = others.chain(quoted).collect();
        let hint = match nearest(found, &allowed) {
            Some(near) => format!("did you mean `{}`?", join(parent, near)),
            None => help.to_owned(),
        };
        let key = join(parent, found);
        return DocumentError::UnknownKey {
            place: place(&key),
            key,
            allowed: allowed.join(", "),
            hint,
        };
    }
    if message.starts_with("unknown variant") {
        let found = quoted.next().unwrap_or_default();
        let names: Vec<&str> = quoted.collect();
        return not_among(place(path), path, &format!("\"{found}\""), &names);
    }
    let (key, message) = match message.starts_with("missing field") {
        true => {
            let key = join(path, quoted.next().unwrap_or_default());
            (key, "the key is missing".to_owned())
        }
        false => (path.to_owned(), in_words(message)),
    };
    DocumentError::Value {
        place: place(path),
        key,
        message,
        hint: help.to_owned(),
    }
}

/// The error of a value that is not in `names`, the allowed values of `key`.
pub fn not_among(place: String, key: &str, found: &str, names: &[&str]) -> DocumentError {
    DocumentError::Value {
        place,
        key: key.into(),
        message: format!("{found} is not among {}", names.join(", ")),
        hint: match nearest(found.trim_matches('"'), names) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => format!("choose one of: {}", names.join(", ")),
        },
    }
}

/// The name in `allowed` that is most similar to `found`, if any is similar.
pub fn nearest<'a>(found: &str, allowed: &[&'a str]) -> Option<&'a str> {
    let similar = |name: &&'a str| (strsim::jaro_winkler(found, name), *name);
    let near = allowed.iter().map(similar).filter(|near| near.0 > 0.75);
    near.max_by(|a, b| a.0.total_cmp(&b.0)).map(|near| near.1)
}

/// Rejects numbers that are not finite, because JSON cannot represent them. The error names the
/// first such key.
pub fn must_be_finite(table: &Table, place: Place<'_>) -> Result<(), DocumentError> {
    let mut entries = table.iter();
    match entries.find_map(|(key, value)| not_finite(key.clone(), value)) {
        None => Ok(()),
        Some((key, number)) => Err(DocumentError::Value {
            place: place(&key),
            key,
            message: format!("{number} is not a finite number"),
            hint: "write a number, or leave the key out for its default".to_owned(),
        }),
    }
}

/// Key and value of the first number in `value` (at `key`) that is not finite.
fn not_finite(key: String, value: &Value) -> Option<(String, f64)> {
    match value {
        Value::Float(number) => (!number.is_finite()).then_some((key, *number)),
        Value::Array(values) => {
            let mut values = values.iter().enumerate();
            values.find_map(|(index, value)| not_finite(format!("{key}[{index}]"), value))
        }
        Value::Table(table) => {
            let mut entries = table.iter();
            entries.find_map(|(name, value)| not_finite(format!("{key}.{name}"), value))
        }
        _ => None,
    }
}

/// Rejects a list instead of a table, because serde would assign the list's elements to fields in
/// order. `read` is the result of serde for `table`. The error names the first such key.
pub fn must_be_tables(
    table: &Table,
    read: &impl Serialize,
    place: Place<'_>,
) -> Result<(), DocumentError> {
    let read = Table::try_from(read).unwrap_or_default();
    match list_for_table("", table, &read) {
        None => Ok(()),
        Some((key, elements)) => Err(DocumentError::Value {
            place: place(&key),
            key,
            message: format!(
                "a list of {elements} values, allowed: a table of `name = value` entries"
            ),
            hint: "name each value: `[table]`, then `key = value`".to_owned(),
        }),
    }
}

/// Key and length of the first list in `table` that is a table in `read`. The keys of `table` begin
/// with `prefix`.
fn list_for_table(prefix: &str, table: &Table, read: &Table) -> Option<(String, usize)> {
    table.iter().find_map(|(name, value)| {
        let key = format!("{prefix}{name}");
        list_at(key, value, read.get(name)?)
    })
}

/// [`list_for_table`] of one value.
fn list_at(key: String, written: &Value, read: &Value) -> Option<(String, usize)> {
    match (written, read) {
        (Value::Array(written), Value::Table(_)) => Some((key, written.len())),
        (Value::Array(written), Value::Array(read)) => {
            let mut both = written.iter().zip(read).enumerate();
            both.find_map(|(index, (value, read))| list_at(format!("{key}[{index}]"), value, read))
        }
        (Value::Table(written), Value::Table(read)) => {
            list_for_table(&format!("{key}."), written, read)
        }
        _ => None,
    }
}

/// The line of a byte, counted from 1.
fn line_of(text: &str, byte: usize) -> usize {
    text.as_bytes()[..byte.min(text.len())]
        .iter()
        .filter(|byte| **byte == b'\n')
        .count()
        + 1
}

/// The first byte of the key `path`, such as `model.channel_mult[2]`, or of the nearest key above
/// it, in the parsed text of `table`.
fn start_of(table: &DeTable<'_>, path: &str) -> Option<usize> {
    let beginnings = table.iter().filter_map(|(name, value)| {
        let rest = path.strip_prefix(name.get_ref().as_ref())?;
        let ends = rest.is_empty() || rest.starts_with(['.', '[']);
        ends.then_some((name, value, rest))
    });
    // A quoted key may contain a dot, so the longest match counts.
    let (name, value, rest) = beginnings.min_by_key(|(_, _, rest)| rest.len())?;
    Some(start_in(value.get_ref(), rest).unwrap_or(name.span().start))
}

/// [`start_of`] in a value, where `rest` is the path behind its key.
fn start_in(value: &DeValue<'_>, rest: &str) -> Option<usize> {
    match value {
        DeValue::Table(inner) => start_of(inner, rest.strip_prefix('.')?),
        DeValue::Array(elements) => {
            let (index, rest) = rest.strip_prefix('[')?.split_once(']')?;
            let element = elements.get(index.parse::<usize>().ok()?)?;
            Some(start_in(element.get_ref(), rest).unwrap_or(element.span().start))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    fn table(text: &str) -> Table {
        text.parse().unwrap()
    }

    /// The key of an error, which must be the place of the error too.
    fn key_of(error: DocumentError) -> String {
        match error {
            DocumentError::Value { place, key, .. } => {
                assert_eq!(place, format!("at {key}"));
                key
            }
            other => panic!("{other}"),
        }
    }

    const AT: Place<'_> = &|key| format!("at {key}");

    #[test]
    fn documents_have_a_bound() {
        let text = format!("a = 1\n{}", "#".repeat(MOST_BYTES - 6));
        assert!(Document::parse(&text, "file").is_ok());
        let longer = format!("{text}#");
        let Err(error) = Document::parse(&longer, "file") else {
            panic!("read");
        };
        let expected = "file: 2097153 bytes found, at most 2097152 allowed";
        assert_eq!(error.to_string(), expected);
    }

    #[test]
    fn paths_with_backslashes_have_their_own_hint() {
        for (text, expected) in [
            ("[data]\nsource = \"C:\\Users\\me\"\n", "single quotes"),
            ("source = \"D:\\data\"\n", "single quotes"),
            // `\t` and `\n` are escapes.
            ("[data]\nsources = [\"C:\\temp\\me\"]\n", "single quotes"),
            ("source = \"d:\\new\"\n", "single quotes"),
            ("source = \n", "[brackets]"),
        ] {
            let error = Document::parse(text, "c.toml").err().expect("no TOML");
            let hint = error.help().expect("a hint").to_string();
            assert!(hint.contains(expected), "{text}: {error}: {hint}");
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_named_at_any_depth() {
        for (text, key) in [
            ("a = inf", "a"),
            ("a.b = [1.0, nan]", "a.b[1]"),
            ("[[a]]\nb = 1\n[[a]]\nb = -inf", "a[1].b"),
        ] {
            let error = must_be_finite(&table(text), AT).unwrap_err();
            assert!(error.to_string().contains("is not a finite number"));
            assert_eq!(key_of(error), key);
        }
        must_be_finite(&table("a = 1e300\nb = [\"nan\"]"), AT).unwrap();
    }

    #[test]
    fn lists_in_the_place_of_tables_are_named_at_any_depth() {
        let read = table("a.b.c = 1\nd = [[1, 2], [3, 4]]\ne = [{ f = 1 }, { f = 2 }]");
        for (text, key) in [
            ("a = [[1]]", "a"),
            ("a = []", "a"),
            ("a.b = [1]", "a.b"),
            ("e = [{ f = 1 }, [2]]", "e[1]"),
        ] {
            let error = must_be_tables(&table(text), &read, AT).unwrap_err();
            assert_eq!(key_of(error), key);
        }
        must_be_tables(&read, &read, AT).unwrap();
        must_be_tables(&table("of_old_versions = [1]"), &read, AT).unwrap();
    }

    #[derive(Debug, Deserialize, Serialize)]
    #[serde(deny_unknown_fields)]
    struct Walk {
        name: String,
        #[serde(default)]
        step: Vec<Step>,
    }

    #[derive(Debug, Deserialize, Serialize)]
    #[serde(deny_unknown_fields)]
    struct Step {
        seconds: f64,
        foot: Option<Foot>,
    }

    #[derive(Debug, Deserialize, Serialize)]
    #[serde(rename_all = "snake_case")]
    enum Foot {
        Left,
        Right,
    }

    #[test]
    fn errors_name_file_line_key_and_remedy() {
        for (text, expected) in [
            ("name = ", "f.toml:1: "),
            (
                "seed = 99999999999999999999",
                "f.toml:1: 99999999999999999999 is too large",
            ),
            (
                "\nname = 3",
                "f.toml:2: `name`: expected text in quotes, found 3; see the docs",
            ),
            (
                "step = []",
                "f.toml: `name`: the key is missing; see the docs",
            ),
            (
                "name = 'x'\n[[step]]\nseconds = 1\n[[step]]\n",
                "f.toml:4: `step[1].seconds`: the key is missing; see the docs",
            ),
            (
                "name = 'x'\n[[step]]\nseconds = 1\n[[step]]\nsecond = 1\n",
                "f.toml:5: unknown key `step[1].second`, allowed: seconds, foot; did you mean \
                 `step[1].seconds`?",
            ),
            (
                "name = 'x'\n[[step]]\nseconds = 1\n\nfoot = 'lefd'",
                "f.toml:5: `step[0].foot`: \"lefd\" is not among left, right; did you mean \
                 \"left\"?",
            ),
            (
                "name = 'x'\nstep = [\n[1.0, 'left']]",
                "f.toml:3: `step[0]`: a list of 2 values, allowed: a table",
            ),
            (
                "name = 'x'\n[[step]]\nseconds = nan",
                "f.toml:3: `step[0].seconds`: NaN is not a finite number",
            ),
        ] {
            let error = read_toml::<Walk>(text, "f.toml", "see the docs").unwrap_err();
            let help = error.help().expect("a hint");
            let message = format!("{error}; {help}");
            assert!(message.starts_with(expected), "{expected}\n{message}");
        }
        let text = "name = 'x'\n[[step]]\nseconds = 0\n";
        let document = Document::parse(text, "f.toml").unwrap();
        let walk: Walk = document.read("").unwrap();
        assert_eq!(walk.step[0].seconds, 0.0);
        let refused = crate::in_range("step[0].seconds", 0.0, crate::ABOVE_ZERO).unwrap_err();
        assert_eq!(
            document.refuse(refused).to_string(),
            "f.toml:3: `step[0].seconds` is 0, allowed: more than 0"
        );
    }
}
