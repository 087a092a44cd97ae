//! Sampling with the files' noise.

use std::ops::ControlFlow;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_bpe_transformer::network::{BlendedTransformer, Composed, TextSegments};
use kinegrad_diffusion::{
    ClipRange, Ddpm, FixedNoise, NoiseKeys, Prediction, PredictionType, Time, TimestepPath, ddpm,
    ddpm_step, guided,
};
use kinegrad_tests::golden::{Golden, GoldenTensors as _};

use super::super::gmd::bench::process;
use super::{counts, motion, network};

/// Sampling from `start` along timesteps, with a given noise for each step, at a guidance scale.
pub struct Drawing<'a> {
    pub golden: &'a Golden,
    pub composed: &'a Composed<'a>,
    pub text: Tensor<3>,
    pub scale: f64,
}

impl Drawing<'_> {
    /// All states after the start, and the last predicted motions.
    pub fn along(&self, start: Tensor<3>, timesteps: &[usize], noise: &str) -> [Vec<Tensor<3>>; 2] {
        let device = start.device();
        let noise = self.golden.get(noise);
        let noise = (0..timesteps.len()).map(|step| {
            let part = noise.part(step);
            let size: Vec<usize> = start.dims().to_vec();
            Tensor::from_data(TensorData::new(part.f32s(), size), &device)
        });
        let given = FixedNoise {
            sampling: noise.collect(),
            imputation: Vec::new(),
        };
        let diffusion = process(PredictionType::Sample);
        let mut predicted = Vec::new();
        let mut predict = |x: Tensor<3>, time: &[Time]| {
            let output = guided(self.composed, x.clone(), time, &self.text, self.scale);
            predicted.push(output.clone());
            let at: Vec<usize> = time.iter().map(|time| time.timestep()).collect();
            Prediction::new(&diffusion, output, x, &at, &ClipRange::None)
        };
        let mut states = Vec::new();
        let path = TimestepPath::to_clean(timesteps.iter().map(|&t| vec![t]).collect());
        ddpm(
            &diffusion,
            &mut predict,
            start,
            &path,
            &Ddpm::default(),
            NoiseKeys::Fixed(&given),
            &mut |_, _, state: &_| {
                states.push(state.clone());
                ControlFlow::Continue(())
            },
        )
        .expect("sizes fit");
        [states, predicted]
    }

    /// The first `steps` states of sampling along `timesteps`, of which there may be one more.
    pub fn around(
        &self,
        start: Tensor<3>,
        timesteps: &[usize],
        steps: usize,
        noise: &str,
    ) -> [Vec<Tensor<3>>; 2] {
        let device = start.device();
        let noise = self.golden.get(noise);
        let diffusion = process(PredictionType::Sample);
        let mut x = start;
        let (mut states, mut predicted) = (Vec::new(), Vec::new());
        for (step, &t) in timesteps.iter().take(steps).enumerate() {
            let output = guided(
                self.composed,
                x.clone(),
                &Time::of(&[t]),
                &self.text,
                self.scale,
            );
            predicted.push(output.clone());
            let prediction = Prediction::new(&diffusion, output, x.clone(), &[t], &ClipRange::None);
            let given = TensorData::new(noise.part(step).f32s(), x.dims());
            let given = Some(Tensor::from_data(given, &device));
            let before = [timesteps.get(step + 1).copied()];
            let prediction = prediction.expect("sizes fit");
            x = ddpm_step(
                &diffusion,
                &prediction,
                &[t],
                &before,
                [given, None],
                &Ddpm::default(),
            );
            states.push(x.clone());
        }
        [states, predicted]
    }
}

/// The common part of the composition files.
pub fn composition(golden: &Golden) -> (BlendedTransformer, TextSegments, Tensor<3>, f64) {
    let device = Device::flex();
    let network = network(golden, &device);
    let script = TextSegments::new([motion(&counts(golden, "in.lengths"), 0, 1)]);
    let text = golden
        .tensor::<2>("in.text_features", &device)
        .unsqueeze_dim(2);
    (network, script, text, golden.get("in.guidance").scalar())
}
