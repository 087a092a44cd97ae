//! Trained runs and their evaluation.

use std::path::PathBuf;

use kinegrad_cli::{checkpoint, while_it_is_trained};
use kinegrad_systems::BUILT_IN;
use kinegrad_train::evaluation::EvaluationRequest;
use kinegrad_train::{Error, TrainedModel, telemetry};
use pyo3::prelude::*;

use crate::calls::{call, call_with, json};
use crate::errors::named;

/// The checkpoint's path, its step, and its config as JSON, for a run or a checkpoint.
#[pyfunction]
pub fn open_run(py: Python<'_>, path: PathBuf) -> PyResult<(PathBuf, u64, String)> {
    call(py, || {
        while_it_is_trained(|| {
            let found = checkpoint(&path)?;
            let config = BUILT_IN.completed(&found.state.config)?;
            Ok((found.path, found.state.step, json(&config)))
        })
    })
}

/// A step, and its scalars by name.
type Line = (u64, Vec<(String, f64)>);

/// The metrics of the run in `folder`: the step of each line, and the scalars by name.
#[pyfunction]
pub fn read_metrics(py: Python<'_>, folder: PathBuf) -> PyResult<Vec<Line>> {
    let records = call(py, || telemetry::read_metrics(&folder, &mut |_| {}))?;
    let line = |record: &telemetry::Record| (record.step, record.scalars.clone());
    Ok(records.iter().map(line).collect())
}

/// A model and its settings.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Model {
    run: PathBuf,
    settings: Vec<String>,
    weights: String,
    device: Option<String>,
}

impl Model {
    /// Opens a run or checkpoint.
    ///
    /// # Errors
    /// If the checkpoint is missing or damaged, or a setting is invalid.
    pub fn open(&self) -> Result<TrainedModel, Error> {
        let weights = named("`weights`", &self.weights, "\"ema\" and \"model\"")?;
        let saved = checkpoint(&self.run)?;
        BUILT_IN.trained(saved, &self.settings, weights, self.device.as_deref())
    }
}

/// What a model is evaluated on.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct EvaluateRequest {
    source: Option<String>,
    songs: Option<PathBuf>,
    num_samples: Option<usize>,
    num_frames: Option<usize>,
    trajectory_run: Option<PathBuf>,
    audio_ablation: bool,
    seed: u64,
}

impl EvaluateRequest {
    fn request(&self) -> Result<EvaluationRequest, Error> {
        let trajectory = self.trajectory_run.as_deref().map(checkpoint);
        Ok(EvaluationRequest {
            source: self.source.clone(),
            songs: self.songs.clone(),
            num_samples: self.num_samples,
            num_frames: self.num_frames,
            trajectory: trajectory.transpose()?,
            audio_ablation: self.audio_ablation,
            seed: self.seed,
            ..EvaluationRequest::default()
        })
    }
}

/// Evaluates a run and returns the report as JSON.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    model: Model,
    request: EvaluateRequest,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    kinegrad_kernels::memory::keep_freed();
    call_with(py, progress, |progress| {
        while_it_is_trained(|| {
            let trained = model.open()?;
            let prepared = BUILT_IN.evaluate(&trained, &request.request()?)?;
            let evaluated =
                (prepared.evaluate)(&mut |stage, done, all| progress.step(stage, done, all))?;
            Ok(json(&evaluated.json))
        })
    })
}
