//! Metrics of motion.

use kinegrad_motion::humanml::Joints;
use kinegrad_motion::metrics::{
    self, FeatureMoments, feature_diversity, mean_jerk, skating_ratio, sliding_ratio,
};
use kinegrad_motion::{CHANNELS, Phrase, Statistics};
use kinegrad_train::Error;
use numpy::{PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{array, shape_and_values};
use crate::calls::call;
use crate::skeletons::{joints, skeleton_of};

/// Share of the frames in which a standing foot skates.
#[pyfunction]
pub fn foot_skating(
    py: Python<'_>,
    positions: PyReadonlyArrayDyn<'_, f64>,
    fps: f64,
    feet: Option<Vec<usize>>,
) -> PyResult<Option<f64>> {
    of_feet(py, &positions, feet, |joints, feet| {
        skating_ratio(joints, fps, feet)
    })
}

/// Share of the frames in which a standing foot slides.
#[pyfunction]
pub fn foot_sliding(
    py: Python<'_>,
    positions: PyReadonlyArrayDyn<'_, f64>,
    fps: f64,
    feet: Option<Vec<usize>>,
) -> PyResult<Option<f64>> {
    of_feet(py, &positions, feet, |joints, feet| {
        sliding_ratio(joints, fps, feet)
    })
}

/// A measure of the joints `feet`; the default joints are the toes.
fn of_feet(
    py: Python<'_>,
    positions: &PyReadonlyArrayDyn<'_, f64>,
    feet: Option<Vec<usize>>,
    measure: impl Fn(&Joints, &[usize]) -> Option<f64> + Send + Sync,
) -> PyResult<Option<f64>> {
    let (shape, values) = shape_and_values(positions);
    call(py, || {
        let joints = joints(&shape, &values)?;
        let feet = match feet {
            Some(feet) => feet,
            // The toes: the second contact of each foot.
            None => {
                let [_, left, _, right] = skeleton_of(&joints)?.contact_joints();
                vec![left, right]
            }
        };
        if let Some(foot) = feet.iter().find(|foot| **foot >= joints.joints()) {
            return Err(Error::usage(
                format!("`feet` names joint {foot} of {} joints", joints.joints()),
                "give the indices of the toes",
            ));
        }
        Ok(measure(&joints, &feet))
    })
}

/// Mean norm of the third derivative of joint positions.
#[pyfunction]
pub fn jerk(
    py: Python<'_>,
    positions: PyReadonlyArrayDyn<'_, f64>,
    fps: f64,
) -> PyResult<Option<f64>> {
    let (shape, values) = shape_and_values(&positions);
    call(py, || Ok(mean_jerk(&joints(&shape, &values)?, fps)))
}

/// Means and deviations of the trajectory channels of a phrase `[T, 25]`, in units of `std`.
#[pyfunction]
pub fn trajectory_features<'py>(
    py: Python<'py>,
    motion: PyReadonlyArrayDyn<'py, f32>,
    std: Vec<f64>,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let phrase = phrase(&motion);
    let features = call(py, || {
        if std.len() != CHANNELS {
            return Err(Error::usage(
                format!("`std` has {} values", std.len()),
                format!("a phrase has {CHANNELS} channels"),
            ));
        }
        let training = Statistics {
            std,
            ..Statistics::unit(CHANNELS)
        };
        Ok(metrics::trajectory_features(&phrase?, &training))
    })?;
    array(py, &[features.len()], &features)
}

/// Mean distance of pairs of feature vectors `[n, features]`.
#[pyfunction]
pub fn diversity(
    py: Python<'_>,
    features: PyReadonlyArrayDyn<'_, f64>,
    pairs: usize,
    seed: u64,
) -> PyResult<Option<f64>> {
    let features = vectors(&features);
    call(py, || Ok(feature_diversity(&features?, pairs, seed)))
}

/// The squared Fréchet distance of two sets of feature vectors `[n, features]`.
#[pyfunction]
pub fn frechet_distance(
    py: Python<'_>,
    a: PyReadonlyArrayDyn<'_, f64>,
    b: PyReadonlyArrayDyn<'_, f64>,
) -> PyResult<Option<f64>> {
    let (a, b) = (vectors(&a), vectors(&b));
    call(py, || {
        let (a, b) = (a?, b?);
        let widths = [&a, &b].map(|set| set.first().map(Vec::len));
        if let [Some(left), Some(right)] = widths
            && left != right
        {
            return Err(Error::usage(
                format!("one set has {left} features, the other {right}"),
                "both are [n, features] with the same features",
            ));
        }
        let moments = FeatureMoments::compute(&a).zip(FeatureMoments::compute(&b));
        Ok(moments.map(|(a, b)| metrics::frechet_distance(&a, &b)))
    })
}

/// Times in seconds of local minima of the root's speed in a phrase `[T, 25]`.
#[pyfunction]
pub fn kinematic_beats<'py>(
    py: Python<'py>,
    motion: PyReadonlyArrayDyn<'py, f32>,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let phrase = phrase(&motion);
    let beats = call(py, || Ok(metrics::kinematic_beats(&phrase?)))?;
    array(py, &[beats.len()], &beats)
}

/// Agreement of the beats of motion with those of music, both in seconds.
#[pyfunction]
pub fn beat_alignment(kinematic: Vec<f64>, music: Vec<f64>) -> Option<f64> {
    metrics::beat_alignment(&kinematic, &music)
}

fn phrase(motion: &PyReadonlyArrayDyn<'_, f32>) -> Result<Phrase, Error> {
    let (shape, values) = shape_and_values(motion);
    match *shape {
        [frames, CHANNELS] if frames > 0 => Ok(Phrase::new(values)?),
        _ => Err(Error::usage(
            format!("the motion is of shape {shape:?}"),
            format!("a phrase is [T, {CHANNELS}]"),
        )),
    }
}

fn vectors(features: &PyReadonlyArrayDyn<'_, f64>) -> Result<Vec<Vec<f64>>, Error> {
    let (shape, values) = shape_and_values(features);
    match *shape {
        [_, width] if width > 0 => Ok(values.chunks_exact(width).map(<[f64]>::to_vec).collect()),
        _ => Err(Error::usage(
            format!("the features are of shape {shape:?}"),
            "feature vectors are [n, features]",
        )),
    }
}
