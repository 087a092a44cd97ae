//! Patterns of ids.

/// True if `text` matches `pattern`, in which `*` matches any characters. Takes at most
/// `pattern.len() * text.len()` steps.
pub fn matches(pattern: &str, text: &str) -> bool {
    let (pattern, text) = (pattern.as_bytes(), text.as_bytes());
    let (mut p, mut t) = (0, 0);
    let mut star: Option<(usize, usize)> = None;
    while t < text.len() {
        if pattern.get(p) == Some(&b'*') {
            star = Some((p + 1, t));
            p += 1;
        } else if pattern.get(p) == Some(&text[t]) {
            p += 1;
            t += 1;
        } else if let Some((after, start)) = star {
            star = Some((after, start + 1));
            (p, t) = (after, start + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|&byte| byte == b'*')
}

/// A warning, prefixed by `key`, for each of `patterns` that matches no id.
pub(crate) fn idle<'a>(
    key: &str,
    patterns: impl Iterator<Item = &'a String>,
    ids: impl Iterator<Item = &'a str> + Clone,
) -> Vec<String> {
    let idle = patterns.filter(|pattern| !ids.clone().any(|id| matches(pattern, id)));
    idle.map(|pattern| format!("{key}: `{pattern}` matches no phrase"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_stand_for_any_run_of_characters() {
        for (pattern, text, expected) in [
            ("C_5_*", "C_5_00188", true),
            ("C_5_*", "C_50_00188", false),
            ("C_5_*", "C_5_", true),
            ("*_00188", "C_5_00188", true),
            ("C*5*8", "C_5_00188", true),
            ("C*5*8", "C_5_00187", false),
            ("a", "ab", false),
            ("ab", "a", false),
            ("*", "", true),
            ("**", "x", true),
            ("*ab*ab", "xabab", true),
            ("é*", "éa", true),
        ] {
            assert_eq!(matches(pattern, text), expected, "{pattern} {text}");
        }
    }
}
