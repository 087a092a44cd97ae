//! Counts in messages.

/// `count` with a noun in its number: `1 motion`, `2 motions`.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {}", plural(count, noun))
}

/// The singular `noun` for a count of 1, else its plural.
pub fn plural(count: usize, noun: &str) -> String {
    let ending = match count {
        1 => "",
        _ if noun.ends_with('s') => "es",
        _ => "s",
    };
    format!("{noun}{ending}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_singular() {
        for (count, noun, text) in [
            (0, "motion", "0 motions"),
            (1, "motion", "1 motion"),
            (2, "key frame", "2 key frames"),
            (1, "process", "1 process"),
            (3, "process", "3 processes"),
        ] {
            assert_eq!(counted(count, noun), text);
        }
    }
}
