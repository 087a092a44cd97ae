//! Output of results and errors.

use std::fmt;
use std::io::{self, ErrorKind, Write};
use std::path::Path;

use kinegrad_report::Panel;
use kinegrad_train::Error;
use miette::Diagnostic;
use serde::Serialize;

/// Prints a line of results to standard output.
///
/// Unlike `println!`, it does not panic where nobody reads on, as in `kinegrad ... | head`.
macro_rules! say {
    ($($text:tt)*) => { $crate::output::result(format_args!($($text)*)) };
}

/// Prints a line about what is going on to standard error, or drops it where that is full: no
/// training ends for it.
macro_rules! tell {
    ($($text:tt)*) => { $crate::output::remark(format_args!($($text)*)) };
}

/// See [`say!`]. Where a result is lost though somebody reads, the program ends with exit code 1.
pub fn result(text: fmt::Arguments<'_>) {
    if let Err(error) = writeln!(io::stdout(), "{text}")
        && error.kind() != ErrorKind::BrokenPipe
    {
        remark(format_args!(
            "error: standard output cannot be written: {error}"
        ));
        std::process::exit(1);
    }
}

/// See [`tell!`].
pub fn remark(text: fmt::Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// Prints results as JSON.
pub fn json(results: &impl Serialize) {
    say!("{}", serde_json::to_string(results).expect("plain data"));
}

/// Prints an error with its hint.
pub fn failure(error: &Error) {
    tell!("error: {error}");
    if let Some(hint) = error.help() {
        tell!("\nhint: {hint}");
    }
}

/// Plots the panels to `out`, `columns` side by side, each of `size` pixels.
pub fn draw(panels: &[Panel], columns: usize, size: (u32, u32), out: &Path) -> Result<(), Error> {
    kinegrad_report::draw(panels, columns, size, out).map_err(unusable)
}

/// The error of something that was given and cannot be used.
pub fn unusable(error: impl Diagnostic) -> Error {
    let hint = error.help().map(|hint| hint.to_string());
    Error::usage(error.to_string(), hint.unwrap_or_default())
}
