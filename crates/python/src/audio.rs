//! Audio features of songs.

use std::path::PathBuf;

use kinegrad_audio::{FPS, Features, SAMPLE_RATE};
use kinegrad_data::{AUDIO_CHANNELS, AudioFeatures, audio_channel_name, write_song_features};
use kinegrad_train::song::song_features;
use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::{array, double};
use crate::calls::call;

/// The features of a song.
#[pyclass(frozen, module = "kinegrad")]
pub struct SongFeatures {
    features: Features,
    stacked: AudioFeatures,
    seconds: f64,
}

#[pymethods]
impl SongFeatures {
    #[getter]
    fn features<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let shape = [AUDIO_CHANNELS, self.stacked.frames()];
        array(py, &shape, self.stacked.as_slice())
    }

    #[getter]
    fn channels(&self) -> Vec<String> {
        (0..AUDIO_CHANNELS).map(audio_channel_name).collect()
    }

    #[getter]
    fn tempo(&self) -> f64 {
        self.features.beats().tempo
    }

    #[getter]
    fn beat_times<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let times = self.features.beats().times();
        double(py, &[times.len()], &times)
    }

    #[getter]
    fn fps(&self) -> f64 {
        FPS
    }

    #[getter]
    fn seconds(&self) -> f64 {
        self.seconds
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        call(py, || Ok(write_song_features(&path, &self.features)?))
    }
}

/// Decodes the song at `path` and computes the features of all of it.
#[pyfunction]
pub fn audio_features(py: Python<'_>, path: PathBuf) -> PyResult<SongFeatures> {
    call(py, || {
        let (waveform, features) = song_features(&path)?;
        Ok(SongFeatures {
            stacked: AudioFeatures::from(&features),
            features,
            seconds: waveform.samples.len() as f64 / f64::from(SAMPLE_RATE),
        })
    })
}
