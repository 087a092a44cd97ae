//! The timestep embedding.

use burn::module::Module;
use burn::tensor::activation::silu;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::Time;

use crate::Initializer;
use crate::layers::Linear;

/// Rows of the sinusoid table of width `dim` (even): column `2i` is `sin(t f_i)` and column
/// `2i + 1` is `cos(t f_i)` with `f_i = 10000^(-2i / dim)`.
///
/// Computed on the host in double precision, because arguments reach 999.
///
/// # Shapes
/// - output: `[batch, dim]`
pub fn interleaved_sinusoidal(positions: &[f64], dim: usize, device: &Device) -> Tensor<2> {
    let values: Vec<f32> = positions
        .iter()
        .flat_map(|&position| position_row(position, dim))
        .collect();
    Tensor::from_data(TensorData::new(values, [positions.len(), dim]), device)
}

fn position_row(position: f64, dim: usize) -> impl Iterator<Item = f32> {
    (0..dim).map(move |column| {
        let pair = (column / 2 * 2) as f64;
        let angle = position * (-pair * 10_000f64.ln() / dim as f64).exp();
        match column % 2 {
            0 => angle.sin() as f32,
            _ => angle.cos() as f32,
        }
    })
}

/// The sinusoidal embedding of times: `[cos(t f_0) .. cos(t f_{h-1}) | sin(t f_0) ..
/// sin(t f_{h-1})]` with `f_i = 10000^(-i / h)` and `h = dim / 2`.
///
/// Computed on the host in double precision: in single precision the argument has an error of 3e-5
/// at t = 999.
///
/// # Shapes
/// - output: `[batch, dim]`
pub fn sinusoidal(time: &[Time], dim: usize, device: &Device) -> Tensor<2> {
    let half = dim / 2;
    let frequencies: Vec<f64> = (0..half)
        .map(|i| 10_000f64.powf(-(i as f64) / half as f64))
        .collect();
    let values: Vec<f32> = time
        .iter()
        .flat_map(|&Time(t)| {
            let angles = frequencies.iter().map(move |f| t * f);
            angles
                .clone()
                .map(|a| a.cos() as f32)
                .chain(angles.map(|a| a.sin() as f32))
        })
        .collect();
    Tensor::from_data(TensorData::new(values, [time.len(), 2 * half]), device)
}

/// Sinusoidal embedding, linear, SiLU, linear. The output is an input of every residual block
/// (CC-MotionGen, section 3.1.2; docs/sources.md, section 1.5).
#[derive(Module, Debug)]
pub struct TimeEmbedding {
    at_0: Linear,
    at_2: Linear,
    dim: usize,
    scale: f64,
}

impl TimeEmbedding {
    /// An embedding of width `dim` (even).
    pub fn new(dim: usize, init: &Initializer) -> Self {
        Self {
            at_0: Linear::new(dim, dim, &init.at("0")),
            at_2: Linear::new(dim, dim, &init.at("2")),
            dim,
            scale: 1.0,
        }
    }

    /// Embeds times multiplied by `scale`.
    #[must_use]
    pub fn scaled(self, scale: f64) -> Self {
        Self { scale, ..self }
    }

    /// # Shapes
    /// - output: `[times, dim]`
    pub fn forward(&self, time: &[Time], device: &Device) -> Tensor<2> {
        let time: Vec<Time> = time.iter().map(|&Time(t)| Time(t * self.scale)).collect();
        let h = self.at_0.forward(sinusoidal(&time, self.dim, device));
        self.at_2.forward(silu(h))
    }
}
