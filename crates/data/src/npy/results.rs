//! Results of other programs: a dictionary that NumPy pickled, with the arrays `motion` and
//! `lengths`, as the programs of MDM and FlowMDM write.

use std::path::Path;

use super::pickle::{Pickle, Place, Value};
use super::{Array, CUT_OFF, MAX_ARRAY_BYTES, decode, header, in_c_order, parse};
use crate::FileError;
use crate::file::read_file;

/// Motions of another program.
#[derive(Debug, PartialEq)]
pub struct Results {
    /// Joint positions, `[motions, joints, 3, frames]`.
    pub motion: Array,
    /// Frames of each motion; the rest is padding.
    pub lengths: Option<Vec<usize>>,
}

/// The contents of a `.npy` file of motion.
#[derive(Debug, PartialEq)]
pub enum MotionFile {
    /// An array of numbers.
    Array(Array),
    /// A pickled dictionary of motions.
    Results(Results),
}

impl MotionFile {
    /// Reads the array, or the dictionary, in the `.npy` file at `path`. Nothing in the file is
    /// executed. Fails with [`FileError`] for an unreadable file or other contents.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let bytes = read_file(path, MAX_ARRAY_BYTES).map_err(FileError::read(path))?;
        Self::parse(&bytes, &path.display().to_string())
    }

    /// Parses the bytes of a file; `file` names the file in errors. Fails as [`read`](Self::read).
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, FileError> {
        let header = header::read(bytes, file)?;
        match header.dtype {
            header::Dtype::Objects => {
                let results = results(&bytes[header.data_start..]);
                let refused = |problem: String| FileError::unusable(file, problem, HINT);
                results.map(Self::Results).map_err(refused)
            }
            _ => parse(bytes, file).map(Self::Array),
        }
    }
}

/// Hint for dictionaries without motions.
const HINT: &str = "a dictionary with the array `motion` of [motions, joints, 3, frames], as the \
                    programs of MDM and FlowMDM save, is read; store others as an array with \
                    numpy.save(\"clip.npy\", joints.astype(\"<f4\")), of [frames, joints, 3]";

fn results(bytes: &[u8]) -> Result<Results, String> {
    let pickle = Pickle::parse(bytes)?;
    let root = pickle.ndarray(pickle.root)?;
    let Data::Objects([only]) = root.data else {
        return Err("its objects are not one dictionary".to_owned());
    };
    let Value::Dict(entries) = pickle.at(*only) else {
        return Err("its object is not a dictionary".to_owned());
    };
    let entry = |name: &str| {
        let mut named = entries.iter();
        let named =
            named.rfind(|[key, _]| matches!(pickle.at(*key), Value::Text(key) if *key == name));
        named.map(|[_, value]| *value)
    };
    let Some(motion) = entry("motion") else {
        let names = entries.iter().filter_map(|[key, _]| match pickle.at(*key) {
            Value::Text(key) => Some(*key),
            _ => None,
        });
        let names: Vec<&str> = names.take(10).collect();
        return Err(format!(
            "its dictionary has no `motion`, but: {}",
            names.join(", ")
        ));
    };
    let within = |name: &'static str| move |reason: String| format!("`{name}`: {reason}");
    let mut motion = pickle.floats(motion).map_err(within("motion"))?;
    if let [joints, 3, frames] = motion.shape[..] {
        motion.shape = vec![1, joints, 3, frames];
    }
    let [count, joints, 3, frames] = motion.shape[..] else {
        return Err(format!("`motion` has shape {:?}", motion.shape));
    };
    if count * joints * frames == 0 {
        return Err("`motion` is empty".to_owned());
    }
    let lengths = entry("lengths").map(|lengths| pickle.counts(lengths));
    let lengths = lengths.transpose().map_err(within("lengths"))?;
    if let Some(lengths) = &lengths {
        let fits = lengths.iter().all(|length| (1..=frames).contains(length));
        if lengths.len() != count || !fits {
            return Err(format!(
                "`lengths` are not {count} lengths of 1 to {frames} frames"
            ));
        }
    }
    Ok(Results { motion, lengths })
}

/// A pickled array.
struct Pickled<'p, 'a> {
    shape: Vec<usize>,
    dtype: &'a str,
    fortran_order: bool,
    data: Data<'p, 'a>,
}

enum Data<'p, 'a> {
    Numbers(&'a [u8]),
    Objects(&'p [Place]),
}

/// Modules of NumPy before and since version 2.
const MULTIARRAY: [&str; 2] = ["numpy.core.multiarray", "numpy._core.multiarray"];
const NUMERIC: [&str; 2] = ["numpy.core.numeric", "numpy._core.numeric"];

/// An object as the call that makes it.
struct Call<'a> {
    module: &'a str,
    name: &'a str,
    arguments: Place,
    state: Option<Place>,
}

impl<'a> Pickle<'a> {
    /// The call of a named callable that makes the object at `place`.
    fn call(&self, place: Place) -> Option<Call<'a>> {
        let Value::Object {
            callable,
            arguments,
            state,
        } = self.at(place)
        else {
            return None;
        };
        let Value::Global(module, name) = self.at(*callable) else {
            return None;
        };
        Some(Call {
            module,
            name,
            arguments: *arguments,
            state: *state,
        })
    }

    fn ndarray<'p>(&'p self, place: Place) -> Result<Pickled<'p, 'a>, String> {
        let not_array = || "not an array of NumPy".to_owned();
        let Call {
            module,
            name,
            arguments,
            state,
        } = self.call(place).ok_or_else(not_array)?;
        let tuple = |place: Option<&Place>| match place.map(|place| self.at(*place)) {
            Some(Value::Tuple(items)) => Ok(items.as_slice()),
            _ => Err(not_array()),
        };
        let (shape, dtype, fortran_order, data) =
            if name == "_reconstruct" && MULTIARRAY.contains(&module) {
                let [_, shape, dtype, order, data] = tuple(state.as_ref())? else {
                    return Err(not_array());
                };
                let fortran_order = matches!(self.at(*order), Value::Bool(true));
                (shape, dtype, fortran_order, data)
            } else if name == "_frombuffer" && NUMERIC.contains(&module) {
                let [data, dtype, shape, order] = tuple(Some(&arguments))? else {
                    return Err(not_array());
                };
                let fortran_order = matches!(self.at(*order), Value::Text("F"));
                (shape, dtype, fortran_order, data)
            } else {
                return Err(not_array());
            };
        let axis = |place: &Place| match self.at(*place) {
            Value::Int(axis) => usize::try_from(*axis).map_err(|_| "a negative axis".to_owned()),
            _ => Err(not_array()),
        };
        let shape: Vec<usize> = tuple(Some(shape))?
            .iter()
            .map(axis)
            .collect::<Result<_, _>>()?;
        Ok(Pickled {
            shape,
            dtype: self.dtype(*dtype)?,
            fortran_order,
            data: match self.at(*data) {
                Value::Bytes(data) => Data::Numbers(data),
                Value::List(objects) => Data::Objects(objects),
                _ => return Err(not_array()),
            },
        })
    }

    /// The type's letter and its size, such as `f4`; big-endian types are refused.
    fn dtype(&self, place: Place) -> Result<&'a str, String> {
        let unknown = || "an unknown dtype".to_owned();
        let call = self.call(place).ok_or_else(unknown)?;
        let Value::Tuple(arguments) = self.at(call.arguments) else {
            return Err(unknown());
        };
        if (call.module, call.name) != ("numpy", "dtype") {
            return Err(unknown());
        }
        let Some(Value::Text(name)) = arguments.first().map(|name| self.at(*name)) else {
            return Err(unknown());
        };
        let order = match call.state.map(|state| self.at(state)) {
            Some(Value::Tuple(state)) => state.get(1).map(|order| self.at(*order)),
            _ => None,
        };
        match order {
            Some(Value::Text(">")) => Err(format!("dtype >{name} found, little-endian needed")),
            _ => Ok(name),
        }
    }

    /// An array of float32 or float64 numbers.
    fn floats(&self, place: Place) -> Result<Array, String> {
        let array = self.ndarray(place)?;
        let double = match array.dtype {
            "f4" => false,
            "f8" => true,
            other => return Err(format!("dtype {other} found, f4 or f8 needed")),
        };
        let data = array.numbers(if double { 8 } else { 4 })?;
        let mut stored = Vec::new();
        decode(&mut stored, data, double);
        let values = in_c_order(stored, &array.shape, array.fortran_order);
        Ok(Array {
            shape: array.shape,
            values,
        })
    }

    /// A list or an array of whole numbers.
    fn counts(&self, place: Place) -> Result<Vec<usize>, String> {
        let not_counts = || "not whole numbers".to_owned();
        if let Value::List(items) = self.at(place) {
            let count = |place: &Place| match self.at(*place) {
                Value::Int(count) => usize::try_from(*count).map_err(|_| not_counts()),
                _ => Err(not_counts()),
            };
            return items.iter().map(count).collect();
        }
        let array = self.ndarray(place)?;
        let signed = match array.dtype {
            "i8" => numbers(array.numbers(8)?, i64::from_le_bytes),
            "i4" => numbers(array.numbers(4)?, |bytes| {
                i64::from(i32::from_le_bytes(bytes))
            }),
            other => return Err(format!("dtype {other} found, i4 or i8 needed")),
        };
        let counts = signed.into_iter().map(usize::try_from);
        counts
            .map(|count| count.map_err(|_| not_counts()))
            .collect()
    }
}

impl<'a> Pickled<'_, 'a> {
    /// The data, if they have the size of the shape.
    fn numbers(&self, bytes: usize) -> Result<&'a [u8], String> {
        let Data::Numbers(data) = self.data else {
            return Err("its data are not numbers".to_owned());
        };
        let product = self
            .shape
            .iter()
            .try_fold(bytes, |all, axis| all.checked_mul(*axis));
        match product == Some(data.len()) {
            true => Ok(data),
            false => Err(format!(
                "{} bytes of data do not fit the shape {:?}; {CUT_OFF}",
                data.len(),
                self.shape
            )),
        }
    }
}

fn numbers<const N: usize>(data: &[u8], number: impl Fn([u8; N]) -> i64) -> Vec<i64> {
    let (numbers, _) = data.as_chunks();
    numbers.iter().map(|&bytes| number(bytes)).collect()
}

#[cfg(test)]
mod tests;
