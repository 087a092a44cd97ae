//! Options in messages of the libraries, as flags of the command line or arguments of Python.

/// Options whose flag is not their name.
const RENAMED: [(&str, &str); 2] = [("song", "audio"), ("trajectory", "trajectory_run")];

/// The argument of Python with that name.
fn argument(name: &str) -> &str {
    let renamed = RENAMED.iter().find(|(known, _)| *known == name);
    renamed.map_or(name, |(_, argument)| argument)
}

/// `text` with each ``option `name ...` `` as the argument of Python.
pub fn as_arguments(text: &str) -> String {
    replaced(text, |name| argument(name).to_string())
}

/// `text` with each ``option `name ...` `` as the flag of the command line.
pub fn as_flags(text: &str) -> String {
    replaced(text, |name| {
        format!("--{}", argument(name).replace('_', "-"))
    })
}

/// Both ``option `name` `` and `` `option name` `` in `text`, with the names as `shown`.
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
