//! Sanity checks of motion.

use std::path::{Path, PathBuf};

use kinegrad_cli::checkpoint;
use kinegrad_motion::Profile;
use kinegrad_systems::BUILT_IN;
use kinegrad_train::Error;
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::shape_and_values;
use crate::calls::{call, json};

/// The report of the checks of `profile` as JSON, with the training statistics of `run`.
#[pyfunction]
pub fn check(
    py: Python<'_>,
    motion: PyReadonlyArrayDyn<'_, f32>,
    profile: &str,
    run: Option<PathBuf>,
) -> PyResult<String> {
    let (shape, values) = shape_and_values(&motion);
    call(py, || {
        let profile = profile_of(profile)?;
        let representation = BUILT_IN.representation_of(Path::new("motion"), &shape, &values)?;
        let statistics = match (profile, &run) {
            (Profile::Strict, Some(run)) => {
                let state = checkpoint(run)?.state;
                Some(state.statistics_of(&*representation)?.clone())
            }
            _ => None,
        };
        let report = representation.check(&values, profile, statistics.as_ref())?;
        Ok(json(&report))
    })
}

fn profile_of(name: &str) -> Result<Profile, Error> {
    match name {
        "ccmotion" => Ok(Profile::Ccmotion),
        "strict" => Ok(Profile::Strict),
        _ => Err(Error::usage(
            format!("the profile is \"{name}\""),
            "\"ccmotion\" and \"strict\" are allowed",
        )),
    }
}
