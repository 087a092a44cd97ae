//! The Python module `kinegrad._kinegrad`. The Python package `kinegrad`, in `python/kinegrad`, is
//! a thin layer over this module. Plain data is passed as JSON, motion as NumPy arrays.
#![recursion_limit = "256"]
// An error moves once, at the end of a call, so the size of errors does not matter.
#![allow(clippy::result_large_err)]

mod arrays;
mod audio;
mod calls;
mod checks;
mod command;
mod dataset;
mod errors;
mod metrics;
mod runs;
mod sampling;
mod skeletons;
mod threads;
mod training;

use pyo3::pymodule;

#[pymodule]
mod _kinegrad {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::audio::{SongFeatures, audio_features};
    #[pymodule_export]
    use super::checks::{check, postprocess};
    #[pymodule_export]
    use super::command::main;
    #[pymodule_export]
    use super::dataset::{Batches, Dataset, abandon};
    #[pymodule_export]
    use super::metrics::{
        beat_alignment, diversity, foot_skating, foot_sliding, frechet_distance, jerk,
        kinematic_beats, trajectory_features,
    };
    #[pymodule_export]
    use super::runs::{evaluate, open_run, read_metrics};
    #[pymodule_export]
    use super::sampling::{Sample, sample};
    #[pymodule_export]
    use super::skeletons::{read_bvh, write_bvh};
    #[pymodule_export]
    use super::training::train;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::threads::remember_process();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
