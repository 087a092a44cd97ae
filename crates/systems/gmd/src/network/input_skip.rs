//! A path from the input of the network to its output.

use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_diffusion::Time;
use kinegrad_models::Initializer;
use kinegrad_models::layers::{Conv1d, Linear};
use kinegrad_models::time_embedding::interleaved_sinusoidal;

/// The part of the input that a network adds to its output:
///
/// ```text
/// g = Linear(sinusoid(t))        one gain a channel, zero in a new network
/// y = g (x + W x)                W of one frame, zero in a new network
/// ```
///
/// The published UNet halves its input's length before the first used skip, and group normalization
/// removes a clip's mean and scale. At low noise, a small network therefore loses the input's
/// finest detail and the root's position (docs/gmd.md). The gain does not depend on the text,
/// because guidance would multiply the gain's errors for captions of few clips.
#[derive(Module, Debug)]
pub(super) struct InputSkip {
    gain: Linear,
    mix: Conv1d,
    width: usize,
}

impl InputSkip {
    /// A path with `channels` channels and sinusoids of even `width`.
    pub fn new(channels: usize, width: usize, init: &Initializer) -> Self {
        let (gain, mix) = (init.at("gain"), init.at("mix"));
        Self {
            gain: Linear::new(width, channels, &gain).zeroed(&gain),
            mix: Conv1d::new(channels, channels, 1, &mix).zeroed(&mix),
            width,
        }
    }

    /// # Shapes
    /// - x, output: `[batch, channels, time]`
    pub fn forward(&self, x: Tensor<3>, time: &[Time]) -> Tensor<3> {
        let positions: Vec<f64> = time.iter().map(|time| time.0).collect();
        let rows = interleaved_sinusoidal(&positions, self.width, &x.device());
        let gain = self.gain.forward(rows).unsqueeze_dim::<3>(2);
        self.mix.operation().residual(x.clone()).forward(x) * gain
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_diffusion::guided;
    use kinegrad_kernels::host_values;
    use kinegrad_motion::humanml::TEXT_CHANNELS;
    use kinegrad_random::{Key, Purpose};

    use crate::network::Backbone;
    use crate::network::GmdUnetConfig;
    use crate::network::TextDenoiser;
    use kinegrad_models::Initializer;
    use kinegrad_models::gradients;
    use kinegrad_models::parameters;

    use super::*;

    const BATCH: usize = 2;
    const CHANNELS: usize = 3;
    const WIDTH: usize = 4;
    const TIME: usize = 6;

    fn normals(seed: u64, count: usize) -> Vec<f32> {
        Key::new(seed, Purpose::Synthetic).normals(count)
    }

    fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
        Tensor::from_data(TensorData::new(values, shape), device)
    }

    #[test]
    fn it_is_the_gain_times_the_mixed_input() {
        let device = Device::flex();
        let skip = InputSkip::new(CHANNELS, WIDTH, &Initializer::new(0, &device));
        let mut seed = 0;
        let skip = parameters::update(skip, |_, values| {
            seed += 1;
            values.copy_from_slice(&normals(seed, values.len()));
        });
        let x = normals(10, BATCH * CHANNELS * TIME);
        let times = [Time(3.0), Time(0.5)];
        let of = |name: &str| {
            let found = parameters::export(&skip).into_iter();
            let mut found = found.filter(|parameter| parameter.info.name == name);
            found.next().expect("a parameter").values
        };
        let [gain, gain_bias] = ["gain.weight", "gain.bias"].map(of);
        let [mix, mix_bias] = ["mix.weight", "mix.bias"].map(of);
        let input = tensor(x.clone(), [BATCH, CHANNELS, TIME], &device);
        let output = host_values(skip.forward(input, &times));
        for (b, time) in times.iter().enumerate() {
            let (t, slow) = (time.0 as f32, time.0 as f32 / 100.0);
            // Sine and cosine of two frequencies, 1 and 1/100.
            let sinusoid = [t.sin(), t.cos(), slow.sin(), slow.cos()];
            for k in 0..CHANNELS {
                let row = (0..WIDTH).map(|i| gain[k * WIDTH + i] * sinusoid[i]);
                let g = row.sum::<f32>() + gain_bias[k];
                for t in 0..TIME {
                    let at = |channel: usize| (b * CHANNELS + channel) * TIME + t;
                    let row = (0..CHANNELS).map(|i| mix[k * CHANNELS + i] * x[at(i)]);
                    let mixed = row.sum::<f32>() + mix_bias[k];
                    let expected = g * (x[at(k)] + mixed);
                    assert!((output[at(k)] - expected).abs() < 1e-4, "{b} {k} {t}");
                }
            }
        }
    }

    fn network(input_skip: bool, zero_init: bool, device: &Device) -> TextDenoiser {
        let backbone = Backbone::GmdUnet(GmdUnetConfig {
            input_skip,
            dim_mults: vec![1.0; 2],
            latent_dim: 8,
            padded_frames: 8,
            zero_init,
            ..GmdUnetConfig::motion_tiny()
        });
        let init = Initializer::new(3, device);
        TextDenoiser::new(&backbone, CHANNELS, &init).expect("a network")
    }

    #[test]
    fn a_new_network_is_as_without_it_and_learns_from_it_at_once() {
        let device = Device::flex().autodiff();
        let [with, without] = [true, false].map(|input_skip| network(input_skip, false, &device));
        let x = normals(1, BATCH * CHANNELS * TIME);
        let x = tensor(x, [BATCH, CHANNELS, TIME], &device);
        let text = Tensor::ones([BATCH, TEXT_CHANNELS, 1], &device);
        let times = [Time(700.0), Time(2.0)];
        let output = with.forward(x.clone(), &times, text.clone());
        assert_eq!(
            host_values(output.clone()),
            host_values(without.forward(x, &times, text))
        );
        let mut found = output.powi_scalar(2).sum().backward();
        let found = gradients(&with, &mut found);
        let infos = parameters::infos(&with);
        let of_gain = infos
            .iter()
            .position(|info| info.name.ends_with("input_skip.gain.weight"));
        let slopes = &found[of_gain.expect("a gain")];
        assert!(slopes.iter().all(|slope| slope.abs() > 0.0), "{slopes:?}");
        let extra = [CHANNELS * (8 + 1), CHANNELS * (CHANNELS + 1)];
        let more = parameters::count(&with) - parameters::count(&without);
        assert_eq!(more, extra.iter().sum::<usize>());
    }

    #[test]
    fn it_returns_the_same_whatever_the_text() {
        let device = Device::flex();
        // The UNet gives 0 at first.
        let fresh = network(true, true, &device);
        let infos = parameters::infos(&fresh);
        let network = parameters::update(fresh, |index, values| {
            if infos[index].name.ends_with("input_skip.gain.bias") {
                values.fill(0.5);
            }
        });
        let x = normals(4, BATCH * CHANNELS * TIME);
        let input = tensor(x.clone(), [BATCH, CHANNELS, TIME], &device);
        let text = normals(5, BATCH * TEXT_CHANNELS);
        let text = tensor(text, [BATCH, TEXT_CHANNELS, 1], &device);
        let time = [Time(40.0), Time(800.0)];
        let output = host_values(guided(&network, input, &time, &text, 7.5));
        for (output, x) in output.iter().zip(&x) {
            assert!((output - 0.5 * x).abs() < 1e-6, "guidance multiplies it");
        }
    }
}
