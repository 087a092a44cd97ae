//! Renames options in the libraries' messages to command-line flags or Python arguments.

/// Options whose flag has a different name.
const RENAMED: [(&str, &str); 2] = [("song", "audio"), ("trajectory", "trajectory_run")];

/// The Python argument for an option.
fn argument(name: &str) -> &str {
    let renamed = RENAMED.iter().find(|(known, _)| *known == name);
    renamed.map_or(name, |(_, argument)| argument)
}

/// `text` with each ``option `name ...` `` as the Python argument.
pub fn as_arguments(text: &str) -> String {
    replaced(text, |name| argument(name).to_string())
}

/// `text` with each ``option `name ...` `` as the command-line flag.
pub fn as_flags(text: &str) -> String {
    replaced(text, |name| {
        format!("--{}", argument(name).replace('_', "-"))
    })
}

/// `text` with the names in ``option `name` `` and `` `option name` `` replaced by `shown`.
fn replaced(text: &str, shown: impl Fn(&str) -> String) -> String {
    let mut done = String::with_capacity(text.len());
    let mut rest = text;
    loop {
        let next = ["option `", "`option "]
            .into_iter()
            .filter_map(|mark| Some((rest.find(mark)?, mark)))
            .min();
        let Some((start, mark)) = next else {
            return done + rest;
        };
        done += &rest[..start];
        rest = &rest[start + mark.len()..];
        let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let end = rest.find(|c| !is_name(c)).unwrap_or(rest.len());
        done.push('`');
        done += &shown(&rest[..end]);
        rest = &rest[end..];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_shown_as_flags_and_as_arguments() {
        let text = "option `song` with `option audio_features`: option `keep 0..3`, `x` and option";
        assert_eq!(
            as_flags(text),
            "`--audio` with `--audio-features`: `--keep 0..3`, `x` and option"
        );
        assert_eq!(
            as_arguments(text),
            "`audio` with `audio_features`: `keep 0..3`, `x` and option"
        );
    }
}
