//! A motion synthesised from an example.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_matching::{Frames, Preset, Request, Settings, synthesize_from};
use serde::Deserialize;

use crate::files::NamedTensors;
use crate::{Done, Result, Work};

/// The size of an example.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Example {
    frames: usize,
    channels: usize,
    /// Constant channels.
    #[serde(rename = "still")]
    _still: usize,
}

/// An example, and the start noise of a motion of twice its length.
pub struct Matching {
    examples: [Frames; 1],
    noise: Frames,
    device: Device,
}

impl Matching {
    pub fn load(example: &Example, inputs: &NamedTensors, device: Device) -> Result<Self> {
        let matrix = |name| -> Result<Frames> {
            let values = inputs.tensor(name)?.try_into_vec_as()?;
            Ok(Frames::new(example.channels, values))
        };
        let (motion, noise) = (matrix("example")?, matrix("noise")?);
        if motion.frames() != example.frames {
            return Err("the example has another length".into());
        }
        Ok(Self {
            examples: [motion],
            noise,
            device,
        })
    }
}

impl Work for Matching {
    fn parameters(&self) -> usize {
        0
    }

    fn step(&mut self) -> Result<Done> {
        let request = Request {
            examples: &self.examples,
            frames: 2 * self.examples[0].frames(),
            settings: &Settings::of(Preset::Published),
            groups: &[],
            constraints: &[],
        };
        let made = synthesize_from(&request, &self.noise)?.frames;
        let shape = [1, made.frames(), made.channels()];
        let data = TensorData::new(made.values().to_vec(), shape);
        Ok(Done {
            sample: Some(Tensor::from_data(data, &self.device)),
            ..Done::default()
        })
    }
}
