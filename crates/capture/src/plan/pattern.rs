//! Texts with names in braces: `walk_{style}_{take}`.

use std::collections::BTreeSet;

/// The label of a file name that is the number of the take.
pub(crate) const TAKE: &str = "take";

/// A part of a text with names in braces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Part<'a> {
    Text(&'a str),
    Name(&'a str),
}

/// The parts of a text with names in braces.
pub(crate) fn parts(text: &str) -> Result<Vec<Part<'_>>, String> {
    let wrong = || format!("`{text}`: names in pairs of braces allowed, as in {{style}}");
    let mut parts = Vec::new();
    let mut rest = text;
    while let Some(open) = rest.find(['{', '}']) {
        let (before, after) = rest.split_at(open);
        let inner = after.strip_prefix('{').ok_or_else(wrong)?;
        let (name, after) = inner.split_once('}').ok_or_else(wrong)?;
        if name.is_empty() || name.contains('{') {
            return Err(wrong());
        }
        if !before.is_empty() {
            parts.push(Part::Text(before));
        }
        parts.push(Part::Name(name));
        rest = after;
    }
    if !rest.is_empty() {
        parts.push(Part::Text(rest));
    }
    Ok(parts)
}

/// The names in braces of a text.
pub(super) fn placeholders(text: &str) -> Result<BTreeSet<String>, String> {
    let names = parts(text)?.into_iter().filter_map(|part| match part {
        Part::Name(name) => Some(name.to_owned()),
        Part::Text(_) => None,
    });
    Ok(names.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn braces_come_in_pairs() {
        assert_eq!(
            parts("a {b}c").unwrap(),
            [Part::Text("a "), Part::Name("b"), Part::Text("c")]
        );
        for broken in ["a {b", "b}", "{}", "{a{b}}", "}{"] {
            assert!(parts(broken).is_err(), "{broken}");
        }
    }
}
