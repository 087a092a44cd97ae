//! The command line.

use std::process::ExitCode;

use kinegrad_systems::BUILT_IN;
use pyo3::prelude::*;

/// Runs a command line and returns its exit code. The first argument is the program's name.
#[pyfunction]
pub fn main(py: Python<'_>, arguments: Vec<String>) -> u8 {
    let code = py.detach(|| kinegrad_cli::run(BUILT_IN, arguments));
    let number = (0..=u8::MAX).find(|number| ExitCode::from(*number) == code);
    number.unwrap_or(1)
}
