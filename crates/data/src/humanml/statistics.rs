//! The stored mean and deviation of each channel of a dataset.

use kinegrad_motion::humanml::{Root, Skeleton};
use kinegrad_motion::{JointFeatures, Statistics};

use crate::files::Files;
use crate::magnitude::{allowed, first_unusable};
use crate::{Digest, Error, FileError, npy};

use super::clip::check_width;

const HINT: &str = "without both files the statistics are taken from the training clips";

/// Names of the mean and deviation files for features with this `root`.
fn names(root: Root) -> [&'static str; 2] {
    match root {
        Root::Relative => ["Mean.npy", "Std.npy"],
        Root::Absolute => ["Mean_abs_3d.npy", "Std_abs_3d.npy"],
    }
}

/// Paths and bytes of the mean and deviation files of `statistics`, for clips with this `root`.
pub fn statistics_files(root: Root, statistics: &Statistics) -> [(&'static str, Vec<u8>); 2] {
    let [mean, std] = names(root);
    let bytes = |values: &[f64]| {
        let values: Vec<f32> = values.iter().map(|value| *value as f32).collect();
        npy::array_bytes(&[values.len()], &values)
    };
    [
        (mean, bytes(&statistics.mean)),
        (std, bytes(&statistics.std)),
    ]
}

/// Reads the dataset's statistics for this representation, if any, and the checksums of both files.
/// Fails with [`Error::File`] if one file is missing, or for an invalid shape or number;
/// [`Error::Store`].
pub(super) fn read_stored(
    files: &Files,
    representation: &JointFeatures,
) -> Result<Option<(Statistics, [Digest; 2])>, Error> {
    let JointFeatures { skeleton, root } = representation;
    let [mean_file, std_file] = names(*root);
    let mean = read(files, mean_file, skeleton)?;
    let std = read(files, std_file, skeleton)?;
    let (missing, there) = match mean {
        Some(_) => (std_file, mean_file),
        None => (mean_file, std_file),
    };
    let ((mut mean, mean_digest), (mut std, std_digest)) = match (mean, std) {
        (None, None) => return Ok(None),
        (Some(mean), Some(std)) => (mean, std),
        _ => {
            let missing = files.store.name_of(missing);
            let beside = format!("it beside {there}");
            return Err(FileError::unexpected(missing, "no such file", beside, HINT).into());
        }
    };
    skeleton.layout().statistics_in_metres(&mut mean, &mut std);
    let statistics = Statistics::new(mean, std, Some(*root)).map_err(|error| {
        FileError::unexpected(
            format!("{} and {std_file}", files.store.name_of(mean_file)),
            error,
            "finite means, and deviations greater than 0",
            HINT,
        )
    })?;
    Ok(Some((statistics, [mean_digest, std_digest])))
}

fn read(
    files: &Files,
    path: &str,
    skeleton: &Skeleton,
) -> Result<Option<(Vec<f64>, Digest)>, Error> {
    let Some((bytes, digest)) = files.find(path, 1 << 20)? else {
        return Ok(None);
    };
    let name = files.store.name_of(path);
    let array = npy::parse(&bytes, &name)?;
    check_width(&array.shape, 1, &name, skeleton)?;
    if let Some(channel) = first_unusable(&array.values) {
        let value = array.values[channel];
        let (allowed, _) = allowed(value);
        let channel = skeleton.layout().channel_name(channel);
        let found = format!("{value} in channel {channel}");
        return Err(FileError::unexpected(name, found, allowed, HINT).into());
    }
    let values = array.values.into_iter().map(f64::from).collect();
    Ok(Some((values, digest)))
}
