//! Sanity checks of motion.

use std::path::{Path, PathBuf};

use kinegrad_cli::checkpoint;
use kinegrad_motion::Profile;
use kinegrad_systems::BUILT_IN;
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::shape_and_values;
use crate::calls::{call, json};
use crate::errors::named;

/// The report of `profile`'s checks as JSON, with the training statistics of `run`.
#[pyfunction]
pub fn check(
    py: Python<'_>,
    motion: PyReadonlyArrayDyn<'_, f32>,
    profile: &str,
    run: Option<PathBuf>,
) -> PyResult<String> {
    let (shape, values) = shape_and_values(&motion);
    call(py, || {
        let allowed = "\"ccmotion\" and \"strict\"";
        let profile: Profile = named("the profile", profile, allowed)?;
        let representation = BUILT_IN.representation_of(Path::new("motion"), &shape, &values)?;
        let statistics = match (profile, &run) {
            (Profile::Strict, Some(run)) => {
                let state = checkpoint(run)?.state;
                Some(state.statistics_of(&*representation)?.clone())
            }
            _ => None,
        };
        let report = representation.check(&values, profile, statistics.as_ref());
        Ok(json(&report))
    })
}
