//! Reading and writing of `.npy` arrays. The size of allocations never depends on a header alone.

use std::path::Path;

use kinegrad_motion::{MAX_FRAMES, Phrase, phrase::CHANNELS};

use crate::file::read_file;
use crate::{Error, FileError, atomic};

mod header;
mod pickle;
mod results;

use header::{Dtype, MAX_HEADER_BYTES};
pub use results::{MotionFile, Results};

/// Hint for a truncated file.
pub(crate) const CUT_OFF: &str = "the file is damaged or was cut off: copy or export it again";

/// An array in C order.
#[derive(Debug, PartialEq)]
pub struct Array {
    /// Length of each axis.
    pub shape: Vec<usize>,
    /// Values, last axis fastest.
    pub values: Vec<f32>,
}

/// Reads the array of float32 or float64 numbers in the `.npy` file at `path`. Fails with
/// [`FileError`] for an unreadable file or another kind of array.
pub fn read_array(path: &Path) -> Result<Array, FileError> {
    let bytes = read_file(path, MAX_ARRAY_BYTES).map_err(FileError::read(path))?;
    parse(&bytes, &path.display().to_string())
}

/// Writes an array of this shape as little-endian float32, atomically. Fails with [`Error::Io`].
pub fn write_values(path: &Path, shape: &[usize], values: &[f32]) -> Result<(), Error> {
    atomic::write(path, &array_bytes(shape, values))
}

/// Largest file of a general array: 4096 x 4096 numbers and a header.
const MAX_ARRAY_BYTES: u64 = 8 * 4096 * 4096 + MAX_HEADER_BYTES as u64;

/// Largest motion file.
pub(crate) const MAX_MOTION_BYTES: u64 = max_bytes(CHANNELS);

/// Largest file of an array with `rows` values per frame.
pub(crate) const fn max_bytes(rows: usize) -> u64 {
    (rows * MAX_FRAMES * 8 + MAX_HEADER_BYTES + 12) as u64
}

/// Reads a motion: `[frames, 25]`, at least two frames. Fails with [`FileError`] for an unreadable
/// or truncated file, and for another dtype or shape. Accepts values that are not finite.
pub fn read_motion(path: &Path) -> Result<Phrase, FileError> {
    let bytes = read_file(path, MAX_MOTION_BYTES).map_err(FileError::read(path))?;
    parse_motion(&bytes, &path.display().to_string())
}

/// Parses the bytes of a motion's `.npy` file; `file` names the file in errors. Fails as
/// [`read_motion`].
pub fn parse_motion(bytes: &[u8], file: &str) -> Result<Phrase, FileError> {
    let array = parse(bytes, file)?;
    let shape = array.shape;
    let refused = || {
        let allowed = format!("[frames, {CHANNELS}] with 2 to {MAX_FRAMES} frames");
        FileError::shape(file, &shape, allowed)
    };
    match shape[..] {
        [frames, CHANNELS] if (2..=MAX_FRAMES).contains(&frames) => {
            Phrase::new(array.values).map_err(|_| refused())
        }
        _ => Err(refused()),
    }
}

/// Writes `motion` as `[frames, 25]` little-endian float32, atomically. Fails with [`Error::Io`].
pub fn write_motion(path: &Path, motion: &Phrase) -> Result<(), Error> {
    atomic::write(path, &motion_bytes(motion))
}

/// The bytes of the `.npy` file of `motion`.
pub fn motion_bytes(motion: &Phrase) -> Vec<u8> {
    array_bytes(&[motion.frames(), CHANNELS], motion.as_slice())
}

/// The bytes of the `.npy` file of `values` in this `shape`.
pub(crate) fn array_bytes(shape: &[usize], values: &[f32]) -> Vec<u8> {
    let mut bytes = header::write(shape);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// True for the bytes of a `.npy` file.
pub(crate) fn is_array(bytes: &[u8]) -> bool {
    bytes.starts_with(header::MAGIC)
}

/// Parses the bytes of a `.npy` file; `file` names the file in errors. Fails with [`FileError`] if
/// the bytes are not an array of float32 or float64 numbers.
pub fn parse(bytes: &[u8], file: &str) -> Result<Array, FileError> {
    let mut values = Vec::new();
    let shape = parse_onto(&mut values, bytes, file)?;
    Ok(Array { shape, values })
}

/// Parses the bytes of a `.npy` file, appends the values to `values` and returns the shape.
pub(crate) fn parse_onto(
    values: &mut Vec<f32>,
    bytes: &[u8],
    file: &str,
) -> Result<Vec<usize>, FileError> {
    let header = header::read(bytes, file)?;
    let shape = header.shape;
    let double = match header.dtype {
        Dtype::Single => false,
        Dtype::Double => true,
        Dtype::Objects => {
            let problem = "dtype '|O' found: Python objects, not numbers";
            let hint = "`kinegrad warp`, `view` and `check` read the results.npy of MDM and FlowMDM; store \
                        others with numpy.save(path, array.astype(\"<f4\"))";
            return Err(FileError::unusable(file, problem, hint));
        }
    };
    let data = &bytes[header.data_start..];
    let needed = header.length.saturating_mul(if double { 8 } else { 4 });
    if data.len() as u64 != needed {
        let found = data.len();
        let problem =
            format!("{found} bytes of data found, {needed} needed for its shape and dtype");
        return Err(FileError::unusable(file, problem, CUT_OFF));
    }
    if header.fortran_order && shape.len() > 1 {
        let mut stored = Vec::new();
        decode(&mut stored, data, double);
        values.extend(in_c_order(stored, &shape, true));
    } else {
        decode(values, data, double);
    }
    Ok(shape)
}

/// The elements of an array in C order.
fn in_c_order(stored: Vec<f32>, shape: &[usize], fortran_order: bool) -> Vec<f32> {
    match fortran_order && shape.len() > 1 && !stored.is_empty() {
        true => {
            let places = column_major(shape).take(stored.len());
            places.map(|at| stored[at]).collect()
        }
        false => stored,
    }
}

/// Indices in Fortran order of the elements of an array in C order, over and over.
fn column_major(shape: &[usize]) -> impl Iterator<Item = usize> {
    // Length and stride of each axis, and the index along it. Without axes of length 1, a step
    // changes two indices on average.
    let mut stride = 1;
    let axes = shape.iter().map(|&length| {
        stride *= length;
        (length, stride / length, 0)
    });
    let mut axes: Vec<(usize, usize, usize)> = axes.filter(|(length, ..)| *length > 1).collect();
    let mut next = 0;
    std::iter::repeat_with(move || {
        let place = next;
        for (length, stride, index) in axes.iter_mut().rev() {
            *index += 1;
            next += *stride;
            if *index < *length {
                break;
            }
            next -= *length * *stride;
            *index = 0;
        }
        place
    })
}

/// Appends the little-endian numbers of `data`.
fn decode(values: &mut Vec<f32>, data: &[u8], double: bool) {
    match double {
        true => values.extend(numbers(data, |bytes| f64::from_le_bytes(bytes) as f32)),
        false => values.extend(numbers(data, f32::from_le_bytes)),
    }
}

/// The numbers of `data`, each of `N` bytes.
pub(crate) fn numbers<const N: usize>(
    data: &[u8],
    number: impl Fn([u8; N]) -> f32,
) -> impl Iterator<Item = f32> {
    let (numbers, _) = data.as_chunks();
    numbers.iter().map(move |&bytes| number(bytes))
}

#[cfg(test)]
pub(crate) mod tests;
