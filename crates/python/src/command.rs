//! The command line.

use std::process::ExitCode;

use kinegrad_systems::BUILT_IN;
use pyo3::prelude::*;

/// Runs a command line, whose first argument is the program's name, and returns its exit code.
#[pyfunction]
pub fn main(py: Python<'_>, arguments: Vec<String>) -> u8 {
    let code = py.detach(|| kinegrad_cli::run(BUILT_IN, arguments));
    let codes = 0..=u8::MAX;
    let mut codes = codes.filter(|number| ExitCode::from(*number) == code);
    codes.next().unwrap_or(1)
}
