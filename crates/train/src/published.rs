//! Files that other programs wrote: PyTorch's weights and NumPy's vectors.

use std::collections::BTreeMap;
use std::path::Path;

use half::{bf16, f16};
use kinegrad_data::read_array;
use pytorch_reader::{DType, PytorchReader, Tensor};

use crate::error::Error;

/// All tensors of a file that `torch.save` wrote, by their path through its dictionaries.
///
/// # Errors
/// [`Error::Foreign`] for any other file.
pub fn read_tensors(path: &Path) -> Result<BTreeMap<String, Tensor>, Error> {
    let read = PytorchReader::new(path).map_err(|error| Error::Foreign {
        path: path.to_path_buf(),
        reason: error.to_string(),
    })?;
    Ok(read.into_tensors().into_iter().collect())
}

/// The tensors below `part`, by the rest of their names.
pub fn part_of(tensors: &BTreeMap<String, Tensor>, part: &str) -> BTreeMap<String, Tensor> {
    let inside = tensors.iter().filter_map(|(name, tensor)| {
        let name = name.strip_prefix(part)?.strip_prefix('.')?;
        Some((name.to_string(), tensor.clone()))
    });
    inside.collect()
}

/// A tensor in single precision.
pub fn values_of(tensor: &Tensor) -> Result<Vec<f32>, String> {
    let bytes = tensor.read().map_err(|error| error.to_string())?;
    match tensor.dtype() {
        DType::F32 => Ok(bytemuck::pod_collect_to_vec(&bytes)),
        DType::F64 => {
            let values: Vec<f64> = bytemuck::pod_collect_to_vec(&bytes);
            Ok(values.into_iter().map(|value| value as f32).collect())
        }
        DType::F16 => {
            let bits: Vec<u16> = bytemuck::pod_collect_to_vec(&bytes);
            Ok(bits
                .into_iter()
                .map(|b| f16::from_bits(b).to_f32())
                .collect())
        }
        DType::BF16 => {
            let bits: Vec<u16> = bytemuck::pod_collect_to_vec(&bytes);
            Ok(bits
                .into_iter()
                .map(|b| bf16::from_bits(b).to_f32())
                .collect())
        }
        other => Err(format!("{other:?} found, a floating-point type needed")),
    }
}

/// The numbers of a one-dimensional `.npy` file.
pub fn vector(path: &Path) -> Result<Vec<f64>, Error> {
    let array = read_array(path)?;
    match array.shape.len() {
        1 => Ok(array.values.into_iter().map(f64::from).collect()),
        _ => Err(Error::Array {
            path: path.to_path_buf(),
            found: format!("shape {:?}", array.shape),
            allowed: "one axis".into(),
        }),
    }
}
