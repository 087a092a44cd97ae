//! `--where`: conditions on the columns of a manifest.
//!
//! ```text
//! any  = all ("or" all)*
//! all  = one ("and" one)*
//! one  = "not" one | "(" any ")" | COLUMN OPERATOR VALUE
//! OPERATOR = "=" | "!=" | "<" | "<=" | ">" | ">=" | "like"
//! VALUE    = NUMBER | WORD | 'TEXT' | "TEXT"
//! ```
//!
//! `like` takes a pattern, in which `*` matches any characters. Conditions on missing values are
//! false.

use std::cmp::Ordering;

use polars::prelude::{DataFrame, DataType};

use super::table::{cast, numbers};
use crate::pattern::matches;

/// Maximum number of words in a filter.
const MAX_PARTS: usize = 200;

/// The rows of `frame` that match the condition, or the condition's error.
pub(super) fn rows(condition: &str, frame: &DataFrame) -> Result<Vec<bool>, String> {
    let words = words(condition)?;
    if words.len() > MAX_PARTS {
        return Err(format!("{} parts found, {MAX_PARTS} allowed", words.len()));
    }
    let mut reader = Reader {
        rest: &words,
        frame,
    };
    let rows = reader.any()?;
    match reader.rest.first() {
        None => Ok(rows),
        Some(word) => Err(format!("`{}` found, `and` or `or` allowed", word.text)),
    }
}

/// The unread rest of a condition, and the table.
struct Reader<'a> {
    rest: &'a [Word],
    frame: &'a DataFrame,
}

impl Reader<'_> {
    fn any(&mut self) -> Result<Vec<bool>, String> {
        let mut rows = self.all()?;
        while self.take("or") {
            rows.iter_mut().zip(self.all()?).for_each(|(a, b)| *a |= b);
        }
        Ok(rows)
    }

    fn all(&mut self) -> Result<Vec<bool>, String> {
        let mut rows = self.one()?;
        while self.take("and") {
            rows.iter_mut().zip(self.one()?).for_each(|(a, b)| *a &= b);
        }
        Ok(rows)
    }

    fn one(&mut self) -> Result<Vec<bool>, String> {
        if self.take("not") {
            return Ok(self.one()?.into_iter().map(|met| !met).collect());
        }
        if self.take("(") {
            let inner = self.any()?;
            return match self.take(")") {
                true => Ok(inner),
                false => Err("`)` is missing".to_owned()),
            };
        }
        let [column, operator, value, after @ ..] = self.rest else {
            return Err("a condition is COLUMN OPERATOR VALUE, as in `tempo > 100`".to_owned());
        };
        self.rest = after;
        compare(self.frame, &column.text, &operator.text, &value.text)
    }

    /// Consumes the next word if it is `keyword`.
    fn take(&mut self, keyword: &str) -> bool {
        match self.rest {
            [first, after @ ..] if first.is(keyword) => {
                self.rest = after;
                true
            }
            _ => false,
        }
    }
}

fn compare(
    frame: &DataFrame,
    name: &str,
    operator: &str,
    value: &str,
) -> Result<Vec<bool>, String> {
    let holds = match operator.to_ascii_lowercase().as_str() {
        "=" | "==" => Ordering::is_eq,
        "!=" | "<>" => Ordering::is_ne,
        "<" => Ordering::is_lt,
        "<=" => Ordering::is_le,
        ">" => Ordering::is_gt,
        ">=" => Ordering::is_ge,
        "like" => |_| false,
        other => {
            return Err(format!(
                "`{other}` found; =, !=, <, <=, >, >= and like allowed"
            ));
        }
    };
    let like = operator.eq_ignore_ascii_case("like");
    let Ok(column) = frame.column(name) else {
        let names: Vec<&str> = frame.columns().iter().map(|c| c.name().as_str()).collect();
        return Err(format!(
            "no column `{name}`; there are {}",
            names.join(", ")
        ));
    };
    if column.dtype().is_primitive_numeric() {
        if like {
            return Err(format!(
                "column `{name}` contains numbers: `like` is for text"
            ));
        }
        let wanted: f64 = value
            .parse()
            .map_err(|_| format!("column `{name}` contains numbers, `{value}` is not one"))?;
        let matched = |found: Option<f64>| {
            found.is_some_and(|found| found.partial_cmp(&wanted).is_some_and(holds))
        };
        return Ok(numbers(column)?.into_iter().map(matched).collect());
    }
    let column = cast(column, &DataType::String)?;
    let matched = |found: &str| match like {
        true => matches(value, found),
        false => holds(found.cmp(value)),
    };
    let texts = column.str().map_err(|error| error.to_string())?;
    let met = texts.iter().map(|found| found.is_some_and(matched));
    Ok(met.collect())
}

/// A word of a condition, quoted or not.
#[derive(Debug, PartialEq)]
struct Word {
    text: String,
    quoted: bool,
}

impl Word {
    fn is(&self, keyword: &str) -> bool {
        !self.quoted && self.text.eq_ignore_ascii_case(keyword)
    }
}

fn words(text: &str) -> Result<Vec<Word>, String> {
    let mut words = Vec::new();
    let mut rest = text.trim_start();
    while let Some(first) = rest.chars().next() {
        let (text, length, quoted) = match first {
            '\'' | '"' => {
                let inner = &rest[1..];
                let end = inner
                    .find(first)
                    .ok_or_else(|| format!("{first} is not closed"))?;
                (&inner[..end], end + 2, true)
            }
            '(' | ')' => (&rest[..1], 1, false),
            '<' | '>' | '=' | '!' => {
                let length = rest
                    .find(|c| !matches!(c, '<' | '>' | '=' | '!'))
                    .unwrap_or(rest.len());
                (&rest[..length], length, false)
            }
            _ => {
                let ends = |c: char| c.is_whitespace() || "()<>=!'\"".contains(c);
                let length = rest.find(ends).unwrap_or(rest.len());
                (&rest[..length], length, false)
            }
        };
        words.push(Word {
            text: text.to_owned(),
            quoted,
        });
        rest = rest[length..].trim_start();
    }
    Ok(words)
}

#[cfg(test)]
mod tests {
    use polars::df;
    use proptest::prelude::*;

    fn rows(text: &str) -> Result<Vec<bool>, String> {
        let frame = df!(
            "id" => ["a_0", "a_1", "b_0", "or"],
            "tempo" => [Some(120.0), Some(90.5), None, Some(90.5)],
            "frames" => [120i64, 60, 120, 30],
        )
        .unwrap();
        super::rows(text, &frame)
    }

    fn chosen(text: &str) -> Vec<usize> {
        let rows = rows(text).unwrap();
        (0..4).filter(|&row| rows[row]).collect()
    }

    #[test]
    fn conditions_choose_rows() {
        for (text, expected) in [
            ("tempo > 100", &[0][..]),
            ("tempo<=90.5", &[1, 3]),
            ("not tempo <= 90.5", &[0, 2]),
            ("frames = 120 and tempo > 1", &[0]),
            ("frames == 120 or id = a_1", &[0, 1, 2]),
            ("(frames = 120 or id = a_1) and not id like 'b*'", &[0, 1]),
            ("id = \"or\"", &[3]),
            ("id like a_*", &[0, 1]),
            ("id != a_0 AND frames >= 60", &[1, 2]),
        ] {
            assert_eq!(chosen(text), expected, "{text}");
        }
    }

    #[test]
    fn problems_are_named() {
        for (text, expected) in [
            ("", "COLUMN OPERATOR VALUE"),
            ("tempo", "COLUMN OPERATOR VALUE"),
            ("tempo near 3", "`near` found"),
            ("tempo > fast", "contains numbers"),
            ("tempo like 1*", "`like` is for text"),
            (
                "speed > 3",
                "no column `speed`; there are id, tempo, frames",
            ),
            ("id = 'a", "not closed"),
            ("(id = a", "`)` is missing"),
            ("id = a id = b", "`id` found, `and` or `or` allowed"),
        ] {
            let message = rows(text).unwrap_err();
            assert!(message.contains(expected), "{text}: {message}");
        }
        assert!(rows(&"(".repeat(100_000)).is_err());
        assert!(rows(&"not ".repeat(100_000)).is_err());
    }

    proptest! {
        #[test]
        fn any_text_is_parsed_or_refused(text in "[a-c<>=!()'\" norlike0-9.]{0,40}") {
            let _ = rows(&text);
        }
    }
}
