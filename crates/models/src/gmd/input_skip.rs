//! A path from the input of the network to its output.

use burn::module::Module;
use burn::tensor::Tensor;

use crate::Initializer;
use crate::layers::{Conv1d, Linear};

/// What a network adds of its input to its output:
///
/// ```text
/// g = Linear(mish(c))            one gain a channel, zero in a new network
/// y = g (x + W x)                W of one frame, zero in a new network
/// ```
///
/// The published UNet halves its input's length before the first skip that it uses, and group
/// normalisation takes the level and the scale of a clip away: where little noise is left, a small
/// network of that shape returns neither the finest detail of its input nor where the root stands
/// (docs/gmd.md).
#[derive(Module, Debug)]
pub(super) struct InputSkip {
    gain: Linear,
    mix: Conv1d,
}

impl InputSkip {
    /// A path of `channels` under an activated condition of `width` numbers.
    pub fn new(channels: usize, width: usize, init: &Initializer) -> Self {
        let (gain, mix) = (init.at("gain"), init.at("mix"));
        Self {
            gain: Linear::new(width, channels, &gain).zeroed(&gain),
            mix: Conv1d::new(channels, channels, 1, &mix).zeroed(&mix),
        }
    }

    /// # Shapes
    /// - x, output: `[batch, channels, time]`
    /// - activated: `mish(c)`, `[batch, width]`
    pub fn forward(&self, x: Tensor<3>, activated: Tensor<2>) -> Tensor<3> {
        let gain = self.gain.forward(activated).unsqueeze_dim::<3>(2);
        self.mix.operation().residual(x.clone()).forward(x) * gain
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_random::{Key, Purpose};

    use crate::gmd::GmdUnetConfig;
    use crate::{Initializer, gradients, parameters};

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

    fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
        tensor.try_into_vec_as().expect("float32")
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
        let (x, c) = (
            normals(10, BATCH * CHANNELS * TIME),
            normals(11, BATCH * WIDTH),
        );
        let of = |name: &str| {
            let found = parameters::export(&skip).into_iter();
            let mut found = found.filter(|parameter| parameter.info.name == name);
            found.next().expect("a parameter").values
        };
        let [gain, gain_bias] = ["gain.weight", "gain.bias"].map(of);
        let [mix, mix_bias] = ["mix.weight", "mix.bias"].map(of);
        let output = values(skip.forward(
            tensor(x.clone(), [BATCH, CHANNELS, TIME], &device),
            tensor(c.clone(), [BATCH, WIDTH], &device),
        ));
        for b in 0..BATCH {
            for k in 0..CHANNELS {
                let row = (0..WIDTH).map(|i| gain[k * WIDTH + i] * c[b * WIDTH + i]);
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

    #[test]
    fn a_new_network_is_as_without_it_and_learns_from_it_at_once() {
        let device = Device::flex().autodiff();
        let network = |input_skip| {
            let config = GmdUnetConfig {
                input_skip,
                dim_mults: vec![1.0; 2],
                latent_dim: 8,
                padded_frames: 8,
                zero_init: false,
                ..GmdUnetConfig::motion_tiny()
            };
            let init = Initializer::new(3, &device);
            config.init(CHANNELS, WIDTH, &init).expect("a network")
        };
        let [with, without] = [true, false].map(network);
        let x = tensor(
            normals(1, BATCH * CHANNELS * 8),
            [BATCH, CHANNELS, 8],
            &device,
        );
        let c = tensor(normals(2, BATCH * WIDTH), [BATCH, WIDTH], &device);
        let output = with.forward(x.clone(), c.clone());
        assert_eq!(values(output.clone()), values(without.forward(x, c)));
        let mut found = output.powi_scalar(2).sum().backward();
        let found = gradients(&with, &mut found);
        let infos = parameters::infos(&with);
        let of_gain = infos
            .iter()
            .position(|info| info.name == "input_skip.gain.weight");
        let slopes = &found[of_gain.expect("a gain")];
        assert!(slopes.iter().all(|slope| slope.abs() > 0.0), "{slopes:?}");
        let extra = [CHANNELS * (8 + 1), CHANNELS * (CHANNELS + 1)];
        let more = parameters::count(&network(true)) - parameters::count(&network(false));
        assert_eq!(more, extra.iter().sum::<usize>());
    }
}
