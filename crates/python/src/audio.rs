//! Audio features of songs.

use std::path::PathBuf;

use kinegrad_audio::{FPS, Features, SAMPLE_RATE};
use kinegrad_data::{
    AUDIO_CHANNELS, AudioFeatures, AudioLayout, audio_channel_name, write_song_features,
};
use kinegrad_train::song::{KnownBeats, song_features};
use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::array;
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
    /// The features, `[163, T]` float32.
    #[getter]
    fn features<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let shape = [AUDIO_CHANNELS, self.stacked.frames()];
        array(py, &shape, self.stacked.as_slice())
    }

    /// Name of each of the 163 features.
    #[getter]
    fn channels(&self) -> Vec<String> {
        (0..AUDIO_CHANNELS).map(audio_channel_name).collect()
    }

    /// Tempo in beats per minute.
    #[getter]
    fn tempo(&self) -> f64 {
        self.features.beats().tempo
    }

    /// Times of the beats in seconds, `[beats]` float64.
    #[getter]
    fn beat_times<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let times = self.features.beats().times();
        array(py, &[times.len()], &times)
    }

    /// Frames per second of the features.
    #[getter]
    fn fps(&self) -> f64 {
        FPS
    }

    /// Length of the song in seconds.
    #[getter]
    fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Writes the `features.npz` that `kinegrad audio features` writes.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        call(py, || {
            Ok(write_song_features(&path, &self.features, &self.stacked)?)
        })
    }
}

/// Decodes the song at `path` and computes the features of the entire song.
#[pyfunction]
pub fn audio_features(py: Python<'_>, path: PathBuf) -> PyResult<SongFeatures> {
    call(py, || {
        let (waveform, features) = song_features(&path, &KnownBeats::default())?;
        Ok(SongFeatures {
            stacked: AudioFeatures::of_song(&features, AudioLayout::CCMOTION, None),
            features,
            seconds: waveform.samples.len() as f64 / f64::from(SAMPLE_RATE),
        })
    })
}
