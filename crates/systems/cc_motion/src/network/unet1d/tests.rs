//! Aligned conditioning: inputs, padding and gradients.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{Denoiser, Time};
use kinegrad_kernels::{Lengths, Mode};
use kinegrad_models::{NetworkConfig, parameters};
use kinegrad_random::{Key, Purpose};
use serde::Deserialize;
use serde::de::value::{Error as ValueError, MapDeserializer};

use super::*;

const FEATURES: usize = 19;

fn config(audio_conditioning: AudioConditioning) -> UNet1dConfig {
    UNet1dConfig {
        audio_conditioning,
        context_dim: 32,
        ..UNet1dConfig::tiny()
    }
}

fn network(audio_conditioning: AudioConditioning, device: &Device) -> UNet1d {
    let init = Initializer::new(3, device);
    let network = config(audio_conditioning).init(25, FEATURES, &init);
    network.expect("a valid network")
}

fn aligned(device: &Device) -> UNet1d {
    network(AudioConditioning::Aligned, device)
}

fn normal(stream: u64, shape: [usize; 3], device: &Device) -> Tensor<3> {
    let values = Key::new(8, Purpose::Noise).at(stream);
    let values = values.normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// The frames of `features` in another order.
fn ordered(features: &Tensor<3>, order: impl Iterator<Item = usize>) -> Tensor<3> {
    let frames = order.map(|t| features.clone().narrow(2, t, 1)).collect();
    Tensor::cat(frames, 2)
}

fn largest(x: Tensor<3>) -> f32 {
    x.abs().max().into_scalar::<f32>()
}

#[test]
fn the_order_of_the_audio_matters_to_an_aligned_network_alone() {
    let (device, time) = (Device::flex(), 37);
    let x = normal(0, [2, 25, time], &device);
    let audio = normal(1, [2, FEATURES, time], &device);
    let orders: [(&str, Vec<usize>); 4] = [
        ("reversed", (0..time).rev().collect()),
        ("rolled", (0..time).map(|t| (t + 7) % time).collect()),
        (
            "rolled by a frame",
            (0..time).map(|t| (t + 1) % time).collect(),
        ),
        ("shuffled", (0..time).map(|t| (t * 10 + 3) % time).collect()),
    ];
    for (conditioning, ordered_in_time) in [
        (AudioConditioning::Ccmotion, false),
        (AudioConditioning::Aligned, true),
    ] {
        let network = network(conditioning, &device);
        let of = |audio: Tensor<3>| network.forward(x.clone(), &Time::of(&[700, 3]), audio, None);
        let own = of(audio.clone());
        // Other audio changes both samples.
        let other = of(normal(2, [2, FEATURES, time], &device));
        let by_other = largest(own.clone() - other);
        assert!(by_other > 0.01, "{conditioning:?}: {by_other}");
        for (name, order) in &orders {
            let changed = largest(own.clone() - of(ordered(&audio, order.iter().copied())));
            match ordered_in_time {
                true => assert!(changed > 0.2 * by_other, "{name}: {changed}, {by_other}"),
                false => assert!(changed <= 1e-5, "{name}: {changed}"),
            }
        }
    }
}

/// A change of one audio frame affects nearby frames most.
#[test]
fn audio_is_joined_where_it_sounds() {
    let (device, time, at) = (Device::flex(), 64, 40);
    let network = aligned(&device);
    let x = normal(0, [1, 25, time], &device);
    let audio = normal(1, [1, FEATURES, time], &device);
    let sound = normal(2, [1, FEATURES, 1], &device).mul_scalar(3.0);
    let [before, after] = [(0, at), (at + 1, time - at - 1)]
        .map(|(first, frames)| audio.clone().narrow(2, first, frames));
    let changed = Tensor::cat(vec![before, sound, after], 2);
    let of = |audio: Tensor<3>| network.forward(x.clone(), &Time::of(&[300]), audio, None);
    let change = (of(audio) - of(changed)).square().sum_dim(1);
    let change = change.try_into_vec_as::<f32>().expect("float32");
    let mean = |frames: std::ops::Range<usize>| {
        let count = frames.len() as f32;
        change[frames].iter().sum::<f32>() / count
    };
    let (near, far) = (mean(at - 2..at + 3), mean(0..16));
    assert!(near > 10.0 * far, "{near} {far}");
}

fn on(device: &Device, mode: Mode, length: usize) -> [Tensor<3>; 2] {
    // Padding in a batch has noise in the motion and zeros in the audio; here the audio also has
    // noise.
    mode.scope(|| {
        let network = aligned(device);
        let time = 29;
        let lengths = [length, time];
        let x = normal(0, [2, 25, time], device);
        let features = normal(1, [2, FEATURES, time], device);
        let padded = AudioCondition {
            features: features.clone(),
            lengths: Some(Lengths::new(lengths)),
            style: None,
            teacher_forcing: false,
        };
        let times = Time::of(&[700, 3]);
        let padded = network.forward(x.clone(), &times, padded, None);
        let part = |x: &Tensor<3>, frames| x.clone().narrow(0, 0, 1).narrow(2, 0, frames);
        let alone = network.forward(part(&x, length), &times[..1], part(&features, length), None);
        // The longer clip equals the clip in a batch without lengths.
        let whole = network.forward(x, &times, features, None);
        let second = |x: Tensor<3>| x.narrow(0, 1, 1);
        let apart = largest(second(padded.clone()) - second(whole));
        assert!(apart < 1e-5, "{mode:?}: {apart}");
        [part(&padded, length), alone]
    })
}

#[test]
fn padding_changes_nothing_that_is_real() {
    for mode in [Mode::Fused, Mode::Composed] {
        // Lengths that are odd and even at every level, and shorter than the coarsest level's
        // stride.
        for length in [28, 21, 16, 13, 9, 3, 1] {
            let [padded, alone] = on(&Device::flex(), mode, length);
            let apart = largest(padded - alone.clone());
            let scale = largest(alone);
            // Each normalization over one or two frames multiplies rounding by up to 1 /
            // sqrt(1e-5).
            let allowed = if length < 8 { 1e-2 } else { 2e-5 };
            assert!(
                apart < allowed * scale.max(1.0),
                "{mode:?}, {length}: {apart}"
            );
        }
    }
}

#[test]
fn the_two_modes_agree_with_padding() {
    let [fused, composed] =
        [Mode::Fused, Mode::Composed].map(|mode| on(&Device::flex(), mode, 13)[0].clone());
    assert!(largest(fused - composed) < 2e-5);
}

/// Frames of a batch, and of its shorter clip. The coarsest level has several frames, because
/// normalization of two numbers is nearly a step function.
const FRAMES: usize = 52;
const SHORTER: usize = 37;

/// The loss of real frames, its gradients by parameter, and its gradient by the audio.
fn loss_and_gradients(network: &UNet1d, mode: Mode) -> (f64, Vec<Vec<f32>>, Vec<f32>) {
    mode.scope(|| {
        let device = Device::flex().autodiff();
        let (time, lengths) = (FRAMES, Lengths::new([SHORTER, FRAMES]));
        let features = normal(1, [2, FEATURES, time], &device).require_grad();
        let cond = AudioCondition {
            features: features.clone(),
            lengths: Some(lengths.clone()),
            style: None,
            teacher_forcing: false,
        };
        let x = normal(0, [2, 25, time], &device);
        let output = network.forward(x, &Time::of(&[700, 3]), cond, None);
        let target = normal(2, [2, 25, time], &device);
        let real = lengths.mask(time, &device);
        let loss = ((output - target) * real).square().mean();
        let mut tracked = loss.backward();
        let of_audio = features.grad(&tracked).expect("a leaf");
        let gradients = kinegrad_models::gradients(network, &mut tracked);
        let of_audio = of_audio.try_into_vec_as::<f32>().expect("float32");
        (f64::from(loss.into_scalar::<f32>()), gradients, of_audio)
    })
}

#[test]
fn gradients_of_the_kernels_are_those_of_burns_operations() {
    let network = aligned(&Device::flex().autodiff());
    let (_, fused, audio_fused) = loss_and_gradients(&network, Mode::Fused);
    let (_, composed, audio_composed) = loss_and_gradients(&network, Mode::Composed);
    let largest = |values: &[f32]| values.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    let overall = fused.iter().map(|g| largest(g)).fold(0.0, f32::max);
    let infos = parameters::infos(&network);
    for ((info, fused), composed) in infos.iter().zip(&fused).zip(&composed) {
        let apart = fused.iter().zip(composed).map(|(a, b)| (a - b).abs());
        let apart = apart.fold(0.0, f32::max);
        let scale = largest(composed).max(1e-3 * overall);
        assert!(apart < 5e-4 * scale, "{}: {apart} of {scale}", info.name);
    }
    // Audio padding has no gradient; real frames have the same gradient in both modes.
    let scale = largest(&audio_fused);
    for (index, (fused, composed)) in audio_fused.iter().zip(&audio_composed).enumerate() {
        assert!(
            (fused - composed).abs() < 5e-4 * scale,
            "{fused} {composed}"
        );
        let (sample, frame) = (index / (FEATURES * FRAMES), index % FRAMES);
        assert!(
            sample == 1 || frame < SHORTER || *fused == 0.0,
            "padding: {fused}"
        );
    }
}

/// Compares the gradient of every new parameter with the loss's slope along the gradient.
#[test]
fn gradients_of_the_encoder_are_slopes_of_the_loss() {
    let network = aligned(&Device::flex().autodiff());
    let (_, gradients, _) = loss_and_gradients(&network, Mode::Fused);
    let infos = parameters::infos(&network);
    let values = parameters::values(&network);
    let mut checked = 0;
    for (index, info) in infos.iter().enumerate() {
        if !info.name.contains("audio") && !info.name.contains("kv_cross") {
            continue;
        }
        let gradient = &gradients[index];
        let norm = gradient
            .iter()
            .map(|&g| f64::from(g).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(norm > 1e-6, "{} does not matter", info.name);
        // A step that changes the loss by about a thousandth.
        let step = (1e-3 / norm).min(0.05);
        let moved = |by: f64| {
            let mut values = values.clone();
            for (value, g) in values[index].iter_mut().zip(gradient) {
                *value += (by * f64::from(*g) / norm) as f32;
            }
            let network = parameters::replace(network.clone(), values);
            loss_and_gradients(&network, Mode::Fused).0
        };
        let slope = (moved(step) - moved(-step)) / (2.0 * step);
        let error = (slope - norm).abs() / norm;
        assert!(
            error < 0.05,
            "{}: {norm}, by differences {slope}",
            info.name
        );
        checked += 1;
    }
    // Stem, four levels, additions in encoder and decoder, and six projections of the context:
    // weight and bias.
    assert_eq!(checked, 2 * (1 + 3 + 2 * 4 + 4 + 3 + 6));
}

#[test]
fn the_null_condition_is_silence_of_the_same_lengths() {
    let (device, time) = (Device::flex(), 11);
    let network = aligned(&device);
    let cond = AudioCondition {
        features: normal(1, [2, FEATURES, time], &device),
        lengths: Some(Lengths::new([7, 11])),
        style: None,
        teacher_forcing: false,
    };
    let null = network.null_cond(&cond);
    assert_eq!(null.lengths, cond.lengths);
    assert_eq!(largest(null.features.clone()), 0.0);
    let x = normal(0, [2, 25, time], &device);
    let times = Time::of(&[700, 3]);
    let [with, without] = [&cond, &null].map(|cond| network.predict(x.clone(), &times, cond));
    assert!(largest(with - without.clone()) > 0.01);
    // A training step drops the condition with the same zeros.
    let dropped = AudioCondition {
        features: cond.features * Tensor::zeros([2, 1, 1], &device),
        lengths: null.lengths,
        style: None,
        teacher_forcing: false,
    };
    let dropped = network.predict(x, &times, &dropped);
    assert_eq!(largest(dropped - without), 0.0);
}

#[test]
fn adapters_reach_the_encoder_and_merge() {
    let device = Device::flex().autodiff();
    let conditioning = kinegrad_models::LoraConfig {
        targets: vec![kinegrad_models::LoraTarget::Conditioning],
        ..Default::default()
    };
    let init = Initializer::new(9, &device);
    let plain = aligned(&device);
    let adapted = plain.clone().with_adapters(&conditioning, &init);
    let adapted = adapted.expect("valid adapters");
    let names = parameters::infos(&adapted)
        .into_iter()
        .map(|info| info.name);
    let adapters: Vec<String> = names.filter(|name| name.ends_with(".lora.a")).collect();
    // The projections of the timestep, the stem, four and three convolutions, seven additions of
    // audio.
    assert_eq!(adapters.len(), 16 + 1 + 4 + 3 + 7);
    for layer in [
        "audio.stem",
        "audio.levels.1.down",
        "enc.0.audio",
        "dec.2.audio",
    ] {
        assert!(adapters.contains(&format!("{layer}.lora.a")), "{layer}");
    }
    let trained = parameters::update(adapted, |index, values| {
        let noise = Key::new(5, Purpose::Noise)
            .at(index as u64)
            .normals(values.len());
        values
            .iter_mut()
            .zip(noise)
            .for_each(|(value, noise)| *value += 0.05 * noise);
    });
    let output = |network: &UNet1d| {
        let [x, audio] = [(0, 25), (1, FEATURES)].map(|(n, c)| normal(n, [2, c, 11], &device));
        network.forward(x, &Time::of(&[3, 700]), audio, None)
    };
    let (before, changed) = (output(&plain), output(&trained));
    assert!(largest(before - changed.clone()) > 0.01);
    let merged = trained.merge_adapters();
    assert_eq!(parameters::infos(&merged), parameters::infos(&plain));
    assert!(largest(output(&merged) - changed) < 2e-5);
}

#[test]
fn sizes_that_cannot_be_aligned_are_refused_by_key() {
    let aligned = AudioConditioning::Aligned;
    let refused = |config: UNet1dConfig| config.validate().expect_err("refused").key;
    let odd = |audio_conditioning| UNet1dConfig {
        // Heads of one channel at attention with 32 channels.
        num_heads: 32,
        ..config(audio_conditioning)
    };
    assert_eq!(refused(odd(aligned)), "model.num_heads");
    odd(AudioConditioning::Ccmotion)
        .validate()
        .expect("no pairs needed");
    let narrow = |audio_conditioning| UNet1dConfig {
        context_dim: 48,
        ..config(audio_conditioning)
    };
    assert_eq!(refused(narrow(aligned)), "model.context_dim");
    narrow(AudioConditioning::Ccmotion)
        .validate()
        .expect("any width");
    // In the decoder, attention of level 1 has level 0's width.
    let up = UNet1dConfig {
        model_channels: 32,
        channel_mult: vec![1, 2],
        num_heads: 64,
        ..UNet1dConfig::tiny()
    };
    assert_eq!(
        refused(UNet1dConfig {
            channel_mult: vec![1, 2, 2],
            ..up
        }),
        "model.num_heads"
    );
}

#[test]
fn old_configs_are_read_as_ccmotion() {
    let read = |entry: (&'static str, &'static str)| {
        let entries = MapDeserializer::<_, ValueError>::new([entry].into_iter());
        UNet1dConfig::deserialize(entries)
    };
    assert_eq!(
        UNet1dConfig::default().audio_conditioning,
        AudioConditioning::Ccmotion
    );
    let aligned = read(("audio_conditioning", "aligned")).expect("a value of the key");
    assert_eq!(aligned.audio_conditioning, AudioConditioning::Aligned);
    for (_, size) in UNet1dConfig::SIZES {
        assert_eq!(size().audio_conditioning, AudioConditioning::Ccmotion);
    }
    let error = read(("audio_conditioning", "set"))
        .expect_err("no value")
        .to_string();
    assert!(
        error.contains("`ccmotion`") && error.contains("`aligned`"),
        "{error}"
    );
}

#[test]
fn rescaled_timesteps_are_other_timesteps() {
    let device = Device::flex();
    let plain = network(AudioConditioning::Ccmotion, &device);
    let x = normal(0, [1, 25, 12], &device);
    let audio = normal(1, [1, FEATURES, 12], &device);
    let of = |network: &UNet1d, t: usize| {
        network.forward(x.clone(), &Time::of(&[t]), audio.clone(), None)
    };
    let (at_100, at_400) = (of(&plain, 100), of(&plain, 400));
    let rescaled = plain.with_timestep_scale(4.0);
    assert_eq!(of(&rescaled, 100).into_data(), at_400.clone().into_data());
    assert!(largest(at_100 - at_400) > 1e-3);
}

#[test]
fn heads_of_a_number_of_channels_are_more_on_wider_levels() {
    let wide = UNet1dConfig {
        num_head_channels: Some(16),
        channel_mult: vec![1, 2],
        ..config(AudioConditioning::Ccmotion)
    };
    wide.validate().expect("a divisor of both widths");
    assert_eq!((wide.heads(32), wide.heads(64)), (2, 4));
    let eight = config(AudioConditioning::Ccmotion);
    assert_eq!((eight.heads(32), eight.heads(64)), (8, 8));
    let refused = |channels| {
        let config = UNet1dConfig {
            num_head_channels: Some(channels),
            ..config(AudioConditioning::Aligned)
        };
        config.validate().expect_err("refused").key
    };
    for channels in [0, 5, 64, 1] {
        assert_eq!(refused(channels), "model.num_head_channels", "{channels}");
    }
}
