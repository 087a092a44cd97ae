//! From the network's samples to motion, and the jerk of transitions.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_bpe_transformer::network::Composed;
use kinegrad_motion::humanml::{FeatureLayout, Features, Joints, Root};
use kinegrad_motion::metrics::{BABEL_JERK, HUMANML3D_JERK, TransitionJerk, jerk_of_frames};
use kinegrad_tests::golden::{Golden, ReferenceTensors as _, values, wide};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

use super::drawing::{Drawing, composition};
use super::{counts, motions, number, switch};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_composition_decode("flowmdm/composition_decode.safetensors"),
        golden_transition_jerk("flowmdm/jerk.safetensors"),
    ]
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
        path: None,
        path_guidance_scale: 1.0,
        segments: script,
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
