//! Labels of captures: from the names of their files, JSON beside them, a table, or the plan.

use std::collections::HashMap;
use std::path::Path;

use kinegrad_data::file::{MAX_TEXT_BYTES, read_file, read_text};
use serde_json::Value;

use super::captions::Labels;
use crate::plan::{LabelsPlan, Names, Part, Plan, TAKE, check_label, parts};

/// Labels, take number and captions of one capture.
#[derive(Debug, Default)]
pub(super) struct CaptureLabels {
    pub labels: Labels,
    pub take: Option<u64>,
    pub captions: Vec<String>,
}

/// A table of captions.
#[derive(Debug)]
pub(super) struct CaptionTable {
    file: String,
    /// Labels and captions by the name of the motion file without ending.
    rows: HashMap<String, (Labels, Vec<String>)>,
}

impl CaptionTable {
    /// Reads a CSV file with a column `file`, columns that begin with `caption`, and labels.
    pub fn read(path: &Path) -> Result<Self, String> {
        let file = path.display().to_string();
        let in_file = |problem: String| format!("{file}: {problem}");
        let bytes = read_file(path, MAX_TEXT_BYTES).map_err(|e| in_file(e.to_string()))?;
        let mut reader = csv::ReaderBuilder::new();
        let mut reader = reader.trim(csv::Trim::All).from_reader(bytes.as_slice());
        let header = reader.headers().map_err(|e| in_file(e.to_string()));
        let header = header?.clone();
        let Some(file_column) = header.iter().position(|column| column == "file") else {
            let found = header.iter().collect::<Vec<_>>().join(", ");
            let allowed = "allowed: file, caption, and labels";
            return Err(in_file(format!(
                "no column `file`, found: {found}; {allowed}"
            )));
        };
        let is_caption = |column: &str| column.starts_with("caption");
        for (place, column) in header.iter().enumerate() {
            if place != file_column && !is_caption(column) {
                check_label(column, column).map_err(|e| in_file(e.to_string()))?;
            }
        }
        let mut rows: HashMap<String, (Labels, Vec<String>)> = HashMap::new();
        for (number, row) in reader.records().enumerate() {
            let row = row.map_err(|e| in_file(e.to_string()))?;
            let name = Path::new(&row[file_column]).file_name().unwrap_or_default();
            let name = without_ending(&name.to_string_lossy());
            let (labels, captions) = rows.entry(name).or_default();
            for (place, column) in header.iter().enumerate() {
                let cell = row[place].trim();
                if place == file_column || cell.is_empty() {
                    continue;
                }
                if !is_caption(column) {
                    labels.insert(column.to_owned(), cell.to_owned());
                } else if cell.contains(['#', '\n']) {
                    return Err(in_file(format!(
                        "row {}: `{cell}`: a caption without # and line ends allowed",
                        number + 1
                    )));
                } else {
                    captions.push(cell.to_owned());
                }
            }
        }
        Ok(Self { file, rows })
    }
}

/// The name of a motion file without its ending.
fn without_ending(name: &str) -> String {
    let ending = Path::new(name).extension().unwrap_or_default();
    let is = |known: &str| ending.eq_ignore_ascii_case(known);
    let length = name.len() - if is("bvh") || is("c3d") { 4 } else { 0 };
    name[..length].to_owned()
}

impl LabelsPlan {
    /// The labels of the capture whose file is called `stem`.
    pub(super) fn of(
        &self,
        stem: &str,
        plan: &Plan,
        table: Option<&CaptionTable>,
    ) -> Result<CaptureLabels, String> {
        let mut found = CaptureLabels::default();
        if let Some(pattern) = &self.name {
            let misfit = || format!("its name does not fit labels.name = \"{pattern}\"");
            for (name, value) in fit(&parts(pattern)?, stem).ok_or_else(misfit)? {
                if name == TAKE {
                    let problem = || format!("take `{value}` in its name: a whole number allowed");
                    found.take = Some(value.parse().map_err(|_| problem())?);
                } else {
                    found.labels.insert(name, value);
                }
            }
        }
        if let Some(path) = &self.json {
            let path = plan.resolve(&path.replace("{name}", stem));
            let read = self.read_json(&path, plan, &mut found.labels);
            read.map_err(|problem| format!("{}: {problem}", path.display()))?;
        }
        if let Some(table) = table {
            let missing = || format!("{} has no row for it", table.file);
            let (labels, captions) = table.rows.get(stem).ok_or_else(missing)?;
            found.labels.extend(labels.clone());
            found.captions.clone_from(captions);
        }
        found.labels.extend(self.fixed.clone());
        Ok(found)
    }

    /// Adds the texts and numbers of a JSON object.
    fn read_json(&self, path: &Path, plan: &Plan, labels: &mut Labels) -> Result<(), String> {
        let text = read_text(path).map_err(|problem| problem.to_string())?;
        let read: Value = serde_json::from_str(&text).map_err(|problem| problem.to_string())?;
        let Value::Object(entries) = read else {
            return Err("an object of labels allowed".to_owned());
        };
        let mut names = self.json_names.keys();
        if let Some(absent) = names.find(|name| !entries.contains_key(*name)) {
            return Err(format!(
                "it has no `{absent}`, which labels.json_names names"
            ));
        }
        for (name, value) in entries {
            let value = match (value, self.json_names.get(&name)) {
                (Value::String(value), _) => value,
                (Value::Number(number), Some(names)) => {
                    let names = names.read(plan)?;
                    let place = number.as_u64().and_then(|n| usize::try_from(n).ok());
                    let value = place.and_then(|place| names.get(place)).cloned();
                    let last = names.len().saturating_sub(1);
                    value.ok_or_else(|| format!("{name} = {number}: 0 to {last} allowed"))?
                }
                (Value::Number(number), None) => number.to_string(),
                _ => continue,
            };
            check_label(&name, &name).map_err(|e| e.to_string())?;
            labels.insert(name, value);
        }
        Ok(())
    }
}

impl Names {
    fn read(&self, plan: &Plan) -> Result<Vec<String>, String> {
        match self {
            Self::List(names) => Ok(names.clone()),
            Self::File(file) => {
                let path = plan.resolve(file);
                let text = read_text(&path).map_err(|e| format!("{}: {e}", path.display()))?;
                let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
                Ok(lines.map(str::to_owned).collect())
            }
        }
    }
}

/// The values of the names in braces of `pattern` in `text`; `None` if the text does not fit. A
/// name matches the shortest fitting text of at least one character; a `*` matches any text.
fn fit(pattern: &[Part<'_>], text: &str) -> Option<Vec<(String, String)>> {
    let Some((first, rest)) = pattern.split_first() else {
        return text.is_empty().then(Vec::new);
    };
    let (text, name, rest) = match first {
        Part::Name(name) => (text, Some(*name), rest.to_vec()),
        Part::Text(literal) => match literal.split_once('*') {
            None => return fit(rest, text.strip_prefix(literal)?),
            Some((before, after)) => {
                let rest = [&[Part::Text(after)][..], rest].concat();
                (text.strip_prefix(before)?, None, rest)
            }
        },
    };
    let ends = text.char_indices().map(|(end, _)| end).chain([text.len()]);
    let mut ends = ends.filter(|end| *end > 0 || name.is_none());
    ends.find_map(|end| {
        let mut found = fit(&rest, &text[end..])?;
        if let Some(name) = name {
            found.insert(0, (name.to_owned(), text[..end].to_owned()));
        }
        Some(found)
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn named(pattern: &str, text: &str) -> Option<Vec<(String, String)>> {
        fit(&parts(pattern).unwrap(), text)
    }

    fn pairs(texts: &[(&str, &str)]) -> Vec<(String, String)> {
        let texts = texts.iter();
        texts
            .map(|(a, b)| ((*a).to_owned(), (*b).to_owned()))
            .collect()
    }

    #[test]
    fn names_are_taken_apart() {
        let pattern = "*_{content}_{style}_{take}";
        assert_eq!(
            named(pattern, "dataset-2_walk-turn-left_happy_012"),
            Some(pairs(&[
                ("content", "walk-turn-left"),
                ("style", "happy"),
                ("take", "012")
            ]))
        );
        assert_eq!(named(pattern, "a_b_c"), None);
        assert_eq!(named(pattern, "a__c_d"), None);
        // A longer text is tried if the shortest does not fit.
        assert_eq!(named("{a}_x", "b_x_x"), Some(pairs(&[("a", "b_x")])));
        assert_eq!(named("walk", "walk"), Some(vec![]));
        assert_eq!(named("*", ""), Some(vec![]));
        assert_eq!(named("{a}", "Größe"), Some(pairs(&[("a", "Größe")])));
    }

    fn plan_in(folder: &Path) -> Plan {
        let text = "output = \"set\"\n[[capture]]\nmotion = \"*.bvh\"\n";
        fs::write(folder.join("plan.toml"), text).unwrap();
        Plan::read(&folder.join("plan.toml")).unwrap()
    }

    #[test]
    fn later_sources_of_labels_decide() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        write(
            "walk_001.json",
            "{\"content\": 1, \"style\": \"sad\", \"speed\": 3, \"x\": []}",
        );
        write("styles.txt", "glad\n\nmad\n");
        write(
            "table.csv",
            "file, caption, style, caption_2\nwalk_001.bvh,\"he walks, slowly\", mad,\n\
             walk_001, he is mad, , he goes\n",
        );
        let plan = plan_in(folder.path());
        let mut labels: LabelsPlan = toml::from_str(
            "name = \"{content}_{take}\"\njson = \"{name}.json\"\n\
             json_names = { content = [\"run\", \"stroll\"] }",
        )
        .unwrap();
        let found = labels.of("walk_001", &plan, None).unwrap();
        let of = |found: &CaptureLabels| -> Vec<(String, String)> {
            found.labels.clone().into_iter().collect()
        };
        let stated = pairs(&[("content", "stroll"), ("speed", "3"), ("style", "sad")]);
        assert_eq!((of(&found), found.take), (stated, Some(1)));
        let table = CaptionTable::read(&folder.path().join("table.csv")).unwrap();
        labels.fixed.insert("speed".to_owned(), "fast".to_owned());
        let found = labels.of("walk_001", &plan, Some(&table)).unwrap();
        let stated = pairs(&[("content", "stroll"), ("speed", "fast"), ("style", "mad")]);
        assert_eq!(of(&found), stated);
        assert_eq!(found.captions, ["he walks, slowly", "he is mad", "he goes"]);

        let refused = |labels: &LabelsPlan, stem: &str, table: Option<&CaptionTable>| {
            labels.of(stem, &plan, table).unwrap_err()
        };
        assert!(refused(&labels, "walk", None).contains("does not fit labels.name"));
        assert!(refused(&labels, "walk_two", None).contains("take `two`"));
        assert!(refused(&labels, "walk_002", None).contains("walk_002.json"));
        labels.json = None;
        assert!(refused(&labels, "run_7", Some(&table)).contains("has no row for it"));
        labels.json = Some("walk_001.json".to_owned());
        labels.json_names = toml::from_str("content = [\"run\"]").unwrap();
        assert!(refused(&labels, "walk_001", None).contains("content = 1: 0 to 0 allowed"));
        labels.json_names = toml::from_str("mood = \"styles.txt\"").unwrap();
        assert!(refused(&labels, "walk_001", None).contains("no `mood`"));
        write("walk_001.json", "{\"mood\": 1}");
        let found = labels.of("walk_001", &plan, None).unwrap();
        assert_eq!(found.labels["mood"], "mad");
    }

    #[test]
    fn tables_that_cannot_be_read_say_why() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        for (text, part) in [
            (
                "name,caption\na,b\n",
                "no column `file`, found: name, caption",
            ),
            ("file,caption,Split\na,b,c\n", "a label called `Split`"),
            ("file,caption,split\na,b,c\n", "a label called `split`"),
            ("file,caption\na,b#c\n", "row 1: `b#c`"),
            ("file,caption\na\n", "table.csv"),
        ] {
            fs::write(&path, text).unwrap();
            let message = CaptionTable::read(&path).unwrap_err();
            assert!(message.contains(part), "{part}: {message}");
        }
    }
}
