//! The transformer with blended positional encodings, its samples and its metrics against the
//! golden files of `flowmdm`. The tolerances are the reference data's own.

mod decode;
mod drawing;
mod network;
mod positions;
mod sampling;
mod training;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_bpe_transformer::network::{BlendedConfig, BlendedTransformer, Segment, Switch};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_tests::golden::{Golden, ReferenceTensors as _};
use kinegrad_tests::stages::Noted;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::weights;

const STAGE: f64 = 4e-4;
const GRADIENT: f64 = 4e-4;

/// The tests of this folder.
pub fn tests() -> Vec<GoldenTest> {
    let tests = [
        positions::tests(),
        network::tests(),
        sampling::tests(),
        decode::tests(),
        training::tests(),
    ];
    tests.into_iter().flatten().collect()
}

fn number(golden: &Golden, name: &str) -> i64 {
    golden.get(name).scalar() as i64
}

fn counts(golden: &Golden, name: &str) -> Vec<usize> {
    golden
        .get(name)
        .values
        .iter()
        .map(|value| *value as usize)
        .collect()
}

fn flags(golden: &Golden, name: &str) -> Vec<bool> {
    golden
        .get(name)
        .values
        .iter()
        .map(|value| *value == 1.0)
        .collect()
}

/// The network of a file, with the sizes of its weights.
fn network(golden: &Golden, device: &Device) -> BlendedTransformer {
    let shape = |name: &str| weights::shape(golden, &format!("model.{name}")).expect(name);
    let layer =
        |index: usize| format!("model.seqTransEncoder.attn_layers.layers.{index}.0.0.weight");
    let layers = (0..).take_while(|&index| weights::shape(golden, &layer(index)).is_some());
    let config = BlendedConfig {
        latent_dim: shape("embed_text.weight")[0],
        num_layers: layers.count() / 2,
        num_heads: number(golden, "in.heads") as usize,
        ff_size: shape("seqTransEncoder.attn_layers.layers.1.1.ff.0.0.weight")[0],
        horizon: number(golden, "in.horizon") as usize,
        dropout: 0.0,
        ..BlendedConfig::flowmdm()
    };
    let channels = shape("input_process.poseEmbedding.weight")[1];
    let text = shape("embed_text.weight")[1];
    let init = Initializer::new(0, device);
    let network = config.init(channels, text, &init).expect("a network");
    parameters::load(network, weights(golden, "model.")).expect("the weights fit")
}

fn switch(golden: &Golden) -> Switch {
    Switch {
        bpe_denoising_step: number(golden, "in.bpe_step"),
        num_train_timesteps: 1000,
    }
}

/// A motion of several segments, with the texts from `first` on, `stride` rows apart.
fn motion(lengths: &[usize], first: usize, stride: usize) -> Vec<Segment> {
    let numbered = lengths.iter().enumerate();
    let segment = |(index, frames): (usize, &usize)| Segment {
        text: first + index * stride,
        frames: *frames,
    };
    numbered.map(segment).collect()
}

/// `[batch, channels, 1, time]` as `[batch, channels, time]`.
fn motions(golden: &Golden, name: &str, device: &Device) -> Tensor<3> {
    golden.get(name).flat().tensor(device)
}

/// `[batch, width, time]` as the file has it, `[batch, time, width]`.
fn compare_turned(golden: &Golden, name: &str, x: Tensor<3>, tolerance: f64) {
    let reference = golden.get(name);
    reference.assert_within(name, x.swap_dims(1, 2), tolerance, 0.0);
}

fn compare_stages(golden: &Golden, stages: &Noted, prefix: &str) {
    let names = golden.names_under(prefix).into_iter();
    let whole = ["y", "y_uncond", "y_cfg", "loss"];
    let names: Vec<String> = names
        .filter(|name| !whole.contains(&name.as_str()))
        .collect();
    assert!(!names.is_empty(), "stages under {prefix}");
    for name in names {
        let [batch, width, time] = stages.shape(&name)[..] else {
            panic!("{name}: {:?}", stages.shape(&name))
        };
        let data = TensorData::new(stages.values(&name).to_vec(), [batch, width, time]);
        let stage = Tensor::from_data(data, &Device::flex());
        compare_turned(golden, &format!("{prefix}{name}"), stage, STAGE);
    }
}
