//! A network that tracks beats: inputs, and loss of the tracker.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::Time;
use kinegrad_kernels::Lengths;
use kinegrad_models::parameters;
use kinegrad_random::{Key, Purpose};

use super::*;

const FEATURES: usize = 11 + BEAT_CHANNELS;

fn network(device: &Device) -> UNet1d {
    let config = UNet1dConfig {
        audio_conditioning: AudioConditioning::Aligned,
        beats: Beats::Tracked,
        context_dim: 32,
        ..UNet1dConfig::tiny()
    };
    let network = config.init(25, FEATURES, &Initializer::new(3, device));
    network.expect("a valid network")
}

fn normal(stream: u64, shape: [usize; 3], device: &Device) -> Tensor<3> {
    let values = Key::new(8, Purpose::Noise).at(stream);
    let values = values.normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn largest(x: Tensor<3>) -> f32 {
    x.abs().max().into_scalar::<f32>()
}

#[test]
fn beats_are_tracked_in_the_music_and_not_in_the_labels() {
    let (device, time) = (Device::flex(), 37);
    let network = network(&device);
    let x = normal(0, [2, 25, time], &device);
    let [music, other, labels, wrong] = [(1, 11), (2, 11), (3, BEAT_CHANNELS), (4, BEAT_CHANNELS)]
        .map(|(stream, rows)| normal(stream, [2, rows, time], &device));
    let outputs = |music: &Tensor<3>, labels: &Tensor<3>| -> [Tensor<3>; 2] {
        let cond = AudioCondition::from(Tensor::cat(vec![music.clone(), labels.clone()], 1));
        let tracked = network.track_beats(&cond).expect("a tracker");
        [
            tracked,
            network.forward(x.clone(), &Time::of(&[400, 30]), cond, None),
        ]
    };
    let (before, relabelled, changed) = (
        outputs(&music, &labels),
        outputs(&music, &wrong),
        outputs(&other, &labels),
    );
    assert_eq!(before[0].dims(), [2, 2, time]);
    for ((a, b), c) in before.iter().zip(relabelled).zip(changed) {
        assert_eq!(largest(a.clone() - b), 0.0);
        assert!(largest(a.clone() - c) > 1e-3);
    }
    // The time of sounds matters: music shifted by a frame gives other tracked beats.
    let later = Tensor::cat(
        vec![
            music.clone().narrow(2, 0, 1),
            music.clone().narrow(2, 0, time - 1),
        ],
        2,
    );
    assert!(largest(outputs(&later, &labels)[0].clone() - before[0].clone()) > 1e-3);
}

#[test]
fn teacher_forcing_replaces_tracked_beats_where_there_are_labels() {
    let (device, time) = (Device::flex(), 29);
    let network = network(&device);
    let x = normal(0, [2, 25, time], &device);
    let music = normal(1, [2, 11, time], &device);
    // The first sample has labels of a beat of ten frames, the second sample has no labels.
    let labels = |start: f32| {
        let mut rows = vec![0.0f32; 2 * BEAT_CHANNELS * time];
        for t in 0..time {
            let angle = std::f32::consts::TAU * (start + t as f32 / 10.3);
            (rows[t], rows[time + t]) = angle.sin_cos();
        }
        Tensor::<3>::from_data(TensorData::new(rows, [2, BEAT_CHANNELS, time]), &device)
    };
    let predicted = |start: f32, teacher_forcing: bool| {
        let cond = AudioCondition {
            teacher_forcing,
            ..Tensor::cat(vec![music.clone(), labels(start)], 1).into()
        };
        let output = network.forward(x.clone(), &Time::of(&[400, 30]), cond, None);
        [0, 1].map(|sample| output.clone().narrow(0, sample, 1))
    };
    let [early, late, tracked] = [(0.11, true), (0.61, true), (0.11, false)]
        .map(|(start, teacher_forcing)| predicted(start, teacher_forcing));
    assert!(largest(early[0].clone() - late[0].clone()) > 1e-3);
    assert!(largest(early[0].clone() - tracked[0].clone()) > 1e-3);
    assert_eq!(largest(early[1].clone() - late[1].clone()), 0.0);
    assert_eq!(largest(early[1].clone() - tracked[1].clone()), 0.0);
}

#[test]
fn labels_and_tracked_beats_are_joined_frame_by_frame() {
    let (device, time) = (Device::flex(), 29);
    let network = network(&device);
    let lengths = Some(Lengths::new([29, 21]));
    let x = normal(0, [2, 25, time], &device);
    let music = normal(1, [2, 11, time], &device);
    let none = Tensor::zeros([2, BEAT_CHANNELS, time], &device);
    let cond = |labels: Tensor<3>, teacher_forcing: bool| AudioCondition {
        lengths: lengths.clone(),
        teacher_forcing,
        ..Tensor::cat(vec![music.clone(), labels], 1).into()
    };
    let predicted = |labels: Tensor<3>, teacher_forcing: bool| {
        let cond = cond(labels, teacher_forcing);
        network.forward(x.clone(), &Time::of(&[400, 30]), cond, None)
    };
    // The labels of the first half are the tracked beats, turned; the second half has no labels.
    let half = |turned: f32| {
        let found = network.find_beats(&cond(none.clone(), false));
        let unit = found.expect("a tracker").narrow(2, 0, 14);
        let (sin, cos) = (unit.clone().narrow(1, 0, 1), unit.narrow(1, 1, 1));
        let (s, c) = turned.sin_cos();
        let sin_turned = sin.clone() * c + cos.clone() * s;
        let labels = Tensor::cat(vec![sin_turned, cos * c - sin * s], 1);
        none.clone().slice_assign([0..2, 0..2, 0..14], labels)
    };
    let tracked = predicted(none.clone(), true);
    assert_eq!(largest(tracked.clone() - predicted(half(2.0), false)), 0.0);
    assert!(largest(tracked.clone() - predicted(half(0.0), true)) < 1e-4);
    assert!(largest(tracked - predicted(half(2.0), true)) > 1e-3);
}

#[test]
fn found_beats_have_a_constant_tempo_and_none_in_silence() {
    let (device, time) = (Device::flex(), 60);
    let network = network(&device);
    let music = normal(1, [1, FEATURES, time], &device);
    let both = Tensor::cat(vec![music.clone(), music.zeros_like()], 0);
    let found = network.find_beats(&both.into()).expect("a tracker");
    let norms = found.clone().square().sum_dim(1);
    assert!(largest(norms.clone().narrow(0, 0, 1) - 1.0) < 0.01);
    assert_eq!(largest(norms.narrow(0, 1, 1)), 0.0);
    // The tracked angle turns by nearly the same amount in each frame.
    let found: Vec<f32> = found
        .narrow(0, 0, 1)
        .into_data()
        .try_into_vec()
        .expect("values");
    let place = |t: usize| found[t].atan2(found[time + t]) / std::f32::consts::TAU;
    let steps = (1..time).map(|t| {
        let step = place(t) - place(t - 1);
        step - step.round()
    });
    let steps: Vec<f32> = steps.collect();
    let mean = steps.iter().sum::<f32>() / steps.len() as f32;
    assert!(
        mean > 0.01 && steps.iter().all(|step| (step - mean).abs() < 0.1),
        "{steps:?}"
    );
}

#[test]
fn its_tracker_learns_from_the_beats_alone() {
    let device = Device::flex().autodiff();
    let network = network(&device);
    let cond = AudioCondition::from(normal(1, [2, FEATURES, 23], &device));
    let x = normal(0, [2, 25, 23], &device);
    let moved = |loss: Tensor<1>| -> Vec<String> {
        let mut gradients = loss.backward();
        let names = parameters::infos(&network)
            .into_iter()
            .map(|info| info.name);
        let of = kinegrad_models::gradients(&network, &mut gradients);
        let moves = |values: &Vec<f32>| values.iter().any(|value| *value != 0.0);
        let named = names.zip(of);
        named
            .filter(|(_, values)| moves(values))
            .map(|(name, _)| name)
            .collect()
    };
    let is_tracker = |name: &String| name.starts_with("audio.beats.");
    let output = network.forward(x, &Time::of(&[400, 30]), cond.clone(), None);
    let of_motion = moved(output.square().sum());
    assert!(
        of_motion.len() > 20 && !of_motion.iter().any(is_tracker),
        "{of_motion:?}"
    );
    let of_beats = moved(
        network
            .track_beats(&cond)
            .expect("a tracker")
            .square()
            .sum(),
    );
    assert!(
        of_beats.len() >= 14 && of_beats.iter().all(is_tracker),
        "{of_beats:?}"
    );
}

#[test]
fn beats_are_tracked_where_there_are_some_to_learn_from() {
    let config = |audio_conditioning| UNet1dConfig {
        audio_conditioning,
        beats: Beats::Tracked,
        ..UNet1dConfig::tiny()
    };
    let init = Initializer::new(3, &Device::flex());
    for (conditioning, features) in [
        (AudioConditioning::Ccmotion, 170),
        (AudioConditioning::Aligned, BEAT_CHANNELS),
    ] {
        let error = config(conditioning).init(25, features, &init).unwrap_err();
        assert!(error.to_string().contains("model.beats"), "{error}");
    }
    // The default without the key.
    assert_eq!(UNet1dConfig::default().beats, Beats::Given);
}
