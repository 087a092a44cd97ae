//! Sampling from trained runs.

use std::path::PathBuf;
use std::sync::Arc;

use kinegrad_cli::{ConditionArguments, Files, bvh_text, must_be_finite, while_it_is_trained};
use kinegrad_motion::PostProcessProfile;
use kinegrad_systems::BUILT_IN;
use kinegrad_train::sampling::{self, BestOf, Contents, Request, SampleSink, SelectBy};
use kinegrad_train::{Error, Reading};
use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::array;
use crate::calls::{Progress, call, call_with, json, until_interrupted};
use crate::errors::named;
use crate::runs::Model;

/// The conditions of samples, and their number.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct SampleRequest {
    source: Option<String>,
    item: Option<String>,
    audio_features: Option<PathBuf>,
    audio: Option<PathBuf>,
    start: f64,
    goal: Vec<PathBuf>,
    trajectory_run: Option<PathBuf>,
    text: Option<String>,
    text_encoder: Option<PathBuf>,
    text_embedding: Option<String>,
    history: Option<PathBuf>,
    prompts: Option<PathBuf>,
    path: Option<PathBuf>,
    metres_per_unit: Option<f64>,
    held_out: Option<usize>,
    count: usize,
    frames: Option<usize>,
    seconds: Option<f64>,
    seed: u64,
    continue_from: Option<PathBuf>,
    keep: Option<String>,
    keep_from: Option<PathBuf>,
    postprocess: String,
    best_of: Option<usize>,
    select_by: Vec<String>,
    style: Option<String>,
}

impl SampleRequest {
    fn request(&self) -> Result<Request, Error> {
        let conditions = ConditionArguments {
            source: self.source.clone(),
            item: self.item.clone(),
            audio_features: self.audio_features.clone(),
            audio: self.audio.clone(),
            start: self.start,
            goal: self.goal.clone(),
            trajectory_run: self.trajectory_run.clone(),
            text: self.text.clone(),
            text_encoder: self.text_encoder.clone(),
            text_embedding: self.text_embedding.clone(),
            prompts: self.prompts.clone(),
            history: self.history.clone(),
            path: self.path.clone(),
            metres_per_unit: self.metres_per_unit,
            style: self.style.clone(),
            continue_from: self.continue_from.clone(),
            keep: self.keep.clone(),
            keep_from: self.keep_from.clone(),
            held_out: self.held_out,
            ..ConditionArguments::default()
        };
        let history_joints = conditions.history_joints()?;
        let conditions = conditions.conditions()?;
        let allowed = "\"default\", \"ccmotion\" and \"none\"";
        let profile = named("`postprocess`", &self.postprocess, allowed)?;
        let names = SelectBy::ALL.map(|by| format!("\"{}\"", by.name()));
        let names = names.join(", ");
        let by = self.select_by.iter();
        let by = by.map(|name| named("`select_by`", name, &names));
        let by: Vec<SelectBy> = by.collect::<Result<_, _>>()?;
        Ok(Request {
            conditions,
            history_joints,
            count: self.count,
            frames: self.frames,
            seconds: self.seconds,
            seed: self.seed,
            post_processing: Some(profile).filter(|own| *own != PostProcessProfile::Default),
            best_of: self.best_of.map(|count| BestOf { count, by }),
        })
    }
}

/// A sample.
#[pyclass(frozen, module = "kinegrad._kinegrad")]
pub struct Sample(Arc<sampling::Sample>);

/// The ending of an array's file, and the array.
type NamedArray<'a, 'py> = (&'a str, Bound<'py, PyArrayDyn<f32>>);

#[pymethods]
impl Sample {
    /// The sample's name, unique in the call.
    #[getter]
    fn name(&self) -> String {
        self.0.name.clone()
    }

    /// The sample's record, as JSON.
    #[getter]
    fn record(&self) -> String {
        json(&self.0.record)
    }

    /// The sample's arrays by file ending; the ending of the motion is `.npy`.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Vec<NamedArray<'_, 'py>>> {
        let arrays = self.0.files.iter().filter_map(|(ending, contents)| {
            let Contents::Array { shape, values } = contents else {
                return None;
            };
            Some(array(py, shape, values).map(|array| (*ending, array)))
        });
        arrays.collect()
    }

    /// The text of the sample's BVH file; `None` without a BVH file.
    fn bvh(&self, py: Python<'_>) -> PyResult<Option<String>> {
        call(py, || {
            let mut files = self.0.files.iter();
            let text = files.find_map(|(_, contents)| match contents {
                Contents::Body { joints, skeleton } => Some(bvh_text(joints, skeleton)),
                Contents::Array { .. } => None,
            });
            text.transpose()
        })
    }

    /// Writes the same files as `kinegrad sample --out PREFIX`, and returns their paths.
    fn save(&self, py: Python<'_>, prefix: PathBuf, overwrite: bool) -> PyResult<Vec<PathBuf>> {
        call(py, || {
            let files = Files::new(&prefix, true)?;
            let path = files.motion_path(&self.0);
            if !overwrite && path.exists() {
                return Err(Error::usage(
                    format!("{} exists already", path.display()),
                    "`overwrite=True` replaces it; or choose another prefix",
                ));
            }
            files.write(&self.0)
        })
    }
}

/// Collects samples.
struct Collector<'a> {
    progress: &'a mut Progress,
    ended: bool,
    samples: Vec<Sample>,
}

impl SampleSink for Collector<'_> {
    fn stepped(&mut self, stage: &'static str, done: usize, all: usize) {
        self.ended |= self.progress.step(stage, done, all).is_break();
    }

    fn warning(&mut self, text: &str) {
        self.ended |= self.progress.warn(text).is_break();
    }

    fn reading(&self) -> Box<Reading> {
        until_interrupted()
    }

    fn stop_requested(&self) -> bool {
        self.ended
    }

    fn sample(&mut self, sample: sampling::Sample) -> Result<(), Error> {
        must_be_finite(&sample, "")?;
        self.samples.push(Sample(Arc::new(sample)));
        Ok(())
    }
}

/// Samples a model.
#[pyfunction]
pub fn sample(
    py: Python<'_>,
    model: Model,
    request: SampleRequest,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<Sample>> {
    kinegrad_kernels::memory::keep_freed();
    call_with(py, progress, |progress| {
        while_it_is_trained(|| {
            let request = request.request()?;
            let trained = model.open()?;
            let mut collector = Collector {
                progress: &mut *progress,
                ended: false,
                samples: Vec::new(),
            };
            BUILT_IN.sample(&trained, &request, &mut collector)?;
            Ok(collector.samples)
        })
    })
}
