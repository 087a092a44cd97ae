//! Reading and writing BVH files.

use std::path::PathBuf;

use kinegrad_capture::Bvh;
use kinegrad_cli::unusable;
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_train::Error;
use numpy::{PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::prelude::*;

use crate::arrays::{array, shape_and_values};
use crate::calls::call;

/// Positions `[T, J, 3]`, names, parents (-1 for the root) and frames per second.
type ReadBvh<'py> = (Bound<'py, PyArrayDyn<f64>>, Vec<String>, Vec<i64>, f64);

/// Joint positions of a BVH file in meters; the file has `units_per_metre` units per meter.
#[pyfunction]
pub fn read_bvh(py: Python<'_>, path: PathBuf, units_per_metre: f64) -> PyResult<ReadBvh<'_>> {
    let (bvh, positions) = call(py, || {
        if !(units_per_metre.is_finite() && units_per_metre > 0.0) {
            return Err(Error::usage(
                format!("`units_per_metre` is {units_per_metre}"),
                "a positive number: 1 for metres, 100 for centimetres",
            ));
        }
        let bytes = std::fs::read(&path).map_err(Error::io("read", &path))?;
        let bvh = Bvh::parse(&bytes, &path.display().to_string()).map_err(unusable)?;
        let frames = (0..bvh.frames()).flat_map(|t| bvh.world(t));
        let places = frames.flat_map(|pose| pose.position.map(|value| value / units_per_metre));
        let positions: Vec<f64> = places.collect();
        Ok((bvh, positions))
    })?;
    let joints = bvh.joints();
    let parent = |parent: Option<usize>| parent.map_or(-1, |parent| parent as i64);
    Ok((
        array(py, &[bvh.frames(), joints.len(), 3], &positions)?,
        joints.iter().map(|joint| joint.name.clone()).collect(),
        joints.iter().map(|joint| parent(joint.parent)).collect(),
        1.0 / bvh.frame_time(),
    ))
}

/// Writes joint positions `[T, J, 3]` in meters, for HumanML3D's 22 or KIT-ML's 21 joints.
#[pyfunction]
pub fn write_bvh(
    py: Python<'_>,
    path: PathBuf,
    positions: PyReadonlyArrayDyn<'_, f64>,
    units_per_metre: f64,
) -> PyResult<()> {
    let (shape, values) = shape_and_values(&positions);
    call(py, || {
        let joints = joints(&shape, &values)?;
        let skeleton = skeleton_of(&joints)?;
        let bvh = Bvh::from_joints(&joints, &skeleton, units_per_metre).map_err(unusable)?;
        kinegrad_output::write(&path, bvh.to_text().as_bytes()).map_err(Error::io("write", &path))
    })
}

/// Joints of an array.
///
/// # Errors
/// If the array's shape is not `[T, J, 3]`, or a value is not finite.
pub fn joints(shape: &[usize], values: &[f64]) -> Result<Joints, Error> {
    match *shape {
        [_, joints, 3] => {
            let (places, _) = values.as_chunks::<3>();
            Ok(Joints::new(places.to_vec(), joints)?)
        }
        _ => Err(Error::usage(
            format!("positions are of shape {shape:?}"),
            "joint positions are [T, J, 3], in metres",
        )),
    }
}

/// The known skeleton with the given number of joints.
///
/// # Errors
/// If no known skeleton has this number.
pub fn skeleton_of(joints: &Joints) -> Result<Skeleton, Error> {
    let mut known = [Skeleton::humanml3d(), Skeleton::kit()].into_iter();
    let found = known.find(|skeleton| skeleton.joints() == joints.joints());
    found.ok_or_else(|| {
        Error::usage(
            format!("{} joints are of no known skeleton", joints.joints()),
            "HumanML3D has 22 joints, KIT-ML 21",
        )
    })
}
