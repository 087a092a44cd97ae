//! Text for terminals and tables. Names of files, keys and tensors come from elsewhere and may
//! contain control sequences.

use std::borrow::Cow;

/// Longest message, in characters.
pub const MOST: usize = 4_000;

/// Longest mark of what is left out, in characters.
const MARK: usize = 60;

/// Characters of the end of a longer message.
const END: usize = 800;

/// True for a character that moves the cursor, changes the terminal, or reverses text.
fn is_control(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn escaped(text: &str, stays: impl Fn(char) -> bool) -> Cow<'_, str> {
    let is_escaped = |c: char| is_control(c) && !stays(c);
    if !text.contains(is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut done = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match is_escaped(c) {
            true => done.extend(c.escape_default()),
            false => done.push(c),
        }
    }
    Cow::Owned(done)
}

/// Lines of text: line breaks and tabs stay, other control characters are escaped.
pub fn block(text: &str) -> Cow<'_, str> {
    escaped(text, |c| matches!(c, '\n' | '\t'))
}

/// One line of text, such as a cell of a table: all control characters are escaped.
pub fn cell(text: &str) -> Cow<'_, str> {
    escaped(text, |_| false)
}

/// A line of output. Line breaks stay at both ends; other control characters are escaped, so that a
/// name cannot begin a line.
pub fn line(text: &str) -> String {
    let inner = text.trim_start_matches('\n');
    let (before, _) = text.split_at(text.len() - inner.len());
    let (inner, after) = inner.split_at(inner.trim_end_matches('\n').len());
    format!("{before}{}{after}", cell(inner))
}

/// [`line()`] of at most about [`MOST`] characters, for errors and warnings.
pub fn message(text: &str) -> String {
    // Escaped characters are longer than their text.
    bounded(&line(&bounded(text, MOST)), MOST + MARK).into_owned()
}

/// The text, without its middle if it is longer than `most` characters.
fn bounded(text: &str, most: usize) -> Cow<'_, str> {
    let all = text.chars().count();
    if all <= most {
        return Cow::Borrowed(text);
    }
    let place = |n: usize| text.char_indices().nth(n).map_or(text.len(), |(at, _)| at);
    let (start, end) = (&text[..place(most - END)], &text[place(all - END)..]);
    Cow::Owned(format!(
        "{start} ... [{} characters left out] ... {end}",
        all - most
    ))
}

/// True for text that a spreadsheet would read as a formula. Numbers are none.
pub fn is_formula(text: &str) -> bool {
    text.starts_with(['=', '+', '-', '@', '\t', '\r']) && text.parse::<f64>().is_err()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_control_a_terminal_or_begin_a_line() {
        let name = "a\u{1b}]0;b\u{7}\r\nerror: c\u{9b}d\u{202e}";
        let shown = "a\\u{1b}]0;b\\u{7}\\r\\nerror: c\\u{9b}d\\u{202e}";
        assert_eq!(cell(name), shown);
        assert_eq!(
            message(&format!("\nwarning: {name}\n")),
            format!("\nwarning: {shown}\n")
        );
        assert_eq!(block("a\tb\n\u{1b}c\n"), "a\tb\n\\u{1b}c\n");
        assert_eq!(message("a\n  error: b"), "a\\n  error: b");
        assert_eq!(message("a\0\n b"), "a\\u{0}\\n b");
        assert_eq!(message("\n\n"), "\n\n");
        for plain in ["", "Füße, 足", "a: b"] {
            assert_eq!(
                (message(plain), block(plain).as_ref()),
                (plain.to_owned(), plain)
            );
        }
    }

    #[test]
    fn messages_are_bounded_and_keep_both_ends() {
        let long = format!("first{}last", "é".repeat(15_000));
        let shown = message(&long);
        assert!(shown.chars().count() < MOST + 60, "{}", shown.len());
        assert!(
            shown.starts_with("firsté") && shown.ends_with("élast"),
            "{shown}"
        );
        assert!(shown.contains("[11009 characters left out]"), "{shown}");
        let controls = message(&"\0".repeat(MOST));
        assert!(
            controls.chars().count() < MOST + 2 * MARK,
            "{}",
            controls.len()
        );
    }

    #[test]
    fn formulas_are_no_numbers() {
        for formula in ["=1+1", "+cmd", "-x", "@SUM(A1)", "\t=1", "-", "- 3"] {
            assert!(is_formula(formula), "{formula}");
        }
        for text in ["", "a=b", "-3", "+1.5e-3", "-inf", "7"] {
            assert!(!is_formula(text), "{text}");
        }
    }
}
