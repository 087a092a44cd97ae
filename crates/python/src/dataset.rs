//! Datasets and the stream of training batches.

use std::mem;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use kinegrad_cli::checkpoint;
use kinegrad_data::humanml::{CaptionLabels, CaptionText, Clip, ClipSamples};
use kinegrad_data::{Alone, Batch, DataConfig, DataKind, Item, ItemSet, Loader};
use kinegrad_data::{PhraseItem, PhraseSamples};
use kinegrad_gmd::{GmdConfig, channels_of};
use kinegrad_motion::{CHANNELS, Representation, Statistics};
use kinegrad_systems::BUILT_IN;
use kinegrad_train::Error;
use kinegrad_train::checkpoint::State;
use kinegrad_train::config::Config;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::array;
use crate::calls::{call, json, until_interrupted};

/// One split of a dataset, kept open.
#[pyclass(frozen, module = "kinegrad._kinegrad")]
pub struct Dataset {
    config: Config,
    items: Items,
    statistics: Arc<Statistics>,
    warnings: Vec<String>,
}

/// The items of a split.
enum Items {
    Phrases(ItemSet<PhraseItem>),
    Clips(Box<Clips>),
}

/// Both splits of a dataset.
type Opened<T> = kinegrad_data::Dataset<T>;

/// The clips of a split, with their dataset.
struct Clips {
    dataset: Opened<Clip>,
    items: ItemSet<Clip>,
    /// The labels of the model; `None` if captions are not labels.
    labels: Option<CaptionLabels>,
}

#[pymethods]
impl Dataset {
    /// Opens the dataset of a `source` (a config file or an address), or of a `run`.
    #[new]
    fn new(
        py: Python<'_>,
        source: Option<String>,
        run: Option<PathBuf>,
        settings: Vec<String>,
        split: &str,
    ) -> PyResult<Self> {
        call(py, || {
            Self::open(source.as_deref(), run.as_deref(), &settings, split)
        })
    }

    fn __len__(&self) -> usize {
        match &self.items {
            Items::Phrases(items) => items.len(),
            Items::Clips(clips) => clips.items.len(),
        }
    }

    /// The ids of the items, in order.
    fn ids(&self) -> Vec<String> {
        match &self.items {
            Items::Phrases(items) => items.ids().map(String::from).collect(),
            Items::Clips(clips) => clips.items.ids().map(String::from).collect(),
        }
    }

    /// The `data` table as JSON.
    #[getter]
    fn config(&self) -> String {
        json(&self.config.data)
    }

    #[getter]
    fn seed(&self) -> u64 {
        self.config.run.seed
    }

    #[getter]
    fn fps(&self) -> f64 {
        match &self.items {
            Items::Phrases(_) => kinegrad_motion::FPS,
            Items::Clips(clips) => clips.dataset.representation.fps(),
        }
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }

    /// Mean and standard deviation of each channel, for normalizing the batches.
    fn statistics(&self) -> (Vec<f64>, Vec<f64>) {
        (self.statistics.mean.clone(), self.statistics.std.clone())
    }

    /// Item `position` as a dictionary of arrays.
    fn item<'py>(&self, py: Python<'py>, position: usize) -> PyResult<Bound<'py, PyDict>> {
        let item = PyDict::new(py);
        match &self.items {
            Items::Phrases(items) => {
                let phrase = call(py, || Ok(items.get(position)?))?;
                let frames = phrase.frames();
                item.set_item("id", &phrase.id)?;
                let rows = array(py, &[frames, CHANNELS], phrase.motion.as_slice())?;
                item.set_item("motion", rows)?;
                let shape = [phrase.audio.channels(), frames];
                item.set_item("audio", array(py, &shape, phrase.audio.as_slice())?)?;
            }
            Items::Clips(clips) => {
                let Clips { dataset, items, .. } = &**clips;
                let clip = call(py, || Ok(items.get(position)?))?;
                let rows = clip.rows(&dataset.representation);
                let shape = [clip.frames(), dataset.representation.channels()];
                item.set_item("id", &clip.id)?;
                item.set_item("motion", array(py, &shape, &rows)?)?;
                let texts: Vec<&str> = clip.captions.iter().map(|c| c.text.as_str()).collect();
                item.set_item("captions", texts)?;
            }
        }
        Ok(item)
    }

    /// The stream of batches, starting at batch `first`.
    fn batches(
        &self,
        py: Python<'_>,
        seed: u64,
        batch_size: Option<usize>,
        num_workers: usize,
        first: u64,
    ) -> PyResult<Batches> {
        call(py, || {
            let mut data = self.config.data.clone();
            data.batch_size = batch_size.unwrap_or(data.batch_size);
            data.num_workers = num_workers;
            data.validate()?;
            if self.__len__() == 0 {
                return Err(Error::usage(
                    "the split is empty: it has no batches",
                    "set `data.validation`, which selects the held-out items",
                ));
            }
            Ok(Batches(Mutex::new(self.loader(&data, seed, first))))
        })
    }
}

impl Dataset {
    fn open(
        source: Option<&str>,
        run: Option<&Path>,
        settings: &[String],
        split: &str,
    ) -> Result<Self, Error> {
        let state = run.map(checkpoint).transpose()?.map(|saved| saved.state);
        let config = match (&state, source) {
            (Some(state), _) => BUILT_IN.completed(&state.config)?,
            (None, Some(source)) => config_of(source, settings)?,
            (None, None) => BUILT_IN.parse("", "the settings", settings)?,
        };
        let trains = match split {
            "train" => true,
            "validation" => false,
            _ => {
                return Err(Error::usage(
                    format!("`split` is \"{split}\""),
                    "\"train\" and \"validation\" are allowed",
                ));
            }
        };
        let progress = until_interrupted();
        match config.data.kind {
            DataKind::Phrases | DataKind::Synthetic => {
                let dataset = Opened::<PhraseItem>::open_among(&config.data, &*progress, &Alone)?;
                let statistics = statistics_of(&dataset, state.as_ref())?;
                Ok(Self {
                    config,
                    statistics,
                    warnings: dataset.warnings,
                    items: Items::Phrases(match trains {
                        true => dataset.train,
                        false => dataset.validation,
                    }),
                })
            }
            DataKind::Humanml3d | DataKind::SyntheticWalks => {
                let dataset = Opened::<Clip>::open_among(&config.data, &*progress, &Alone)?;
                let statistics = statistics_of(&dataset, state.as_ref())?;
                let items = match trains {
                    true => dataset.train.clone(),
                    false => dataset.validation.clone(),
                };
                let labels = labels_of(&config, &dataset)?;
                Ok(Self {
                    config,
                    statistics,
                    warnings: dataset.warnings.clone(),
                    items: Items::Clips(Box::new(Clips {
                        dataset,
                        items,
                        labels,
                    })),
                })
            }
        }
    }

    /// The stream of training batches on this split.
    fn loader(&self, data: &DataConfig, seed: u64, first: u64) -> Loader {
        let statistics = self.statistics.clone();
        match &self.items {
            Items::Phrases(items) => {
                let samples = PhraseSamples::new(items.clone(), statistics, data, seed);
                Loader::new(samples, data, seed, first)
            }
            Items::Clips(clips) => {
                let Clips {
                    dataset,
                    items,
                    labels,
                } = &**clips;
                let representation = dataset.representation.clone();
                // All channels without a recipe of clips.
                let channels = match self.config.system.get::<GmdConfig>() {
                    Some(_) => channels_of(&self.config),
                    None => representation.channels(),
                };
                let mut samples = ClipSamples::new(
                    items.clone(),
                    representation,
                    statistics,
                    channels,
                    data,
                    seed,
                );
                if let Some(labels) = labels {
                    samples = samples.with_labels(labels.clone());
                }
                Loader::new(samples, data, seed, first)
            }
        }
    }
}

/// The labels of a model of `config`, if captions are labels. The config's labels take precedence
/// over the training clips' labels.
fn labels_of(config: &Config, dataset: &Opened<Clip>) -> Result<Option<CaptionLabels>, Error> {
    if config.data.humanml3d.text != CaptionText::Labels {
        return Ok(None);
    }
    let own = config.system.get::<GmdConfig>();
    let mut captions = own.map_or(Vec::new(), |own| own.text.captions.clone());
    if captions.is_empty() {
        let progress = until_interrupted();
        let found = dataset.train.captions_among(&*progress, &Alone)?;
        captions = found.into_keys().collect();
    }
    Ok(Some(CaptionLabels::new(captions)))
}

/// The statistics for normalizing the batches: the run's statistics, or the dataset's without a
/// run.
fn statistics_of<T: Item>(
    dataset: &Opened<T>,
    state: Option<&State>,
) -> Result<Arc<Statistics>, Error> {
    Ok(Arc::new(match state {
        Some(state) => state.statistics_of(&dataset.representation)?.clone(),
        None => dataset.statistics_among(&*until_interrupted(), &Alone)?,
    }))
}

/// The config in a file, or a config for the dataset at an address, with the defaults of the
/// dataset's kind.
fn config_of(source: &str, settings: &[String]) -> Result<Config, Error> {
    if source.ends_with(".toml") {
        return Ok(BUILT_IN.load(Path::new(source), settings)?);
    }
    let mut overrides = vec![format!("data.source={}", json(&source))];
    let clips = Path::new(source).join("new_joint_vecs").is_dir();
    let recipe = match clips {
        true => "[train]\nrecipe = \"gmd_motion\"\n",
        false => "",
    };
    overrides.extend_from_slice(settings);
    Ok(BUILT_IN.parse(recipe, source, &overrides)?)
}

/// The endless stream of training batches.
#[pyclass(frozen, module = "kinegrad._kinegrad")]
pub struct Batches(Mutex<Loader>);

#[pymethods]
impl Batches {
    /// The next batch as a dictionary of arrays.
    fn next_batch<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let batch = call(py, || {
            let mut loader = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            Ok(loader.next()?)
        })?;
        dictionary(py, &batch)
    }
}

fn dictionary<'py>(py: Python<'py>, batch: &Batch) -> PyResult<Bound<'py, PyDict>> {
    let found = PyDict::new(py);
    let Batch {
        batch_size,
        channels,
        frames,
        ..
    } = *batch;
    found.set_item("ids", &batch.ids)?;
    let motion = array(py, &[batch_size, channels, frames], &batch.x_start)?;
    found.set_item("motion", motion)?;
    for condition in &batch.conditions {
        let shape = [batch_size, condition.channels, condition.frames];
        found.set_item(condition.name, array(py, &shape, &condition.values)?)?;
    }
    found.set_item("mask", array(py, &[batch_size, frames], &batch.mask)?)?;
    Ok(found)
}

/// Leaks an object that a fork inherited: dropping it would wait for threads that only the parent
/// process has.
#[pyfunction]
pub fn abandon(object: Py<PyAny>) {
    mem::forget(object);
}
