//! The transformer with blended positional encodings, its draws and its metrics against the golden
//! files of `flowmdm`. The tolerances are the reference data's own.

use std::ops::ControlFlow;
use std::path::PathBuf;

use burn::module::Module as _;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{
    ClipRange, Denoiser as _, GivenNoise, NoiseKeys, Path, Prediction, PredictionType, Time, ddpm,
    ddpm_step, guided,
};
use kinegrad_kernels::KeyRanges;
use kinegrad_models::blended::{
    BlendedConfig, BlendedTransformer, Composed, HEAD_CHANNELS, Pass, PoseCentricAttention, Script,
    Segment, Shared, Switch, absolute_positions,
};
use kinegrad_models::gmd::interleaved_sinusoidal;
use kinegrad_models::rotary::Rotation;
use kinegrad_models::{Initializer, parameters};
use kinegrad_motion::humanml::{FeatureLayout, Features, Joints, Root};
use kinegrad_motion::metrics::{BABEL_JERK, HUMANML3D_JERK, TransitionJerk, jerk_of_frames};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors, compared, values, wide};
use kinegrad_tests::stages::Noted;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{gradients, trials, weights};
use kinegrad_train::config::OptimConfig;
use kinegrad_train::optim::AdamW;

use super::gmd::bench::process;

const STAGE: f64 = 4e-4;
const GRADIENT: f64 = 4e-4;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_blended_positions("flowmdm/positions.safetensors"),
        golden_pose_centric_attention("flowmdm/attention_pccat.safetensors"),
        golden_blended_single_text("flowmdm/denoiser_single.safetensors"),
        golden_blended_several_texts("flowmdm/denoiser_multi.safetensors"),
        golden_blended_schedule("flowmdm/schedule_bpe.safetensors"),
        golden_composition_sampling("flowmdm/composition_sampling.safetensors"),
        golden_composition_decode("flowmdm/composition_decode.safetensors"),
        golden_transition_jerk("flowmdm/jerk.safetensors"),
        golden_blended_training("flowmdm/training.safetensors"),
        golden_published_names("flowmdm/keys_humanml3d.csv"),
    ]
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

/// The network of a file: its sizes are those of its weights.
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

/// A motion of so many segments, told texts from `first` on, `stride` rows apart.
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
    // Fifty frames on, the products are the same.
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

/// Which frames attend to which, and what they are told.
fn compare_masks(golden: &Golden) {
    let lengths = counts(golden, "in.segment_lengths");
    let time: usize = lengths.iter().sum();
    let script = Script::new([motion(&lengths, 0, 1)]);
    let places = script.places(time);
    golden.compare_exactly("out.segment_positions", &places[0]);
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
    let script = Script::new(both.iter().map(|lengths| motion(lengths, 0, 1)));
    golden.compare_exactly("out.batch.positions", &script.places(time).concat());
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
        // The file says which frames are allowed; they are ranges.
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
        let shared = Shared::new(turned(&cond), ranges, &is_relative);
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

/// One forward pass with gradients of a case of a denoiser file.
struct Case<'a> {
    golden: &'a Golden,
    network: &'a BlendedTransformer,
    name: &'a str,
    script: &'a Script,
    is_relative: Vec<bool>,
    time: Vec<Time>,
    /// Of each text whether it is dropped.
    dropped: Vec<bool>,
}

impl Case<'_> {
    fn run(&self, text: &str, loss_weights: &Tensor<3>, device: &Device) {
        let golden = self.golden;
        let x = golden.get("in.x").flat().tensor::<3>(device).require_grad();
        let stored = golden.get(text);
        let channels = *stored.shape.last().expect("text features");
        let texts: Tensor<2> = Tensor::from_data(
            TensorData::new(stored.f32s(), [stored.values.len() / channels, channels]),
            device,
        )
        .require_grad();
        let kept: Vec<f32> = self
            .dropped
            .iter()
            .map(|dropped| f32::from(u8::from(!dropped)))
            .collect();
        let count = kept.len();
        let kept = Tensor::<2>::from_data(TensorData::new(kept, [count, 1]), device);
        let pass = Pass {
            script: self.script,
            is_relative: &self.is_relative,
            dropout: None,
        };
        let mut stages = Noted::default();
        let told = texts.clone() * kept;
        let y = self
            .network
            .forward_stages(x.clone(), &self.time, told, pass, &mut stages);
        let name = self.name;
        compare_stages(golden, &stages, &format!("out.{name}."));
        golden
            .get(&format!("out.{name}.y"))
            .flat()
            .assert_within(name, y.clone(), STAGE, 0.0);
        let uncond = format!("out.{name}.y_uncond");
        if golden.has(&uncond) {
            let without = self
                .network
                .forward(x.clone(), &self.time, texts.zeros_like(), pass);
            golden
                .get(&uncond)
                .flat()
                .assert_within(&uncond, without, STAGE, 0.0);
        }
        let loss = (y * loss_weights.clone()).sum();
        golden
            .get(&format!("out.{name}.loss"))
            .assert_within("loss", loss.clone(), STAGE, STAGE);
        let mut found = loss.backward();
        let mut inputs = vec![("in.x", values(x.grad(&found).expect("part of the loss")))];
        if golden.has(&format!("grad.{name}.in.text_features")) {
            inputs.push((
                "in.text_features",
                values(texts.grad(&found).expect("part too")),
            ));
        }
        let computed = kinegrad_models::gradients(self.network, &mut found);
        for (input, gradient) in inputs {
            let stored = golden.get(&format!("grad.{name}.{input}"));
            stored.assert_close_f32(input, &gradient, GRADIENT);
        }
        let prefix = format!("grad.{name}.model.");
        gradients::compare_under(golden, self.network, &computed, &prefix, GRADIENT);
    }
}

/// The loss weights, zero in padding.
fn loss_weights(golden: &Golden, device: &Device) -> Tensor<3> {
    let mask = golden.get("in.mask").flat();
    let [batch, 1, time] = mask.shape[..] else {
        panic!("{:?}", mask.shape)
    };
    let mask = Tensor::<3>::from_data(TensorData::new(mask.f32s(), [batch, 1, time]), device);
    motions(golden, "in.loss_weights", device) * mask
}

fn golden_blended_single_text(golden: Golden) {
    let device = Device::flex().autodiff();
    let network = network(&golden, &device);
    let script = Script::single(counts(&golden, "in.lengths"));
    let switch = switch(&golden);
    let weights = loss_weights(&golden, &device);
    let plain = network.valid();
    let at = |name: &str| Time::of(&golden.get(name).indices());
    for name in ["absolute", "relative"] {
        let time = at(&format!("in.{name}.t"));
        let is_relative: Vec<bool> = time
            .iter()
            .map(|time| switch.is_relative(time.timestep()))
            .collect();
        assert_eq!(is_relative, [name == "relative"; 2]);
        let case = Case {
            golden: &golden,
            network: &network,
            name,
            script: &script,
            is_relative,
            time: time.clone(),
            dropped: vec![false; 2],
        };
        case.run("in.text_features", &weights, &device);
        let composed = Composed {
            network: &plain,
            script: script.clone(),
            switch,
        };
        let device = Device::flex();
        let text = golden
            .tensor::<2>("in.text_features", &device)
            .unsqueeze_dim(2);
        let scale = golden.get("in.guidance").scalar();
        let x = motions(&golden, "in.x", &device);
        let mixed = guided(&composed, x, &time, &text, scale);
        let name = format!("out.{name}.y_cfg");
        golden
            .get(&name)
            .flat()
            .assert_within(&name, mixed, 3e-3, 0.0);
    }
    // The last absolute step and the first relative one.
    let device = Device::flex();
    let text = golden
        .tensor::<2>("in.text_features", &device)
        .unsqueeze_dim(2);
    let composed = Composed {
        network: &plain,
        script,
        switch,
    };
    for (index, t) in golden.get("in.switch.t").indices().into_iter().enumerate() {
        let x = motions(&golden, "in.x", &device);
        let y = composed.predict(x, &Time::of(&[t; 2]), &text);
        let expected = golden.get("out.switch.y").part(index).flat();
        expected.assert_within("switch", y, STAGE, 0.0);
    }
}

/// The script of a file with `in.lengths0` and `in.lengths1`, whose texts lie
/// `[segments, batch, width]`.
fn two_motions(golden: &Golden) -> Script {
    let both = ["in.lengths0", "in.lengths1"].map(|name| counts(golden, name));
    Script::new([motion(&both[0], 0, 2), motion(&both[1], 1, 2)])
}

fn golden_blended_several_texts(golden: Golden) {
    let device = Device::flex().autodiff();
    let network = network(&golden, &device);
    let script = two_motions(&golden);
    let weights = loss_weights(&golden, &device);
    let switch = switch(&golden);
    let texts: usize = golden.get("in.text_features").shape[..2].iter().product();
    let at = |name: &str| Time::of(&golden.get(name).indices());
    for name in ["absolute", "relative"] {
        let time = at(&format!("in.{name}.t"));
        let case = Case {
            golden: &golden,
            network: &network,
            name,
            script: &script,
            is_relative: time
                .iter()
                .map(|time| switch.is_relative(time.timestep()))
                .collect(),
            time,
            dropped: vec![false; texts],
        };
        case.run("in.text_features", &weights, &device);
    }
    for name in ["mixed", "mixed_swapped"] {
        let case = Case {
            golden: &golden,
            network: &network,
            name,
            script: &script,
            is_relative: flags(&golden, &format!("in.{name}.is_relative")),
            time: at("in.train.t"),
            dropped: flags(&golden, "in.train.text_drop"),
        };
        case.run("in.text_features", &weights, &device);
    }
}

fn golden_blended_schedule(golden: Golden) {
    let diffusion = process(PredictionType::Sample);
    let schedule = &diffusion.schedule;
    let same = |name: &str, values: &[f64]| {
        golden
            .get(name)
            .assert_within_f64(name, values, 1e-12, 1e-12);
    };
    same("out.betas_initial", &schedule.betas);
    same("out.alphas_cumprod", &schedule.alphas_cumprod);
    same("out.alphas_cumprod_prev", &schedule.alphas_cumprod_prev);
    same("out.sqrt_alphas_cumprod", &schedule.sqrt_alphas_cumprod);
    same(
        "out.sqrt_one_minus_alphas_cumprod",
        &schedule.sqrt_one_minus_alphas_cumprod,
    );
    same("out.posterior_mean_coef1", &schedule.posterior_mean_coef1);
    same("out.posterior_mean_coef2", &schedule.posterior_mean_coef2);
    same("out.posterior_variance", &schedule.posterior_variance);
    let steps = golden.get("in.bpe_step").values;
    let of = |k: f64| Switch {
        bpe_denoising_step: k as i64,
        num_train_timesteps: 1000,
    };
    let relative = |k: f64| (0..1000).map(move |t| f64::from(u8::from(of(k).is_relative(t))));
    let flags: Vec<f64> = steps.iter().flat_map(|&k| relative(k)).collect();
    golden.compare_exactly("out.is_relative", &flags);
    let absolute: Vec<f64> = steps
        .iter()
        .map(|&k| 1000.0 - relative(k).sum::<f64>())
        .collect();
    golden.compare_exactly("out.absolute_steps", &absolute);
    let ratio = golden.get("in.train_ratio").scalar();
    for (input, output, ratio) in [
        ("in.train_uniform", "out.train_is_relative", ratio),
        ("in.train_uniform_r03", "out.train_is_relative_r03", 0.3),
    ] {
        let drawn = golden.get(input).values;
        let flags = drawn.iter().map(|u| f64::from(u8::from(*u < ratio)));
        golden.compare_exactly(output, &flags.collect::<Vec<f64>>());
    }
    // Respaced processes: the products at the timesteps that are kept.
    for steps in [25, 50] {
        let kept = golden
            .get(&format!("out.respaced{steps}.timestep_map"))
            .indices();
        let products: Vec<f64> = kept.iter().map(|&t| schedule.alphas_cumprod[t]).collect();
        same(&format!("out.respaced{steps}.alphas_cumprod"), &products);
    }
}

/// A draw from `start` along timesteps, with a given noise for each step, at a guidance scale.
struct Drawing<'a> {
    golden: &'a Golden,
    composed: &'a Composed<'a>,
    text: Tensor<3>,
    scale: f64,
}

impl Drawing<'_> {
    /// All states behind the start, and the last predicted motions.
    fn along(&self, start: Tensor<3>, timesteps: &[usize], noise: &str) -> [Vec<Tensor<3>>; 2] {
        let device = start.device();
        let noise = self.golden.get(noise);
        let noise = (0..timesteps.len()).map(|step| {
            let part = noise.part(step);
            let size: Vec<usize> = start.dims().to_vec();
            Tensor::from_data(TensorData::new(part.f32s(), size), &device)
        });
        let given = GivenNoise {
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
        let path = Path::to_clean(timesteps.iter().map(|&t| vec![t]).collect());
        ddpm(
            &diffusion,
            &mut predict,
            start,
            &path,
            NoiseKeys::Given(&given),
            &mut |_, _, state: &_| {
                states.push(state.clone());
                ControlFlow::Continue(())
            },
        )
        .expect("sizes fit");
        [states, predicted]
    }
}

fn compare_each(golden: &Golden, name: &str, from: usize, found: &[Tensor<3>], tolerance: f64) {
    let reference = golden.get(name);
    assert_eq!(reference.shape[0], found.len() + from, "{name}: steps");
    for (index, found) in found.iter().enumerate() {
        let expected = reference.part(index + from);
        let expected_size: usize = expected.values.len();
        let found = values(found.clone());
        assert_eq!(found.len(), expected_size, "{name}");
        expected.assert_within_f32(name, &found, tolerance, 0.0);
    }
}

/// What the composition files have in common.
fn composition(golden: &Golden) -> (BlendedTransformer, Script, Tensor<3>, f64) {
    let device = Device::flex();
    let network = network(golden, &device);
    let script = Script::new([motion(&counts(golden, "in.lengths"), 0, 1)]);
    let text = golden
        .tensor::<2>("in.text_features", &device)
        .unsqueeze_dim(2);
    (network, script, text, golden.get("in.guidance").scalar())
}

fn golden_composition_sampling(golden: Golden) {
    let (network, script, text, scale) = composition(&golden);
    let device = Device::flex();
    let switch = switch(&golden);
    let composed = |bpe_denoising_step: i64| Composed {
        network: &network,
        script: script.clone(),
        switch: Switch {
            bpe_denoising_step,
            ..switch
        },
    };
    let published = composed(switch.bpe_denoising_step);
    let drawing = Drawing {
        golden: &golden,
        composed: &published,
        text: text.clone(),
        scale,
    };
    // Single steps.
    let diffusion = process(PredictionType::Sample);
    let x_t = motions(&golden, "in.step.x_t", &device);
    for (index, t) in golden.get("in.step.t").indices().into_iter().enumerate() {
        let time = Time::of(&[t]);
        let part = |name: &str| golden.get(&format!("out.step.{name}")).part(index);
        let cond = published.predict(x_t.clone(), &time, &text);
        let uncond = published.predict(x_t.clone(), &time, &published.null_cond(&text));
        let x_start = guided(&published, x_t.clone(), &time, &text, scale);
        let noise = golden.get("in.step.noise").part(index).f32s();
        let noise = Tensor::from_data(TensorData::new(noise, x_t.dims()), &device);
        let prediction = Prediction::new(
            &diffusion,
            x_start.clone(),
            x_t.clone(),
            &[t],
            &ClipRange::None,
        );
        let prediction = prediction.expect("sizes fit");
        let before = [t.checked_sub(1)];
        let mean = ddpm_step(&diffusion, &prediction, &[t], &before, None, None);
        let sample = ddpm_step(&diffusion, &prediction, &[t], &before, Some(noise), None);
        for (name, found) in [
            ("cond", cond),
            ("uncond", uncond),
            ("pred_xstart", x_start),
            ("mean", mean),
            ("sample", sample),
        ] {
            part(name).assert_within_f32(name, &values(found), 1e-3, 0.0);
        }
    }
    // Consecutive steps across the switch, and the last ones.
    for (name, tolerance) in [("around_switch", 2e-5), ("last", 1e-3)] {
        let start = motions(&golden, &format!("in.{name}.x"), &device);
        let timesteps = golden.get(&format!("in.{name}.t")).indices();
        // A draw's path ends at clean motion: the last of these steps lands one timestep on, and so
        // the path goes further.
        let mut path = timesteps.clone();
        if let Some(next) = timesteps.last().and_then(|t| t.checked_sub(1)) {
            path.push(next);
        }
        let [states, _] =
            drawing.around(start, &path, timesteps.len(), &format!("in.{name}.noise"));
        compare_each(
            &golden,
            &format!("out.{name}.states"),
            1,
            &states,
            tolerance,
        );
    }
    // Whole draws of 25 steps.
    let timesteps = golden.get("in.respaced25.t").indices();
    let start = motions(&golden, "in.respaced25.noise_start", &device);
    let run = |composed: &Composed<'_>, scale: f64| {
        let drawing = Drawing {
            golden: &golden,
            composed,
            text: text.clone(),
            scale,
        };
        drawing.along(start.clone(), &timesteps, "in.respaced25.noise")
    };
    let [states, predicted] = run(&published, scale);
    compare_each(&golden, "out.respaced25.bpe.states", 0, &states, 3e-3);
    compare_each(
        &golden,
        "out.respaced25.bpe.pred_xstart",
        0,
        &predicted,
        3e-3,
    );
    for (name, step, scale) in [
        ("all_absolute", -1, scale),
        ("all_relative", 0, scale),
        ("chunked", switch.bpe_denoising_step, scale),
        ("no_guidance", switch.bpe_denoising_step, 1.0),
    ] {
        let [states, _] = run(&composed(step), scale);
        let name = format!("out.respaced25.{name}.final");
        let last = states.last().expect("steps").clone();
        golden
            .get(&name)
            .flat()
            .assert_within(&name, last, 3e-3, 0.0);
    }
}

impl Drawing<'_> {
    /// The first `steps` states of a draw along `timesteps`, of which there may be one more.
    fn around(
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
            x = ddpm_step(&diffusion, &prediction, &[t], &before, given, None);
            states.push(x.clone());
        }
        [states, predicted]
    }
}

/// Features `[frames, channels]` of normalised motion `[1, channels, time]`.
fn features(golden: &Golden, x: &Tensor<3>) -> Features {
    let (mean, std) = (golden.get("in.mean").values, golden.get("in.std").values);
    let [_, channels, time] = x.dims();
    let rows = values(x.clone().swap_dims(1, 2));
    let scaled = rows.iter().enumerate().map(|(place, value)| {
        let channel = place % channels;
        (f64::from(*value) * std[channel] + mean[channel]) as f32
    });
    let layout = FeatureLayout::of_channels(channels).expect("the layout of 22 joints");
    let rows: Vec<f32> = scaled.collect();
    assert_eq!(rows.len(), channels * time);
    Features::new(rows, layout, Root::Relative).expect("features")
}

fn golden_composition_decode(golden: Golden) {
    let (network, script, text, scale) = composition(&golden);
    let device = Device::flex();
    let composed = Composed {
        network: &network,
        script,
        switch: switch(&golden),
    };
    let drawing = Drawing {
        golden: &golden,
        composed: &composed,
        text,
        scale,
    };
    let timesteps = golden.get("in.t").indices();
    let start = motions(&golden, "in.noise_start", &device);
    let [states, _] = drawing.along(start, &timesteps, "in.noise");
    let drawn = states.last().expect("steps").clone();
    golden
        .get("out.sample")
        .flat()
        .assert_within("sample", drawn.clone(), 2e-3, 0.0);
    let decoded = features(&golden, &drawn);
    golden.compare("out.features", &wide(decoded.as_slice()), 4e-4);
    golden.compare("out.joints", &wide(&decoded.joints().to_f32()), 4e-4);
    // From the stored sample alone.
    let stored = motions(&golden, "out.sample", &device);
    let whole = features(&golden, &stored);
    golden.compare("out.joints", &wide(&whole.joints().to_f32()), 5e-6);
    // Windows around borders, each from its own first frame.
    let lengths = counts(&golden, "in.lengths");
    let width = number(&golden, "in.transition_length") as usize;
    let borders = lengths.iter().scan(0, |end, length| {
        *end += length;
        Some(*end)
    });
    let borders: Vec<usize> = borders.take(lengths.len() - 1).collect();
    let (mut rows, mut joints, mut curves) = (Vec::new(), Vec::new(), Vec::new());
    for border in borders {
        let first = border - width / 2;
        let window = whole.slice(first..first + width);
        rows.extend(wide(window.as_slice()));
        let window = window.joints();
        joints.extend(wide(&window.to_f32()));
        curves.extend(jerk_of_frames(&window));
    }
    golden.compare("out.window_features", &rows, 5e-6);
    golden.compare("out.window_joints", &joints, 5e-6);
    golden.compare("out.window_jerk", &curves, 1e-5);
}

fn golden_transition_jerk(golden: Golden) {
    let reference = golden.get("in.joints");
    let [_, frames, count, 3] = reference.shape[..] else {
        panic!("{:?}", reference.shape)
    };
    let lengths = counts(&golden, "in.lengths");
    let (places, _) = reference.values.as_chunks::<3>();
    let clips = places.chunks(frames * count).zip(&lengths);
    let curves = clips.map(|(clip, length)| {
        let joints = Joints::new(clip[..length * count].to_vec(), count).expect("finite");
        jerk_of_frames(&joints)
    });
    let curves: Vec<Vec<f64>> = curves.collect();
    let padded = curves.iter().flat_map(|curve| {
        let rest = vec![0.0; frames - 3 - curve.len()];
        curve.iter().copied().chain(rest)
    });
    golden.compare("out.jerk", &padded.collect::<Vec<f64>>(), 1e-5);
    for (name, published) in [("humanml3d", HUMANML3D_JERK), ("babel", BABEL_JERK)] {
        let real = golden.get(&format!("in.mean_jerk.{name}")).scalar();
        assert!((real - published).abs() < 1e-9);
        let found = TransitionJerk::of(&curves, real).expect("frames");
        golden.compare(&format!("out.auj.{name}"), &[found.area], 5e-6);
        golden.compare("out.peak_jerk", &[found.peak], 3e-6);
    }
    // Through features.
    let normalised = golden.get("in.features_normalised");
    let [clips, frames, channels] = normalised.shape[..] else {
        panic!("{:?}", normalised.shape)
    };
    let mut curves = Vec::new();
    for clip in 0..clips {
        let values = normalised.part(clip).f32s();
        let x = Tensor::<3>::from_data(
            TensorData::new(values, [1, frames, channels]),
            &Device::flex(),
        );
        let joints = features(&golden, &x.swap_dims(1, 2)).joints();
        curves.push(jerk_of_frames(&joints));
    }
    let found = TransitionJerk::of(&curves, HUMANML3D_JERK).expect("frames");
    golden.compare("out.features.peak_jerk", &[found.peak], 1e-5);
    golden.compare("out.features.auj_humanml3d", &[found.area], 1e-4);
}

/// The mean over elements of the mean squared error over what counts of each, `[batch]` first.
fn training_loss(x_start: &Tensor<3>, y: Tensor<3>, script: &Script) -> Tensor<1> {
    let [_, channels, time] = y.dims();
    let device = y.device();
    let frames: Vec<usize> = script.frames().collect();
    let mask = frames.iter().flat_map(|&frames| {
        let weight = 1.0 / (channels * frames) as f32;
        (0..time).map(move |t| if t < frames { weight } else { 0.0 })
    });
    let data = TensorData::new(mask.collect::<Vec<f32>>(), [frames.len(), 1, time]);
    let squares = (x_start.clone() - y).square() * Tensor::<3>::from_data(data, &device);
    squares.sum_dims_squeeze::<1, _>(&[1, 2])
}

fn golden_blended_training(golden: Golden) {
    let device = Device::flex().autodiff();
    let network = network(&golden, &device);
    let script = two_motions(&golden);
    let x_start = motions(&golden, "in.x0", &device);
    let timesteps = golden.get("in.t").indices();
    let noise = motions(&golden, "in.noise", &device);
    let x_t = process(PredictionType::Sample).add_noise(x_start.clone(), noise, &timesteps);
    golden
        .get("out.x_t")
        .flat()
        .assert_within("x_t", x_t.clone(), 5e-6, 0.0);
    let told = |name: &str, dropped: &str| -> Tensor<2> {
        let stored = golden.get(name);
        let width = *stored.shape.last().expect("text features");
        let dropped = flags(&golden, dropped);
        let kept = stored.f32s();
        let kept = kept.chunks(width).zip(dropped).flat_map(|(row, dropped)| {
            let factor = if dropped { 0.0 } else { 1.0 };
            row.iter().map(move |value| factor * value)
        });
        let kept: Vec<f32> = kept.collect();
        let rows = kept.len() / width;
        Tensor::from_data(TensorData::new(kept, [rows, width]), &device)
    };
    let is_relative = flags(&golden, "in.is_relative");
    let pass = Pass {
        script: &script,
        is_relative: &is_relative,
        dropout: None,
    };
    let time = Time::of(&timesteps);
    let y = network.forward(
        x_t.clone(),
        &time,
        told("in.text_features", "in.text_drop"),
        pass,
    );
    golden
        .get("out.pred")
        .flat()
        .assert_within("prediction", y.clone(), 4e-4, 0.0);
    let each = training_loss(&x_start, y, &script);
    golden
        .get("out.loss_per_element")
        .assert_close_tensor("loss of each", each.clone(), 1e-5);
    let loss = each.mean();
    golden
        .get("out.loss")
        .assert_close_tensor("loss", loss.clone(), 1e-5);
    let mut found = loss.backward();
    let computed = kinegrad_models::gradients(&network, &mut found);
    gradients::compare_under(&golden, &network, &computed, "grad.model.", 2e-4);
    compare_step(&golden, &network, &computed);
    // One text for each.
    let single = Script::single(script.frames());
    let pass = Pass {
        script: &single,
        ..pass
    };
    let texts = told("in.single.text_features", "in.single.text_drop");
    let y = network.forward(x_t, &time, texts, pass);
    golden
        .get("out.single.pred")
        .flat()
        .assert_within("single", y.clone(), 4e-4, 0.0);
    let each = training_loss(&x_start, y, &single);
    golden
        .get("out.single.loss_per_element")
        .assert_close_tensor("loss of each", each.clone(), 1e-5);
    let mut found = each.mean().backward();
    let computed = kinegrad_models::gradients(&network, &mut found);
    gradients::compare_under(&golden, &network, &computed, "grad.single.model.", 2e-4);
}

/// One step of AdamW: where a gradient is not rounding, its step is compared.
fn compare_step(golden: &Golden, network: &BlendedTransformer, computed: &[Vec<f32>]) {
    let rate = golden.get("in.lr").scalar();
    let config = OptimConfig {
        learning_rate: rate,
        weight_decay: 0.0,
        ..OptimConfig::default()
    };
    let before = parameters::export(network);
    let mut adamw = AdamW::new(
        &config,
        before.iter().map(|parameter| parameter.values.len()),
    );
    adamw.begin_step();
    let updated = golden.names_under("out.after_single_step.");
    for (index, parameter) in before.iter().enumerate() {
        let mut after = parameter.values.clone();
        adamw.update(index, &mut after, &computed[index], 1.0, rate, None);
        let name = &parameter.info.name;
        if !updated.contains(name) {
            continue;
        }
        let gradient = golden.get(&format!("grad.model.{name}")).values;
        let largest = gradient
            .iter()
            .fold(0.0f64, |most, value| most.max(value.abs()));
        let stored = golden.get(&format!("out.after_single_step.{name}")).values;
        let (mut found, mut expected) = (Vec::new(), Vec::new());
        for place in 0..after.len() {
            if gradient[place].abs() > 1e-3 * largest {
                let start = f64::from(parameter.values[place]);
                found.push((f64::from(after[place]) - start) / rate);
                expected.push((stored[place] - start) / rate);
            }
        }
        golden.compare_lists(&format!("step of {name}"), &found, &expected, 3e-2);
    }
}

/// Names, shapes and order of the published weights.
fn golden_published_names(path: PathBuf) {
    let text = std::fs::read_to_string(path).expect("readable");
    let rows = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').collect::<Vec<_>>());
    let published: Vec<(String, Vec<usize>)> = rows
        .filter(|row| row[3] == "parameter")
        .map(|row| {
            let shape = row[1].split('x').map(|size| size.parse().expect("a size"));
            (row[0].to_owned(), shape.collect())
        })
        .collect();
    let init = Initializer::new(0, &Device::flex());
    let network = BlendedConfig::flowmdm()
        .init(263, 512, &init)
        .expect("a network");
    let mut own: Vec<(String, Vec<usize>)> = parameters::infos(&network)
        .into_iter()
        .map(|info| (info.name, info.shape))
        .collect();
    let mut published = published;
    own.sort();
    published.sort();
    assert_eq!(own, published);
    compared(own.len());
}
