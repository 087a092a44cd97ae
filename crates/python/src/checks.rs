//! Sanity checks and post-processing of motion.

use std::path::{Path, PathBuf};

use kinegrad_cli::checkpoint;
use kinegrad_motion::postprocess::{PostProcessConfig, process};
use kinegrad_motion::{
    CHANNELS, Phrase, PostProcessProfile, Profile, SanityThresholds, check_thresholds,
};
use kinegrad_settings::InvalidSetting;
use kinegrad_systems::BUILT_IN;
use kinegrad_train::Error;
use numpy::{PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use serde_json::{Map, Value};

use crate::arrays::{array, shape_and_values};
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

/// The phrase `motion` after post-processing by a profile, of which `settings` as JSON replace keys,
/// with the training statistics of `run`.
#[pyfunction]
pub fn postprocess<'py>(
    py: Python<'py>,
    motion: PyReadonlyArrayDyn<'_, f32>,
    profile: &str,
    settings: &str,
    run: Option<PathBuf>,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let (shape, values) = shape_and_values(&motion);
    let processed = call(py, || {
        let allowed = "\"default\", \"ccmotion\" and \"none\"";
        let profile: PostProcessProfile = named("the profile", profile, allowed)?;
        let representation = BUILT_IN.representation_of(Path::new("motion"), &shape, &values)?;
        if representation.stored_channels() != CHANNELS {
            return Err(Error::usage(
                "post-processing of another motion than a phrase",
                "give an array [T, 25]",
            ));
        }
        let saved = run.as_deref().map(checkpoint).transpose()?;
        let statistics = saved.as_ref();
        let statistics = statistics.map(|saved| saved.state.statistics_of(&*representation));
        let config = changed(profile.into(), settings)?;
        Ok(process(
            &Phrase::new(values)?,
            &config,
            statistics.transpose()?,
        ))
    })?;
    array(py, &shape, processed.as_slice())
}

/// `config` with the keys of `settings`.
fn changed(config: PostProcessConfig, settings: &str) -> Result<PostProcessConfig, Error> {
    let keys = "docs/config.md lists the keys of `evaluation.postprocess`";
    let unusable = |error: serde_json::Error| Error::usage(format!("`settings`: {error}"), keys);
    let mut table = serde_json::to_value(&config).map_err(unusable)?;
    let given: Map<String, Value> = serde_json::from_str(settings).map_err(unusable)?;
    for (key, value) in given {
        match (&mut table[&key], value) {
            (Value::Object(own), Value::Object(inner)) => own.extend(inner),
            (own, value) => *own = value,
        }
    }
    let config: PostProcessConfig = serde_json::from_value(table).map_err(unusable)?;
    let invalid = |error: InvalidSetting| Error::usage(format!("`settings`: {error}"), keys);
    config.validate().map_err(invalid)?;
    Ok(config)
}
