//! Clips that are shorter than the sampled length.

use burn::tensor::{Tensor, TensorData};
use kinegrad_diffusion::{Denoiser, GaussianDiffusion, PredictionType, Time};

/// A network that pads clips as in training. After a clip's last frame, the network's input is
/// noised zeros of normalized motion, and its output is replaced by zeros.
pub struct Padded<'a, D> {
    network: &'a D,
    diffusion: &'a GaussianDiffusion,
    /// 1 in frames of the clip, else 0, `[batch, 1, frames]`; `None` if every clip has the sampled
    /// length.
    real: Option<Tensor<3>>,
}

impl<'a, D> Padded<'a, D> {
    /// `network` for clips of these `lengths`, sampled as `frames` frames. `like` is on the
    /// network's device.
    pub fn new(
        network: &'a D,
        diffusion: &'a GaussianDiffusion,
        lengths: &[usize],
        like: &Tensor<3>,
    ) -> Self {
        let [batch, _, frames] = like.dims();
        let is_full = lengths.iter().all(|&length| length >= frames);
        let real = (!is_full).then(|| {
            let is_real = |length: usize, t: usize| f32::from(u8::from(t < length));
            let of_clip = |&length: &usize| (0..frames).map(move |t| is_real(length, t));
            let values: Vec<f32> = lengths.iter().flat_map(of_clip).collect();
            Tensor::from_data(TensorData::new(values, [batch, 1, frames]), &like.device())
        });
        Self {
            network,
            diffusion,
            real,
        }
    }
}

impl<D: Denoiser<Cond = Tensor<3>>> Denoiser for Padded<'_, D> {
    type Cond = Tensor<3>;

    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &Tensor<3>) -> Tensor<3> {
        let Some(real) = &self.real else {
            return self.network.predict(x_t, time, cond);
        };
        let padding = real.clone() * -1.0 + 1.0;
        // Padding must not let a goal influence the clip.
        let behind = x_t.clone().detach() * padding.clone();
        let seen = x_t * real.clone() + behind.clone();
        let output = self.network.predict(seen, time, cond);
        let timesteps: Vec<usize> = time.iter().map(|time| time.timestep()).collect();
        let (from, to) = (
            PredictionType::Sample,
            self.diffusion.config.prediction_type,
        );
        let zeros = behind.zeros_like();
        let zeros = self.diffusion.convert(zeros, behind, &timesteps, from, to);
        output * real.clone() + zeros * padding
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        self.network.null_cond(cond)
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use burn::tensor::Device;
    use kinegrad_diffusion::{
        ClipRange, Ddpm, DiffusionConfig, NoiseKeys, Prediction, SamplerConfig, SamplerKind,
        Timesteps, sample,
    };
    use kinegrad_random::{Key, Purpose};

    use super::*;

    /// Predicts the mean of all frames for every frame, so visible padding would change the
    /// prediction.
    struct Mean;

    impl Denoiser for Mean {
        type Cond = Tensor<3>;

        fn predict(&self, x_t: Tensor<3>, _: &[Time], cond: &Tensor<3>) -> Tensor<3> {
            let shape = x_t.dims();
            x_t.mean_dim(2).expand(shape) + cond.clone()
        }

        fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
            cond.zeros_like()
        }
    }

    const LENGTHS: [usize; 3] = [5, 8, 3];
    const TIMESTEP: usize = 400;

    fn normal(name: &str, shape: [usize; 3]) -> Tensor<3> {
        let values = Key::new(3, Purpose::Noise)
            .named(name)
            .normals(shape.iter().product());
        Tensor::from_data(TensorData::new(values, shape), &Device::flex())
    }

    fn process(prediction_type: PredictionType) -> GaussianDiffusion {
        let config = DiffusionConfig {
            prediction_type,
            ..DiffusionConfig::default()
        };
        GaussianDiffusion::new(&config).unwrap()
    }

    /// The clean motion predicted from `x_t`, `[3, 2, 8]`.
    fn x_start(
        network: &impl Denoiser<Cond = Tensor<3>>,
        kind: PredictionType,
        x_t: Tensor<3>,
    ) -> Tensor<3> {
        let timesteps = [TIMESTEP; 3];
        let cond = Tensor::ones([3, 2, 1], &x_t.device());
        let output = network.predict(x_t.clone(), &Time::of(&timesteps), &cond);
        let clip = ClipRange::None;
        let prediction = Prediction::new(&process(kind), output, x_t, &timesteps, &clip);
        prediction.unwrap().x_start
    }

    fn largest(x: Tensor<3>) -> f32 {
        x.abs().max().into_scalar()
    }

    #[test]
    fn behind_a_clip_are_zeros_whatever_the_network_predicts() {
        for kind in [
            PredictionType::Sample,
            PredictionType::Epsilon,
            PredictionType::VPrediction,
        ] {
            let diffusion = process(kind);
            let x_t = normal("x_t", [3, 2, 8]);
            let padded = Padded::new(&Mean, &diffusion, &LENGTHS, &x_t);
            let (found, bare) = (
                x_start(&padded, kind, x_t.clone()),
                x_start(&Mean, kind, x_t),
            );
            for (index, length) in LENGTHS.into_iter().enumerate() {
                let of = |x: &Tensor<3>, from: usize, to: usize| {
                    x.clone().narrow(0, index, 1).narrow(2, from, to - from)
                };
                assert_eq!(largest(of(&found, 0, length) - of(&bare, 0, length)), 0.0);
                if length < 8 {
                    let behind = largest(of(&found, length, 8));
                    assert!(behind < 1e-5, "{kind:?}: {behind}");
                    assert!(largest(of(&bare, length, 8)) > 0.1);
                }
            }
        }
    }

    #[test]
    fn the_gradient_of_a_clip_does_not_reach_behind_it() {
        let diffusion = process(PredictionType::Sample);
        let x_t = normal("x_t", [3, 2, 8]).autodiff().require_grad();
        let padded = Padded::new(&Mean, &diffusion, &LENGTHS, &x_t);
        let weights = normal("weights", [3, 2, 8]).autodiff();
        let found = x_start(&padded, PredictionType::Sample, x_t.clone());
        let gradients = (found * weights).sum().backward();
        let gradient = x_t.grad(&gradients).expect("of a leaf");
        for (index, length) in LENGTHS.into_iter().enumerate() {
            let of_clip = gradient.clone().narrow(0, index, 1);
            assert!(largest(of_clip.clone().narrow(2, 0, length)) > 0.0);
            if length < 8 {
                assert_eq!(largest(of_clip.narrow(2, length, 8 - length)), 0.0);
            }
        }
    }

    #[test]
    fn every_sampler_ends_at_zeros_after_a_clip_and_samples_it_as_if_alone() {
        let diffusion = process(PredictionType::Sample);
        let start = normal("start", [3, 2, 8]);
        let cond = normal("cond", [3, 2, 1]);
        for kind in [
            SamplerKind::Ddpm(Ddpm::default()),
            SamplerKind::default(),
            SamplerKind::Dpmpp2m(Timesteps::default()),
            SamplerKind::Heun(Timesteps::default()),
        ] {
            let sampler = SamplerConfig {
                kind,
                num_inference_steps: 5,
                guidance_scale: 2.5,
                ..SamplerConfig::default()
            };
            let sampled = |clips: std::ops::Range<usize>| {
                let count = clips.len();
                let part = |x: &Tensor<3>| x.clone().narrow(0, clips.start, count);
                let lengths = &LENGTHS[clips.clone()];
                let padded = Padded::new(&Mean, &diffusion, lengths, &part(&start));
                let key = Key::new(7, Purpose::Sampling);
                let keys: Vec<(Key, u64)> = clips.clone().map(|clip| (key, clip as u64)).collect();
                let found = sample(
                    &diffusion,
                    &padded,
                    part(&start),
                    &part(&cond),
                    &sampler,
                    &ClipRange::None,
                    NoiseKeys::Numbered(&keys),
                    &mut |_, _, _| ControlFlow::Continue(()),
                );
                found.expect("valid settings")
            };
            let all = sampled(0..3);
            for (index, length) in LENGTHS.into_iter().enumerate() {
                let clip = all.clone().narrow(0, index, 1);
                if length < 8 {
                    let behind = largest(clip.clone().narrow(2, length, 8 - length));
                    assert!(behind < 1e-4, "{kind}: {behind}");
                }
                assert!(
                    largest(clip.clone() - sampled(index..index + 1)) < 1e-5,
                    "{kind}"
                );
            }
        }
    }
}
