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
//! `like` takes a pattern with `*` for any run of characters. A missing value meets no condition.

use polars::prelude::{Column, DataFrame, DataType};

use crate::split::matches;

/// Most conditions and brackets of one filter.
const MAX_PARTS: usize = 200;

/// A condition, parsed.
#[derive(Debug, PartialEq)]
pub(super) enum Filter {
    Any(Vec<Filter>),
    All(Vec<Filter>),
    Not(Box<Filter>),
    Compare {
        column: String,
        operator: Operator,
        value: String,
    },
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Operator {
    Equal,
    Unequal,
    Less,
    AtMost,
    Greater,
    AtLeast,
    Like,
}

impl Filter {
    /// Reads a condition; in an error, what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let words = words(text)?;
        if words.len() > MAX_PARTS {
            return Err(format!("{} parts found, {MAX_PARTS} allowed", words.len()));
        }
        let mut rest = words.as_slice();
        let filter = any(&mut rest)?;
        match rest.first() {
            None => Ok(filter),
            Some(word) => Err(format!("`{}` found, `and` or `or` allowed", word.text)),
        }
    }

    /// Which rows of `frame` meet it.
    pub fn rows(&self, frame: &DataFrame) -> Result<Vec<bool>, String> {
        match self {
            Self::Any(parts) => combine(parts, frame, false, |a, b| a | b),
            Self::All(parts) => combine(parts, frame, true, |a, b| a & b),
            Self::Not(part) => Ok(part.rows(frame)?.into_iter().map(|met| !met).collect()),
            Self::Compare {
                column,
                operator,
                value,
            } => {
                let found = frame.column(column).map_err(|_| {
                    let names: Vec<&str> =
                        frame.columns().iter().map(|c| c.name().as_str()).collect();
                    format!("no column `{column}`; there are {}", names.join(", "))
                })?;
                compare(found, *operator, value)
            }
        }
    }
}

fn combine(
    parts: &[Filter],
    frame: &DataFrame,
    start: bool,
    join: impl Fn(bool, bool) -> bool,
) -> Result<Vec<bool>, String> {
    let mut all = vec![start; frame.height()];
    for part in parts {
        for (sum, met) in all.iter_mut().zip(part.rows(frame)?) {
            *sum = join(*sum, met);
        }
    }
    Ok(all)
}

fn compare(column: &Column, operator: Operator, value: &str) -> Result<Vec<bool>, String> {
    let name = column.name();
    let broken = |error: polars::prelude::PolarsError| format!("column `{name}`: {error}");
    let holds = |order: std::cmp::Ordering| match operator {
        Operator::Equal => order.is_eq(),
        Operator::Unequal => order.is_ne(),
        Operator::Less => order.is_lt(),
        Operator::AtMost => order.is_le(),
        Operator::Greater => order.is_gt(),
        Operator::AtLeast => order.is_ge(),
        Operator::Like => false,
    };
    if column.dtype().is_primitive_numeric() {
        if operator == Operator::Like {
            return Err(format!("column `{name}` holds numbers: `like` is for text"));
        }
        let wanted: f64 = value
            .parse()
            .map_err(|_| format!("column `{name}` holds numbers, `{value}` is none"))?;
        let numbers = column.cast(&DataType::Float64).map_err(broken)?;
        let numbers = numbers.f64().map_err(broken)?;
        let meets = |found: Option<f64>| {
            found.is_some_and(|found| found.partial_cmp(&wanted).is_some_and(holds))
        };
        return Ok(numbers.iter().map(meets).collect());
    }
    let texts = column.cast(&DataType::String).map_err(broken)?;
    let texts = texts.str().map_err(broken)?;
    let meets = |found: Option<&str>| match (found, operator) {
        (None, _) => false,
        (Some(found), Operator::Like) => matches(value, found),
        (Some(found), _) => holds(found.cmp(value)),
    };
    Ok(texts.iter().map(meets).collect())
}

/// A part of a condition, and whether it was in quotes.
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

fn any(rest: &mut &[Word]) -> Result<Filter, String> {
    let mut parts = vec![all(rest)?];
    while take(rest, "or") {
        parts.push(all(rest)?);
    }
    Ok(only_or(parts, Filter::Any))
}

fn all(rest: &mut &[Word]) -> Result<Filter, String> {
    let mut parts = vec![one(rest)?];
    while take(rest, "and") {
        parts.push(one(rest)?);
    }
    Ok(only_or(parts, Filter::All))
}

fn only_or(mut parts: Vec<Filter>, several: impl Fn(Vec<Filter>) -> Filter) -> Filter {
    match parts.len() {
        1 => parts.remove(0),
        _ => several(parts),
    }
}

fn one(rest: &mut &[Word]) -> Result<Filter, String> {
    if take(rest, "not") {
        return Ok(Filter::Not(Box::new(one(rest)?)));
    }
    if take(rest, "(") {
        let inner = any(rest)?;
        return match take(rest, ")") {
            true => Ok(inner),
            false => Err("`)` is missing".to_owned()),
        };
    }
    let [column, operator, value, after @ ..] = *rest else {
        return Err("a condition is COLUMN OPERATOR VALUE, as in `tempo > 100`".to_owned());
    };
    let operator = match operator.text.to_ascii_lowercase().as_str() {
        "=" | "==" => Operator::Equal,
        "!=" | "<>" => Operator::Unequal,
        "<" => Operator::Less,
        "<=" => Operator::AtMost,
        ">" => Operator::Greater,
        ">=" => Operator::AtLeast,
        "like" => Operator::Like,
        other => {
            return Err(format!(
                "`{other}` found; =, !=, <, <=, >, >= and like allowed"
            ));
        }
    };
    let filter = Filter::Compare {
        column: column.text.clone(),
        operator,
        value: value.text.clone(),
    };
    *rest = after;
    Ok(filter)
}

fn take(rest: &mut &[Word], keyword: &str) -> bool {
    match rest {
        [first, after @ ..] if first.is(keyword) => {
            *rest = after;
            true
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use polars::df;
    use proptest::prelude::*;

    fn rows(text: &str) -> Result<Vec<bool>, String> {
        let frame = df!(
            "id" => ["a_0", "a_1", "b_0", "or"],
            "tempo" => [Some(120.0), Some(90.5), None, Some(90.5)],
            "frames" => [120i64, 60, 120, 30],
        )
        .unwrap();
        Filter::parse(text)?.rows(&frame)
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
    fn what_is_wrong_is_said() {
        for (text, expected) in [
            ("", "COLUMN OPERATOR VALUE"),
            ("tempo", "COLUMN OPERATOR VALUE"),
            ("tempo near 3", "`near` found"),
            ("tempo > fast", "holds numbers"),
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
