//! Sanity checks of motion.

use std::path::{Path, PathBuf};

use kinegrad_cli::checkpoint;
use kinegrad_motion::{CHANNELS, Phrase, Profile, SanityThresholds, check_thresholds};
use kinegrad_systems::BUILT_IN;
use kinegrad_train::Error;
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::shape_and_values;
use crate::calls::{call, json};
use crate::errors::named;

/// The report of `profile`'s checks as JSON, with the training statistics of `run`, or with the bounds
/// of the profile `ccmotion` as JSON in `thresholds`.
#[pyfunction]
pub fn check(
    py: Python<'_>,
    motion: PyReadonlyArrayDyn<'_, f32>,
    profile: &str,
    run: Option<PathBuf>,
    thresholds: Option<String>,
) -> PyResult<String> {
    let (shape, values) = shape_and_values(&motion);
    call(py, || {
        let allowed = "\"ccmotion\" and \"strict\"";
        let profile: Profile = named("the profile", profile, allowed)?;
        let representation = BUILT_IN.representation_of(Path::new("motion"), &shape, &values)?;
        if let Some(text) = &thresholds {
            let keys = "docs/config.md lists the keys of `evaluation.thresholds`";
            let unusable = |reason: String| Error::usage(format!("`thresholds`: {reason}"), keys);
            if profile != Profile::Ccmotion || representation.stored_channels() != CHANNELS {
                return Err(unusable(
                    "bounds of the profile \"ccmotion\" of phrases".to_owned(),
                ));
            }
            let bounds: SanityThresholds =
                serde_json::from_str(text).map_err(|error| unusable(error.to_string()))?;
            bounds.validate()?;
            return Ok(json(&check_thresholds(&Phrase::new(values)?, &bounds)));
        }
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
