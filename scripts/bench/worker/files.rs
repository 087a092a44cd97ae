//! The files that the worker loads.

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::{AUDIO, TEXT};
use kinegrad_models::parameters::{HostParameter, ParameterInfo};
use kinegrad_train::denoising::{Conditions, Inputs, RandomInputs};
use safetensors::{Dtype, SafeTensors};

use crate::Result;

/// The inputs of a step by name.
pub struct NamedTensors {
    tensors: HashMap<String, Tensor<3>>,
    timesteps: Vec<usize>,
}

impl NamedTensors {
    pub fn read(path: &Path, device: &Device) -> Result<Self> {
        let bytes = fs::read(path)?;
        let file = SafeTensors::deserialize(&bytes)?;
        let mut tensors = HashMap::new();
        for (name, view) in file.iter().filter(|(_, view)| view.dtype() == Dtype::F32) {
            let data = TensorData::new(floats(view.data()), view.shape().to_vec());
            tensors.insert(name.to_string(), Tensor::from_data(data, device));
        }
        let integers = file.tensor("timesteps");
        let integers = integers.map_or(&[][..], |view| view.data().as_chunks::<8>().0);
        let timesteps = integers.iter().map(|&b| i64::from_le_bytes(b) as usize);
        Ok(Self {
            tensors,
            timesteps: timesteps.collect(),
        })
    }

    pub fn tensor(&self, name: &str) -> Result<Tensor<3>> {
        let tensor = self.tensors.get(name).cloned();
        Ok(tensor.ok_or_else(|| format!("no tensor `{name}`"))?)
    }

    pub fn batch(&self) -> Result<Inputs> {
        let x_start = self.tensor("motion")?;
        let [batch, _, time] = x_start.dims();
        Ok(Inputs {
            mask: Tensor::ones([batch, time], &x_start.device()),
            cond: Conditions::new([(AUDIO, self.tensor("cond")?)]),
            lengths: None,
            x_start,
        })
    }

    /// Clips, each with a mask `[batch, 1, time]` and a text.
    pub fn clips(&self) -> Result<Inputs> {
        Ok(Inputs {
            x_start: self.tensor("motion")?,
            cond: Conditions::new([(TEXT, self.tensor("cond")?)]),
            mask: self.tensor("mask")?.squeeze_dim(1),
            lengths: None,
        })
    }

    pub fn draws(&self) -> Result<RandomInputs> {
        Ok(RandomInputs {
            timesteps: self.timesteps.clone(),
            noise: self.tensor("noise")?,
            condition_dropout_mask: None,
            style_dropout_mask: None,
            dropout: None,
        })
    }
}

/// The weights of a file by their names.
pub fn read_weights(path: &Path) -> Result<Vec<HostParameter>> {
    let bytes = fs::read(path)?;
    let file = SafeTensors::deserialize(&bytes)?;
    let weights = file.iter().map(|(name, view)| HostParameter {
        info: ParameterInfo {
            name: name.to_string(),
            shape: view.shape().to_vec(),
        },
        values: floats(view.data()),
    });
    Ok(weights.collect())
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    let chunks = bytes.as_chunks::<4>().0;
    chunks.iter().map(|&b| f32::from_le_bytes(b)).collect()
}
