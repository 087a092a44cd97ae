//! Mean and deviation of each channel that a dataset brings along.

use kinegrad_motion::humanml::{Root, Skeleton};
use kinegrad_motion::{JointFeatures, Statistics};

use crate::files::Files;
use crate::listing::Expected;
use crate::{Digest, Error, FileError, StoreError, npy};

use super::clip::check_width;

/// The statistics that a dataset brings along.
pub(super) struct Given {
    pub statistics: Statistics,
    /// Checksums of both files.
    pub digests: [Digest; 2],
}

/// The files of mean and deviation for features with this `root`.
fn names(root: Root) -> [&'static str; 2] {
    match root {
        Root::Relative => ["Mean.npy", "Std.npy"],
        Root::Absolute => ["Mean_abs_3d.npy", "Std_abs_3d.npy"],
    }
}

/// Reads the statistics of clips in this representation, if the dataset has them.
///
/// # Errors
/// [`Error::File`] for one file without the other, for another layout, and for numbers that cannot
/// be used; [`Error::Store`].
pub(super) fn given(files: &Files, representation: &JointFeatures) -> Result<Option<Given>, Error> {
    let JointFeatures { skeleton, root } = representation;
    let [mean_file, std_file] = names(*root);
    let (mean, std) = (
        read(files, mean_file, skeleton)?,
        read(files, std_file, skeleton)?,
    );
    let (there, missing) = match (&mean, &std) {
        (None, None) => return Ok(None),
        (Some(_), Some(_)) => ("", ""),
        (Some(_), None) => (mean_file, std_file),
        (None, Some(_)) => (std_file, mean_file),
    };
    let (Some((mean, mean_digest)), Some((std, std_digest))) = (mean, std) else {
        return Err(FileError::unexpected(
            files.store.name_of(missing),
            "no such file",
            format!("it beside {there}"),
            "without both of them the statistics are taken from the training clips",
        )
        .into());
    };
    let statistics = Statistics::new(mean, std, Some(*root)).map_err(|error| {
        FileError::unexpected(
            format!("{} and {std_file}", files.store.name_of(mean_file)),
            error.to_string(),
            "finite means, and deviations greater than 0",
            "without both files the statistics are taken from the training clips",
        )
    })?;
    Ok(Some(Given {
        statistics,
        digests: [mean_digest, std_digest],
    }))
}

fn read(
    files: &Files,
    path: &str,
    skeleton: &Skeleton,
) -> Result<Option<(Vec<f64>, Digest)>, Error> {
    let unknown = Expected::Version(String::new());
    let (bytes, digest) = match files.read(path, &unknown, 1 << 20, "") {
        Err(StoreError::Missing { .. }) => return Ok(None),
        read => read?,
    };
    let name = files.store.name_of(path);
    let array = npy::parse(&bytes, &name)?;
    check_width(&array.shape, 1, &name, skeleton)?;
    let values = array.values.into_iter().map(f64::from).collect();
    Ok(Some((values, digest)))
}
