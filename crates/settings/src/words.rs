//! Plain wording for a deserializer's messages.

/// Rewords a `message` of serde, such as "invalid type: string "many", expected u64", for the
/// author of a document. Other messages are unchanged.
pub(crate) fn in_words(message: &str) -> String {
    let message = message.trim().lines().next().unwrap_or_default();
    if message.ends_with("value was too large") {
        return "the whole number is too large".to_owned();
    }
    if let Some(number) = message.strip_prefix("invalid type: integer `")
        && let Some((number, _)) = number.split_once("` as i128")
    {
        return too_large(number);
    }
    if let Some(rest) = message.strip_prefix("invalid length ")
        && let Some((found, expected)) = rest.split_once(", expected ")
    {
        return format!("expected {}, found {found}", expected_in_words(expected));
    }
    let rest = ["invalid type: ", "invalid value: "]
        .iter()
        .find_map(|start| message.strip_prefix(start));
    match rest.and_then(|rest| rest.rsplit_once(", expected ")) {
        Some((found, expected)) => {
            let expected = expected_in_words(expected);
            match long_number(found) {
                Some(number) => format!("expected {expected}, and {}", too_large(number)),
                None => format!("expected {expected}, found {}", found_in_words(found)),
            }
        }
        None => message.to_owned(),
    }
}

/// The number in `found`, such as `string "99999999999999999999"`, if the number is text because it
/// is too large for an integer of a document.
fn long_number(found: &str) -> Option<&str> {
    let text = found.strip_prefix("string \"")?.strip_suffix('"')?;
    let digits = text.strip_prefix(['+', '-']).unwrap_or(text);
    let is_number = !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit() || b == b'_');
    let fits = digits.replace('_', "").parse::<i64>().is_ok();
    (is_number && !fits).then_some(text)
}

fn too_large(number: &str) -> String {
    let (most, side) = match number.starts_with('-') {
        true => (i64::MIN, "least"),
        false => (i64::MAX, "most"),
    };
    format!("{number} is too large for a whole number: {most} at {side}")
}

fn expected_in_words(expected: &str) -> String {
    match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more".into(),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".into(),
        "f32" | "f64" => "a number".into(),
        "a boolean" => "true or false".into(),
        "a string" | "path string" | "a borrowed string" => "text in quotes".into(),
        "string or table" => "one name in quotes".into(),
        "a sequence" => "a list, in square brackets".into(),
        "a map" => "a table".into(),
        _ => {
            let list = ["an array of length ", "a tuple of size "];
            let mut length = list.iter().filter_map(|start| expected.strip_prefix(start));
            if let Some(length) = length.next() {
                return format!("a list of {length} values");
            }
            let table = ["struct ", "internally tagged enum "];
            match table.iter().any(|start| expected.starts_with(start)) {
                true => "a table".into(),
                false => expected.to_owned(),
            }
        }
    }
}

fn found_in_words(found: &str) -> String {
    for start in ["integer `", "floating point `", "boolean `"] {
        if let Some(value) = found.strip_prefix(start) {
            return value.trim_end_matches('`').to_owned();
        }
    }
    if let Some(text) = found.strip_prefix("string ") {
        return format!("the text {text}");
    }
    match found {
        "sequence" => "a list".into(),
        "map" => "a table".into(),
        "unit value" => "nothing".into(),
        _ => found.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_become_words() {
        for (message, words) in [
            (
                "invalid type: string \"many\", expected u64",
                "expected a whole number, 0 or more, found the text \"many\"",
            ),
            (
                "invalid value: integer `-5`, expected usize",
                "expected a whole number, 0 or more, found -5",
            ),
            (
                "invalid type: floating point `1.5`, expected a boolean\n",
                "expected true or false, found 1.5",
            ),
            (
                "invalid type: string \"a, expected b\", expected f64",
                "expected a number, found the text \"a, expected b\"",
            ),
            (
                "invalid type: integer `3`, expected struct TrainConfig",
                "expected a table, found 3",
            ),
            (
                "invalid length 3, expected an array of length 2",
                "expected a list of 2 values, found 3",
            ),
            (
                "invalid type: string \"99999999999999999999\", expected u64",
                "expected a whole number, 0 or more, and 99999999999999999999 is too large for a \
                 whole number: 9223372036854775807 at most",
            ),
            (
                "invalid type: string \"-99999999999999999999\", expected i64",
                "expected a whole number, and -99999999999999999999 is too large for a whole \
                 number: -9223372036854775808 at least",
            ),
            (
                "invalid type: string \"600\", expected u64",
                "expected a whole number, 0 or more, found the text \"600\"",
            ),
            (
                "invalid type: integer `99999999999999999999` as i128, expected any valid TOML value",
                "99999999999999999999 is too large for a whole number: 9223372036854775807 at most",
            ),
            ("something else", "something else"),
        ] {
            assert_eq!(in_words(message), words);
        }
    }
}
