//! Output of results and errors.

use std::fmt;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use kinegrad_output::{block, line, message};
use kinegrad_report::{Panel, grouped};
use kinegrad_train::{Error, ParameterCount};
use miette::Diagnostic;
use serde::Serialize;

use crate::folder;
use crate::options::as_flags;

/// Prints a line of results to standard output. Unlike `println!`, the macro does not panic on a
/// closed pipe, as in `kinegrad ... | head`. Control characters are escaped.
macro_rules! say {
    ($($text:tt)*) => { $crate::output::result(format_args!($($text)*)) };
}

/// [`say!`] for text of several lines, such as a table.
macro_rules! show {
    ($($text:tt)*) => { $crate::output::lines(format_args!($($text)*)) };
}

/// Prints a line of progress to standard error; a failure to write is ignored. Control characters
/// are escaped.
macro_rules! tell {
    ($($text:tt)*) => { $crate::output::remark(format_args!($($text)*)) };
}

/// See [`say!`]. If a result cannot be written, the program ends with exit code 1.
pub fn result(text: fmt::Arguments<'_>) {
    print(&line(&text.to_string()));
}

/// See [`show!`].
pub fn lines(text: fmt::Arguments<'_>) {
    print(&block(&text.to_string()));
}

fn print(text: &str) {
    if let Err(error) = writeln!(io::stdout(), "{text}")
        && error.kind() != ErrorKind::BrokenPipe
    {
        tell!("error: standard output cannot be written: {error}");
        std::process::exit(1);
    }
}

/// Only results, warnings and errors are printed.
static QUIET: AtomicBool = AtomicBool::new(false);

/// Turns progress and notes off.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Only errors are printed.
static SILENT: AtomicBool = AtomicBool::new(false);

/// Prints only errors from now on: another rank prints the rest.
pub fn be_silent() {
    be_quiet();
    SILENT.store(true, Ordering::Relaxed);
}

/// True if progress and notes are turned off.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// See [`tell!`]. A quiet command prints only lines that begin with `warning:` or `error:`.
pub fn remark(text: fmt::Arguments<'_>) {
    if is_quiet() {
        let text = text.to_string();
        let first = text.trim_start();
        if SILENT.load(Ordering::Relaxed)
            || !(first.starts_with("warning:") || first.starts_with("error:"))
        {
            return;
        }
    }
    always(text);
}

fn always(text: fmt::Arguments<'_>) {
    let text = message(&as_flags(&text.to_string()));
    let _ = writeln!(io::stderr(), "{text}");
}

/// Columns of the terminal on standard output; `None` elsewhere.
pub fn width() -> Option<usize> {
    let size = terminal_size::terminal_size_of(io::stdout());
    size.map(|(width, _)| usize::from(width.0))
}

/// Largest number of motions in the command of [`how_to_view`].
const VIEWED: usize = 4;

/// Prints the command that plays motions, with their goal; the first ones if they are many.
pub fn how_to_view(motions: &[PathBuf], goal: Option<&Path>) {
    let Some(command) = view_command(motions, goal) else {
        return;
    };
    tell!("to play: {command}");
}

fn view_command(motions: &[PathBuf], goal: Option<&Path>) -> Option<String> {
    let motions = motions.iter().take(VIEWED).map(PathBuf::as_path);
    let goal = goal
        .into_iter()
        .flat_map(|goal| [Path::new("--goal"), goal]);
    let words: Option<Vec<&str>> = motions.chain(goal).map(Path::to_str).collect();
    let words = words.filter(|words| !words.is_empty())?;
    let words = ["kinegrad", "view"].into_iter().chain(words);
    shlex::try_join(words).ok()
}

/// A number of parameters, with its parts if there are several.
pub fn parameters(count: &ParameterCount) -> String {
    let parts = count.networks.iter();
    let parts = parts.map(|(name, own)| format!("{name} {}", grouped(*own)));
    let mut parts: Vec<String> = parts.collect();
    if count.adapters > 0 {
        parts.push(format!("adapters among them {}", grouped(count.adapters)));
    }
    if count.trained != count.all {
        let [trained, frozen] = [count.trained, count.all - count.trained].map(grouped);
        parts.push(format!("trained {trained}, frozen {frozen}"));
    }
    match parts.is_empty() {
        true => format!("{} parameters", grouped(count.all)),
        false => format!("{} parameters ({})", grouped(count.all), parts.join(", ")),
    }
}

/// Prints results as JSON.
pub fn json(results: &impl Serialize) {
    show!("{}", serde_json::to_string(results).expect("plain data"));
}

/// Prints an error with its hint.
pub fn failure(error: &Error) {
    always(format_args!("error: {error}"));
    if let Some(hint) = error.help() {
        always(format_args!("\nhint: {hint}"));
    }
}

/// Plots panels of `size` pixels to `out`, `columns` side by side.
pub fn draw(panels: &[Panel], columns: usize, size: (u32, u32), out: &Path) -> Result<(), Error> {
    folder::make_for(out)?;
    kinegrad_report::draw(panels, columns, size, out).map_err(unusable)
}

/// A library's error as an error of the user's input.
pub fn unusable(error: impl Diagnostic) -> Error {
    let hint = error.help().map(|hint| hint.to_string());
    Error::usage(error.to_string(), hint.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_that_plays_motions_can_be_pasted() {
        let files: Vec<PathBuf> = ["a dance.npy", "b.npy", "c.npy", "d.npy", "e.npy"]
            .map(PathBuf::from)
            .to_vec();
        let goal = view_command(&files[1..2], Some(Path::new("goal.toml")));
        assert_eq!(
            goal.as_deref(),
            Some("kinegrad view b.npy --goal goal.toml")
        );
        let many = view_command(&files, None).expect("a command");
        let words = shlex::split(&many).expect("words");
        assert_eq!(
            words,
            ["kinegrad", "view", "a dance.npy", "b.npy", "c.npy", "d.npy"]
        );
        assert_eq!(view_command(&[], None), None);
    }
}
