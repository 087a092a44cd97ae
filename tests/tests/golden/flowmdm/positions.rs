//! Positions, masks and attention.

use burn::tensor::{Device, Tensor};
use kinegrad_bpe_transformer::network::{
    BlendedConfig, HEAD_CHANNELS, PoseCentricAttention, Shared, TextSegments, absolute_positions,
};
use kinegrad_diffusion::Time;
use kinegrad_kernels::KeyRanges;
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_models::rotary::Rotation;
use kinegrad_models::time_embedding::interleaved_sinusoidal;
use kinegrad_tests::golden::{Golden, GoldenTensors as _, ReferenceTensors as _, wide};
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{gradients, trials, weights};

use super::{counts, motion};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_blended_positions("flowmdm/positions.safetensors"),
        golden_pose_centric_attention("flowmdm/attention_pccat.safetensors"),
    ]
}

fn golden_blended_positions(golden: Golden) {
    let device = Device::flex();
    let timesteps = golden.get("in.timesteps").values;
    for width in [32, 512] {
        let rows = interleaved_sinusoidal(&timesteps, width, &device);
        let name = format!("out.time_table{width}");
        golden.get(&name).assert_within(&name, rows, 2e-4, 0.0);
    }
    // A network whose other parameters do not matter.
    let width = golden.get("out.time_embedding").shape[1];
    let config = BlendedConfig {
        latent_dim: width,
        ..BlendedConfig::flowmdm_tiny()
    };
    let network = config
        .init(3, width, &Initializer::new(0, &device))
        .expect("a network");
    let given = weights(&golden, "model.");
    let mut all = parameters::export(&network);
    for parameter in &mut all {
        if let Some(found) = given
            .iter()
            .find(|found| found.info.name == parameter.info.name)
        {
            *parameter = found.clone();
        }
    }
    let network = parameters::load(network, all).expect("the same names");
    let times: Vec<Time> = timesteps.iter().map(|t| Time(*t)).collect();
    let embedded = network.embed_time(&times, &device);
    golden
        .get("out.time_embedding")
        .assert_within("time embedding", embedded, 2e-4, 0.0);
    // Absolute positions, [positions, width].
    let positions = golden.get("in.positions").values;
    let table = |width: usize, scale: f64| -> Vec<f64> {
        let columns = wide(&absolute_positions(&positions, width));
        let count = positions.len();
        let places = (0..count).flat_map(|p| (0..width).map(move |c| (p, c)));
        places
            .map(|(p, c)| scale * columns[c * count + p])
            .collect()
    };
    let scale = golden
        .get("model.seqTransEncoder.pos_emb.absolute.scale")
        .scalar();
    golden.compare("out.absolute32", &table(32, scale), 5e-5);
    let initial = 1.0 / 512f64.sqrt();
    golden.compare("out.scale512_initial", &[initial], 1e-7);
    golden.compare("out.absolute512_initial", &table(512, initial), 5e-5);
    // Rotation, [batch, heads, time, channels] of the file.
    let [batch, heads, time, channels] = golden.get("in.q").shape[..] else {
        panic!("queries of heads")
    };
    let flat = |name: &str| -> Tensor<3> {
        let x: Tensor<4> = golden.tensor(name, &device);
        x.swap_dims(2, 3).reshape([batch, heads * channels, time])
    };
    let heads_of = |x: Tensor<3>| x.reshape([batch, heads, channels, time]).swap_dims(2, 3);
    let rotation = |turns: bool| Rotation::new(32, time, &[turns], &device);
    let turned = |name: &str, turns| heads_of(rotation(turns).turn(flat(name), heads));
    // As logits are.
    let scaled = |dots: Tensor<4>| dots / (channels as f64).sqrt();
    let (q, k) = (turned("in.q", true), turned("in.k", true));
    for (name, found, tolerance) in [
        ("out.q_rotated", q.clone(), 2e-5),
        ("out.k_rotated", k.clone(), 2e-5),
        ("out.q_absolute_mode", turned("in.q", false), 2e-5),
        ("out.dots", scaled(q.matmul(k.swap_dims(2, 3))), 5e-5),
    ] {
        golden.get(name).assert_within(name, found, tolerance, 0.0);
    }
    // Fifty frames later, the products are the same.
    let shifted = Rotation::new(32, time + 50, &[true], &device);
    let late = |name: &str| {
        let x = flat(name);
        let zeros = Tensor::zeros([batch, heads * channels, 50], &device);
        let x = shifted
            .turn(Tensor::cat(vec![zeros, x], 2), heads)
            .narrow(2, 50, time);
        heads_of(x)
    };
    let dots = scaled(late("in.q").matmul(late("in.k").swap_dims(2, 3)));
    let name = "out.dots_shifted_by_50";
    golden.get(name).assert_within(name, dots, 5e-5, 0.0);
    compare_masks(&golden);
}

/// The attention ranges of frames, and their conditions.
fn compare_masks(golden: &Golden) {
    let lengths = counts(golden, "in.segment_lengths");
    let time: usize = lengths.iter().sum();
    let script = TextSegments::new([motion(&lengths, 0, 1)]);
    let places = |script: &TextSegments, time| {
        let places = script.places(time).concat();
        places.into_iter().map(|p| p as f64).collect::<Vec<_>>()
    };
    golden.compare_exactly("out.segment_positions", &places(&script, time));
    let mask = |ranges: &KeyRanges, sample: usize, time: usize| -> Vec<f64> {
        let pairs = (0..time).flat_map(|query| (0..time).map(move |key| (query, key)));
        let allowed = pairs.map(|(query, key)| ranges.of(sample, query).contains(&key));
        allowed
            .map(|allowed| f64::from(u8::from(allowed)))
            .collect()
    };
    let all = script.ranges(time, time, &[false]);
    golden.compare_exactly("out.same_segment", &mask(&all, 0, time));
    for horizon in [2, 5] {
        let band = script.ranges(time, horizon, &[true]);
        golden.compare_exactly(&format!("out.band{horizon}"), &mask(&band, 0, time));
    }
    // A padded batch.
    let both = [
        counts(golden, "in.batch.lengths0"),
        counts(golden, "in.batch.lengths1"),
    ];
    let time = golden.get("out.batch.positions").shape[1];
    let script = TextSegments::new(both.iter().map(|lengths| motion(lengths, 0, 1)));
    golden.compare_exactly("out.batch.positions", &places(&script, time));
    let counted: Vec<f64> = script
        .frames()
        .flat_map(|frames| (0..time).map(move |t| f64::from(u8::from(t < frames))))
        .collect();
    golden.compare_exactly("out.batch.mask", &counted);
}

fn golden_pose_centric_attention(golden: Golden) {
    let device = Device::flex().autodiff();
    let shape = |name: &str| golden.get(&format!("model.{name}")).shape;
    let config = BlendedConfig {
        latent_dim: shape("to_q.weight")[1],
        num_heads: shape("to_q.weight")[0] / HEAD_CHANNELS,
        ..BlendedConfig::flowmdm_tiny()
    };
    let layer = PoseCentricAttention::new(&config, &Initializer::new(0, &device));
    let layer = parameters::load(layer, weights(&golden, "model.")).expect("the weights fit");
    let [batch, time, _] = golden.get("in.x").shape[..] else {
        panic!("frames of a batch")
    };
    let loss_weights: Tensor<3> = golden.tensor("in.loss_weights", &device);
    for case in ["absolute", "relative", "mixed"] {
        let is_relative: Vec<bool> = match case {
            "absolute" => vec![false; batch],
            "relative" => vec![true; batch],
            _ => (0..batch).map(|element| element == 1).collect(),
        };
        // The allowed frames of the file are ranges.
        let allowed = golden.get(&format!("out.{case}.allowed")).values;
        let ranges = KeyRanges::new(allowed.chunks(time * time).map(|sample| {
            let range = |row: &[f64]| {
                let first = row.iter().position(|value| *value == 1.0).unwrap_or(0);
                let count = row.iter().filter(|value| **value == 1.0).count();
                assert!(row[first..first + count].iter().all(|value| *value == 1.0));
                first..first + count
            };
            sample.chunks(time).map(range).collect()
        }));
        let x = golden.tensor::<3>("in.x", &device).require_grad();
        let cond = golden.tensor::<3>("in.cond", &device).require_grad();
        let turned = |x: &Tensor<3>| x.clone().swap_dims(1, 2);
        // Each frame has its own condition.
        let told = cond.clone().reshape([(batch * time) as i64, -1]);
        let rows = Tensor::arange(0..(batch * time) as i64, &device);
        let shared = Shared::new(told, rows, ranges, &is_relative);
        let y = layer.forward(turned(&x), &shared).swap_dims(1, 2);
        golden
            .get(&format!("out.{case}.y"))
            .assert_within(case, y.clone(), 1e-4, 0.0);
        let mut found = (y * loss_weights.clone()).sum().backward();
        let of = |tensor: &Tensor<3>, found: &_| tensor.grad(found).expect("part of the loss");
        for (name, gradient) in [("in.x", of(&x, &found)), ("in.cond", of(&cond, &found))] {
            golden
                .get(&format!("grad.{case}.{name}"))
                .assert_close_tensor(name, gradient, 2e-5);
        }
        let computed = kinegrad_models::gradients(&layer, &mut found);
        let prefix = format!("grad.{case}.model.");
        gradients::compare_under(&golden, &layer, &computed, &prefix, 2e-5);
    }
}
